"""Cars whose curves bend within mm/s of rest, where RK4 makes a larger share of a small motion."""

import pytest

from models.roads.road import LOWEST, Bump
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.runs.report import verdict
from sim.runs.run import Run, run_controllers, sample_times
from synth.vehicle.designer import Designer
from tests.models.test_measured_dampers import with_tables
from tests.models.test_semi_active_dampers import BOTH
from tests.support.commands import in_the_suite

PUSHED = BOTH.split("[actuators.front]")[0] + BOTH[BOTH.index("[controllers.sky]") :]
SOFT = "{ velocity = [-1.0, -0.005, 0.0, 0.005, 1.0], force = [-700, -4, 0, 5, 900] }"
FIRM = "{ velocity = [-1.0, -0.005, 0.0, 0.003, 1.0], force = [-1700, -18, 0, 17, 2000] }"
PAIR = BOTH.replace("c_min = 300.0\nc_max = 3000.0", f"c_min = {SOFT}\nc_max = {FIRM}")
LAW = '[controllers.skyhook]\nsemi_active = "skyhook"\n'


def rough(text, friction, line=1000.0, front=0.004, rear=0.003):
    """A car both of whose axles have a friction that turns at millimetres a second beside the line of their dampers."""

    def table(velocity):
        straight = f"velocity = [-1.0, 0.0, 1.0], force = [-{line}, 0.0, {line}]"
        return f"{{ {straight}, friction = {friction}, friction_velocity = {velocity} }}"

    return with_tables(text, suspension_damping_front=table(front), suspension_damping_rear=table(rear))


SHARP = with_tables(PUSHED, suspension_damping_front=FIRM, suspension_damping_rear=FIRM)
CARS = {  # a file, one of its controllers, the height of a bump
    "friction": (rough(PUSHED, 60.0), "sky", 0.05),
    "much friction": (rough(PUSHED, 200.0), "passive", 0.05),
    "bends": (SHARP, "sky", 0.1),
    "adjustable, with friction": (rough(BOTH, 200.0), "passive", 0.05),
    "measured pair": (PAIR, "sky", 0.05),
    "measured pair, with friction": (rough(PAIR, 60.0, front=0.003, rear=0.004) + LAW, "skyhook", 0.02),
    "full car": (rough(read_vehicle("full_car").text, 60.0, 1500.0), "passive", 0.05),
}


def driven(name: str, height: float | None = None, step: float = 1e-3) -> Run:
    """The run of one of the cars over its bump, or one of another height."""
    text, controller, usual = CARS[name]
    vehicle = parse_vehicle(text)
    driver = Designer(vehicle).design(controller) if controller != "skyhook" else vehicle.controllers[controller].driver()
    road = Bump(usual if height is None else height, 5.0, 12.5)
    return run_controllers(vehicle, [driver], road, sample_times(vehicle, 0.35, step))[0]


@pytest.mark.parametrize("name", in_the_suite(("measured pair, with friction",), CARS))
def test_physics_agrees(name):
    """Every step over knots near rest is that of RK4, over a bump and over the lowest one, where friction holds."""
    for height in (None, LOWEST):
        assert driven(name, height).passed


@pytest.mark.attack
def test_a_step_that_is_too_coarse_for_friction_is_named():
    """If RK4 cannot follow friction near rest at a step, the verdict names the step; a half of it is accurate."""
    coarse, fine = (driven("much friction", step=step) for step in (2e-3, 1e-3))
    assert coarse.passed
    assert "the timestep is too coarse for accurate numbers" in verdict(coarse).text
    assert "coarse" not in verdict(fine).text
