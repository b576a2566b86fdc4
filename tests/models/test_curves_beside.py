"""Curves of springs and dampers parallel to adjustable dampers."""

from dataclasses import replace

import pytest

from models.common.errors import InputError
from models.laws.semi_active import SemiActive, SemiActiveLaw
from models.vehicle.vehicle import parse_vehicle
from sim.runs.run import run_controllers, sample_times
from synth.vehicle.designer import Designer
from tests.models.test_semi_active_dampers import BUMP, DAMPER, QUARTER
from tests.support.commands import refused
from tests.support.curved import DIGRESSIVE, PROGRESSIVE

LINE = "velocity = [-1.0, 0.0, 1.0], force = [-1000.0, 0.0, 1000.0]"
FRICTION = f"{{ {LINE}, friction = 60.0, friction_velocity = 0.02 }}"


def with_tables(text, **curves):
    """A vehicle file with these tables in place of its parameters."""
    lines = [line for line in text.splitlines() if line.split(" =")[0] not in curves]
    return "\n".join([*lines, "[curves]", *(f"{name} = {table}" for name, table in curves.items()), ""])


ROUGH = with_tables(QUARTER, suspension_stiffness=PROGRESSIVE, suspension_damping=FRICTION)


def runs(text, *names, road=BUMP, duration=1.0):
    """The runs of some controllers."""
    vehicle = parse_vehicle(text)
    laws = {name: one.source for name, one in vehicle.controllers.items() if isinstance(one.source, SemiActiveLaw)}
    controllers = [SemiActive(name, laws[name]) if name in laws else Designer(vehicle).design(name) for name in names]
    return run_controllers(vehicle, controllers, road, sample_times(vehicle, duration, 1e-3))


def test_what_would_feed_energy_in():
    """A digressive curve beside a damper that may be softer than the curve falls is refused in a line; friction is not."""
    with refused("at c_min both together supply energy at -1.5 m/s"):
        parse_vehicle(with_tables(QUARTER, suspension_damping=DIGRESSIVE) + DAMPER)
    falling = "{ velocity = [-1.0, -0.5, 0.0, 0.5, 1.0], force = [-2000, -1000, 0, 500, 600] }"
    with pytest.raises(InputError, match=r"at 0\.5 m/s; give only a line and friction"):
        parse_vehicle(with_tables(QUARTER, suspension_damping=falling) + DAMPER)
    late = "{ velocity = [-1.0, -0.5, 0.0, 0.5, 1.0], force = [-1000, -500, 0, 500, 700] }"
    with pytest.raises(InputError, match="beyond 1 m/s, where its end is extended"):
        parse_vehicle(with_tables(QUARTER, suspension_damping=late) + DAMPER)
    vehicle = parse_vehicle(ROUGH + DAMPER)
    with pytest.raises(InputError, match="suspension_damping = 5000 N s/m"):
        replace(vehicle, parameters={**vehicle.parameters, "suspension_damping": 5000.0}).checked()
