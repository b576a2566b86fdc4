"""Drivers of runs other than linear laws: laws in Python, known forces, and adjustable dampers, sample by sample."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.python_law import Programmed, samples_ahead
from models.laws.semi_active import SemiActive
from models.vehicle.limits_and_implementation import Implementation, steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.physics.sensor_readout import AntiWindup, Laws, LinearLaws, Readout
from synth.controller.controller import Controller, Driver

if TYPE_CHECKING:
    from models.laws.python_runtime import FileRuns, LawRuns
    from models.suspension.damper_range import CoefficientRange


WILD = 1e8  # largest measurement, in SI units: beyond it the run has diverged, and its law is no longer called


@dataclass(frozen=True, eq=False)
class RecordedForces:
    """Forces that are known beforehand, whatever the measurements.

    Attributes:
        measured: measurements of the original controller, so that everything is read in the same order bit for bit.
        forces: requested at every step [N], shape (T, m).
    """

    measured: tuple[str, ...]
    forces: Array


class RepeatedForces:
    """Law that repeats the known forces of N runs, shape (T, N, m)."""

    def __init__(self, forces: Array) -> None:
        self.forces, self.used = forces, np.zeros((forces.shape[1], 0))

    def __call__(self, k: int, reading: Array) -> Array:
        """See `sim.physics.stepping.Law`."""
        return self.forces[k]


@dataclass(frozen=True)
class Failure:
    """Failure of the law of a run.

    Attributes:
        why: reason, in one line.
        together: True if the law was called for several runs at once, so another of them may have caused the failure.
    """

    why: str
    together: bool


RunDriver = Driver | RecordedForces


def preview_samples(controller: RunDriver, period: float) -> int:
    """Returns the number of road heights that a controller receives under each wheel, the present one included; 0 without
    preview.
    """
    if isinstance(controller, Programmed) and controller.law.preview is not None:
        return samples_ahead(controller.law.preview, period)
    if isinstance(controller, Controller) and controller.preview is not None:
        return controller.preview.samples(period)
    return 0


def steps_ahead(vehicles: Sequence[Vehicle], controllers: Sequence[RunDriver], timestep: float) -> int:
    """Returns the largest number of timesteps [s] by which a controller previews its road beyond a run's end."""
    periods = [steps_per_sample(vehicle.implementation, timestep) for vehicle in vehicles]
    pairs = zip(controllers, periods, strict=True)
    return max((max(preview_samples(driver, steps * timestep) - 1, 0) * steps for driver, steps in pairs), default=0)


def implementation_around(controller: RunDriver, vehicle: Vehicle) -> Implementation:
    """Returns the implementation around a controller: of the vehicle's delay, what an FMU does not have in itself."""
    how = vehicle.implementation
    if not isinstance(controller, Programmed) or not controller.law.is_fmu or controller.law.path is None or not how.delay:
        return how
    from models.vehicle.foreign_fmu import own_delay

    return replace(how, delay=max(how.delay - own_delay(controller.law.path), 0))


def preview_forces(
    controllers: Sequence[RunDriver], vehicles: Sequence[Vehicle], heights: Array, timestep: float, samples: int
) -> Array | None:
    """Returns the forces by which N linear controllers answer the road ahead [N], shape (T, N, m), or None if none does.

    Args:
        heights: road heights from the start to `steps_ahead` of the end [m], shape (.., N, r).
        timestep: timestep of the forces [s].
        samples: T.
    """
    ahead = [one.preview if isinstance(one, Controller) else None for one in controllers]
    if not any(ahead):
        return None
    forces = np.zeros((samples, len(controllers), len(vehicles[0].linear_model.inputs)))
    for i, (one, vehicle) in enumerate(zip(ahead, vehicles, strict=True)):
        if one is not None:
            forces[:, i] = one.forces(heights[:, i], steps_per_sample(vehicle.implementation, timestep), timestep, samples)
    return forces


