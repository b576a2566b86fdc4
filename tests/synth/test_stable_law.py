"""`stable = true`: full-order laws that are stable by themselves, and what that costs."""

import re

import numpy as np
import pytest

from models.vehicle.vehicle import parse_vehicle, read_vehicle
from synth.command.check import check
from synth.design.full_order.full_order import full_order_design
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer
from synth.vehicle.state_space import law_system
from tests.support.shared import printed

HUB = 'measured = ["unsprung_acceleration", "control_force"]\norder = "full"\n'
CAR = re.sub("tyre_damping = .*\n", "", read_vehicle("quarter_car_semi_active").text)  # if its tyre damps, stability has a price
TEXT = f"{CAR}\n[controllers.free]\n{HUB}\n[controllers.calm]\n{HUB}stable = true\n"


@pytest.mark.attack
def test_a_law_that_is_stable_by_itself():
    """With `stable = true` a design whose law is else unstable is stable by itself and proved, and its price is printed.

    It is saved, checked and handed on as it is; `--json` has the growth of the unstable law.
    """
    names = [part for name in ("free", "calm") for part in ("--controller", name)]
    found = printed("synth", "--vehicle", "car.toml", *names, "--json", "--save", "saved.toml", files={"car.toml": TEXT})
    assert [("law_growth" in row) for row in found.json["controllers"] if row["name"] in ("free", "calm")] == [True, False]
    free, calm = (Designer(parse_vehicle(TEXT)).design(name) for name in ("free", "calm"))
    assert free.law.growth > 1
    assert not calm.law.growth
    poles = np.linalg.eigvals(calm.law.A).real
    assert poles.max() < 0
    certificate = calm.certificate
    assert certificate.proof is not None
    assert certificate.proof.holds
    assert certificate.lower_bound is not None
    assert certificate.bound is not None
    assert certificate.lower_bound * (1 - 1e-9) <= certificate.norm.value <= certificate.bound  # rounding of the norm
    assert certificate.norm.value <= free.certificate.norm.value * 1.001  # here it costs nothing, to the design's own 0.1 %
    (remark,) = calm.remarks
    assert f"stable by itself, its slowest pole {poles.max():.4g} 1/s" in remark
    assert f"of an unstable law (+{free.law.growth:.4g} 1/s), the norm does not rise" in remark
    vehicle = read_vehicle(found.folder / "saved.toml")
    (row,) = [row for row in check(Designer(vehicle), None) if row.name == "calm_designed"]
    assert row.failures == ()
    controller = Designer(vehicle).design("calm_designed")
    assert np.all(np.real(law_system(vehicle, controller).poles()) < 0)


@pytest.mark.attack
def test_where_none_is_found_it_says_so():
    """A pole right of the plant's zero cannot be stabilised by a stable law: one line says that none was found."""
    plant = GeneralizedPlant(  # y = (s - 1) / ((s - 2) (s + 1)) u
        A=np.array([[2.0, 1.0], [0.0, -1.0]]),
        B=np.array([[1.0], [-2.0]]),
        Bw=np.array([[1.0], [0.0]]),
        C=np.array([[1.0, 0.0], [0.0, 0.0]]),
        D=np.array([[0.0], [0.1]]),
        Dw=np.zeros((2, 1)),
    )
    with pytest.raises(DesignError, match="every law found is unstable by itself"):
        full_order_design(plant, np.array([[1.0, 0.0]]), stable=True)
