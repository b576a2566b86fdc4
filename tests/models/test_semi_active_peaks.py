"""Peak and rms of runs with adjustable dampers, whose accelerations and forces jump at each decision."""

import numpy as np
import pytest

from models.roads.road import Bump
from models.vehicle.vehicle import parse_vehicle
from sim.runs.report import RUN
from sim.runs.run import run_controllers, sample_times
from sim.studies.ride.metrics import Meter, measure
from tests.models.test_semi_active_dampers import BOTH, DAMPER, QUARTER
from tests.support.analysed import simulate

LAWS = {
    "skyhook": lambda body, stretching: 4000.0 if body * stretching > 0 else 300.0,
    "skyhook_linear": lambda body, stretching: np.clip(4000 * body / stretching, 300, 4000) if body * stretching > 0 else 300.0,
}


def integrated(law, road, time):
    """Body acceleration and damper force of the quarter-car at every tenth of a step, from start to end, shape (T - 1, 11, 2).

    The coefficient is decided at the samples, and the road is held over a step at its height midway.
    """
    m, hub, k, tyre, nominal, h = 504.5, 62.0, 13100.0, 252000.0, 1000.0, time[1] / 10
    x, found = np.zeros(4), []
    for height in road.displacement(time[:-1] + time[1] / 2):
        c = law(x[2], x[2] - x[3])
        body = np.array([-k, k, -c, c])
        A = np.stack([[0, 0, 1, 0], [0, 0, 0, 1], body / m, (-body - [0, tyre, 0, 0]) / hub])
        states = [x]
        for _ in range(10):
            rate = A @ x + np.array([0, 0, 0, tyre / hub * height])
            x = x + h * (rate + h / 2 * A @ (rate + h / 3 * A @ (rate + h / 4 * A @ rate)))
            states.append(x)
        found.append([(A[2] @ state, (nominal - c) * (state[2] - state[3])) for state in states])
    return np.array(found)


@pytest.mark.parametrize(
    ("law", "speed", "peak_of", "low"),
    [("skyhook", 28.0, "sprung_acceleration", 0.009), ("skyhook_linear", 12.5, "control_force", 0.025)],
)
def test_peak_and_rms_use_both_sides_of_a_decision(law, speed, peak_of, low):
    """Peak and rms of a run and its metrics are those of the continuous signals to 1e-3; just after decisions, peaks are low."""
    vehicle = parse_vehicle(f'{QUARTER}{DAMPER}[controllers.law]\nsemi_active = "{law}"\n')
    road, time = Bump(0.05, 5.0, speed), sample_times(vehicle, 0.8, 1e-3)
    (run,) = run_controllers(vehicle, [vehicle.controllers["law"].driver()], road, time)
    signals, whole = RUN(run)["signals"], measure(vehicle, run.physics, 0)
    sides = integrated(LAWS[law], road, time)
    for name, exact in zip(("sprung_acceleration", "control_force"), np.moveaxis(sides, 2, 0), strict=True):
        peak, rms = np.abs(exact).max(), np.sqrt(np.mean((exact[:, :-1] ** 2 + exact[:, 1:] ** 2) / 2))
        assert signals[name]["peak"]["mujoco"] == pytest.approx(peak, rel=1e-3)
        assert [signals[name]["rms"]["mujoco"], whole[f"{name}_rms"]] == pytest.approx([rms, rms], rel=1e-3)
        assert np.abs(exact[:, 0] - run.physics[name][:-1]).max() < 1e-5 * peak  # RK4's error
        assert name != peak_of or np.abs(run.physics[name]).max() < (1 - low) * peak
    assert whole["control_force_peak"] == signals["control_force"]["peak"]["mujoco"]
    meter = Meter([vehicle], 1e-3, 0)
    for block in np.array_split(run.physics.values, 3):  # as in campaigns
        meter.update(block[..., None])
    assert {name: values[0] for name, values in meter.result().items()} == pytest.approx(whole, rel=1e-9)


def test_values_before_a_decision_are_those_measured_there():
    """Controllers measure accelerations just before they decide. `before` has these values, but for the angle of a car's body."""
    text = BOTH.replace("bandwidth = 90.0", "") + '[controllers.law]\nsemi_active = "add"\n'
    vehicle = parse_vehicle(text)
    time = sample_times(vehicle, 0.5, 1e-3)
    runs = simulate([vehicle], [vehicle.controllers["law"].driver()], [Bump(0.1, 5.0, 12.5)], time)
    run, measured = runs.run(0), runs.recordings[0].measured
    for name in ("sprung_acceleration_front", "sprung_acceleration_rear"):
        far = np.abs(run.before[name] - measured[name]).max() / run.peak(name)
        assert far < 1e-3 < np.abs(run[name] - measured[name]).max() / run.peak(name)
