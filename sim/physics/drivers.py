"""What drives a run beside a linear law: laws in Python, forces that are known, and adjustable dampers, sample by sample."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.python_law import Programmed
from models.laws.semi_active import SemiActive
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.physics.sensor_readout import Laws, Readout
from synth.controller.controller import Driver

if TYPE_CHECKING:
    from models.laws.python_runtime import OwnLaw
    from models.suspension.damper_range import Range


WILD = 1e8  # beyond it in any measurement, in SI units, there is no vehicle any more, and its law is asked no more


@dataclass(frozen=True, eq=False)
class Played:
    """Forces that are known beforehand, whatever is measured.

    Attributes:
        measured: what was measured for them, so that everything is read in the same order, to the last bit.
        forces: asked for at every step [N], shape (T, m).
    """

    measured: tuple[str, ...]
    forces: Array


class Again:
    """The forces of N runs that are known beforehand, shape (T, N, m)."""

    def __init__(self, forces: Array) -> None:
        self.forces, self.used = forces, np.zeros((forces.shape[1], 0))

    def __call__(self, k: int, reading: Array) -> Array:
        """See `sim.physics.stepping.Law`."""
        return self.forces[k]


@dataclass(frozen=True)
class Failure:
    """Why the law of a run failed.

    Attributes:
        why: in one line.
        together: whether it was called for other runs as well, and the fault may be of one of those.
    """

    why: str
    together: bool


RunDriver = Driver | Played


def preview_samples(controller: RunDriver, period: float) -> int:
    """How many heights of a road a controller is told under each wheel, the one now among them; 0 for none."""
    if not isinstance(controller, Programmed) or controller.law.preview is None:
        return 0
    return int(controller.law.preview / period * (1 + 1e-9)) + 1


def steps_ahead(vehicles: Sequence[Vehicle], controllers: Sequence[RunDriver], timestep: float) -> int:
    """How many timesteps [s] beyond a run's end a law is told of its road, at most."""
    periods = [steps_per_sample(vehicle.implementation, timestep) for vehicle in vehicles]
    pairs = zip(controllers, periods, strict=True)
    return max((max(preview_samples(one, steps * timestep) - 1, 0) * steps for one, steps in pairs), default=0)


class PythonLaws:
    """N laws in Python, each with a state of its own; a vectorised one is one of all its runs."""

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
        """Executes their files.

        Args:
            controllers: N laws.
            vehicles: theirs.
            signals: what there is to measure.
            timestep: [s].
            heights: of the roads from the start to `steps_ahead` of the end [m], shape (.., N, r).
            failures: takes those that fail, whose runs get no forces from then on; None where they are raised.
            numbers: of the runs in it.

        Raises:
            InputError: one fails.
        """
        self.forces, self._timestep, self._heights = len(vehicles[0].linear_model.inputs), timestep, heights
        self.used = np.zeros((len(vehicles), 0))
        self._failures, self._numbers = failures, numbers
        self._count, self._gone = len(controllers), np.zeros(len(controllers), dtype=bool)
        self._measured = np.array([[name in one.measured for name in signals] for one in controllers])
        from models.laws.python_runtime import OwnLaw

        members: list[tuple[OwnLaw, Programmed, int, list[int]]] = []
        together: dict[tuple[int, int], tuple[OwnLaw, list[int]]] = {}
        for i, (one, vehicle) in enumerate(zip(controllers, vehicles, strict=True)):
            steps = steps_per_sample(vehicle.implementation, timestep)
            if (id(one), steps) in together:
                together[id(one), steps][1].append(i)
                continue
            try:
                law = OwnLaw(one, self.forces)
            except InputError as error:
                self._failed(error, np.array([i]))
                continue
            members.append((law, one, steps, [i]))
            if law.vectorised:
                together[id(one), steps] = law, members[-1][3]
        self._groups = []
        for law, one, steps, runs in members:
            seen, ahead = np.array([signals.index(name) for name in one.measured]), preview_samples(one, steps * timestep)
            self._groups.append(_Group(law, seen, steps, ahead, np.array(runs), _parameters(law, [vehicles[i] for i in runs])))

    def __call__(self, due: Array | slice, which: Array, k: int, seen: Array) -> Array:
        """The forces that those that are due ask for at step k, shape (len(which), m), from the signals (len(which), S)."""
        forces, everybody = np.zeros((len(which), self.forces)), len(which) == self._count
        self._gone[which] |= np.any(self._measured[which] & ~(np.abs(seen) <= WILD), axis=1)
        for group in self._groups:
            if k % group.steps == 0:
                rows = group.runs if everybody else np.searchsorted(which, group.runs)
                if not self._gone[group.runs].all():
                    forces[rows] = self._asked(group, k, seen[rows[:, None], group.seen])
        return forces

    def _asked(self, group: "_Group", k: int, y: Array) -> Array:
        """What the runs of a group ask for, shape (n, m), from what they measure, shape (n, q)."""
        preview, many, runs = None, group.law.vectorised, group.runs
        if group.ahead:
            heights = self._heights[k : k + (group.ahead - 1) * group.steps + 1 : group.steps][:, runs]
            preview = np.ascontiguousarray(np.moveaxis(heights, 0, 2))
        time, period = k * self._timestep, group.steps * self._timestep
        try:
            if not many:
                return group.law(y[0], time, period, None if preview is None else preview[0], group.parameters)[None]
            gone = self._gone[runs, None]
            return np.where(gone, 0.0, group.law(np.where(gone, 0.0, y), time, period, preview, group.parameters))
        except InputError as error:
            self._failed(error, runs)
            return np.zeros((len(runs), self.forces))

    def _failed(self, error: InputError, runs: Array) -> None:
        """Takes down that the law of these runs has failed; raises it where nobody wants that."""
        if self._failures is None:
            raise error
        self._gone[runs] = True
        self._failures |= {self._numbers[i]: Failure(str(error), len(runs) > 1) for i in runs.tolist()}


