"""The semi-active laws over bump and rough road, on quarter-car and cars, against their exact response: the whole table.

Each side decides for itself. MuJoCo differs from the exact response by RK4's own error, which is told from others in two ways:
it is gone against the same response in RK4's arithmetic (`integrated`), and it falls with the fourth power of the step. Of cars
there is geometry, too, which is gone over a thousandth of the road.
"""

import re

import numpy as np
import pytest

from models.laws.semi_active import LAWS, SemiActive
from models.roads.choice import choose_road
from models.roads.road import Bump, Road
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.response.response import Response
from sim.runs.agreement import SLACK
from sim.runs.report import verdict, verdict_lines
from sim.runs.run import Run, run_controllers, sample_times
from tests.models.test_semi_active_dampers import DAMPER
from tests.support.commands import attacks

KINDS = ("quarter_car", "half_car", "full_car")
CARS = KINDS[1:]
ROAD = "iso8608:class=C"
SMALL = 1e-3  # of the road, at which geometry is gone
EXACT = 1e-6  # of a peak
ARITHMETIC = 1e-9  # of a peak: the rounding of some thousand steps
OVER_ROUGH = 5e-5  # RK4's own, at 1 ms, of what continuous laws ask of slow dampers at c_max; measured 2.7e-5 at most
DURATION = 2.0


def laws_of(kind: str) -> tuple[str, ...]:
    """The names of the laws for a kind."""
    return tuple(name for name in LAWS if name != "skyhook_modal" or kind in CARS)


def with_laws(kind: str) -> Vehicle:
    """A vehicle that ships, with adjustable dampers and every law."""
    sections = "".join(f'[controllers.law_{name}]\nsemi_active = "{name}"\n' for name in laws_of(kind))
    return parse_vehicle(read_vehicle(kind).text + DAMPER + sections)


def rough(vehicle: Vehicle, seed: int, speed: float) -> Road:
    """A road of class C; of a car, a thousandth of it."""
    road = choose_road(ROAD).build(vehicle, speed, seed, speed * DURATION)
    return road if vehicle.kind.name == "quarter_car" else road.scaled(SMALL)


def driven(kind: str, road: Road, timestep: float, duration: float) -> list[Run]:
    """Every law over a road."""
    vehicle = with_laws(kind)
    laws = []
    for name in laws_of(kind):
        law = vehicle.controllers[f"law_{name}"].semi_active
        assert law is not None
        laws.append(SemiActive(name, law))
    return run_controllers(vehicle, laws, road, sample_times(vehicle, duration, timestep))


def apart(run: Run, reference: Response, until: float = np.inf) -> float:
    """Returns how far physics is from a response, of a peak, of the signal that is furthest, as long as it is compared."""
    end = min(run.agreement.until, until)
    physics, other = run.physics.until(end), reference.until(end)
    return max(
        float(np.abs(physics[name] - other[name]).max()) / (other.scale(name) or 1.0) for name in run.vehicle.linear_model.outputs
    )


def said(run: Run) -> str:
    """The verdict of a run, on one line."""
    return " ".join(" ".join(verdict_lines(run)).split())


def check_verdict(run: Run) -> None:
    """The run agrees, only takes energy, and says how far it is from the exact response; and when and how many decisions
    differ."""
    assert verdict(run).startswith("agrees")
    assert run.energy is not None
    assert run.energy.least is not None
    assert run.energy.least >= 0
    text, otherwise = said(run), [one for one in run.prediction.otherwise if one.time < run.agreement.until]
    worst = re.search(r"own error \(worst (\w+), (\S+) of its peak", text)
    geometry = re.search(r"geometry makes up to (\S+) of a peak \((\w+)\)", text)
    assert (worst is None) != (geometry is None)
    if worst is not None:
        assert float(worst[2]) == pytest.approx(run.agreement.signals[worst[1]].sampled, rel=0.06)  # two digits
    if geometry is not None:  # beside RK4's own error
        signal = run.agreement.signals[geometry[2]]
        assert float(geometry[1]) == pytest.approx(signal.sampled - signal.allowed / SLACK, rel=0.06)
    told = re.search(r"(\d+) decisions? differs? from those of the exact response, first of \w+ at (\S+) s", text)
    assert (told is not None) == bool(otherwise)
    if told is not None:
        assert int(told[1]) == len(otherwise)
        assert float(told[2]) == pytest.approx(otherwise[0].time, rel=1e-3)
        assert max(mismatch.margin for mismatch in otherwise) < 1e-3  # of a peak; what physics is off


def check(kind: str, road: Road, duration: float = DURATION) -> None:
    """All laws over a road, at 1 ms and at half of it."""
    whole, half = (driven(kind, road, timestep, duration) for timestep in (1e-3, 5e-4))
    for run, finer in zip(whole, half, strict=True):
        check_verdict(run)
        check_verdict(finer)
        exact = apart(run, run.sampled), apart(finer, finer.sampled)
        assert exact[0] < OVER_ROUGH, run.controller.name
        for one in (run, finer):
            assert apart(one, one.prediction.integrated) < ARITHMETIC, run.controller.name
        # The fourth power of the step is 16; decisions at twice as many samples are others, and so are peaks.
        assert exact[1] < exact[0] / 8, run.controller.name
        if not run.prediction.otherwise and exact[0] > EXACT:
            assert exact[1] < 2.5 * EXACT, run.controller.name


@pytest.mark.parametrize("kind", attacks(KINDS))
def test_over_a_bump(kind):
    """Over a bump every law is within 2e-6 of a peak of its exact response at 1 ms, and 1e-6 at 0.5 ms; cars over 1 mm."""
    steps = ((1e-3, 2 * EXACT), (5e-4, EXACT))
    for timestep, most in steps if kind == "quarter_car" else steps[:1]:  # a car's half step is in `test_over_class_c`
        for run in driven(kind, Bump(0.03 if kind == "quarter_car" else 0.001, 5.0, 12.5), timestep, 0.2):
            check_verdict(run)
            assert apart(run, run.sampled) < most, run.controller.name


@pytest.mark.attack
@pytest.mark.parametrize(("kind", "speed"), [("quarter_car", 25.0), ("full_car", 8.0)])
def test_over_class_c(kind, speed):
    """Over class C MuJoCo does what the exact response does, but for RK4: 3e-5 of a peak; cars over a thousandth of the road."""
    check(kind, rough(with_laws(kind), 1, speed), DURATION / 4)


@pytest.mark.attack
@pytest.mark.parametrize("kind", CARS)
def test_cars_over_whole_roads(kind):
    """Over class C as it is, a car leaves the exact response as its geometry does, and no further; the verdict says so."""
    vehicle = with_laws(kind)
    road = choose_road(ROAD).build(vehicle, 15.0, 0, 15.0 * DURATION)
    for run in driven(kind, road, 1e-3, DURATION / 4):
        assert verdict(run).startswith("agrees")
        assert apart(run, run.sampled) < 1e-3, run.controller.name  # measured 4e-4 at most
        small = [one.small for one in run.agreement.signals.values() if one.small is not None]
        assert small, "it was looked at more closely"
        assert "geometry" in said(run)
