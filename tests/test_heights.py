"""Heights of body, corners and hubs over the datum of a flat road: driven, weighed where a norm exists, and measured nowhere."""

import numpy as np
import pytest

from models.common.errors import InputError
from models.roads.choice import choose_road
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.linear.frequency_response import continuous_frequency_response
from sim.runs.run import run_controllers, sample_times
from synth.controller.problem import generalized_plant
from synth.vehicle.designer import Designer

KINDS = ("quarter_car", "half_car", "full_car")
RISE = 0.05  # m


def with_heights(kind: str) -> tuple[Vehicle, list[str]]:
    """A vehicle that ships with its heights named, at no weight."""
    plain = read_vehicle(kind)
    names = [
        signal.name for signal in plain.kind.on_demand if signal.name.endswith("displacement") or "displacement_" in signal.name
    ]
    return parse_vehicle(
        plain.text.replace("[performance]", "\n".join(["[performance]", *(f"{name} = 0.0" for name in names)]))
    ), names


@pytest.mark.parametrize("kind", KINDS)
def test_they_are_those_of_physics(kind):
    """Over a kerb every height agrees with MuJoCo's own place, step by step, and all come to the kerb's height."""
    vehicle, names = with_heights(kind)
    road = choose_road(f"step:height={RISE}:edge=1").build(vehicle, 12.5, 0, 3.0)
    (run,) = run_controllers(vehicle, [Designer(vehicle).design("passive")], road, sample_times(vehicle, 3.0, 1e-3))
    assert run.passed
    assert run.agreement.steps is not None
    assert run.agreement.steps.error < 1e-10
    ends = {"quarter_car": 2, "half_car": 5, "full_car": 9}[kind]
    assert len(names) == ends
    for name in names:
        # The slowest mode of a passive car has a tenth of its amplitude left.
        assert run.physics[name][-1] == pytest.approx(RISE, rel=0.35), name
        assert run.prediction.sampled[name][-1] == pytest.approx(run.physics[name][-1], rel=1e-3), name


@pytest.mark.parametrize("kind", KINDS)
def test_their_rates_are_the_velocities(kind):
    """Over the road's velocity the response of a height is that of its velocity over s, exactly."""
    vehicle, names = with_heights(kind)
    omega = np.array([0.3, 6.0, 70.0])
    response = continuous_frequency_response(vehicle, Designer(vehicle).design("passive"), omega)
    outputs = vehicle.linear_model.outputs
    for name in names:
        rate = response[:, outputs.index(name.replace("displacement", "velocity"))]
        height = response[:, outputs.index(name)] * 1j * omega[:, None]
        assert np.abs(height - rate).max() < 1e-9 * np.abs(rate).max()


def test_a_height_has_a_norm_where_the_road_has_a_height():
    """With a road filter that is 0 at 0 rad/s the plant's z is the height, to rounding; without one it is refused."""
    text = read_vehicle("quarter_car").text
    road = "road = { numerator = [0.07, 0.0], denominator = [0.01, 0.3, 1.0] }"
    weighed = text.replace("[performance]", f"[performance]\n{road}\nsprung_displacement = 2.0")
    vehicle, omega = parse_vehicle(weighed), np.array([1e-3, 5.0, 64.0])
    plant = generalized_plant(vehicle)
    row = [name for name, weight in vehicle.performance.items() if weight].index("sprung_displacement")
    response = continuous_frequency_response(vehicle, Designer(vehicle).design("passive"), omega)
    own = response[:, vehicle.linear_model.outputs.index("sprung_displacement"), 0]
    s = 1j * omega
    own = 2.0 * own * 0.07 * s / (0.01 * s**2 + 0.3 * s + 1)
    assert np.abs(plant.frequency_response(omega)[:, row, 0] - own).max() < 1e-9 * np.abs(own).max()
    certificate = Designer(vehicle).design("I").certificate
    assert certificate.bound is not None
    assert certificate.norm.value <= certificate.bound < np.inf
    without = parse_vehicle(text.replace("[performance]", "[performance]\nsprung_displacement = 2.0"))
    with pytest.raises(
        InputError, match="sprung_displacement is a height over the datum of a flat road, which a road of bounded"
    ):
        Designer(without).design("I")


def test_no_car_measures_one():
    text = read_vehicle("quarter_car").text + '\n[controllers.rig]\nmeasured = ["sprung_displacement"]\n'
    with pytest.raises(
        InputError, match="'sprung_displacement' is a height over the datum of a flat road, which no sensor on a car"
    ):
        parse_vehicle(text)