@dataclass(frozen=True, eq=False)
class _Group:
    """Runs that one execution of a law drives.

    Attributes:
        law: the execution.
        seen: which of the signals it measures.
        steps: timesteps between two of its samples.
        ahead: heights of the road that it is told under each wheel.
        runs: which of the runs; one of a law that is not vectorised.
        parameters: of the vehicle or, of a vectorised law, of the vehicles, by name.
    """

    law: "OwnLaw"
    seen: Array
    steps: int
    ahead: int
    runs: Array
    parameters: Mapping[str, Array | float]


def _parameters(law: "OwnLaw", vehicles: Sequence[Vehicle]) -> Mapping[str, Array | float]:
    if not law.vectorised:
        return vehicles[0].parameters
    return {name: np.array([vehicle.parameters[name] for vehicle in vehicles]) for name in vehicles[0].parameters}


@dataclass(frozen=True, eq=False)
class Dampers:
    """The adjustable dampers of N vehicles that have them at the same places.

    A controller works with the velocity of its suspension as it is linear at rest. Where a body turns, what the damper itself
    moves at differs from that as geometry does.

    Attributes:
        vehicles: theirs.
        of: what they can be.
        closing: from (qpos, qvel) to how fast every suspension closes, shape (m, nq + nv); 0 of one whose actuator pushes.
        lagging: of every actuator, where its activation lies among those of the model, -1 for none, shape (m,).
    """

    vehicles: Sequence[Vehicle]
    of: "Range"
    closing: Array
    lagging: Array

    @property
    def velocities(self) -> dict[str, str]:
        """The signal of the velocity of every suspension, by its force."""
        return {one.force: one.velocity.name for one in self.vehicles[0].kind.suspensions}

    @property
    def ramps(self) -> Array:
        """Of every actuator that makes the ramps of curves, the last ones of the model, which input it goes with, shape (k,)."""
        vehicle = self.vehicles[0]
        counts = [0 if one.damper.pair is None else len(one.damper.pair.ramps) for one in vehicle.adjustable]
        return np.repeat([vehicle.linear_model.inputs.index(one.force) for one in vehicle.adjustable], counts)

    @property
    def lags(self) -> bool:
        """Whether some coefficient is not at once the one that is asked for."""
        return bool(np.any(self.lagging[self.of.adjustable] >= 0))

    def beside(self, gain: Array, memory: Array, offset: Array) -> tuple[Array, Array, Array]:
        """What makes forces of a reading, with how fast the suspensions close behind the forces; see `stepping.Reading`.

        Of laws that ship it is what they measure in place of the forces.
        """
        m, count, asked = len(self.closing), len(gain), gain.shape[1] - memory.shape[2]
        closing = np.zeros((count, m, gain.shape[2]))
        closing[..., : self.closing.shape[1]] = self.closing
        still = np.broadcast_to(self.of.at_rest, (*offset.shape[:2], m))
        return (
            np.concatenate([gain[:, :asked], closing, gain[:, asked:]], axis=1),
            np.concatenate([memory[:, :asked], np.zeros((count, m, memory.shape[2])), memory[:, asked:]], axis=1),
            np.concatenate([offset[..., :asked], still, offset[..., asked:]], axis=-1),
        )

    def after(self, of_reading: Array, unseen: Array) -> tuple[Array, Array]:
        """What makes signals of a reading, (S, r), and what that has not seen, (T, N, S), with how fast they close behind."""
        closing = np.zeros((len(self.closing), of_reading.shape[1]))
        closing[:, : self.closing.shape[1]] = self.closing
        still = np.broadcast_to(self.of.at_rest, (*unseen.shape[:2], len(closing)))
        return np.concatenate([of_reading, closing]), np.concatenate([unseen, still], axis=-1)

    def record(self, values: Array, commands: Array, acts: Array) -> None:
        """Writes their signals among those of some samples, shape (B, S, N).

        Args:
            values: the signals.
            commands: see `Range.commands`, shape (B, N, 2 m).
            acts: activations, shape (B, N, na), or (0, N, na) where none lags.
        """
        vehicle, m = self.vehicles[0], len(self.closing)
        names = [signal.name for signal in vehicle.kind.signals]
        for i, one in enumerate(vehicle.adjustable):
            j = vehicle.linear_model.inputs.index(one.force)
            nominal = np.array([other.adjustable[i].nominal for other in self.vehicles])
            beyond = commands[..., j] if self.lagging[j] < 0 else acts[..., self.lagging[j]]
            values[:, names.index(one.coefficient)] = nominal + beyond
            values[:, names.index(one.missing)] = commands[..., m + j]
            if one.damper.pair is not None:  # its force is that of several actuators
                velocity = values[:, names.index(self.velocities[one.force])]
                shaped = np.stack(
                    [other.adjustable[i].shape(v) for other, v in zip(self.vehicles, velocity.T, strict=True)], axis=-1
                )
                values[:, names.index(one.force)] = -beyond * shaped


