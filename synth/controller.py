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
from synth.full_order import best_possible
from synth.lower_bound import LowerBound
from synth.output_feedback import independent_rows, l_matrix, nullspace, output_feedback
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
        redundant: the signals among `measured` that follow from the others; their gain is zero.
        certificate: what is true of it.
    """

    name: str
    measured: tuple[str, ...]
    gain: Array
    designed: bool
    certificate: Certificate
    short: float = 0.0
    stopped: float = 0.0
    redundant: tuple[str, ...] = ()

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

    @cached_property
    def _bounds(self) -> dict[tuple[str, ...], LowerBound]:
        return {}

    def best_possible(self, measured: Sequence[str]) -> LowerBound:
        """What no controller that measures these signals can beat, of whatever order; full state feedback for all states."""
        key = tuple(measured)
        if key not in self._bounds:
            everything = not key or key == self.vehicle.linear_model.states
            Cy = None if everything else self.vehicle.linear_model.rows(key)[0]
            try:
                path = self.state_path
            except DesignError:  # what cannot be designed may be checked
                path = []
            self._bounds[key] = best_possible(self.plant, Cy, path)
        return self._bounds[key]

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

        Cy, kept = self.measurement(entry.measured)
        Q = nullspace(Cy)
        failures: list[DesignError] = []
        # From the optimal X the second problem can be infeasible where from a point a little short of it it is not: back off.
        for start in reversed(self.state_path):
            L = l_matrix(start.X, Cy, Q)  # (14)
            try:
                controller = self._certified(name, entry.measured, output_feedback(self.plant, Cy, L, Q), kept)
            except DesignError as error:
                failures.append(error)
                continue
            return replace(controller, short=start.gamma / self.state_feedback.gamma - 1)
        raise type(failures[0])(f"controller {name!r}: {failures[0]} (from {len(failures)} points of the central path)")

    def measurement(self, measured: Sequence[str]) -> tuple[Array, list[int]]:
        """C_y without the rows that follow from others, and which rows those are that stay."""
        Cy, _ = self.vehicle.linear_model.rows(measured)
        kept = independent_rows(Cy)
        return Cy[kept], kept

    def controller(
        self, name: str, measured: Sequence[str], kept: Sequence[int], K: Array, certificate: Certificate
    ) -> Controller:
        """A designed controller from the gain on the signals that were kept: the others get a gain of zero."""
        gain = np.zeros((len(K), len(measured)))
        gain[:, kept] = K
        redundant = tuple(signal for i, signal in enumerate(measured) if i not in kept)
        return Controller(name, tuple(measured), gain, designed=True, certificate=certificate, redundant=redundant)

    def _given(self, entry: ControllerEntry) -> Controller:
        assert entry.gain is not None
        Cy, _ = self.vehicle.linear_model.rows(entry.measured)
        certificate = certify(self.plant, entry.gain @ Cy, lower=self.best_possible(entry.measured))
        return Controller(entry.name, entry.measured, entry.gain, designed=False, certificate=certificate)

    def _certified(
        self, name: str, measured: Sequence[str], path: Sequence[CentralPoint], kept: Sequence[int] | None = None
    ) -> Controller:
        """The controller furthest along a central path whose certificate holds."""
        kept = range(len(measured)) if kept is None else kept
        Cy, _ = self.vehicle.linear_model.rows([measured[i] for i in kept])
        certificates, lower = [], self.best_possible(measured)
        for point in reversed(path):
            certificates.append(certify(self.plant, point.K @ Cy, point.X, point.eta, lower))
            if not certificates[-1].failures:
                controller = self.controller(name, measured, kept, point.K, certificates[-1])
                return replace(controller, stopped=point.gamma / path[-1].gamma - 1)
        raise DesignError(f"the certificate of controller {name!r} fails: {'; '.join(certificates[0].failures)}")


def design(vehicle: Vehicle, name: str) -> Controller:
    """One controller of a vehicle; `Designer` shares work between several."""
    return Designer(vehicle).design(name)
