"""The one door through which a vehicle's named signals come in: from a vehicle and a controller's name to a certified gain."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from models.arrays import Array
from models.errors import InputError, known
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
        certificate: what is true of it.
    """

    name: str
    measured: tuple[str, ...]
    gain: Array
    designed: bool
    certificate: Certificate

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
    return GeneralizedPlant(
        A=model.A, B=model.B, Bw=model.Bw, C=weights * C, D=weights * D, Dw=np.zeros((len(C), model.Bw.shape[1]))
    )


class Designer:
    """Designs the controllers of one vehicle. The state-feedback step (22) is shared by them all, and done when first needed."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle
        self.plant = generalized_plant(vehicle)

    @cached_property
    def state_feedback(self) -> CentralPoint:
        """The optimum of (22)."""
        return state_feedback(self.plant)

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
            return self._certified(name, model.states, self.state_feedback)
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
        L = l_matrix(self.state_feedback.X, Cy, Q)  # (14)
        try:
            return self._certified(name, entry.measured, output_feedback(self.plant, Cy, L, Q))
        except DesignError as error:
            raise type(error)(f"controller {name!r}: {error}") from error

    def _given(self, entry: ControllerEntry) -> Controller:
        assert entry.gain is not None
        Cy, _ = self.vehicle.linear_model.rows(entry.measured)
        certificate = certify(self.plant, entry.gain @ Cy)
        return Controller(entry.name, entry.measured, entry.gain, designed=False, certificate=certificate)

    def _certified(self, name: str, measured: Sequence[str], point: CentralPoint) -> Controller:
        Cy, _ = self.vehicle.linear_model.rows(measured)
        certificate = certify(self.plant, point.K @ Cy, point.X, point.eta)
        if certificate.failures:
            raise DesignError(f"the certificate of controller {name!r} fails: {'; '.join(certificate.failures)}")
        return Controller(name, tuple(measured), point.K, designed=True, certificate=certificate)


def design(vehicle: Vehicle, name: str) -> Controller:
    """One controller of a vehicle; `Designer` shares work between several."""
    return Designer(vehicle).design(name)
