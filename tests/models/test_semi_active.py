"""The built-in semi-active laws: the coefficients that they request, their runs and peaks, and the published car that ships."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest

from models.common.errors import InputError
from models.laws.semi_active import LAWS, SemiActive, SemiActiveLaw
from models.roads.choice import choose_road
from models.roads.road import Bump
from models.vehicle.semi_active_coefficients import numbers_of
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.bump import main as bump
from sim.runs.record import RUN, controller_record
from sim.runs.report import controller_notes, verdict
from sim.runs.run import run_controllers, sample_times
from sim.studies.ride.metrics import Meter, measure
from synth.__main__ import main as synth
from tests.models.test_semi_active_dampers import BOTH, BUMP, DAMPER, HALF, QUARTER, check_physics
from tests.support.analysed import simulate
from tests.support.commands import attacks

NAMES = [name for name in LAWS if name != "skyhook_modal"]
SOFT, HARD, SPRING = 300.0, 4000.0, 13100.0
EACH = "".join(f'[controllers.{name}]\nsemi_active = "{name}"\n' for name in NAMES)
CAR = HALF[: HALF.index("[actuators.front]")] + DAMPER


def law_of(text: str, name: str) -> tuple[SemiActiveLaw, SemiActive]:
    """A law of a vehicle file."""
    law = parse_vehicle(text).controllers[name].source
    assert isinstance(law, SemiActiveLaw)
    return law, SemiActive(name, law)


def asked(name: str, z: float, z_s: float, z_u: float, a: float) -> float:
    """What a law asks for, case by case as its source has it: travel, velocity of body and wheel, acceleration of the body."""
    v = z_s - z_u
    if name == "skyhook":
        return HARD if z_s * v > 0 else SOFT
    if name == "skyhook_linear":
        return HARD * z_s / v if z_s * v > 0 else SOFT
    if name == "groundhook":
        return HARD if -z_u * v > 0 else SOFT
    if name == "hybrid":
        return (0.5 * (HARD * z_s / v if z_s * v > 0 else 0.0)) + 0.5 * (-HARD * z_u / v if -z_u * v > 0 else 0.0)
    if name == "add":
        return HARD if a * v > 0 else SOFT
    if name == "pdd":
        if SPRING * z * v + SOFT * v * v >= 0:
            return SOFT
        return HARD if SPRING * z * v + HARD * v * v < 0 else -SPRING * z / v
    slow = a * a - 12.0**2 * z_s * z_s <= 0
    return HARD if (slow and z_s * v > 0) or (not slow and a * v > 0) else SOFT


@pytest.mark.parametrize("name", NAMES)
def test_what_a_law_asks_for(name):
    """Each law is its source's, in all signs of what it measures, also of many vehicles at once."""
    law, _ = law_of(QUARTER + DAMPER + EACH, name)
    numbers = numbers_of([law], [parse_vehicle(QUARTER + DAMPER)])
    rng = np.random.default_rng(0)
    states = rng.normal(size=(200, 4)) * [0.02, 0.5, 0.7, 3.0]
    signals = ["suspension_deflection", "sprung_velocity", "unsprung_velocity", "sprung_acceleration"]
    columns = {signal: states[:, i] for i, signal in enumerate(signals)}
    y = np.stack([columns[signal] for signal in law.measured], axis=-1)
    found = law.coefficients(y, numbers)[:, 0]
    expected = np.array([asked(name, *state) for state in states])
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert len(set(np.sign(expected - (SOFT + HARD) / 2))) == 2  # hard and soft both


def test_keys_change_a_law():
    """The numbers that a section gives are those that its law has: half the damper to the sky is half the force."""
    text = QUARTER + DAMPER + '[controllers.soft]\nsemi_active = "skyhook_linear"\nsky_damping = 2000.0\n'
    law, controller = law_of(text, "soft")
    (found,) = law.coefficients(np.array([[0.2, 0.1]]), numbers_of([law], [parse_vehicle(text)]))
    assert found == pytest.approx([4000.0])  # 2000 N s/m * 0.2 m/s over 0.1 m/s
    assert "sky_damping 2000" in controller_notes(parse_vehicle(text), controller)[0]
    assert controller_record(controller)["sky_damping"] == 2000.0
    assert controller_record(controller)["norm"] is None


def test_modes_are_corners():
    """If heave and pitch are damped alike, modal skyhook is that of the corners; one not damped asks for nothing."""
    by_corners = SemiActiveLaw("skyhook_linear", (), ("_front", "_rear"))
    modes = ("heave_velocity", "pitch_rate")
    modal = SemiActiveLaw("skyhook_modal", (), ("_front", "_rear"), modes)
    only = SemiActiveLaw("skyhook_modal", (("pitch_damping", 0.0),), ("_front", "_rear"), modes)
    heave, pitch, wheels = 0.3, 0.1, np.array([0.05, -0.2])
    body = np.array([heave - 1.3 * pitch, heave + 1.5 * pitch])  # nose down
    corners = by_corners.coefficients(np.array([[*body, *wheels]]), numbers_of([by_corners], [parse_vehicle(CAR)]))
    found = modal.coefficients(np.array([[heave, pitch, *wheels]]), numbers_of([modal], [parse_vehicle(CAR)]))
    np.testing.assert_allclose(found, corners, rtol=1e-12)
    found = only.coefficients(np.array([[heave, pitch, *wheels]]), numbers_of([only], [parse_vehicle(CAR)]))
    np.testing.assert_allclose(found[0], HARD * heave / (body - wheels), rtol=1e-12)