class PythonLaws:
    """N laws in Python, each with its own state; a vectorised law serves all its runs at once."""

    def __init__(
        self,
        controllers: Sequence[Programmed],
        vehicles: Sequence[Vehicle],
        signals: Sequence[str],
        timestep: float,
        heights: Array,
        failures: dict[int, Failure] | None,
        numbers: Sequence[int],
    ) -> None:
        """Executes the files of the laws.

        Args:
            controllers: N laws.
            vehicles: vehicles, one for each controller.
            signals: names of the signals that can be measured.
            timestep: timestep of the runs [s].
            heights: road heights from the start to `steps_ahead` of the end [m], shape (.., N, r).
            failures: dict that receives failures, whose runs continue without forces, or None to raise them.
            numbers: keys of the runs in `failures`.

        Raises:
            InputError: a law fails, and `failures` is None.
        """
        self.forces, self._timestep, self._heights = len(vehicles[0].linear_model.inputs), timestep, heights
        self.used = np.zeros((len(vehicles), 0))
        self._failures, self._numbers = failures, numbers
        self._count, self._gone = len(controllers), np.zeros(len(controllers), dtype=bool)
        self._measured = np.array([[name in controller.measured for name in signals] for controller in controllers])
        from models.laws.python_runtime import runs_of

        alike: dict[tuple[int, int], list[int]] = {}
        for i, (controller, vehicle) in enumerate(zip(controllers, vehicles, strict=True)):
            alike.setdefault((id(controller), steps_per_sample(vehicle.implementation, timestep)), []).append(i)
        self._groups = list[_Group]()
        for (_, steps), some in alike.items():
            controller, runs = controllers[some[0]], list[int]()
            laws = runs_of(controller, self.forces)
            for i in some:
                try:
                    laws.add(vehicles[i].parameters)
                    runs.append(i)
                except InputError as error:
                    self._failed(error, [i])
            seen, ahead = [signals.index(name) for name in controller.measured], preview_samples(controller, steps * timestep)
            self._groups.append(_Group(laws, np.array(seen), steps, ahead, np.array(runs, dtype=int)))

    def __call__(self, due: Array | slice, which: Array, k: int, seen: Array) -> Array:
        """Returns the forces of the due laws at step k, shape (len(which), m), from the signals (len(which), S)."""
        forces, everybody = np.zeros((len(which), self.forces)), len(which) == self._count
        self._gone[which] |= np.any(self._measured[which] & ~(np.abs(seen) <= WILD), axis=1)
        for group in self._groups:
            if k % group.steps == 0 and not self._gone[group.runs].all():
                rows = group.runs if everybody else np.searchsorted(which, group.runs)
                forces[rows] = self._requested(group, k, seen[rows[:, None], group.seen])
        return forces

    def _requested(self, group: "_Group", k: int, y: Array) -> Array:
        """Returns the requested forces of a group's runs, shape (n, m), from their measurements, shape (n, q)."""
        preview, runs, gone = None, group.runs, self._gone[group.runs]
        if group.ahead:
            heights = self._heights[k : k + (group.ahead - 1) * group.steps + 1 : group.steps][:, runs]
            preview = np.ascontiguousarray(np.moveaxis(heights, 0, 2))
        try:
            forces, errors = group.laws.call(gone, y, k * self._timestep, group.steps * self._timestep, preview)
        except InputError as error:
            self._failed(error, runs[~gone].tolist(), len(runs) > 1)
            return np.zeros((len(runs), self.forces))
        for i, error in errors.items():
            self._failed(error, [int(runs[i])])
        return forces

    def _failed(self, error: InputError, runs: Sequence[int], together: bool = False) -> None:
        """Records that the law of these runs has failed, or raises the error if failures are not collected."""
        if self._failures is None:
            raise error
        self._gone[runs] = True
        self._failures |= {self._numbers[i]: Failure(str(error), together) for i in runs}


@dataclass(frozen=True, eq=False)
class _Group:
    """Runs of one controller with the same sample period.

    Attributes:
        laws: the executions of its law.
        seen: indices of the signals it measures.
        steps: timesteps between two of its samples.
        ahead: number of road heights that it previews under each wheel.
        runs: indices of the runs whose law could be executed.
    """

    laws: "LawRuns | FileRuns"
    seen: Array
    steps: int
    ahead: int
    runs: Array


