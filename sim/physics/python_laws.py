"""What drives a run beside a linear law: laws in Python, called at their samples, and forces that are known, played again."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.damping.laws import SemiActive
from models.own.python_law import Programmed
from models.own.running import OwnLaw
from models.reality import steps_per_sample
from models.vehicle import Vehicle
from synth.controller import Controller

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


Driven = Controller | Programmed | SemiActive | Played


def preview_samples(controller: Driven, period: float) -> int:
    """How many heights of a road a controller is told under each wheel, the one now among them; 0 for none."""
    if not isinstance(controller, Programmed) or controller.law.preview is None:
        return 0
    return int(controller.law.preview / period * (1 + 1e-9)) + 1


def steps_ahead(vehicles: Sequence[Vehicle], controllers: Sequence[Driven], timestep: float) -> int:
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

    law: OwnLaw
    seen: Array
    steps: int
    ahead: int
    runs: Array
    parameters: Mapping[str, Array | float]


def _parameters(law: OwnLaw, vehicles: Sequence[Vehicle]) -> Mapping[str, Array | float]:
    if not law.vectorised:
        return vehicles[0].parameters
    return {name: np.array([vehicle.parameters[name] for vehicle in vehicles]) for name in vehicles[0].parameters}