@pytest.mark.parametrize(
    ("kind", "road"),
    [("quarter_car", "bump"), *attacks(itertools.product(("half_car", "full_car"), ("bump", "iso8608:class=C")))],
)
def test_runs_agree(kind, road):
    """The run of every law agrees to rounding, and its dampers dissipate energy at every sample."""
    names = [name for name in LAWS if name != "skyhook_modal" or kind != "quarter_car"]
    sections = "".join(f'[controllers.law_{name}]\nsemi_active = "{name}"\n' for name in names)
    vehicle = parse_vehicle(read_vehicle(kind).text + DAMPER + sections)
    over = BUMP if road == "bump" else choose_road(road).build(vehicle, 15.0, 0, 10.0)
    drivers = [vehicle.controllers[f"law_{name}"].driver() for name in names]
    for run in run_controllers(vehicle, drivers, over, sample_times(vehicle, 0.5, 1e-3)):
        check_physics(run)
        assert verdict(run).text.startswith("MuJoCo agrees with the model; no linear analysis")


@pytest.mark.attack
def test_a_law_is_decided_before_a_step_as_by_a_computer():
    """Set in the loop itself, of a run alone and of many, dampers are what a computer of every timestep makes of them."""
    text = QUARTER + DAMPER + EACH
    slow = parse_vehicle(text + "[implementation]\nsample_period = 0.002\n")
    fast = parse_vehicle(text)
    for name in NAMES:
        law = law_of(text, name)[1]
        time = sample_times(fast, 0.3, 1e-3)
        alone = simulate([fast], [law], [BUMP], time).response.run(0)
        three = simulate([fast] * 3, [law] * 3, [BUMP] * 3, time).response.run(1)
        # Delays of 0 beside one of 5 ms: `Sampler` holds all of them, this one at every timestep.
        late = replace(fast, implementation=replace(fast.implementation, delay=5.0))
        other = simulate([fast, late], [law] * 2, [BUMP] * 2, time).response.run(0)
        for signal in ("damping", "missing_force", "sprung_velocity"):
            for one in (three, other):
                assert np.abs(alone[signal] - one[signal]).max() <= 1e-9 * np.abs(alone[signal]).max()
        held = simulate([slow], [law], [BUMP], time).response.run(0)["damping"]
        assert np.array_equal(held[:-1:2], held[1::2])


def test_a_law_needs_dampers():
    """A law that sets dampers has no linear claim."""
    vehicle = parse_vehicle(QUARTER + DAMPER + EACH)
    assert set(NAMES).isdisjoint(vehicle.linear_names)
    with pytest.raises(InputError, match="is a semi-active law, which has no linear loop"):
        vehicle.linear_entry("add")


COEFFICIENTS = {
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
    sides = integrated(COEFFICIENTS[law], road, time)
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


VEHICLE = "quarter_car_semi_active"
# eFMI's test case M06, QuarterVehiclePlant: m_b, m_w, c_b, c_w, d_w; dMin and dMax.
SOURCE = {
    "sprung_mass": 250.0,
    "unsprung_mass": 30.0,
    "suspension_stiffness": 20e3,
    "tyre_stiffness": 250e3,
    "tyre_damping": 500.0,
}
LEAST, MOST = 200.0, 1000.0


def test_numbers_of_the_source():
    """Masses, stiffnesses, tyre damping and the damper's limits are the source's; the nominal damper is midway between these."""
    vehicle = read_vehicle(VEHICLE)
    assert {name: vehicle.parameters[name] for name in SOURCE} == SOURCE
    (damper,) = vehicle.dampers.values()
    assert (damper.c_min, damper.c_max) == (LEAST, MOST)
    assert vehicle.parameters["suspension_damping"] == (LEAST + MOST) / 2


def test_every_claim_holds(capsys):
    """Its controllers are designed and certified, the given one too, and they agree with physics over a bump."""
    assert synth(["--vehicle", VEHICLE, "--json"]) == 0
    capsys.readouterr()
    assert (
        bump(["--vehicle", VEHICLE, "--controller", "all", "--height", "0.02", "--duration", "0.25", "--no-logs", "--json"]) == 0
    )
    runs = json.loads(capsys.readouterr().out)["runs"]
    names = {run["controller"]["name"] for run in runs}
    assert names == {"passive", "state", "I", "sky", *LAWS} - {"skyhook_modal"}  # of cars
    assert all(run["agrees"] for run in runs)