@dataclass(frozen=True, eq=False)
class Dampers:
    """Adjustable dampers of N vehicles, at the same places in each.

    A controller works with the suspension velocity linearised at rest. When a body turns, the damper's own velocity differs by
    geometry.

    Attributes:
        vehicles: N of them.
        of: range of the dampers.
        closing: map from (qpos, qvel) to the closing velocity of every suspension, shape (m, nq + nv); 0 for force actuators.
        lagging: index of each actuator's activation in the model, or -1 if it has none, shape (m,).
    """

    vehicles: Sequence[Vehicle]
    of: "CoefficientRange"
    closing: Array
    lagging: Array

    @property
    def velocities(self) -> dict[str, str]:
        """Returns the name of every suspension's velocity signal, by its force."""
        return {suspension.force: suspension.velocity.name for suspension in self.vehicles[0].kind.suspensions}

    @property
    def ramps(self) -> Array:
        """Returns the input of every actuator that makes ramps of curves, shape (k,); these actuators are the last ones of the
        model.
        """
        vehicle = self.vehicles[0]
        counts = [0 if one.damper.pair is None else len(one.damper.pair.ramps) for one in vehicle.adjustable]
        return np.repeat([vehicle.linear_model.inputs.index(one.force) for one in vehicle.adjustable], counts)

    @property
    def lags(self) -> bool:
        """Returns True if some coefficient lags behind its command."""
        return bool(np.any(self.lagging[self.of.adjustable] >= 0))

    def beside(self, gain: Array, memory: Array, offset: Array) -> tuple[Array, Array, Array]:
        """Appends the suspensions' closing velocities to the forces' gain, memory and offset; see `sim.physics.stepping.Reading`.

        For semi-active laws the rows of the forces are those of the measurements.
        """
        m, count, measured = len(self.closing), len(gain), gain.shape[1] - memory.shape[2]
        closing = np.zeros((count, m, gain.shape[2]))
        closing[..., : self.closing.shape[1]] = self.closing
        still = np.broadcast_to(self.of.at_rest, (*offset.shape[:2], m))
        return (
            np.concatenate([gain[:, :measured], closing, gain[:, measured:]], axis=1),
            np.concatenate([memory[:, :measured], np.zeros((count, m, memory.shape[2])), memory[:, measured:]], axis=1),
            np.concatenate([offset[..., :measured], still, offset[..., measured:]], axis=-1),
        )

    def after(self, of_reading: Array, unseen: Array) -> tuple[Array, Array]:
        """Appends the closing velocities to the signals of a reading, (S, r), and to the parts it lacks, (T, N, S)."""
        closing = np.zeros((len(self.closing), of_reading.shape[1]))
        closing[:, : self.closing.shape[1]] = self.closing
        still = np.broadcast_to(self.of.at_rest, (*unseen.shape[:2], len(closing)))
        return np.concatenate([of_reading, closing]), np.concatenate([unseen, still], axis=-1)

    def record(self, values: Array, commands: Array, acts: Array) -> None:
        """Writes the dampers' signals among those of some samples, shape (B, S, N).

        Args:
            commands: commands as in `CoefficientRange.commands`, shape (B, N, 2 m).
            acts: activations, shape (B, N, na), or (0, N, na) if none lags.
        """
        vehicle, m = self.vehicles[0], len(self.closing)
        names = [signal.name for signal in vehicle.kind.signals]
        for i, adjustable in enumerate(vehicle.adjustable):
            j = vehicle.linear_model.inputs.index(adjustable.force)
            nominal = np.array([other.adjustable[i].nominal for other in self.vehicles])
            beyond = commands[..., j] if self.lagging[j] < 0 else acts[..., self.lagging[j]]
            values[:, names.index(adjustable.coefficient)] = nominal + beyond
            values[:, names.index(adjustable.missing)] = commands[..., m + j]
            if adjustable.damper.pair is not None:  # its force is the sum of several actuators
                velocity = values[:, names.index(self.velocities[adjustable.force])]
                shaped = np.stack(
                    [other.adjustable[i].shape(v) for other, v in zip(self.vehicles, velocity.T, strict=True)], axis=-1
                )
                values[:, names.index(adjustable.force)] = -beyond * shaped


