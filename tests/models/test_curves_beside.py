"""Curves of springs and dampers beside adjustable dampers: in MuJoCo, against their exact response, in verdicts and diagrams."""

from dataclasses import replace

import numpy as np
import pytest

from models.common.errors import InputError
from models.laws.semi_active import SemiActive
from models.vehicle.vehicle import parse_vehicle
from sim.runs.run import run_controllers, sample_times
from synth.vehicle.designer import Designer
from tests.models.test_semi_active_dampers import BUMP, DAMPER, LATE, QUARTER
from tests.support.commands import attacks, refused
from tests.support.curved import DIGRESSIVE, PROGRESSIVE

LINE = "velocity = [-1.0, 0.0, 1.0], force = [-1000.0, 0.0, 1000.0]"
FRICTION = f"{{ {LINE}, friction = 60.0, friction_velocity = 0.02 }}"
LAWS = "".join(f'[controllers.{name}]\nsemi_active = "{name}"\n' for name in ("skyhook", "add", "hybrid", "pdd"))


def with_tables(text, **curves):
    """A vehicle file with these tables in place of its parameters."""
    lines = [line for line in text.splitlines() if line.split(" =")[0] not in curves]
    return "\n".join([*lines, "[curves]", *(f"{name} = {table}" for name, table in curves.items()), ""])


SPRING = with_tables(QUARTER, suspension_stiffness=PROGRESSIVE)
ROUGH = with_tables(QUARTER, suspension_stiffness=PROGRESSIVE, suspension_damping=FRICTION)


def runs(text, *names, road=BUMP, duration=1.0, step=1e-3):
    """The runs of some controllers."""
    vehicle = parse_vehicle(text)
    laws = {name: entry.semi_active for name, entry in vehicle.controllers.items() if entry.semi_active}
    controllers = [SemiActive(name, laws[name]) if name in laws else Designer(vehicle).design(name) for name in names]
    return run_controllers(vehicle, controllers, road, sample_times(vehicle, duration, step))


def off(run, other, until=np.inf):
    """The largest difference of physics from a response, over its peak, of all output signals."""
    physics, other = run.physics.until(until), other.until(until)
    return max(
        np.abs(physics[name] - other[name]).max() / (other.scale(name) or 1.0) for name in run.vehicle.linear_model.outputs
    )


def check_physics(run, far):
    """MuJoCo is RK4's own arithmetic, this far from the exact response, and no damper drives at any sample."""
    assert run.passed
    assert off(run, run.prediction.integrated) < 1e-9
    assert off(run, run.sampled) < far
    assert run.energy is not None
    assert run.energy.least is not None
    assert run.energy.least >= 0.0


@pytest.mark.parametrize(
    ("text", "far", "more"),
    [(SPRING, 2e-5, "bandwidth = 100.0\n" + LATE), *attacks([(SPRING, 2e-5, ""), (ROUGH, 5e-5, "bandwidth = 100.0\n" + LATE)])],
    ids=["spring, both", "spring", "friction, both"],
)
def test_the_exact_response(text, far, more):
    """MuJoCo is what RK4 is foretold to make, to rounding, and that is next to the exact response, which decides for itself.

    1e-9: rounding, over 300 steps. 2e-5: RK4 over the knots of a spring at 1 ms, as without adjustable dampers; friction, which
    turns within 0.1 m/s, at most 4e-5.
    """
    for run in runs(text + LAWS + DAMPER + more, "passive", "leaky", "pdd", duration=0.3):
        check_physics(run, far)


def test_what_would_feed_energy_in():
    """A digressive curve beside a damper that may be softer than the curve falls is refused in a line; friction is not."""
    with refused("suspension_damping adds to a semi-active damper, whose softest setting then feeds energy in at -1.5 m/s"):
        parse_vehicle(with_tables(QUARTER, suspension_damping=DIGRESSIVE) + DAMPER)
    falling = "{ velocity = [-1.0, -0.5, 0.0, 0.5, 1.0], force = [-2000, -1000, 0, 500, 600] }"
    with pytest.raises(InputError, match=r"at 0\.5 m/s; give only the line and the friction"):
        parse_vehicle(with_tables(QUARTER, suspension_damping=falling) + DAMPER)
    late = "{ velocity = [-1.0, -0.5, 0.0, 0.5, 1.0], force = [-1000, -500, 0, 500, 700] }"
    with pytest.raises(InputError, match="beyond 1 m/s, as it goes on from there"):
        parse_vehicle(with_tables(QUARTER, suspension_damping=late) + DAMPER)
    vehicle = parse_vehicle(ROUGH + DAMPER)
    with pytest.raises(InputError, match="suspension_damping = 5000 N s/m"):
        replace(vehicle, parameters={**vehicle.parameters, "suspension_damping": 5000.0}).checked()