def dampers_of(vehicles: Sequence[Vehicle], readout: Readout) -> Dampers | None:
    """The adjustable dampers of vehicles of one kind; None where there are none."""
    if not vehicles[0].dampers:
        return None
    from models.suspension.damper_range import range_of

    of = range_of([vehicle.adjustable for vehicle in vehicles], vehicles[0].linear_model.inputs)
    closing = np.zeros((len(readout.stretching), readout.of_state.shape[1]))
    closing[of.adjustable, -readout.stretching.shape[1] :] = -readout.stretching[of.adjustable]
    return Dampers(vehicles, of, closing, readout.lagging)


class Damped:
    """What laws ask for, as commands of adjustable dampers."""

    def __init__(self, laws: Laws, of: "Range") -> None:
        """For laws on signals behind which, in what they are given, stands how fast every suspension closes.

        Args:
            laws: N of them.
            of: what their dampers can be.
        """
        self.laws, self.of, self.forces = laws, of, 2 * laws.forces

    @property
    def used(self) -> Array:
        """See `Laws`."""
        return self.laws.used

    def __call__(self, due: Array | slice, which: Array, k: int, seen: Array) -> Array:
        """See `Laws`."""
        m = self.laws.forces
        asked = self.laws(due, which, k, seen[:, :-m])
        return self.of.commands(np.concatenate([asked, seen[:, -m:]], axis=-1), due)


class Clipped:
    """Sets the adjustable dampers of N runs to the forces of linear laws; see `sim.physics.stepping.Setting`."""

    def __init__(self, of: "Range") -> None:
        """For dampers that can be so much."""
        self.of, self.actuators = of, of.low.shape[1]
        self._turned = np.empty_like(of.low)

    def set(self, seen: Array, acting: Array) -> None:
        """See `sim.physics.stepping.Setting`; as `Range.commands`, without the forces that are missing."""
        closing = seen[:, self.actuators :]
        np.divide(seen[:, : self.actuators], closing if self.of.bent is None else self.of.felt(closing), self._turned)
        np.maximum(self._turned, self.of.low, out=self._turned)
        np.minimum(self._turned, self.of.high, out=acting)

    def commands(self, seen: Array) -> Array:
        """See `sim.physics.stepping.Setting`."""
        return self.of.commands(seen)


