"""Controllers with states, and measured accelerations: closed, sampled, driven and cut as a static gain is."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy import linalg, optimize

from models.common.errors import InputError
from models.kinds.kind import HERE
from models.laws.linear import LinearLaw, static_law
from models.roads.road import Bump
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.campaign.__main__ import main as campaign
from sim.linear.frequency_response import continuous_frequency_response
from sim.margins import main
from sim.report.designs import gain_table
from sim.runs.run import run_controllers, sample_times
from sim.studies.stability.edge import rates_of_runs
from sim.studies.stability.simulated_loop import LoopCase, simulated_loop
from sim.studies.stability.step_derivative import step_derivative
from synth.analysis.certificate import Certificate, certify
from synth.controller.controller import Controller
from synth.controller.loop_of import loop_of
from synth.controller.problem import generalized_plant
from synth.controller.sample_period_margin import largest_sample_period
from synth.controller.stability_margins import (
    crossovers,
    gain_crossings,
    margins,
)
from synth.vehicle.designer import Designer
from tests.support.analysed import cut_loop, sampled_radius
from tests.support.commands import attacks
from tests.support.shared import made

REALITIES = {
    "ideal": (Implementation(), Limits()),
    "slow": (Implementation(sample_period=0.004), Limits()),
    "late": (Implementation(sample_period=0.002, delay=3), Limits()),
    "between": (Implementation(sample_period=0.002, delay=1.5), Limits()),
    "lagging": (Implementation(delay=1), Limits(actuator_bandwidth=60.0)),
}


def controller(vehicle: Vehicle, kind: str, states: int = 4) -> Controller:
    """A stable random law on deflections and velocities, or accelerations, weak enough for the loop to be stable."""
    rng = np.random.default_rng(states)
    names = [one for one in vehicle.linear_model.measurable if kind in one or one.startswith("suspension_deflection")]
    m, q = len(vehicle.linear_model.inputs), len(names)
    A = np.diag(-np.geomspace(2.0, 300.0, states)) + np.triu(rng.uniform(-20, 20, (states, states)), 1)
    B, C = rng.standard_normal((states, q)), 40.0 * rng.standard_normal((m, states))
    law = LinearLaw(A, B, C, 5.0 * rng.standard_normal((m, q)))
    return Controller(kind, tuple(names), law, False, made(_without_control, vehicle.kind.name))


def _without_control(kind: str) -> Certificate:
    plant = generalized_plant(read_vehicle(kind))
    return certify(plant, np.zeros_like(plant.B.T))


@pytest.mark.parametrize(
    ("name", "reality"),
    [
        *(("quarter_car", reality) for reality in REALITIES),
        *attacks((name, reality) for name in ("half_car", "full_car") for reality in REALITIES),
    ],
)
def test_physics_agrees_to_rk4s_own_error(name, reality):
    """A run agrees, and without geometry MuJoCo is within 1e-6 of peak of the exact sampled response over a bump."""
    implementation, limits = REALITIES[reality]
    vehicle = replace(read_vehicle(name), implementation=implementation, limits=limits)
    some = [controller(vehicle, "velocity"), controller(vehicle, "acceleration")]
    for run in run_controllers(vehicle, some, Bump(height=0.01), sample_times(vehicle, 0.25, 1e-3)):
        assert run.passed
        if name == "quarter_car":
            assert max(one.sampled for one in run.agreement.signals.values()) < 1e-6


def test_a_static_law_is_a_law_without_states():
    """A law whose states do nothing asks for what its gain does, in every form of it."""
    vehicle = read_vehicle("quarter_car")
    gain = np.array([[9000.0, -1500.0]])
    silent = LinearLaw(-np.eye(2), np.zeros((2, 2)), np.ones((1, 2)), gain)
    plain = controller(vehicle, "velocity")
    names = ("suspension_deflection", "sprung_velocity")
    one, other = (replace(plain, measured=names, law=law) for law in (static_law(gain), silent))
    omega = np.geomspace(0.1, 1000, 50)
    found = [continuous_frequency_response(vehicle, each, omega) for each in (one, other)]
    np.testing.assert_allclose(*found, rtol=1e-10)
    first, second = (margins(loop_of(vehicle, each)) for each in (one, other))
    assert first.gain == pytest.approx(second.gain, rel=1e-9)
    assert first.delay == pytest.approx(second.delay, rel=1e-9)
    assert first.sample_period == pytest.approx(second.sample_period, rel=1e-9)


def test_a_loop_through_the_measurements_is_solved():
    """A law on y = y0 + D u is the law on y0 with that loop closed, at every frequency; a singular one is refused."""
    rng = np.random.default_rng(1)
    law = LinearLaw(
        -np.diag([1.0, 30.0, 4.0]), rng.standard_normal((3, 2)), rng.standard_normal((2, 3)), rng.standard_normal((2, 2))
    )
    D = rng.standard_normal((2, 2))
    solved = law.fed_back(D)
    for omega in (0.0, 1.0, 20.0):
        K, L = (one.C @ np.linalg.solve(1j * omega * np.eye(3) - one.A, one.B) + one.D for one in (law, solved))
        np.testing.assert_allclose(L, np.linalg.solve(np.eye(2) - K @ D, K), rtol=1e-10)
    back = solved.fed_back(-D)
    for name in "ABCD":
        np.testing.assert_allclose(getattr(back, name), getattr(law, name), atol=1e-10)
    with pytest.raises(InputError, match="I - D_c D is singular"):
        static_law(np.eye(2)).fed_back(np.eye(2))


def test_sampled_law_is_exact_for_ramps():
    """Between samples of a measurement that goes straight a continuous law's force is met exactly at the samples."""
    rng = np.random.default_rng(2)
    law = LinearLaw(-np.diag([1.0, 2000.0]), rng.standard_normal((2, 1)), rng.standard_normal((1, 2)), np.ones((1, 1)))
    T, y = 0.01, rng.standard_normal(40).cumsum()
    sampled, x, forces = law.sampled(T), np.zeros(2), []
    for value in y - y[0]:
        forces.append(float((sampled.C @ x + sampled.D @ [value])[0]))
        x = sampled.A @ x + sampled.B @ [value]
    exact, state = [0.0], np.zeros(2)
    for now, then in zip(y - y[0], y[1:] - y[0], strict=False):
        # x' = A x + B y with y' constant: the exponential of both together.
        both = np.zeros((4, 4))
        both[:2, :2], both[:2, 2:3], both[2, 3] = law.A, law.B, 1.0
        state = (linalg.expm(both * T) @ np.concatenate([state, [now, (then - now) / T]]))[:2]
        exact.append(float((law.C @ state)[0] + then))
    np.testing.assert_allclose(forces, exact, atol=1e-12 * np.abs(exact).max())


