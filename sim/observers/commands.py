"""Compares the commands of a run with the control law, which is evaluated at every sample for the measurements of the run.

At each sample, the law is evaluated with the measurements of the run and the recorded states of the law. Because each sample is
evaluated separately, an error at one sample cannot hide an error at another sample. The module makes three comparisons. The
measurements must be the run's signals at the sample, to which noise and quantisation are added. The commands must be those of
the law, within the ranges of semi-active dampers. Each command must act `delay` samples after its measurements. A Python
control law, an FMU or exported code is started again and receives the measurements of the run.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.extensions import FEATURES
from models.roads.road import RoadInput
from models.vehicle.limits_and_implementation import CommandLimiter, command_limiter, steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.drive.actuators import closing_names
from sim.drive.computer import implementation_around, measurement_noise
from sim.drive.driver import steps_ahead
from sim.drive.drivers.registry import driver_of
from sim.linear.outputs import forces_ahead
from sim.linear.rounding import roundings
from sim.observers.recorder import Recording, from_steady
from sim.observers.results import CommandAgreement
from synth.controller.controller import AnyController, Controller

if TYPE_CHECKING:
    from models.laws.semi_active import SemiActive

SPEED = 1e-8  # allowed difference of a closing velocity: in m/s, plus relative to its largest value; at most 4e-16 was observed
# allowed difference between two commands, relative to the largest term of their sums; rounding causes at most 1e-13, a command
# that is one sample late at least 1e-3
EXACT = 1e-10


# Name of a signal, sample times [s], and the difference and the allowed difference relative to the peak, shape (K,) each
Difference = tuple[str, Array, Array, Array]


@dataclass(frozen=True, eq=False)
class _Samples:
    """Samples of one controller whose commands are compared with the control law.

    Attributes:
        due: indices of the time steps at which the controller takes the K samples.
        period: number of time steps per sample.
        y: measurements that the law receives, shape (K, q).
        closing_velocities: closing velocities of the suspensions [m/s], shape (K, m); (K, 0) without semi-active dampers.
        states: states of a linear law at the samples, in the discrete form of the law, shape (K, k).
    """

    due: Array
    period: int
    y: Array
    closing_velocities: Array
    states: Array


def compare_commands(controller: AnyController, road: RoadInput, recording: Recording) -> CommandAgreement:
    """Compares a run's commands with its control law, up to the time at which the run diverges.

    Args:
        controller, road: controller and road input that the run should have; the road input includes the vehicle.
        recording: recording of the run.
    """
    vehicle, h = road.vehicle, road.timestep
    how = implementation_around(controller, vehicle)
    period, count = steps_per_sample(how, h), int(np.searchsorted(road.time, recording.diverged))
    due, outputs = np.arange(0, count, period), vehicle.linear_model.outputs
    noise = measurement_noise([how], (*outputs, *[""] * len(closing_names(vehicle))), len(road.time))
    columns = []
    for name in controller.measured:
        seen = recording.measured[name][due]
        if len(noise):
            seen = seen + noise[due, 0, outputs.index(name)]
        if step := how.quantisation.get(name):
            seen = step * np.round(seen / step)
        columns.append(seen)
    closing = [recording.measured[name][due] for name in closing_names(vehicle)]
    y, velocities = (np.stack(one, axis=1) if one else np.zeros((len(due), 0)) for one in (columns, closing))
    samples = _Samples(due, period, y, velocities, recording.law_states[due] / controller.state_scale(period * h))
    late = round(how.delay * period)
    readings = [*_readings(controller, road, recording, due)]

    def answer() -> list[Difference]:
        return [*_commands(controller, road, samples, recording, count, late)]

    result = _worst([*readings, *answer()], vehicle)
    if result.agrees or not controller.serial:
        return result
    once = answer()
    # the law first repeats half of the samples; a law that depends on its previous run then gives different commands
    _again(controller, road, replace(samples, due=due[: len(due) // 2]))
    if any(np.any(a[2] != b[2]) for a, b in zip(once, answer(), strict=True)):
        return replace(_worst(readings, vehicle), repeatable=False)
    return result


def _worst(differences: list[Difference], vehicle: Vehicle) -> CommandAgreement:
    """Returns the agreement for the signal whose difference is largest relative to the allowed difference of the signal."""
    worst = CommandAgreement(0.0, EXACT, vehicle.linear_model.inputs[0], np.inf)
    since = np.inf
    for name, times, far, allowed in differences:
        if not len(far):
            continue
        far = np.where(np.isfinite(far), far, np.inf)
        excess = far / allowed
        k = int(excess.argmax())
        if excess[k] > worst.error / worst.allowed:
            worst = CommandAgreement(float(far[k]), float(allowed[k]), name, np.inf)
        if np.any(excess > 1):
            since = min(since, float(times[(excess > 1).argmax()]))
    return CommandAgreement(worst.error, worst.allowed, worst.signal, since)


def _readings(controller: AnyController, road: RoadInput, recording: Recording, due: Array) -> Iterator[Difference]:
    """Yields the differences between the measurements and the run's signals at the samples.

    An acceleration is measured before the new force and the new load act. Accelerations are therefore compared by
    `sim.observers.steps`.
    """
    physics = from_steady(road, recording.response)
    rounded = roundings(road.vehicle, None)
    D, Dh = road.vehicle.linear_model.D, road.vehicle.linear_model.Dh
    for name in controller.measured:
        row = road.vehicle.linear_model.outputs.index(name)
        if not (D[row].any() or Dh[row].any()):
            scale = physics.scale(name) or 1.0
            far = np.abs(recording.measured[name][due] - physics[name][due]) / scale
            yield name, road.time[due], far, np.full(len(due), EXACT + rounded[name] / scale)
    if road.vehicle.dampers:
        closing = FEATURES.load("dampers in linear analysis").closing_velocities(road.vehicle, physics.samples(due))
        for name, expected in zip(closing_names(road.vehicle), closing.T, strict=True):
            scale = float(np.abs(expected).max(initial=0.0)) or 1.0
            far = np.abs(recording.measured[name][due] - expected) / scale
            yield name, road.time[due], far, np.full(len(due), SPEED * (1 + 1 / scale))


def _commands(
    controller: AnyController, road: RoadInput, samples: _Samples, recording: Recording, count: int, late: int
) -> Iterator[Difference]:
    """Yields the differences between the commands of the run and those of the law; for a linear law, also between the states."""
    vehicle, times = road.vehicle, road.time[:count]
    inputs = vehicle.linear_model.inputs
    names = (*inputs, *(f"missing {name}" for name in inputs))
    arrived = (np.arange(count) - late) // samples.period  # for each time step, index of the sample whose command acts
    after, limiter = None, command_limiter([vehicle], road.timestep)
    logged = recording.commands[samples.due[samples.due + late < count] + late, : len(inputs)]
    if controller.user_code is True or controller.driver_key[0] not in ("linear", "semi_active"):
        computed = _again(controller, road, samples)
        if limiter is not None and driver_of([controller]).requests != "commands":
            computed = _limit_commands(limiter, computed, logged)
        allowed = np.full_like(computed, EXACT) * np.abs(computed).max(axis=0, initial=0.0)
    elif controller.linear is True:
        computed, allowed, after = _linear(controller, road, samples, limiter, logged)
    else:
        computed, allowed = _semi_active(controller, vehicle, samples)
    for j in range(computed.shape[1]):
        expected, slack = (np.where(arrived >= 0, one[np.maximum(arrived, 0), j], 0.0) for one in (computed, allowed))
        scale = float(np.abs(expected).max(initial=0.0)) or 1.0
        yield names[j], times, np.abs(recording.commands[:count, j] - expected) / scale, np.maximum(slack / scale, EXACT)
    if after is not None:
        for i, (expected, slack) in enumerate(zip(*(one.T for one in after), strict=True)):
            scale = float(np.abs(expected).max(initial=0.0)) or 1.0
            far = np.abs(samples.states[1:, i] - expected[:-1]) / scale
            yield f"state {i + 1} of the law", times[samples.due[1:]], far, np.maximum(slack[:-1] / scale, EXACT)


def _limit_commands(limiter: CommandLimiter, requested: Array, logged: Array) -> Array:
    """Returns the command at each sample after limiting the rate, shape (K, m).

    Each command is limited relative to the logged command of the previous sample.

    Args:
        logged: commands that acted in the run, by sample, shape (.., m). After the last logged command, each command starts
            from the previous command that this function computed.
    """
    before = np.zeros_like(requested)
    before[1 : len(logged) + 1] = logged[: max(len(before) - 1, 0)]
    for i in range(len(logged) + 1, len(before)):
        before[i] = limiter(requested[i - 1 : i], before[i - 1 : i])[0]
    return limiter(requested, before)


def _linear(
    controller: Controller, road: RoadInput, samples: _Samples, limiter: CommandLimiter | None, logged: Array
) -> tuple[Array, Array, tuple[Array, Array]]:
    """Returns a linear law's commands, shape (K, c), and its next states, shape (K, k), each with its allowed differences.

    Args:
        limiter: rate limiter of the commands; None if the rate of the commands is not limited.
        logged: commands that acted in the run; see `_limit_commands`.
    """
    vehicle, h, y, x = road.vehicle, road.timestep, samples.y, samples.states
    law = controller.law.sampled(samples.period * h)
    forces, of_forces = y @ law.D.T + x @ law.C.T, np.abs(y) @ np.abs(law.D).T + np.abs(x) @ np.abs(law.C).T
    if controller.preview is not None:
        ahead = forces_ahead(controller.preview, road, samples.period)[samples.due]
        forces, of_forces = forces + ahead, of_forces + np.abs(ahead).max(axis=0, initial=0.0)
    after, of_after = y @ law.B.T + x @ law.A.T, np.abs(y) @ np.abs(law.B).T + np.abs(x) @ np.abs(law.A).T
    slack = EXACT * np.broadcast_to(of_forces.max(axis=0, initial=0.0), forces.shape)
    closing = samples.closing_velocities if vehicle.dampers else None
    given = forces if limiter is None else _limit_commands(limiter, forces, logged)
    if law.anti_windup is not None:
        range_of = FEATURES.load("damper ranges").range_of
        of, gain = range_of([vehicle], [vehicle.limits.actuator_force]), FEATURES.load("anti-windup").anti_windup_gain(law)
        lost = of.clipped_off(forces, closing) if limiter is None else given - forces
        after = after + lost @ gain.T
        of_after = of_after + of_forces @ np.abs(gain).T
    states = after, EXACT * np.broadcast_to(of_after.max(axis=0, initial=0.0), after.shape)
    if closing is None:
        return given, slack, states
    range_of = FEATURES.load("damper ranges").range_of
    of = range_of([vehicle])
    speed = np.abs(of.effective_velocity(closing))
    commands = of.commands(np.concatenate([forces, closing], axis=1))
    return (
        commands,
        np.concatenate([np.minimum(slack / speed, of.high - of.low) + EXACT * np.abs(of.high), slack], axis=1),
        states,
    )


def _semi_active(controller: "SemiActive", vehicle: Vehicle, samples: _Samples) -> tuple[Array, Array]:
    """Returns the commands of a semi-active law, shape (K, 2 m), with the differences that rounding can cause."""
    semi_active = FEATURES.load("semi-active coefficients")
    of, whole = FEATURES.load("damper ranges").range_of([vehicle]), slice(None)
    numbers = semi_active.numbers_at(semi_active.numbers_of([controller.law], [vehicle]), of, samples.closing_velocities, whole)
    commands = of.clip_coefficients(controller.law.coefficients(samples.y, numbers), samples.closing_velocities)
    return commands, EXACT * np.broadcast_to(np.abs(commands).max(axis=0, initial=0.0), commands.shape)


def _again(controller: AnyController, road: RoadInput, samples: _Samples) -> Array:
    """Starts a Python control law, an FMU or exported code again. Returns the law's commands for the measurements of the run,
    shape (K, c).
    """

    vehicle, h = road.vehicle, road.timestep
    driver = driver_of([controller])
    state = driver.start([vehicle], h)
    heights = np.concatenate([road.heights, road.ahead(steps_ahead([vehicle], [controller], h))])
    requests = []
    for i, k in enumerate(samples.due.tolist()):
        ahead = None
        if driver.ahead:
            ahead = heights[k : k + (driver.ahead - 1) * samples.period + 1 : samples.period].T[None]
        y = samples.y[i : i + 1]
        if len(driver.measured) > y.shape[1]:
            y = np.concatenate([y, samples.closing_velocities[i : i + 1]], axis=1)
        request, state = driver.step(k, y, ahead, state)
        requests.append(request[0])
    requested = np.array(requests).reshape(len(requests), -1) if requests else np.zeros((0, 0))
    if not vehicle.dampers or driver.requests == "commands":
        return requested
    of, closing = FEATURES.load("damper ranges").range_of([vehicle]), samples.closing_velocities[: len(requested)]
    if driver.requests == "coefficients":
        return of.clip_coefficients(requested, closing)
    return of.commands(np.concatenate([requested, closing], axis=1))