class SemiActiveLaws:
    """N laws that ship, which set adjustable dampers: as `Laws`, and as `sim.physics.stepping.Setting`.

    A run alone is decided in plain numbers, which are the same to the last bit: between its steps calls of numpy would take as
    long as the steps.
    """

    def __init__(self, controllers: Sequence[SemiActive], dampers: Dampers, names: Sequence[str] | None = None) -> None:
        """For laws on signals of these names, behind which, in what they are given, stands how fast every suspension closes.

        Args:
            controllers: N of them.
            dampers: those of their N vehicles.
            names: of the signals; None for those alone that each law measures, in its order, from the first on.
        """
        from models.vehicle.semi_active_coefficients import numbers_of

        self.of, self.actuators, self.used = dampers.of, len(dampers.closing), np.zeros((len(controllers), 0))
        self.forces = 2 * self.actuators
        self._nominal = np.array([[one.nominal for one in vehicle.adjustable] for vehicle in dampers.vehicles])
        self._groups = []
        for law in dict.fromkeys(one.law for one in controllers):
            mine = np.array([one.law == law for one in controllers])
            places = list(range(len(law.measured))) if names is None else [names.index(name) for name in law.measured]
            self._groups.append((law, mine, numbers_of(law, dampers.vehicles), places))
        self._alone: tuple[Callable[[Sequence[float]], list[float]], list[float], list[tuple[float, float]]] | None = None
        if len(controllers) == 1 and self.of.bent is None:
            law, _, numbers, places = self._groups[0]
            ends = list(zip(self.of.low[0].tolist(), self.of.high[0].tolist(), strict=True))
            self._alone = law.alone(numbers, places), self._nominal[0].tolist(), ends

    def set(self, seen: Array, acting: Array) -> None:
        """See `sim.physics.stepping.Setting`."""
        if self._alone is None:
            asked = self.of.setting(self._asked(seen, slice(None)), seen[:, -self.actuators :])
            np.minimum(np.maximum(asked, self.of.low), self.of.high, out=acting)
        else:
            acting[0] = self._decided(seen[0].tolist())[1]

    def commands(self, seen: Array) -> Array:
        """See `sim.physics.stepping.Setting`."""
        return self.of.set_to(self._asked(seen, slice(None)), seen[..., -self.actuators :])

    def __call__(self, due: Array | slice, which: Array, k: int, seen: Array) -> Array:
        """See `Laws`."""
        if self._alone is None:
            return self.of.set_to(self._asked(seen, due), seen[:, -self.actuators :], due)
        numbers = seen[0].tolist()
        asked, beyond = self._decided(numbers)
        closing = numbers[-self.actuators :]
        missing = ((one - given) * speed for one, given, speed in zip(asked, beyond, closing, strict=True))
        return np.array([[*beyond, *missing]])

    def _asked(self, seen: Array, which: Array | slice) -> Array:
        """Coefficients that are asked for beyond the nominal ones [N s/m], shape (..., d, m), from signals (..., d, S)."""
        from models.vehicle.semi_active_coefficients import numbers_at

        closing = seen[..., -self.actuators :]
        if len(self._groups) == 1:
            law, _, numbers, places = self._groups[0]
            some = numbers if isinstance(which, slice) else numbers.some(which)
            return law.coefficients(seen[..., places], numbers_at(some, self.of, closing, which)) - self._nominal[which]
        asked, every = np.empty((*seen.shape[:-1], self.actuators)), np.arange(len(self._nominal))[which]
        for law, mine, numbers, places in self._groups:
            some = np.flatnonzero(mine[which])
            of = numbers_at(numbers.some(every[some]), self.of, closing[..., some, :], every[some])
            asked[..., some, :] = law.coefficients(seen[..., some, :][..., places], of)
        return asked - self._nominal[which]

    def _decided(self, seen: Sequence[float]) -> tuple[list[float], list[float]]:
        """What a run alone asks for, and gets, beyond the nominal coefficients [N s/m], m of them each."""
        assert self._alone is not None, "it is alone"
        law, nominal, ends = self._alone
        asked = [c - own for c, own in zip(law(seen), nominal, strict=True)]
        return asked, [low if c < low else high if c > high else c for c, (low, high) in zip(asked, ends, strict=True)]
