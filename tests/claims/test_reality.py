"""Limits and implementation: exact in the MJCF, and with an exact linear counterpart for all that is linear."""

import dataclasses
import itertools

import numpy as np
import pytest
from scipy import linalg, stats

from models.laws.linear import static_law
from models.roads.road import Bump
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.vehicle import read_vehicle
from sim.linear.sampled_response import taylor4
from sim.runs.report import verdict_lines
from sim.runs.run import run_controllers, sample_times
from synth.vehicle.designer import Designer, certify_given
from tests.support.analysed import continuous_response, most_quantised, noise_rms, sampled_radius, sampled_response, simulate
from tests.support.commands import refused


def with_reality(vehicle, limits=None, implementation=None):
    return dataclasses.replace(vehicle, limits=limits or Limits(), implementation=implementation or Implementation())


def worst(vehicle, controller, road, time):
    """Largest difference of any signal between MuJoCo and the RK4-sampled linear response, over the signal's scale."""
    physics = simulate([vehicle], [controller], [road], time).response.run(0)
    predicted = sampled_response(vehicle, controller, road, time, exponential=taylor4)
    return max(np.abs(physics[name] - predicted[name]).max() / predicted.scale(name) for name in vehicle.linear_model.outputs)


LINEAR = {
    "delay": (None, Implementation(delay=7)),
    "sample period": (None, Implementation(sample_period=5e-3)),
    "sample period and delay": (None, Implementation(sample_period=4e-3, delay=3)),
    "delay of a fraction": (None, Implementation(sample_period=4e-3, delay=0.25)),
    "delay and a fraction": (Limits(actuator_bandwidth=60.0), Implementation(sample_period=5e-3, delay=2.6)),
    "lag": (Limits(actuator_bandwidth=60.0), None),
    "all": (Limits(actuator_bandwidth=60.0), Implementation(sample_period=4e-3, delay=3)),
}


@pytest.mark.parametrize(("case", "name"), [*zip(LINEAR, itertools.cycle(["state", "I", "II"])), ("all", "state")])
def test_what_is_linear_agrees_to_rounding(paper, designer, case, name):
    """A sampled, delayed, lagged controller in MuJoCo is its linear counterpart, to rounding."""
    vehicle = with_reality(paper, *LINEAR[case])
    assert worst(vehicle, designer.design(name), Bump(), sample_times(paper, 1.5, 1e-3)) < 1e-11  # 1500 steps of rounding


def test_half_car_agrees_too():
    """A delayed, lagged half-car, whose deflections are read from sensors, is its linear counterpart at small amplitude."""
    half = read_vehicle("half_car")
    controller = Designer(half).design("I")
    vehicle = with_reality(half, *LINEAR["all"])
    assert worst(vehicle, controller, Bump(height=1e-3), sample_times(half, 1.0, 1e-3)) < 1e-5  # geometry at 1 mm


def test_lag_tends_to_the_continuous_loop(paper, designer):
    """With a lagged actuator the sampled loop tends to the continuous one, at first order in the step."""
    vehicle, controller, errors = with_reality(paper, Limits(actuator_bandwidth=60.0)), designer.design("I"), []
    for step in (2e-3, 1e-3, 5e-4):
        time = sample_times(paper, 1.0, step)
        sampled, continuous = (f(vehicle, controller, Bump(), time) for f in (sampled_response, continuous_response))
        errors.append(np.abs(sampled["suspension_deflection"] - continuous["suspension_deflection"]).max())
    np.testing.assert_allclose(np.diff(np.log2(errors)), -1.0, atol=0.05)  # the next order


def test_force_saturates(paper, designer):
    """No actuator gives more than its largest force, and gives it while more is asked for."""
    vehicle, time = with_reality(paper, Limits(actuator_force=500.0)), sample_times(paper, 1.0, 1e-3)
    force = simulate([vehicle], [designer.design("I")], [Bump()], time).response.run(0)["control_force"]
    assert np.abs(force).max() == 500.0
    assert np.sum(np.abs(force) == 500.0) > 50


def test_quantisation_is_exact(paper, designer):
    """The force is the gain on measurements rounded to their resolution."""
    vehicle = with_reality(paper, None, Implementation(quantisation={"sprung_velocity": 0.01}))
    controller, time = designer.design("II"), sample_times(paper, 1.0, 1e-3)
    response = simulate([vehicle], [controller], [Bump()], time).response.run(0)
    expected = controller.gain[0, 0] * 0.01 * np.round(response["sprung_velocity"] / 0.01)
    np.testing.assert_allclose(response["control_force"], expected, atol=1e-9)


