"""Limits and implementation: exact in the MJCF, and with an exact linear counterpart for all that is linear."""

import dataclasses
import itertools
import re

import numpy as np
import pytest
from scipy import linalg

from models.roads.road import Bump
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.vehicle import read_vehicle
from sim.linear.sampled_response import taylor4
from sim.runs.report import reasons
from sim.runs.run import run_controllers, sample_times
from synth.vehicle.designer import Designer
from tests.support.analysed import continuous_response, sampled_response, simulate
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


def test_lag_tends_to_the_continuous_loop(paper, designer):
    """With a lagged actuator the sampled loop tends to the continuous one, at first order in the step."""
    vehicle, controller, errors = with_reality(paper, Limits(actuator_bandwidth=60.0)), designer.design("I"), []
    for step in (2e-3, 1e-3, 5e-4):
        time = sample_times(paper, 1.0, step)
        sampled, continuous = (f(vehicle, controller, Bump(), time) for f in (sampled_response, continuous_response))
        errors.append(np.abs(sampled["suspension_deflection"] - continuous["suspension_deflection"]).max())
    np.testing.assert_allclose(np.diff(np.log2(errors)), -1.0, atol=0.05)  # the next order


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


def test_noise_and_geometry_are_causes():
    """If a run has noise and geometry, both are named as causes of its distance from linear analysis; it agrees."""
    half = with_reality(read_vehicle("half_car"), None, Implementation(noise={"heave_velocity": 1e-7}))
    (run,) = run_controllers(half, [Designer(half).design("I")], Bump(), sample_times(half, 1.0, 1e-3))
    assert run.passed
    *_, steps, commands, distance, _ = [one.text for one in reasons(run)]
    assert re.fullmatch(r"every MuJoCo step equals one RK4 step of the model, to \d\.\de-1\d of a peak", steps)
    assert re.fullmatch(r"every command equals the control law, to \d\.\de-1\d of a peak", commands)
    assert "of every peak over the whole run; the difference comes from geometry and noise" in distance


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


def test_delay_and_sample_period_fit_the_timestep(paper, designer):
    """A delay or a sample period that ends within a step of physics is refused, with the step; one that ends at one is not."""
    vehicle = with_reality(paper, None, Implementation(sample_period=0.01, delay=1.5))
    simulate([vehicle], [designer.design("I")], [Bump()], sample_times(paper, 0.1, 1e-3))
    for one, said in (
        (vehicle, "delay = 1.5 samples (0.015 s) is not a multiple of the timestep 0.002 s"),
        (with_reality(paper, None, Implementation(sample_period=3e-3)), "not a multiple of the timestep"),
    ):
        with refused(said):
            simulate([one], [designer.design("I")], [Bump()], sample_times(paper, 0.1, 2e-3))
