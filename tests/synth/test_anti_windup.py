"""`anti_windup`: the states of a law follow the forces that are given where these are clipped, and nothing else changes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from models.laws.anti_windup import anti_windup_gain
from models.laws.linear import LinearLaw
from models.parts.damper_range import range_of
from models.roads.iso8608 import Iso8608
from models.roads.road import Bump, RoadInput
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.drive.case import Case
from sim.drive.drive import drive
from sim.drive.regime import END_NAMES, RATE_LIMIT, SATURATION, scaled, utilisation
from sim.inspect.__main__ import main as inspect
from sim.observers.ends import Ends
from sim.runs.record import controller_record
from sim.runs.report import controller_notes, reasons
from sim.runs.run import run_controllers, sample_times
from synth import design_controllers as design
from tests.support.analysed import simulate_inputs as simulate
from tests.support.commands import attacks, refused
from tests.support.shared import designed, printed

HUB = 'measured = ["unsprung_acceleration", "control_force"]\norder = "full"\n'
RATE = 20.0  # 1/s
SEMI_ACTIVE = (
    f"{read_vehicle('quarter_car_semi_active').text}\n[controllers.free]\n{HUB}\n[controllers.kept]\n{HUB}anti_windup = {RATE}\n"
)
LAW = """
measured = ["suspension_deflection", "sprung_velocity"]
A = [[5.0, 40.0], [-40.0, 3.0]]
B = [[1.0, 2.0], [0.5, -1.0]]
C = [[300.0, -200.0]]
D = [[-1000.0, -800.0]]
"""
BUMP = Bump(height=0.03, length=4.0, speed=12.0)


def limited(most, **how):
    """The paper's car with actuators of so many N, and an unstable law without and with anti-windup."""
    sections = f"\n[controllers.free]{LAW}\n[controllers.kept]{LAW}anti_windup = {RATE}\n\n[limits]\nactuator_force = {most}\n"
    vehicle = parse_vehicle(read_vehicle("quarter_car").text + sections, source="mine")
    return replace(vehicle, implementation=Implementation(**how))


def runs_of(vehicle, names, road, duration):
    """Runs of these controllers."""
    return run_controllers(vehicle, [designed(vehicle, name) for name in names], road, sample_times(vehicle, duration, 1e-3))


@pytest.mark.attack
def test_an_unstable_law_behind_a_damper_stays_bounded():
    """Over class C the states of an unstable law run away; with anti-windup they stay, and it is said so."""
    vehicle = parse_vehicle(SEMI_ACTIVE, source="mine")
    free, kept = runs_of(vehicle, ["free", "kept"], Iso8608("C", speed=20.0), 1.2)
    states = [name for name in kept.physics.names if name.startswith("controller_")]
    assert max(free.physics.peak(name) for name in states) > 1e8
    assert max(kept.physics.peak(name) for name in states) < 100
    assert np.abs(kept.physics["missing_force"]).max() < 2000
    assert kept.passed, reasons(kept)
    said = "anti-windup: when forces are clipped, the states of the law follow the clipped forces at a rate of 20 1/s or faster"
    assert said in controller_notes(vehicle, kept.controller)
    assert not any("winds up" in line for line in controller_notes(vehicle, kept.controller))
    assert any("winds up" in line for line in controller_notes(vehicle, free.controller))
    assert controller_record(kept.controller)["anti_windup"] == RATE


@pytest.mark.parametrize("how", [*attacks([{}]), {"sample_period": 0.002, "delay": 1}], ids=["ideal", "sampled and late"])
def test_a_run_agrees_while_forces_are_clipped(how):
    """If forces are clipped most of the time, every step, command and state of the law is right to rounding."""
    vehicle = replace(parse_vehicle(SEMI_ACTIVE, source="mine"), implementation=Implementation(**how))
    (run,) = runs_of(vehicle, ["kept"], Bump(height=0.02, length=4.0, speed=12.0), 1.5)
    assert run.passed
    assert math.isinf(run.agreement.until)
    assert np.mean(np.abs(run.physics["missing_force"]) > 1e-3) > 0.5
    assert run.agreement.commands is not None
    assert run.agreement.commands.error < 1e-10


@pytest.mark.parametrize(
    "how",
    [{}, {"sample_period": 0.004}, {"sample_period": 0.004, "delay": 1.5, "noise": {"sprung_velocity": 0.001}}],
    ids=["ideal", "sampled", "late and noisy"],
)
def test_nothing_changes_while_nothing_is_clipped(how):
    """With limits that are never reached, runs with and without anti-windup are the same to the last bit."""
    vehicle = limited(1e7, **how)
    free, kept = runs_of(vehicle, ["free", "kept"], BUMP, 0.5)
    assert np.array_equal(free.physics.values, kept.physics.values)
    assert np.array_equal(free.sampled.values, kept.sampled.values)
    assert free.physics.peak("control_force") > 1


