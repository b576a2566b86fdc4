"""Adjustable dampers in MuJoCo: what controllers ask for becomes coefficients, sample by sample."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.damping.laws import SemiActive
from models.damping.range import Range, range_of
from models.vehicle import Vehicle
from sim.physics.readout import Readout
from sim.physics.sampler import Laws
from sim.semi_active.numbers import numbers_of


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
    of: Range
    closing: Array
    lagging: Array

    @property
    def lags(self) -> bool:
        """Whether some coefficient is not at once the one that is asked for."""
        return bool(np.any(self.lagging[self.of.adjustable] >= 0))

    def beside(self, gain: Array, memory: Array, offset: Array) -> tuple[Array, Array, Array]:
        """What makes forces of a reading, with how fast the suspensions close behind the forces; see `stepping.Reading`."""
        m, count = len(self.closing), len(gain)
        closing = np.zeros((count, m, gain.shape[2]))
        closing[..., : self.closing.shape[1]] = self.closing
        still = np.broadcast_to(self.of.at_rest, (*offset.shape[:2], m))
        return (
            np.concatenate([gain[:, :m], closing, gain[:, m:]], axis=1),
            np.concatenate([memory[:, :m], np.zeros((count, m, memory.shape[2])), memory[:, m:]], axis=1),
            np.concatenate([offset[..., :m], still, offset[..., m:]], axis=-1),
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


def dampers_of(vehicles: Sequence[Vehicle], readout: Readout) -> Dampers | None:
    """The adjustable dampers of vehicles of one kind; None where there are none."""
    if not vehicles[0].dampers:
        return None
    of = range_of([vehicle.adjustable for vehicle in vehicles], vehicles[0].linear_model.inputs)
    closing = np.zeros((len(readout.stretching), readout.of_state.shape[1]))
    closing[of.adjustable, -readout.stretching.shape[1] :] = -readout.stretching[of.adjustable]
    return Dampers(vehicles, of, closing, readout.lagging)


class Damped:
    """What laws ask for, as commands of adjustable dampers."""

    def __init__(self, laws: Laws, of: Range) -> None:
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


class SemiActiveLaws:
    """N laws that ship, which set adjustable dampers."""

    def __init__(self, controllers: Sequence[SemiActive], dampers: Dampers, names: Sequence[str]) -> None:
        """For laws on signals of these names, behind which, in what they are given, stands how fast every suspension closes.

        Args:
            controllers: N of them.
            dampers: those of their N vehicles.
            names: of the signals.
        """
        self.of, self.forces, self.used = dampers.of, 2 * len(dampers.closing), np.zeros((len(controllers), 0))
        self._nominal = np.array([[one.nominal for one in vehicle.adjustable] for vehicle in dampers.vehicles])
        self._groups = []
        for law in dict.fromkeys(one.law for one in controllers):
            mine = np.array([one.law == law for one in controllers])
            numbers = numbers_of(law, dampers.vehicles)
            self._groups.append((law, mine, numbers, [names.index(name) for name in law.measured]))

    def __call__(self, due: Array | slice, which: Array, k: int, seen: Array) -> Array:
        """See `Laws`."""
        closing = seen[:, -len(self._nominal[0]) :]
        if len(self._groups) == 1 and len(which) == len(self._nominal):  # as a run alone is
            law, _, numbers, places = self._groups[0]
            return self.of.set_to(law.coefficients(seen[:, places], numbers) - self._nominal, closing)
        asked = np.empty_like(closing)
        for law, mine, numbers, places in self._groups:
            some = mine[which]
            asked[some] = law.coefficients(seen[some][:, places], numbers.some(which[some]))
        return self.of.set_to(asked - self._nominal[due], closing, due)
