"""Adjustable dampers in MuJoCo: what controllers ask for becomes coefficients, sample by sample."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.damping.laws import SemiActive
from models.damping.range import Range, range_of
from models.vehicle import Vehicle
from sim.physics.readout import Readout
from sim.physics.sampler import Laws
from sim.semi_active.numbers import numbers_at, numbers_of


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


class Clipped:
    """Sets the adjustable dampers of N runs to the forces of linear laws; see `sim.physics.stepping.Setting`."""

    def __init__(self, of: Range) -> None:
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