@pytest.mark.attack
@pytest.mark.parametrize("acceleration", ["sprung_acceleration", "unsprung_acceleration"])
def test_margins_of_a_loop_with_an_accelerometer(acceleration):
    """Gain, delay and sample period at which it is unstable are where a pole of the loop that bears them is on the verge."""
    law = {
        "sprung_acceleration": "A = [[-3.0]]\nB = [[0.0, 1.0]]\nC = [[-4000.0]]\nD = [[6000.0, 100.0]]\n",
        "unsprung_acceleration": "A = [[-0.5]]\nB = [[0.0, 1.0]]\nC = [[600.0]]\nD = [[9000.0, 5.0]]\n",
    }[acceleration]
    section = f'[controllers.mine]\nmeasured = ["suspension_deflection", "{acceleration}"]\n{law}'
    vehicle = parse_vehicle(f"{read_vehicle('quarter_car').text}\n{section}")
    one = Designer(vehicle).design("mine")
    whole = loop_of(vehicle, one)
    found, loop = margins(whole), whole.cut(whole.forces)
    scaled = replace(one, law=one.law.scaled(found.gain))
    assert abs(np.linalg.eigvals(scaled.loop(vehicle).A).real.max()) < 1e-7 * np.abs(loop.A).max()
    at = np.exp(-1j * found.frequency * found.delay)
    assert abs(np.linalg.eigvals(loop.response(1j * np.array([found.frequency]))[0] * at)[0] - 1) < 1e-7
    sampled = loop_of(vehicle, one, largest_sample_period(whole)).closed_loop
    assert np.abs(np.linalg.eigvals(sampled.A)).max() == pytest.approx(1, abs=1e-9)


