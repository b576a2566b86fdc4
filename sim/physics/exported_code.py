"""Exported code in the loop: it reads the signals and sets the actuators of runs, and computes everything in between.

Quantisation, delay, limits and anti-windup of the controller are in the code, and not here. Noise is of the sensors, and is here.
"""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.semi_active import SemiActive
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.physics import drivers
from synth.controller.controller import Controller, code_of
from synth.controller.export.compiled import ExportedCode
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
    ) -> None:
        """Starts the code of N controllers, each of its own vehicle.

        Args:
            timestep: timestep of the runs [s].
            dampers: adjustable dampers of the vehicles, or None.

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
        self.flat = False
        self._given, self._used = list[Array](), list[Array]()
        self._last = np.zeros(0), np.zeros(0)
        self.kept = np.zeros((0, len(self._codes), self._law.states))  # states at the samples of the last block
        self._semi_active = None
        if dampers is not None and (laws := [one for one in controllers if isinstance(one, SemiActive)]):
            self._semi_active = drivers.SemiActiveLaws(laws, dampers)
        late = self._law.delay * self._held
        self._late = np.zeros((late, len(controllers), self.actuators * (1 if dampers is None else 2)))

    def set(self, seen: Array, acting: Array) -> None:
        """See `sim.physics.stepping.Setting`."""
        if self._k == 0:
            pairs = [self._sample(i, row) for i, row in enumerate(seen)]
            self._last = np.stack([one for one, _ in pairs]), np.stack([one for _, one in pairs])
        self._given.append(self._last[0])
        self._used.append(self._last[1])
        acting[...] = self._last[0]
        self._k = (self._k + 1) % self._held

    def _sample(self, i: int, seen: Array) -> tuple[Array, Array]:
        """Returns the commands of a run from its signals, and the states at the sample."""
        step = self._steps[i]
        step.read(seen if self._sign is None else seen[: len(self._sign)] * self._sign)
        used = step.states
        step.step()
        return step.forces - self._nominal[i], used

    def commands(self, seen: Array) -> Array:
        """See `sim.physics.stepping.Setting`: of the samples since the last call."""
        law, given, self.kept = self._law, np.array(self._given), np.array(self._used)
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
    if not is_law_of(code.law, vehicle, driver):
        raise InputError(
            f"exported code drives controller {driver.name!r} as it was exported alone, and this run changes its law or its "
            "implementation; omit --as"
        )
    return code