def dampers_of(vehicles: Sequence[Vehicle], readout: Readout) -> Dampers | None:
    """Returns the adjustable dampers of vehicles of one kind, or None if they have none."""
    if not vehicles[0].dampers:
        return None
    from models.suspension.damper_range import range_of

    of = range_of([vehicle.adjustable for vehicle in vehicles], vehicles[0].linear_model.inputs)
    closing = np.zeros((len(readout.stretching), readout.of_state.shape[1]))
    closing[of.adjustable, -readout.stretching.shape[1] :] = -readout.stretching[of.adjustable]
    return Dampers(vehicles, of, closing, readout.lagging)


def anti_windup_of(vehicles: Sequence[Vehicle], gain: Array | None) -> AntiWindup | None:
    """Returns the anti-windup of laws of N vehicles with these gains, shape (N, k, m), or None without gains."""
    if gain is None:
        return None
    from models.suspension.damper_range import range_of

    most = [vehicle.limits.actuator_force for vehicle in vehicles]
    return AntiWindup(gain, range_of([vehicle.adjustable for vehicle in vehicles], vehicles[0].linear_model.inputs, most))


class Damped:
    """Laws whose forces become commands of adjustable dampers."""

    def __init__(self, laws: Laws, of: "CoefficientRange") -> None:
        """Wraps laws, whose signals are followed by the suspensions' closing velocities.

        Args:
            laws: N of them.
        """
        self.laws, self.of, self.forces = laws, of, 2 * laws.forces

    @property
    def used(self) -> Array:
        """See `Laws`."""
        return self.laws.used

    def __call__(self, due: Array | slice, which: Array, k: int, seen: Array) -> Array:
        """See `Laws`."""
        m = self.laws.forces
        requested = np.concatenate([self.laws(due, which, k, seen[:, :-m]), seen[:, -m:]], axis=-1)
        if isinstance(self.laws, LinearLaws):
            self.laws.follow(due, requested)
        return self.of.commands(requested, due)


class Limited:
    """Linear laws whose forces the actuators limit, and whose states follow the limited forces."""

    def __init__(self, laws: LinearLaws) -> None:
        """Wraps N laws."""
        self.laws, self.forces = laws, laws.forces

    @property
    def used(self) -> Array:
        """See `Laws`."""
        return self.laws.used

    def __call__(self, due: Array | slice, which: Array, k: int, seen: Array) -> Array:
        """See `Laws`."""
        requested = self.laws(due, which, k, seen)
        self.laws.follow(due, requested)
        return requested


class Clipped:
    """Sets the adjustable dampers of N runs to the forces of linear laws; see `sim.physics.stepping.Setting`."""

    flat = False

    def __init__(self, of: "CoefficientRange") -> None:
        """Prepares dampers of this range."""
        self.of, self.actuators = of, of.low.shape[1]
        self._turned = np.empty_like(of.low)

    def set(self, seen: Array, acting: Array) -> None:
        """See `sim.physics.stepping.Setting`; as `CoefficientRange.commands`, without the missing forces."""
        closing = seen[:, self.actuators :]
        np.divide(
            seen[:, : self.actuators], closing if self.of.bent is None else self.of.effective_velocity(closing), self._turned
        )
        np.maximum(self._turned, self.of.low, out=self._turned)
        np.minimum(self._turned, self.of.high, out=acting)

    def commands(self, seen: Array) -> Array:
        """See `sim.physics.stepping.Setting`."""
        return self.of.commands(seen)