def test_noise_has_its_predicted_variance(paper, designer):
    """On a flat road, measurement noise moves the car with the variance that the discrete Lyapunov equation predicts."""
    controller, rms, step = designer.design("II"), 0.01, 4e-3
    time, runs = sample_times(paper, 6.0, step), 40
    vehicles = [with_reality(paper, None, Implementation(noise={"sprung_velocity": rms}, seed=seed)) for seed in range(runs)]
    response = simulate(vehicles, [controller] * runs, [Bump(height=0.0)] * runs, time).response
    predicted = lyapunov_rms(paper, controller, step, {"sprung_velocity": rms})["suspension_deflection"]
    measured = np.sqrt(np.mean(response["suspension_deflection"][:, len(time) // 2 :] ** 2))
    assert measured == pytest.approx(predicted, rel=0.1)  # 40 runs of a slow mode, a dozen independent values each: 5 %
    again = simulate(vehicles[:1], [controller], [Bump(height=0.0)], time).response
    np.testing.assert_array_equal(again.values[0], response.values[0])  # the seed fixes it


def test_noise_of_what_symmetry_keeps_silent():
    """A full car's gains are symmetric to eight digits, so noise on heave makes it roll: hardly, and as much as is predicted."""
    car = with_reality(read_vehicle("full_car"), None, Implementation(noise={"heave_velocity": 0.005}))
    controller, time = Designer(car).design("I"), sample_times(car, 3.0, 2e-3)
    spread = stationary(car, controller, 2e-3)
    assert 0 < spread["roll_rate"] < 1e-6 * spread["heave_velocity"]
    predicted = sampled_response(car, controller, Bump(height=0.0), time)
    assert predicted.peak("roll_rate") == 0
    (run,) = run_controllers(car, [controller], Bump(), time)
    assert run.agreement.agrees  # within six of those standard deviations, roll too


def test_noise_and_geometry_together():
    """If noise is small beside what turning makes, that is told from error as it is without noise."""
    half = with_reality(read_vehicle("half_car"), None, Implementation(noise={"heave_velocity": 1e-7}))
    (run,) = run_controllers(half, [Designer(half).design("I")], Bump(), sample_times(half, 1.0, 1e-3))
    assert run.agreement.agrees
    line, steps = verdict_lines(run)
    assert line.startswith("agrees to first order throughout: geometry and noise make up to")
    assert steps.startswith(
        "agrees step by step throughout: each step of MuJoCo is that of the vehicle's nonlinear equations of motion to"
    )
    assert "exact" not in line


def stationary(vehicle, controller, step):
    """Returns what the rms of every output comes to under noise, the largest of any timestep of a sample."""
    last = noise_rms(vehicle, controller, step, 20_000)[-100:].max(axis=0)
    return dict(zip(vehicle.linear_model.outputs, last.tolist(), strict=True))


@pytest.mark.parametrize(("gain", "held"), [(-2000.0, 1), (9000.0, 1), (-2000.0, 5)])
def test_rms_from_rest_is_the_covariance_step_by_step(paper, gain, held):
    """At every timestep it is that of the covariance, whether the loop decays or grows, and while a force is held over steps."""
    vehicle = with_reality(paper, None, Implementation(sample_period=held * 2e-3, noise={"sprung_velocity": 0.01}))
    controller = certify_given(vehicle, "mine", ("sprung_velocity",), static_law(np.array([[gain]])))
    found = noise_rms(vehicle, controller, 2e-3, 400)
    model = vehicle.linear_model
    augmented = np.zeros((5, 5))  # of the state and the held force
    augmented[:4] = np.hstack([model.A, model.B])
    step, sampled = linalg.expm(2e-3 * augmented), np.eye(5)
    sampled[4] = [*controller.state_gain(vehicle)[0], 0.0]
    grows = np.abs(np.linalg.eigvals(np.linalg.matrix_power(step, held) @ sampled)).max() > 1
    assert grows == (gain > 0)
    rows, P = np.hstack([model.C, model.D]), np.zeros((5, 5))
    for k, row in enumerate(found):
        if k % held == 0:
            P = sampled @ P @ sampled.T
            P[4, 4] += (0.01 * gain) ** 2
        np.testing.assert_allclose(row**2, np.diag(rows @ P @ rows.T), rtol=1e-9)  # the same sums, otherwise put
        P = step @ P @ step.T


@pytest.mark.parametrize(
    "how", [Implementation(), Implementation(sample_period=0.01), Implementation(sample_period=6e-3, delay=2)]
)
def test_the_worst_rounding_is_the_sum_of_what_every_sample_does(paper, how):
    """The largest effect of quantisation is half a resolution times the sum of |h|, where noise of that size makes the sum of
    h^2."""
    quantised = with_reality(paper, None, dataclasses.replace(how, quantisation={"sprung_velocity": 0.002}))
    noisy = with_reality(paper, None, dataclasses.replace(how, noise={"sprung_velocity": 0.001}))
    controller = certify_given(paper, "mine", ("sprung_velocity",), static_law(np.array([[-9000.0]])))
    steps = round((how.sample_period or 2e-3) / 2e-3)
    most = most_quantised(quantised, controller, 2e-3, 200)[::steps]
    rms = noise_rms(noisy, controller, 2e-3, 200)[::steps]
    of_each = np.sqrt(np.maximum(np.diff(rms**2, axis=0), 0.0))  # beside what a sample does at once, the same in all of them
    np.testing.assert_allclose(most[1:], rms[0] + np.cumsum(of_each, axis=0), rtol=1e-6)  # differences of sums lose digits


@pytest.mark.parametrize(("gain", "resolution"), [(-2000.0, 1e-3), (-20000.0, 0.02), (1500.0, 1e-3)])
def test_no_rounding_moves_a_signal_further_than_is_said(paper, gain, resolution):
    """A quantised loop stays within the bound of the one that is not, with a dead zone that no white noise has, and unstable."""
    vehicle = with_reality(paper, None, Implementation(quantisation={"sprung_velocity": resolution}))
    controller = certify_given(vehicle, "mine", ("sprung_velocity",), static_law(np.array([[gain]])))
    for run in run_controllers(vehicle, [controller], Bump(height=0.02), sample_times(vehicle, 2.0, 1e-3)):
        off = {name: one.sampled / one.allowed for name, one in run.agreement.signals.items()}
        assert run.agreement.agrees
        assert max(off.values()) > 1e-3, "and it is a bound that is seen"


@pytest.mark.attack
@pytest.mark.parametrize("implementation", [Implementation(sample_period=0.04, delay=delay) for delay in (1, 0.3)])
def test_noise_between_samples(implementation):
    """Between the samples of a slow controller noise moves wheels by more than at them, at every step by what is predicted."""
    runs, step, rms = 100, 4e-3, 1e-5  # m/s: small, so that turning makes nothing
    half = read_vehicle("half_car")
    controller, noise = Designer(half).design("II"), {"heave_velocity": rms, "pitch_rate": rms}
    vehicles = [with_reality(half, None, dataclasses.replace(implementation, noise=noise, seed=seed)) for seed in range(runs)]
    predicted = noise_rms(vehicles[0], controller, step, 20_000)[-10:]  # a period, from its sample on
    time = sample_times(half, 2.4, step)  # the slowest mode has e^-14 of its variance to come
    response = simulate(vehicles, [controller] * runs, [Bump(height=0.0)] * runs, time).response
    last = (len(time) - 1) // 10 * 10 - 10  # the first step of the last whole period
    names = half.linear_model.outputs
    measured = np.stack([np.mean(response[name][:, last : last + 10] ** 2, axis=0) for name in names], axis=-1)
    # Runs are independent, so such a mean square is a chi-square of as many degrees, and all lie within its quantiles but once in
    # a million tests, whatever they share.
    low, high = stats.chi2.ppf([5e-7 / predicted.size, 1 - 5e-7 / predicted.size], runs) / runs
    assert np.all(measured >= low * predicted**2)
    assert np.all(measured <= high * predicted**2)
    spread = stationary(vehicles[0], controller, step)
    larger = spread["unsprung_velocity_front"] / predicted[0, names.index("unsprung_velocity_front")]
    assert larger > (2 if implementation.delay % 1 == 0 else 1.1)  # measured: 3, and 1.13
    (run,) = run_controllers(vehicles[0], [controller], Bump(height=1e-4), sample_times(half, 1.0, step))
    assert run.agreement.agrees


def lyapunov_rms(vehicle, controller, step, noise):
    """Stationary rms of every output under white measurement noise, by the discrete Lyapunov equation."""
    model = vehicle.linear_model
    augmented = np.zeros((5, 5))
    augmented[:4] = np.hstack([model.A, model.B])
    held = linalg.expm(augmented * step)
    Phi, Gamma = held[:4, :4], held[:4, 4:]
    drive = Gamma @ controller.gain @ np.diag([noise[name] for name in controller.measured])
    P = linalg.solve_discrete_lyapunov(Phi + Gamma @ controller.state_gain(vehicle), drive @ drive.T)
    return {name: float(np.sqrt(row @ P @ row)) for name, row in zip(model.outputs, model.C, strict=True)}


def test_delay_margin_of_ii(paper, designer):
    """At a 0.5 ms sample II is stable with 173 samples of delay and unstable with 174: theory's 87.097 ms, to one sample."""
    radius = {
        delay: sampled_radius(with_reality(paper, None, Implementation(delay=delay)), designer.design("II"), 5e-4)
        for delay in (173, 174)
    }
    assert radius[173] < 1 < radius[174]


def test_delay_and_sample_period_fit_the_timestep(paper, designer):
    """A delay or a sample period that ends within a step of physics is refused, with the step; one that ends at one is not."""
    vehicle = with_reality(paper, None, Implementation(sample_period=0.01, delay=1.5))
    simulate([vehicle], [designer.design("I")], [Bump()], sample_times(paper, 0.1, 1e-3))
    for one, said in (
        (vehicle, "delay = 1.5 samples, 0.015 s, is not a multiple of the timestep, 0.002 s"),
        (with_reality(paper, None, Implementation(sample_period=3e-3)), "not a multiple of the timestep"),
    ):
        with refused(said):
            simulate([one], [designer.design("I")], [Bump()], sample_times(paper, 0.1, 2e-3))
