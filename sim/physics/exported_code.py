"""Exported code in the loop: it reads the signals and sets the actuators of runs, and computes everything in between.

Quantisation, delay, limits and anti-windup of the controller are in the code, and not here. Noise is of the sensors, and is here.
"""

from collections import deque
from collections.abc import Callable, Sequence

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.semi_active import SemiActive
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.physics import drivers
from synth.controller.controller import Controller, code_of
from synth.controller.export.compiled import BehindCode, CompiledLoop, ExportedCode
from synth.controller.export.folder import is_law_of

NEARLY = 1 - 1e-6  # of a limit: rounded to float it is a little less


class CodeInTheLoop:
    """Exported code that drives N runs, as a `sim.physics.stepping.Setting`.

    It is given the measured signals, then with adjustable dampers the suspensions' closing velocities. The first m commands of a
    sample are those of the code. What it cannot tell, forces beyond its limits and forces that dampers do not give, are computed
    by our own law from the same readings and the code's own states.
    """

    def __init__(
        self,
        controllers: Sequence["drivers.RunDriver"],
        vehicles: Sequence[Vehicle],
        timestep: float,
        dampers: "drivers.Dampers | None",
        longest: int = 0,
    ) -> None:
        """Starts the code of N controllers, each of its own vehicle.

        Args:
            timestep: timestep of the runs [s].
            dampers: dampers of the vehicles, or None.
            longest: largest number of timesteps of a block with contiguous measurements; 0 if they are not contiguous.

        Raises:
            InputError: the code is of another law, sample period or vehicle than a run.
        """
        self._codes = [_checked(one, vehicle) for one, vehicle in zip(controllers, vehicles, strict=True)]
        self._law, self._dampers = self._codes[0].law, dampers
        self._steps = [code.start() for code in self._codes]
        self._held, self._k = steps_per_sample(vehicles[0].implementation, timestep), 0
        self.actuators, q = len(self._law.outputs), self._law.readings
        self._nominal = np.array([[one[0] for one in code.law.dampers] or [0.0] * self.actuators for code in self._codes])
        self._sign = None if dampers is None else np.repeat([1.0, -1.0], [q, len(self._law.inputs) - q])
        self.flat = len(self._codes) == 1
        self._given, self._used = list[bytes](), list[bytes]()
        self._last = np.zeros(0), np.zeros(0)
        self.kept = np.zeros((0, len(self._codes), self._law.states))  # states at the samples of the last block
        self._semi_active = None
        if dampers is not None and (laws := [one for one in controllers if isinstance(one, SemiActive)]):
            self._semi_active = drivers.SemiActiveLaws(laws, dampers)
        late = self._law.delay * self._held
        self._late = np.zeros((late, len(controllers), self.actuators * (1 if dampers is None else 2)))

        behind = [getattr(one, "behind", None) or BehindCode() for one in controllers]
        self._factor = np.array([[one.factor] for one in behind])
        self._later = [deque([np.zeros(self.actuators)] * one.steps) for one in behind]
        self._moved = any(one != BehindCode() for one in behind)
        self._alone: CompiledLoop | None = None
        if longest and self.flat and dampers is None and not self._moved:
            self._alone = CompiledLoop(self._codes[0], self._held, longest)

    @property
    def in_c(self) -> Callable[[Array, Array], Callable[[], None]] | None:
        """Returns what begins a block of a single run in C, see `CompiledLoop.begin`; None for other runs, which `set` steps."""
        return None if self._alone is None else self._alone.begin

    def set(self, seen: Array, acting: Array) -> None:
        """See `sim.physics.stepping.Setting`; of a single run the signals have shape (d,)."""
        if self._k:
            given, used = self._last
        elif self.flat:
            self._last = given, used = self._sample(0, seen)
        else:
            pairs = [self._sample(i, row) for i, row in enumerate(seen)]
            self._last = given, used = np.stack([one for one, _ in pairs]), np.stack([one for _, one in pairs])
        self._given.append(given.tobytes())
        self._used.append(used.tobytes())
        acting[...] = self._behind(given) if self._moved else given
        self._k = (self._k + 1) % self._held

    def _behind(self, given: Array) -> Array:
        """Returns the forces that act, from those of the code, shape (N, m) or (m,)."""
        forces = (self._factor * given).reshape(-1, self.actuators)
        for line, row in zip(self._later, forces, strict=True):
            line.append(row.copy())
            row[...] = line.popleft()
        return forces.reshape(given.shape)

    def _sample(self, i: int, seen: Array) -> tuple[Array, Array]:
        """Returns the commands of a run from its signals, and the states at the sample."""
        step = self._steps[i]
        step.read(seen if self._sign is None else seen[: len(self._sign)] * self._sign)
        used = step.states
        step.step()
        return step.forces - self._nominal[i], used

    def commands(self, seen: Array) -> Array:
        """See `sim.physics.stepping.Setting`: of the samples since the last call."""
        law, shape = self._law, (len(seen), len(self._steps))
        if self._alone is not None:
            given, self.kept = (each[: len(seen), None].copy() for each in (self._alone.given, self._alone.used))
        else:
            given = np.frombuffer(b"".join(self._given)).reshape(*shape, self.actuators)
            self.kept = np.frombuffer(b"".join(self._used)).reshape(*shape, law.states)
            self._given.clear()
            self._used.clear()
        if self._dampers is None and law.limit is None:
            return given
        y, closing = seen[..., : law.readings], seen[..., law.readings :]
        step = np.where(law.resolution > 0, law.resolution, 1.0)
        y = np.where(law.resolution > 0, step * np.round(y / step), y)
        if self._semi_active is not None:
            ours = self._semi_active.commands(np.concatenate([y, closing], axis=-1))
        else:
            ours = y @ law.D.T + self.kept @ law.C.T
            if self._dampers is not None:
                ours = self._dampers.of.commands(np.concatenate([ours, closing], axis=-1))
        whole = np.concatenate([self._late, ours])
        ours, self._late = whole[: len(seen)], whole[len(seen) :]
        if self._dampers is None:
            most = law.limit if law.fixed is None or law.fixed.limit is None else law.fixed.limit * law.fixed.given
            assert most is not None, "else nothing is clipped"
            return np.where(np.abs(given) >= NEARLY * most, ours, given)
        return np.concatenate([given, ours[..., self.actuators :]], axis=-1)


def _checked(driver: "drivers.RunDriver", vehicle: Vehicle) -> ExportedCode:
    """Returns the code of a controller, if it is of the law and implementation of its run."""
    code = code_of(driver)
    assert code is not None, "exported code drives all of these runs"
    assert isinstance(driver, (Controller, SemiActive)), "and it is of such a law"
    if getattr(driver, "behind", None) is not None:  # its maker has checked it, and changed the law since
        return code
    if not is_law_of(code.law, vehicle, driver):
        raise InputError(
            f"exported code drives controller {driver.name!r} as it was exported alone, and this run changes its law or its "
            "implementation; leave out --as"
        )
    return code
