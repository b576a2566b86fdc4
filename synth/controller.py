"""The one door through which a vehicle's named signals come in: from a vehicle and a controller's name to a certified gain."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from models.arrays import Array
from models.errors import InputError, known
from models.linear_model import LinearModel
from models.vehicle import ControllerEntry, Vehicle
from synth.central import CentralPoint
from synth.certificate import Certificate, certify
from synth.errors import DesignError
from synth.output_feedback import l_matrix, nullspace, output_feedback
from synth.plant import GeneralizedPlant
from synth.state_feedback import state_feedback


@dataclass(frozen=True, eq=False)
class Controller:
    """A static controller u = K y with what is known of it.

    Attributes:
        name: as asked for.
        measured: the signals y, q of them. Empty for `passive`.
        gain: K, shape (m, q) [N per measured unit].
        designed: whether it was designed here; otherwise the gain was given (or is zero, for `passive`).
        short: how far from the optimum of (22) the X was taken that L (14) comes from, relative in gamma: 0 at the limit of the
            central path, more where the second problem is infeasible from there.
        stopped: how far from the optimum of its own problem the gain was taken, relative in gamma: 0 at the limit, more where the
            optimum is reached only by gains beyond any actuator.
        certificate: what is true of it.
    """

    name: str
    measured: tuple[str, ...]
    gain: Array
    designed: bool
    certificate: Certificate
    short: float = 0.0
    stopped: float = 0.0

    def state_gain(self, vehicle: Vehicle) -> Array:
        """G = K C_y (6) for a vehicle that has these signals, shape (m, n)."""
        Cy, _ = vehicle.linear_model.rows(self.measured)
        return self.gain @ Cy


def generalized_plant(vehicle: Vehicle) -> GeneralizedPlant:
    """The plant (15) of a vehicle: its linear model, and the weighted signals of `[performance]` as z (34)-(37)."""
    model = vehicle.linear_model
    weighted = [signal for signal, weight in vehicle.performance.items() if weight > 0]
    C, D = model.rows(weighted)
    weights = np.array([vehicle.performance[signal] for signal in weighted])[:, None]
    Br, Cr = _twist(model, weighted)
    return GeneralizedPlant(
        A=model.A,
        B=model.B,
        Bw=np.hstack([model.Bw, Br]),
        C=weights * C,
        D=weights * D,
        Dw=np.hstack([np.zeros((len(C), model.Bw.shape[1])), weights * Cr]),
    )


def _twist(model: LinearModel, signals: Sequence[str]) -> tuple[Array, Array]:
    """What the road's heights do where they act as such, as disturbances of their own, shapes (n, k) and (len(signals), k).

    From the road's velocity a lasting twist is an integral, which no controller bounds. As a disturbance beside the velocities it
    is bounded, and counts at the rate of wheel hop (`LinearModel.twist_rate`): a bound that holds for both together.
    """
    Cr = model.Cr[[model.outputs.index(signal) for signal in signals]]
    _, sizes, directions = np.linalg.svd(np.vstack([model.Br, model.Cr]))
    directions = directions[: int(np.sum(sizes > 1e-12 * sizes.max(initial=0.0)))] if np.any(sizes) else directions[:0]
    return model.Br @ directions.T / model.twist_rate, Cr @ directions.T / model.twist_rate


class Designer:
    """Designs the controllers of one vehicle. The state-feedback step (22) is shared by them all, and done when first needed."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle
        self.plant = generalized_plant(vehicle)

    @cached_property
    def state_path(self) -> list[CentralPoint]:
        """The central path of (22)."""
        return state_feedback(self.plant)

    @property
    def state_feedback(self) -> CentralPoint:
        """The optimum of (22)."""
        return self.state_path[-1]

    def design(self, name: str) -> Controller:
        """The controller of that name: `passive`, `state`, or one of the vehicle file, designed unless the file gives its gain.

        Raises:
            InputError: no controller has that name.
            DesignError: it could not be designed, or its certificate fails. A gain from the file is reported as it is.
        """
        vehicle, model = self.vehicle, self.vehicle.linear_model
        if name == "passive":
            return self._given(ControllerEntry(name, (), np.zeros((len(model.inputs), 0))))
        if name == "state":
            return self._certified(name, model.states, self.state_path)
        if name not in vehicle.controllers:
            raise InputError(f"unknown controller {name!r}; this vehicle has {known(vehicle.controller_names)}")
        entry = vehicle.controllers[name]
        if entry.gain is not None:
            return self._given(entry)

        Cy, _ = model.rows(entry.measured)
        if np.linalg.matrix_rank(Cy) < len(Cy):
            raise DesignError(
                f"controller {name!r} measures signals that depend on each other: {', '.join(entry.measured)}; drop one"
            )
        Q = nullspace(Cy)
        failures: list[DesignError] = []
        # From the optimal X the second problem can be infeasible where from a point a little short of it it is not: back off.
        for start in reversed(self.state_path):
            L = l_matrix(start.X, Cy, Q)  # (14)
            try:
                controller = self._certified(name, entry.measured, output_feedback(self.plant, Cy, L, Q))
            except DesignError as error:
                failures.append(error)
                continue
            return replace(controller, short=start.gamma / self.state_feedback.gamma - 1)
        raise type(failures[0])(f"controller {name!r}: {failures[0]} (from {len(failures)} points of the central path)")

    def _given(self, entry: ControllerEntry) -> Controller:
        assert entry.gain is not None
        Cy, _ = self.vehicle.linear_model.rows(entry.measured)
        certificate = certify(self.plant, entry.gain @ Cy)
        return Controller(entry.name, entry.measured, entry.gain, designed=False, certificate=certificate)

    def _certified(self, name: str, measured: Sequence[str], path: Sequence[CentralPoint]) -> Controller:
        """The controller furthest along a central path whose certificate holds."""
        Cy, _ = self.vehicle.linear_model.rows(measured)
        certificates = []
        for point in reversed(path):
            certificates.append(certify(self.plant, point.K @ Cy, point.X, point.eta))
            if not certificates[-1].failures:
                stopped = point.gamma / path[-1].gamma - 1
                return Controller(name, tuple(measured), point.K, designed=True, certificate=certificates[-1], stopped=stopped)
        raise DesignError(f"the certificate of controller {name!r} fails: {'; '.join(certificates[0].failures)}")


def given(vehicle: Vehicle, name: str, measured: Sequence[str], gain: Sequence[Sequence[float]]) -> Controller:
    """A controller whose gain is known, whatever its name, certified as it is.

    Args:
        vehicle: of which it is.
        name: its name.
        measured: the signals y, q of them.
        gain: K, m rows of q numbers [N per measured unit].
    """
    entry = ControllerEntry(name, tuple(measured), np.array(gain, dtype=float).reshape(len(gain), len(measured)))
    return Designer(vehicle)._given(entry)


def design(vehicle: Vehicle, name: str) -> Controller:
    """One controller of a vehicle; `Designer` shares work between several."""
    return Designer(vehicle).design(name)