class SemiActiveLaws:
    """N semi-active laws, which set adjustable dampers: as `Laws`, and as `sim.physics.stepping.Setting`.

    A single run is computed in plain numbers, which are the same bit for bit: calls of numpy would take as long as its steps.
    """

    flat = False

    def __init__(self, controllers: Sequence[SemiActive], dampers: Dampers, names: Sequence[str] | None = None) -> None:
        """Prepares laws on signals of these names, which are followed by the suspensions' closing velocities.

        Args:
            controllers: N of them.
            dampers: dampers of their N vehicles.
            names: names of the signals, or None for the measurements of each law alone, in its order.
        """
        from models.vehicle.semi_active_coefficients import numbers_of

        self.of, self.actuators, self.used = dampers.of, len(dampers.closing), np.zeros((len(controllers), 0))
        self.forces = 2 * self.actuators
        self._nominal = np.array([[adjustable.nominal for adjustable in vehicle.adjustable] for vehicle in dampers.vehicles])
        self._groups = []
        for law in {(one.law.name, one.law.measured): one.law for one in controllers}.values():
            mine = np.array([(one.law.name, one.law.measured) == (law.name, law.measured) for one in controllers])
            laws = [one.law if own else law for one, own in zip(controllers, mine, strict=True)]
            places = list(range(len(law.measured))) if names is None else [names.index(name) for name in law.measured]
            self._groups.append((law, mine, numbers_of(laws, dampers.vehicles), places))
        self._alone: tuple[Callable[[Sequence[float]], list[float]], list[float], list[tuple[float, float]]] | None = None
        if len(controllers) == 1 and self.of.bent is None:
            law, _, numbers, places = self._groups[0]
            ends = list(zip(self.of.low[0].tolist(), self.of.high[0].tolist(), strict=True))
            self._alone = law.alone(numbers, places), self._nominal[0].tolist(), ends

    def set(self, seen: Array, acting: Array) -> None:
        """See `sim.physics.stepping.Setting`."""
        if self._alone is None:
            requested = self.of.coefficient_for(self._asked(seen, slice(None)), seen[:, -self.actuators :])
            np.minimum(np.maximum(requested, self.of.low), self.of.high, out=acting)
        else:
            acting[0] = self._decided(seen[0].tolist())[1]

    def commands(self, seen: Array) -> Array:
        """See `sim.physics.stepping.Setting`."""
        return self.of.clip_coefficients(self._asked(seen, slice(None)), seen[..., -self.actuators :])

    def __call__(self, due: Array | slice, which: Array, k: int, seen: Array) -> Array:
        """See `Laws`."""
        if self._alone is None:
            return self.of.clip_coefficients(self._asked(seen, due), seen[:, -self.actuators :], due)
        numbers = seen[0].tolist()
        coefficients, beyond = self._decided(numbers)
        closing = numbers[-self.actuators :]
        missing = ((requested - actual) * speed for requested, actual, speed in zip(coefficients, beyond, closing, strict=True))
        return np.array([[*beyond, *missing]])

    def _asked(self, seen: Array, which: Array | slice) -> Array:
        """Returns the requested coefficients beyond the nominal ones [N s/m], shape (..., d, m), from signals (..., d, S)."""
        from models.vehicle.semi_active_coefficients import numbers_at

        closing = seen[..., -self.actuators :]
        if len(self._groups) == 1:
            law, _, numbers, places = self._groups[0]
            some = numbers if isinstance(which, slice) else numbers.subset(which)
            return law.coefficients(seen[..., places], numbers_at(some, self.of, closing, which)) - self._nominal[which]
        coefficients, every = np.empty((*seen.shape[:-1], self.actuators)), np.arange(len(self._nominal))[which]
        for law, mine, numbers, places in self._groups:
            some = np.flatnonzero(mine[which])
            of = numbers_at(numbers.subset(every[some]), self.of, closing[..., some, :], every[some])
            coefficients[..., some, :] = law.coefficients(seen[..., some, :][..., places], of)
        return coefficients - self._nominal[which]

    def _decided(self, seen: Sequence[float]) -> tuple[list[float], list[float]]:
        """Returns a single run's requested and actual coefficients beyond the nominal ones [N s/m], m of each."""
        assert self._alone is not None, "it is alone"
        law, nominal, ends = self._alone
        coefficients = [c - own for c, own in zip(law(seen), nominal, strict=True)]
        return coefficients, [
            low if c < low else high if c > high else c for c, (low, high) in zip(coefficients, ends, strict=True)
        ]