def test_growth_that_creeps_is_seen():
    """A loop that a filtered measurement lets diverge slowly is found to, in MuJoCo, where its pole crosses zero."""
    vehicle = read_vehicle("quarter_car")
    # At rest the force is a third of the spring's, and away from it: three times the gain holds nothing.
    stiffness = vehicle.parameters["suspension_stiffness"]
    law = LinearLaw(*(np.array(one) for one in ([[-2.0]], [[2.0]], [[stiffness / 3]], [[0.0]])), sample_period=None)
    one = replace(controller(vehicle, "velocity"), measured=("suspension_deflection",), law=law)
    assert gain_crossings(cut_loop(vehicle, one)) == [pytest.approx(3, rel=1e-9)]
    trials = [LoopCase(vehicle, replace(one, law=law.scaled(3 * share))) for share in (0.98, 1.02)]
    step = step_derivative(vehicle, 2e-3)
    rates = rates_of_runs(trials, [simulated_loop(step, trial) for trial in trials])
    assert [rate > 0 for rate in rates] == [False, True]
    for rate, trial in zip(rates, trials, strict=True):
        slowest = np.linalg.eigvals(trial.controller.loop(vehicle).A).real.max()
        assert rate == pytest.approx(slowest, rel=1e-2)  # of first order in the hold


def test_a_force_in_its_own_measurement_bears_no_more_gain_than_it_comes_back_with():
    """Of a gain on acceleration the margin is where the force moves the sensor by more than itself, as the sampled loop tells."""
    vehicle = read_vehicle("quarter_car")
    mass = vehicle.parameters["sprung_mass"]
    one = replace(controller(vehicle, "velocity"), measured=("sprung_acceleration",), law=static_law(-np.full((1, 1), mass / 5)))
    assert gain_crossings(cut_loop(vehicle, one)) == [pytest.approx(5, rel=1e-9)]
    errors = [gain_crossings(cut_loop(vehicle, one, step))[0] - 5 for step in (1e-4, 5e-5)]
    assert 0 < errors[0] < 0.01  # of first order in the step
    assert errors[0] / errors[1] == pytest.approx(2, rel=0.01)


def test_a_vehicle_with_an_accelerometer_ships():
    """The vehicle is found by its name, its law is within 0.1 % of the norm of I, which needs the velocity, and MuJoCo agrees."""
    vehicle = read_vehicle("quarter_car_accelerometer")
    found = Designer(vehicle).design("accelerometer")
    assert found.certificate.norm.value == pytest.approx(Designer(vehicle).design("I").certificate.norm.value, rel=1e-3)
    assert found.certificate.stability.worst.real < -1  # as fast as I, and three times as fast as without control
    (run,) = run_controllers(vehicle, [found], Bump(), sample_times(vehicle, 2.0, 1e-3))
    assert run.passed
    assert max(one.sampled for one in run.agreement.signals.values()) < 1e-6


@pytest.mark.parametrize("period", [None, 0.02])
def test_what_is_printed_of_a_law_with_states(period):
    """The report's table holds its forces' amplitudes, found here from a law that is run on a sinusoid."""
    vehicle = read_vehicle("half_car")
    one = controller(vehicle, "acceleration", 3)
    law = one.law if period is None else one.law.sampled(period)
    one = replace(one, law=law)
    table = gain_table(vehicle, one)
    assert table is not None
    frequencies = [float(name.removesuffix(" Hz")) for name in table.headings[2:]]
    assert frequencies == [0.1, 1, 3, 10, 25][: 5 if period is None else 4]  # below half of 50 Hz
    assert [row[0] for row in table.rows] == [name.replace("_", " ") for name in one.measured]
    step = 1e-3 if period is None else period
    run = law.sampled(step)
    for i, row in enumerate(table.rows):
        for frequency, cell in zip(frequencies, row[2:], strict=True):
            turn = np.exp(2j * np.pi * frequency * step)
            x = np.linalg.solve(turn * np.eye(3) - run.A, run.B[:, i])
            force = run.C @ x + run.D[:, i]
            # Between samples that go straight a sinusoid is less by (w h)^2 / 12: 2e-3 at 25 Hz.
            assert float(cell) == pytest.approx(np.linalg.norm(force), rel=3e-3 if period is None else 1e-5)