@pytest.mark.parametrize(
    "how", [*attacks([{}]), {"sample_period": 0.004}, {"sample_period": 0.004, "delay": 1}], ids=["ideal", "sampled", "late"]
)
@pytest.mark.parametrize("rate", [None, 4000.0])
def test_the_states_are_those_of_the_equation(how, rate):
    """The states of a run are x_c[i+1] = A x_c + B y + L (clip(u) - u), computed from what it measured, and stay bounded; under a
    rate limit, with the given forces for clip(u).
    """
    most, time = 40.0, sample_times(limited(1.0), 3.0, 1e-3)
    vehicle = limited(most, **how)
    vehicle = replace(vehicle, limits=replace(vehicle.limits, force_rate=rate))
    free, kept = (designed(vehicle, name) for name in ("free", "kept"))
    made = simulate([free, kept], [RoadInput(vehicle, BUMP, time)] * 2)
    runs, every = [made.run(i) for i in (0, 1)], round(how.get("sample_period", 1e-3) / 1e-3)
    law = kept.law.sampled(1e-3 * every)
    L, x, far, given, change = anti_windup_gain(law), np.zeros(2), 0.0, np.zeros(1), (rate or np.inf) * 1e-3 * every
    y = np.stack([runs[1][name] for name in kept.measured], axis=-1)[::every]
    states = np.stack([runs[1][f"controller_{i}"] for i in (1, 2)], axis=-1)[::every]
    for now, expected in zip(y, states, strict=True):
        far = max(far, float(np.abs(x - expected).max()))
        u = law.C @ x + law.D @ now
        given = np.clip(np.clip(u, -most, most), given - change, given + change)
        x = law.A @ x + law.B @ now + L @ (given - u)
    assert far <= 1e-9 * np.abs(states).max()  # a few roundings a step, of a contraction
    assert np.abs(runs[1]["control_force"]).max() == most
    assert np.abs(states).max() < 1
    assert np.abs(runs[0]["controller_1"]).max() > 100 * np.abs(states).max()


@pytest.mark.parametrize("lag", [None, 60.0])
def test_the_linear_regime_ends_with_the_first_command_at_the_rate_limit(lag):
    """The end is that of a run, of a batch in blocks and of a scaled linear response. The verdict compares states up to the last
    sample, also where commands under the rate limit have not arrived.
    """
    vehicle, end = limited(40.0, sample_period=0.004, delay=3), END_NAMES.index(RATE_LIMIT.name)
    vehicle = replace(vehicle, limits=replace(vehicle.limits, force_rate=200.0, actuator_bandwidth=lag))
    (run,) = runs_of(vehicle, ["kept"], BUMP, 0.176)
    road = RoadInput(vehicle, BUMP, run.physics.time)
    (ends,) = drive([Case(vehicle, run.controller, BUMP)] * 2, run.physics.time, Ends, streamed=True)
    commands = simulate([run.controller], [road]).requested_force[0, :, 0]
    first = run.physics.time[(np.abs(np.diff(commands, prepend=0.0)) > 0.8 * (1 - 1e-9)).argmax()]
    assert run.passed
    assert 0 < first == run.agreement.end_times[RATE_LIMIT.name]
    assert [one.times[end] for one in ends] == [first] * 2
    (factor,) = 1 / utilisation(vehicle, run.sampled)[[end]]
    times = scaled(vehicle, run.sampled, np.array([1.0, 0.999 * factor, 1.001 * factor])).times[:, end]
    assert times[0] == first
    assert np.isfinite(times).tolist() == [True, False, True]


def test_behind_a_lag_the_linear_regime_ends_with_the_first_clipped_demand():
    """No linear claim is made once anti-windup acts: when the demand is clipped, before the lagging force is at its limit.

    The first clipped demand is that of a run, of a batch in blocks, as of campaigns and maps, and of a scaled linear response.
    """
    plain = limited(50.0)
    vehicle = replace(plain, limits=replace(plain.limits, actuator_bandwidth=20.0))
    controller, time, end = designed(vehicle, "kept"), sample_times(vehicle, 0.5, 1e-3), END_NAMES.index(SATURATION.name)
    road = RoadInput(vehicle, BUMP, time)
    made = simulate([controller], [road])
    demand, force = made.requested_force[0, :, 0], made.response["control_force"][0]
    clipped, full = (time[(np.abs(signal) >= 50.0).argmax()] for signal in (demand, force))
    assert 0 < clipped < full - 5e-3
    (run,) = runs_of(vehicle, ["kept"], BUMP, 0.5)
    assert run.passed
    assert run.agreement.end_times[SATURATION.name] == run.agreement.until == clipped
    assert any("the command of a lagging actuator first exceeds its largest force" in line.text for line in reasons(run))
    (free,) = runs_of(vehicle, ["free"], BUMP, 0.5)
    full = time[(np.abs(free.physics["control_force"]) >= 50.0).argmax()]
    assert clipped < free.agreement.end_times[SATURATION.name] == full  # without anti-windup a lag is linear until then
    (ends,) = drive([Case(vehicle, controller, BUMP)] * 2, time, Ends, streamed=True)
    assert [one.times[end] for one in ends] == [clipped] * 2
    (factor,) = 1 / utilisation(vehicle, run.sampled, anti_windup=True)[[end]]
    times = scaled(vehicle, run.sampled, np.array([1.0, 0.999 * factor, 1.001 * factor]), anti_windup=True).times[:, end]
    assert times[0] == clipped
    assert np.isfinite(times).tolist() == [True, False, True]


