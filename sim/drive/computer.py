"""The controller's computer: samples the signals with noise and quantisation, calls the driver, and delays the commands."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.vehicle.limits_and_implementation import Implementation, command_limiter, steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.drive.actuators import Actuators, closing_names
from sim.drive.driver import Driver, RunDriver


class Computer:
    """Computer that executes one driver for several runs, as the section `[implementation]` of each vehicle file describes.

    A measurement is quantisation * round((signal + noise) / quantisation). The commands computed from a measurement act `delay`
    samples later; `delay` need not be an integer. The rate limit on commands is applied before the delay. All commands are 0
    until the first computed commands arrive after the delay. The states of the driver are not delayed.

    Attributes:
        driver: driver that computes the commands of the runs.
        runs: indices in the batch of the n runs that use this computer.
        period: number of time steps in a sample period of the controller.
        used: states of the driver from which the last commands were computed, shape (n, k).
    """

    def __init__(
        self,
        driver: Driver,
        runs: Array | slice,
        vehicles: Sequence[Vehicle],
        how: Sequence[Implementation],
        actuators: Actuators,
        names: Sequence[str],
        heights: Array,
        timestep: float,
        samples: int,
    ) -> None:
        """Starts the driver for the n vehicles that it controls.

        Args:
            vehicles, how: vehicle and controller implementation of each of the n runs.
            actuators: actuators of all runs of the batch.
            names: names of the signals that `step` receives, without the closing velocities, which follow these signals.
            heights: road heights of the n runs at the time steps, and beyond the end of the runs as far as the driver's preview
                reaches [m], shape (.., n, r).
            timestep: duration of a time step of the runs [s].
            samples: number of time steps in each run.
        """
        self.driver, self.runs, self._actuators, self._heights = driver, runs, actuators, heights
        self._limiter = None if driver.requests == "commands" else command_limiter(vehicles, timestep)
        self._given = np.zeros((len(how), actuators.size))  # commands at the last sample, before they are delayed
        self.period, closing = steps_per_sample(how[0], timestep), closing_names(vehicles[0])
        self._state = self.used = driver.start(vehicles, timestep)
        whole = (*names, *closing)
        self._places, self._signals = np.array([whole.index(name) for name in driver.measured], dtype=int), len(names)
        self._late, self._each = np.array([round(one.delay * self.period) for one in how]), np.arange(len(how))
        # for each time step of a sample period, True if a delayed command begins to act at this step
        self._changes = np.zeros(self.period, dtype=bool)
        self._changes[self._late % self.period] = True
        most = max(one.pending_forces for one in how)
        self._waiting = np.zeros((most + 1, len(how), actuators.size))  # ring buffer of delayed commands, indexed by sample
        self._all, self._at_once = isinstance(runs, slice), not most
        self._resolution = np.array([[one.quantisation.get(name, 0.0) for name in driver.measured] for one in how])
        self._step = np.where(self._resolution > 0, self._resolution, 1.0) if self._resolution.any() else None
        drawn = (*vehicles[0].linear_model.outputs, *closing)
        noise = measurement_noise(how, drawn, samples)
        self._noise = noise[:, :, [drawn.index(name) for name in driver.measured]] if len(noise) else None

    def resume(self, starts: Mapping[int, tuple[Array, Sequence[Array] | Array]], commands: Array) -> None:
        """Sets the states and pending forces at the start of runs, and the commands that act until the first new commands arrive.

        Args:
            starts: initial state of the driver and pending forces of each run that does not start in equilibrium, by index in
                the batch.
            commands: actuator commands of all runs of the batch, shape (N, size); this array is changed in place.
        """
        for i, number in enumerate(np.arange(len(commands))[self.runs].tolist()):
            state, forces = starts.get(number, ((), []))
            self._state[i, : len(state)] = state
            if len(forces):
                self._waiting[-len(forces) :, i] = forces  # commands that were computed before sample 0
                commands[number] = forces[0]

    def step(self, k: int, signals: Array, commands: Array) -> None:
        """Computes the commands for time step k from the signals and closing velocities at the start of this step.

        Args:
            k: index of the time step, from 0.
            signals: signals and closing velocities of all runs, shape (N, S).
            commands: actuator commands of all runs, shape (N, size); this array is changed in place.
        """
        sample, phase = divmod(k, self.period)
        if not phase:
            seen = signals if self._all else signals[self.runs]
            y, closing = seen.take(self._places, axis=1), seen[:, self._signals :]
            if self._noise is not None:
                y += self._noise[k]
            if self._step is not None:
                y = np.where(self._resolution > 0, self._step * np.round(y / self._step), y)
            ahead = None
            if self.driver.ahead:
                coming = self._heights[k : k + (self.driver.ahead - 1) * self.period + 1 : self.period]
                ahead = np.moveaxis(coming, 0, 2)
            self.used = self._state
            requested, self._state = self.driver.step(k, y, ahead, self._state)
            if not k:
                self._check(np.shape(requested))
            computed = self._actuators.commands(requested, closing, self.runs, self.driver.requests)
            if self._limiter is not None:
                computed = self._given = self._limiter(computed, self._given)
            if self._at_once:
                commands[self.runs] = computed
                return
            self._waiting[sample % len(self._waiting)] = computed
        if self._changes[phase] and not self._at_once:
            # before the first command arrives, the ring buffer contains 0
            due = (k - self._late) // self.period % len(self._waiting)
            commands[self.runs] = self._waiting[due, self._each]

    def _check(self, shape: tuple[int, ...]) -> None:
        """Raises InputError if the requests of a user's driver do not have the shape that the actuators need."""
        needed = len(self._each), self._actuators.size if self.driver.requests == "commands" else self._actuators.forces
        if shape != needed:
            raise InputError(
                f"driver {type(self.driver).__name__}: step returns {self.driver.requests} of shape {shape}; return "
                f"the shape {needed}, with one row for each run"
            )


def measurement_noise(how: Sequence[Implementation], names: Sequence[str], samples: int) -> Array:
    """Returns the noise that is added to the measured signals of N controllers, shape (samples, N, S); shape (0, N, S) without
    noise.
    """
    rms = np.array([[one.noise.get(name, 0.0) for name in names] for one in how])
    noise = np.zeros((samples if np.any(rms) else 0, *rms.shape))
    for i, one in enumerate(how):
        if np.any(rms[i]):
            noise[:, i] = rms[i] * np.random.default_rng(one.seed).standard_normal((samples, len(names)))
    return noise


def implementation_around(controller: RunDriver, vehicle: Vehicle) -> Implementation:
    """Returns the implementation of a controller, without effects (such as delay) that the control law or the exported code
    already contains.

    For recorded commands, the result is an implementation without any effects.
    """
    how = vehicle.implementation
    if not controller.implemented:
        return Implementation()
    if controller.code is not None:
        return replace(how, delay=0.0, quantisation={})
    return replace(how, delay=max(how.delay - controller.own_delay, 0)) if how.delay else how
