"""`stable = true`: full-order laws that are stable by themselves, and what that costs."""

import re

import numpy as np
import pytest

from models.common.printed import percent
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from synth.analysis.norm import hinf_norm
from synth.command.check import check
from synth.design.full_order import full_order, stable
from synth.design.full_order.full_order import full_order_design
from synth.design.full_order.riccati import RiccatiSearch
from synth.lmi.full_order_bound import find_lower_bound
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer
from synth.vehicle.state_space import law_system
from tests.shared import made, printed
from tests.test_fixed_order import posed

HUB = 'measured = ["unsprung_acceleration", "control_force"]\norder = "full"\n'
CAR = re.sub("tyre_damping = .*\n", "", read_vehicle("quarter_car_semi_active").text)  # if its tyre damps, stability has a price
TEXT = f"{CAR}\n[controllers.free]\n{HUB}\n[controllers.calm]\n{HUB}stable = true\n"


@pytest.mark.attack
def test_a_law_that_is_stable_by_itself():
    """Beside the unstable law the same design with `stable = true` is stable by itself, proved, saved and told its price."""
    (free, calm) = (made(_designed, name) for name in ("free", "calm"))
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
    assert f"of an unstable law (+{free.law.growth:.4g} 1/s) at no price" in remark


def _designed(name):
    return Designer(parse_vehicle(TEXT)).design(name)


@pytest.mark.attack
def test_it_is_saved_and_read_again():
    """`--json` says of which law it is that it grows, and the stable one is saved, checked and handed on as it is."""
    names = [part for name in ("free", "calm") for part in ("--controller", name)]
    found = printed("synth", "--vehicle", "car.toml", *names, "--json", "--save", "saved.toml", files={"car.toml": TEXT})
    assert [("law_growth" in row) for row in found.json["controllers"] if row["name"] in ("free", "calm")] == [True, False]
    vehicle = read_vehicle(found.folder / "saved.toml")
    (row,) = [row for row in check(Designer(vehicle), None) if row.name == "calm_designed"]
    assert row.failures == ()
    controller = Designer(vehicle).design("calm_designed")
    assert np.all(np.real(law_system(vehicle, controller).poles()) < 0)


def test_the_descent_begins_where_the_law_is(monkeypatch):
    """The gain of a noisy plant with a law's states has the law's own norm, noise included, and is that law again."""
    plant, Cy, Dyw = posed(1, n=2)
    search = RiccatiSearch(plant, Cy, Dyw, find_lower_bound(plant, Cy, Dyw=Dyw).gamma)
    start = search.traded(1e-2, 1.3 * search.bound)
    assert start is not None
    norms = []

    def not_moved(larger, Cy, Dyw, K, states, light):
        by_w, by_u = (larger.Bw, larger.Dw), (larger.B @ K, larger.D @ K)
        Bw, Dw = (own + on @ Dyw for own, on in zip(by_w, by_u, strict=True))
        loop = GeneralizedPlant(larger.A + by_u[0] @ Cy, larger.B, Bw, larger.C + by_u[1] @ Cy, larger.D, Dw)
        norms.append(hinf_norm(loop).value / search.own.norm)
        return K

    monkeypatch.setattr(stable, "descend_stable", not_moved)
    law = stable._descended(search, start)
    assert norms == [pytest.approx(start.norm, rel=1e-7)]  # where each norm stops
    for name in "ABCD":
        np.testing.assert_array_equal(getattr(law, name), getattr(start.own, name))


@pytest.mark.attack
def test_without_a_descent_it_says_so(monkeypatch):
    """A law of too many numbers is the best of the central ones: the remark has its price, and that there was no descent."""
    vehicle, free, reached = parse_vehicle(TEXT), *(made(_designed, name) for name in ("free", "calm"))
    monkeypatch.setattr(full_order, "MOST", 24)
    calm = Designer(vehicle).design("calm")
    assert not calm.law.growth
    share = calm.certificate.norm.value / free.certificate.norm.value - 1
    assert calm.certificate.norm.value > reached.certificate.norm.value
    (remark,) = calm.remarks
    assert remark.endswith("; no descent: of a law of 25 numbers it would take too long, 24 are the most")
    assert f"its norm is {percent(share)} higher" in remark


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
    with pytest.raises(DesignError, match="no law was found that is stable by itself"):
        full_order_design(plant, np.array([[1.0, 0.0]]), stable=True)
