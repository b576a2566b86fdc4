"""Driver for exported controller code. The exported code receives the measurements and computes the commands of the actuators.

Quantisation, delay, limits and anti-windup of the controller are part of the exported code. Sensor noise is added to the
measurements before the exported code receives the measurements.
"""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.semi_active import SemiActive
from models.vehicle.limits_and_implementation import command_limiter
from models.vehicle.vehicle import Vehicle
from sim.drive.actuators import closing_names
from sim.drive.driver import Request
from sim.drive.drivers.registry import driver_of
from synth.controller.controller import Controller
from synth.controller.export.compiled import ExportedCode
from synth.controller.export.folder import is_law_of

NEARLY = 1 - 1e-6  # a limit counts as reached at this fraction of its value, because rounding to float may reduce the limit


class CodeDriver:
    """Exported code that controls N runs; the code has a separate state for each run.

    The exported code computes the actuator commands. The lost forces (requested forces cut off by limits and dampers) are
    computed by the law itself, from the code's measurements and states. Lost forces are recorded as in a run in which the law
    itself computes the forces.
    """

    ahead = 0
    requests: Request = "commands"

    def __init__(self, controllers: Sequence[Controller | SemiActive], *_: object) -> None:
        """Prepares N controllers that have the same exported code and control different vehicles."""
        self._controllers = controllers
        self._codes: list[ExportedCode] = [one.code for one in controllers]
        self._law, own = self._codes[0].law, controllers[0].law_key[0]
        self._semi_active = driver_of(controllers, own) if own == "semi_active" else None
        self.measured = self._law.inputs[: self._law.readings]

    def start(self, vehicles: Sequence[Vehicle], timestep: float) -> Array:
        """See `sim.drive.driver.Driver.start`.

        Raises:
            InputError: the code was exported for a control law, sample period or vehicle that differs from that of the run.
        """
        law, q, first = self._law, self._law.readings, vehicles[0]
        for one, code, vehicle in zip(self._controllers, self._codes, vehicles, strict=True):
            if not is_law_of(code.law, vehicle, one):
                raise InputError(
                    f"the law or implementation of controller {one.name!r} in this run differs from the exported code; omit "
                    "--as, or export the controller again"
                )
        self._steps, self._range = [code.start() for code in self._codes], None
        self._nominal = np.array([[one[0] for one in code.law.dampers] or [0.0] * len(law.outputs) for code in self._codes])
        if first.dampers:
            from models.parts.damper_range import range_of

            self.measured = (*self.measured, *closing_names(first))
            self._range = range_of(vehicles)
        # The exported code expects extension velocities, whose sign is the opposite
        self._sign = np.repeat([1.0, -1.0], [q, len(law.inputs) - q])
        if self._semi_active is not None:
            self._semi_active.start(vehicles, timestep)
        self._limiter, self._given = command_limiter(vehicles, timestep), np.zeros_like(self._nominal)
        size = len(law.outputs) * (1 if self._range is None else 2)
        self._late = [np.zeros((len(vehicles), size))] * law.delay  # delayed commands of the law, which have not yet arrived
        return np.zeros((len(vehicles), law.states))

    def step(self, k: int, y: Array, ahead: Array | None, state: Array) -> tuple[Array, Array]:
        given, after = np.empty_like(self._nominal), np.empty_like(state)
        for i, step in enumerate(self._steps):
            step.read(y[i, : len(self._sign)] * self._sign)
            step.step()
            given[i], after[i] = step.forces, step.states
        given -= self._nominal
        law, m = self._law, given.shape[1]
        if self._range is None and law.limit is None and self._limiter is None:
            return given, after
        self._late.append(self._ours(y, state))
        ours = self._late.pop(0)
        if self._range is not None:
            return np.concatenate([given, ours[:, m:]], axis=1), after
        if self._limiter is not None:
            limited, self._given = self._limiter(ours, self._given), given
            return np.where(limited == ours, given, limited), after
        most = law.limit if law.fixed is None or law.fixed.limit is None else law.fixed.limit * law.fixed.given
        assert most is not None, "a law without a limit has returned"
        return np.where(np.abs(given) >= NEARLY * most, ours, given), after

    def _ours(self, y: Array, state: Array) -> Array:
        """Returns the commands that the control law computes from the measurements and the states of the code, shape (N, m) or
        (N, 2 m).
        """
        law, q = self._law, self._law.readings
        step = np.where(law.resolution > 0, law.resolution, 1.0)
        seen, closing = np.where(law.resolution > 0, step * np.round(y[:, :q] / step), y[:, :q]), y[:, q:]
        if self._semi_active is not None and self._range is not None:
            requested, _ = self._semi_active.step(0, seen, None, state)
            return self._range.clip_coefficients(requested, closing)
        forces = seen @ law.law.D.T + state @ law.law.C.T
        return forces if self._range is None else self._range.commands(np.concatenate([forces, closing], axis=1))