def test_what_is_clipped_is_zero_while_nothing_is():
    """For a force that a damper gives exactly nothing is clipped, to the last bit; of others as much as the harness misses."""
    of = range_of([read_vehicle("quarter_car_semi_active")])
    rng = np.random.default_rng(1)
    closing, forces = rng.normal(size=(1000, 1, 1)), rng.normal(size=(1000, 1, 1)) * 300
    clipped, coefficient = of.clipped_off(forces, closing), forces / closing
    missing = of.commands(np.concatenate([forces, closing], axis=-1))[..., 1:]
    given = (coefficient > -399) & (coefficient < 399)  # the damper's range is 400 N s/m about the nominal one
    assert not np.any(clipped[given])
    assert np.all(clipped[np.abs(coefficient) > 401])
    assert clipped == pytest.approx(-missing, abs=1e-9)


def random_law(seed, factor=1.0):
    """A law of some states in some units, at 1 ms; for a factor the same in other units of its states and forces."""
    rng = np.random.default_rng(seed)
    k, m = int(rng.integers(1, 5)), int(rng.integers(1, 4))
    A, C = rng.normal(size=(k, k)) * 10 ** rng.uniform(0, 2), 1e3 * rng.normal(size=(m, k))
    units = np.diag(factor ** rng.uniform(-1, 1, k))
    return LinearLaw(
        units @ A @ np.linalg.inv(units),
        units @ np.ones((k, 1)),
        factor * C @ np.linalg.inv(units),
        np.zeros((m, 1)),
        anti_windup=RATE,
    ).sampled(1e-3), units


@pytest.mark.parametrize("seed", range(4))
def test_the_gain_mirrors_slow_poles(seed):
    """A - L C has the poles of A, but for those slower than the rate, which are mirrored at it; in any units the same."""
    law, _ = random_law(seed)
    L, circle = anti_windup_gain(law), np.exp(-RATE * 1e-3)
    poles, left = np.linalg.eigvals(law.A), np.linalg.eigvals(law.A - L @ law.C)
    expected = np.where(np.abs(poles) > circle, circle**2 / np.conj(poles), poles)
    assert np.poly(left) == pytest.approx(np.poly(expected).real, abs=1e-9)  # coefficients, of size one: roots lose digits
    scaled, units = random_law(seed, 1e3)
    assert anti_windup_gain(scaled) * 1e3 == pytest.approx(units @ L, rel=1e-6, abs=1e-9 * np.abs(units @ L).max())


def test_a_state_that_shows_in_no_force_is_refused():
    """If a slow state acts on no force, no gain can hold it: one line says so."""
    law = LinearLaw(np.diag([1.0, -1.0]), np.ones((2, 1)), np.array([[0.0, 1.0]]), np.zeros((1, 1)), anti_windup=RATE)
    with refused("anti_windup = 20", "almost no effect on the forces"):
        anti_windup_gain(law.sampled(1e-3))


def test_a_rate_that_rounding_hides_is_refused():
    """An integrator decays at twice the rate; a rate below a millionth per sample would do nothing, and is refused."""
    integrator = LinearLaw(np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)), anti_windup=2e-3)
    law = integrator.sampled(1e-3)
    left = 1 - float((law.A - anti_windup_gain(law) @ law.C)[0, 0])
    assert left == pytest.approx(2 * 2e-3 * 1e-3, rel=1e-5)  # first order of 4e-6, and rounding of 1 + 4e-6
    with refused("anti_windup = 0.0005", "too small for a sample period of 0.001 s, because ", "; give at least 0.001"):
        anti_windup_gain(replace(law, anti_windup=5e-4))


def test_it_is_recorded_saved_and_proved():
    """A log has it and proves itself; a saved controller has it, and so has `--json`."""
    files, car = {"car.toml": SEMI_ACTIVE}, ("--vehicle", "car.toml", "--controller", "kept")
    bumped = printed("sim.bump", *car, "--height", "0.02", "--duration", "0.5", "--json", files=files)
    assert bumped.code == 0
    assert bumped.json["runs"][0]["controller"]["anti_windup"] == RATE
    (log,) = (bumped.folder / "logs").glob("*.mcap")
    assert inspect([str(log)]) == 0
    saved = printed("synth", *car, "--json", "--save", "saved.toml", files=files)
    assert next(row for row in saved.json["controllers"] if row["name"] == "kept")["anti_windup"] == RATE
    vehicle = read_vehicle(saved.folder / "saved.toml")
    (controller,) = design(vehicle, ["kept_designed"])
    assert controller.law.anti_windup == RATE