@pytest.mark.attack
@pytest.mark.parametrize("period", [0.002, None])
def test_a_campaign_drives_laws_with_states(tmp_path, capsys, period):
    """Over a campaign their linear errors are RK4's own; its folder holds their laws, confirms them, and goes on with them."""
    one = controller(read_vehicle("quarter_car"), "acceleration", 3)
    record = (one.law if period is None else one.law.sampled(period)).record
    text = (HERE / "quarter_car_accelerometer.toml").read_text(encoding="utf-8")
    matrices = "".join(f"{key} = {value}\n" for key, value in record.items())
    text += f"\n[controllers.mine]\nmeasured = {json.dumps(one.measured)}\n{matrices}"
    text += "" if period is None else f"\n[implementation]\nsample_period = {period}\n"
    (tmp_path / "car.toml").write_text(text, encoding="utf-8")
    (tmp_path / "campaign.toml").write_text(
        'vehicles = ["car.toml"]\ncontrollers = ["I", "accelerometer", "mine"]\nroads = ["bump", "iso8608:class=A"]\n'
        "speeds = [12.5]\nseeds = 1\nduration = 0.5\nsettle = 0.25\n",
        encoding="utf-8",
    )
    ask = [str(tmp_path / "campaign.toml"), "--results", str(tmp_path / "results"), "--workers", "1", "--json"]
    assert campaign(ask) == 0
    table = pq.read_table(next((tmp_path / "results").glob("*.parquet"))).to_pylist()
    assert {row["controller"] for row in table} == {"I", "accelerometer", "mine"}
    if period is None:  # MuJoCo is compared where the loop is ideal
        assert all(row["linear_error"] < 1e-6 for row in table if row["road"] == "bump")  # 4e-8 to 4e-7, as in sim.bump
    assert all(row["reason"] is None for row in table)
    assert campaign(ask) == 0  # nothing is left to do
    assert campaign(["--verify", str(tmp_path / "results"), "--json"]) == 0
    capsys.readouterr()
    held = json.loads((tmp_path / "results" / "plan.json").read_text(encoding="utf-8"))["controllers"]["car.toml"]["mine"]
    assert held == {"measured": list(one.measured), **record}


@pytest.mark.parametrize(("bandwidth", "unit"), [(60.0, 1.0), (500.0, 1e-6)])
def test_no_crossover_is_missed(bandwidth, unit):
    """Behind a lag, and with a law's states in whatever unit, every crossing of |L| = 1 on a fine grid is found."""
    vehicle = replace(read_vehicle("quarter_car"), limits=Limits(actuator_bandwidth=bandwidth))
    plain, states = controller(vehicle, "velocity"), np.diag([1.0, unit])
    law = LinearLaw(
        np.diag([-3.0, -200.0]),
        np.linalg.solve(states, np.array([[0.0, 1.0], [200.0, 0.0]])),
        np.array([[-2000.0, 11000.0]]) @ states,
        np.array([[0.0, 0.0]]),
    )
    names = ("suspension_deflection", "sprung_acceleration")
    static = replace(plain, measured=vehicle.linear_model.states, law=static_law(np.array([[11810.0, 2333.0, -1096.0, 109.0]])))
    for one in (replace(plain, measured=names, law=law), static):
        loop = cut_loop(vehicle, one)
        omega = np.geomspace(1e-2, 1e4, 5_000)

        def excess(w, loop=loop):
            return np.abs(loop.response(1j * np.atleast_1d(w))[:, 0, 0]) - 1

        at = np.flatnonzero(np.diff(excess(omega) > 0))
        crossings = np.array([optimize.brentq(lambda w: float(excess(w)[0]), *omega[i : i + 2], xtol=1e-12) for i in at])
        found = sorted(crossover.frequency for crossover in crossovers(loop))
        np.testing.assert_allclose(found, crossings, rtol=1e-8)  # both refined further


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_force_that_comes_back_larger_bears_no_delay(share, tmp_path):
    """From once its own size on, a force in its own measurement has a delay margin of zero, as the sampled loop shows."""
    vehicle = read_vehicle("quarter_car")
    gain = share * vehicle.parameters["sprung_mass"]
    one = replace(controller(vehicle, "velocity"), measured=("sprung_acceleration",), law=static_law(np.array([[-gain]])))
    loop = loop_of(vehicle, one)
    found = margins(loop)
    assert loop.direct_radius == pytest.approx(share, rel=1e-12)
    radii = [sampled_radius(vehicle, one, h) for h in (1e-3, 1e-6)]
    if share < 1:
        assert found.delay > 0
        assert found.gain == pytest.approx(1 / share, rel=1e-9)
        assert radii[1] < 1
        return
    assert found.delay == found.sample_period == 0
    assert found.gain_lower == 0, "the loop on paper is stable at any lower gain"
    assert min(radii) > 1
    (tmp_path / "car.toml").write_text(
        f"{vehicle.text}\n[controllers.mine]\nmeasured = ['sprung_acceleration']\ngain = [[-{gain}]]\n"
    )
    with pytest.raises(
        InputError, match=rf"neither delay nor sampling.*returns in its measurements {share:.4g} times as large"
    ) as said:
        main(["--vehicle", str(tmp_path / "car.toml"), "--controller", "mine"])
    assert "smaller timestep" not in str(said.value), "none would help"
