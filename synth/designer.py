"""The designs of a vehicle file: from a controller's name to a certified gain."""

import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from models.common.errors import InputError
from models.controllers import ControllerEntry
from models.law import LinearLaw, static_law
from models.vehicle import Vehicle
from synth.certificate.bounding import certify_tightly
from synth.certificate.certificate import Certificate
from synth.certificate.lower_bound import LowerBound
from synth.controller import Controller, alike, certified, checked, generalized_plant, measurements, on_readings, plant_states
from synth.design import Design, state_design, state_path, zero_l_design
from synth.dynamic.named import named_design
from synth.errors import BatchError, DesignError
from synth.fallback import two_steps_or_descent
from synth.lmi.central import CentralPoint
from synth.lmi.full_order import bound_beyond_control, find_lower_bound
from synth.lmi.output_feedback import independent_rows
from synth.plant import Feedback
from synth.redesign import state_designs, two_step_designs
from synth.search.refine import SEEN, Refinement, from_some, refine, worth_refining
from synth.search.static import static_output_feedback

STATE_ALONE = (
    "filters have states that nothing measures: this is a static gain on the vehicle's own, found by the two steps as any other "
    "output feedback is"
)


@dataclass(frozen=True, eq=False)
class Refined:
    """A controller whose norm was lowered, and what that took.

    Attributes:
        controller: the refined one, with its certificate.
        start: what it was refined from; None where the two steps find no gain.
        origin: where the descent began instead, in words; empty where at `start`.
        refinement: the norms before and after, the growth of the gain, and what was refused.
    """

    controller: Controller
    start: Controller | None
    origin: str
    refinement: Refinement

    @property
    def traded(self) -> str:
        """What was traded, in words."""
        return f"refined: {f'from {self.origin}; ' if self.origin else ''}{self.refinement.traded}"


class Designer:
    """Designs the controllers of one vehicle. The state-feedback step (22) is shared by them all, and done when first needed."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle
        self.plant = generalized_plant(vehicle)

    @cached_property
    def state_path(self) -> list[CentralPoint]:
        """The central path of (22)."""
        return state_path(self.plant, plant_states(self.vehicle))

    @property
    def state_feedback(self) -> CentralPoint:
        """The optimum of (22)."""
        return self.state_path[-1]

    @cached_property
    def beyond_control(self) -> LowerBound:
        """What no control force changes, whatever is measured."""
        return bound_beyond_control(self.plant)

    @cached_property
    def _bounds(self) -> dict[tuple[str, ...], LowerBound]:
        return {}

    def lower_bound(self, measured: Sequence[str]) -> LowerBound:
        """What no controller that measures these signals beats, of whatever order; for none of them, full state feedback."""
        key = tuple(measured)
        if key not in self._bounds:
            of_state = [signal for signal in key if signal not in self.vehicle.linear_model.inputs]
            everything = not of_state or key == plant_states(self.vehicle)
            Cy = None if everything else measurements(self.vehicle, of_state)[0]
            try:
                path = self.state_path
            except DesignError:  # what cannot be designed may be checked
                path = []
            self._bounds[key] = find_lower_bound(self.plant, Cy, path, self.beyond_control)
        return self._bounds[key]

    def design(self, name: str, zero_l: bool = False) -> Controller:
        """The controller of that name: `passive`, `state`, or one of the vehicle file, designed unless the file gives its gain.

        Args:
            name: of the controller.
            zero_l: L = 0 instead of (14), as in remark 4; for a controller that is designed from measurements.

        Raises:
            InputError: no controller has that name.
            DesignError: it could not be designed, or its certificate fails. A gain from the file is reported as it is. Where the
                two steps cannot be gone to their end, descent on the norm goes on instead, and the result says so.
        """
        entry = self._entry(name)
        if entry.law is not None:
            return self._given(entry, entry.law)
        if entry.design and zero_l:
            raise InputError(f"controller {name!r} is not designed in two steps, so that there is no L; design it as it is")
        Cy, _ = measurements(self.vehicle, entry.measured)
        try:
            lower_bound = self.lower_bound(entry.measured)
            if entry.design:
                return self._named(entry, lower_bound)
            if name == "state" and not self.vehicle.filtered:
                design = state_design(self.plant, self.state_path, lower_bound)
            elif zero_l:
                design = zero_l_design(self.plant, Cy, lower_bound)
            else:
                states, always = plant_states(self.vehicle), name == "state"
                design = two_steps_or_descent(self.plant, Cy, lambda: self.state_path, lower_bound, states, always)
        except DesignError as error:
            raise type(error)(f"controller {name!r}: {error}") from error
        return _designed(self.vehicle, entry, design)

    def _given(self, entry: ControllerEntry, law: LinearLaw) -> Controller:
        certificate, wrong = certified(self.vehicle, self.plant, entry, self.lower_bound(entry.measured))
        return Controller(entry.name, entry.measured, law, designed=False, certificate=certificate, false_claims=wrong)

    def _named(self, entry: ControllerEntry, lower_bound: LowerBound) -> Controller:
        """A controller that is designed in another way than by two steps."""
        vehicle, how = self.vehicle, self.vehicle.implementation
        model = vehicle.linear_model
        of_state = [signal for signal in entry.measured if signal not in model.inputs]
        Cy, _ = measurements(vehicle, of_state)
        # Drawn every T seconds, noise of rms sigma is white noise of sigma sqrt(T).
        rms = [how.noise.get(signal, 0.0) * (how.sample_period or 0.0) ** 0.5 for signal in of_state]
        noise = rms if any(rms) else None
        found = named_design(entry.design, self.plant, Cy, lower_bound, plant_states(vehicle), noise)
        certificate = replace(found.certificate, below=lower_bound)
        law = on_readings(found.law, model, entry.measured)
        return Controller(entry.name, entry.measured, law, True, certificate, remarks=found.remarks)

    def refine(self, name: str, zero_l: bool = False) -> Refined:
        """The controller of that name with a lower norm, as far as it is worth a larger gain (`synth.search.refine`).

        Where the two steps find no gain, it is the best that any start leads to.

        Args:
            name: of the controller.
            zero_l: as for `design`.

        Raises:
            InputError: no controller has that name, or it has no gain to change, as `passive`.
            DesignError: it does not stabilise the vehicle, or no start leads to a gain.
        """
        entry = self._entry(name)
        measured = entry.measured
        if not measured:
            raise InputError(f"controller {name!r} measures nothing, so that it has no gain to refine; give one that does")
        if entry.design or (entry.law is not None and entry.law.states):
            raise DesignError(f"controller {name!r} is no static gain of the least norm, which is what is refined")
        try:
            start = self.design(name, zero_l)
        except DesignError:
            start = None
        rows, through = measurements(self.vehicle, measured)
        kept = independent_rows(self.plant, rows)
        Cy, origin, lower_bound = rows[kept], "", self.lower_bound(measured)
        if start is None:
            found = static_output_feedback(self.plant, Cy, lower_bound=lower_bound)
            K, origin = found.gain, found.origin
        else:
            K = from_some(start.law_on_states(self.vehicle).D, rows, kept)
        refinement = refine(self.plant, Cy, K)
        gain = np.zeros((len(K), len(measured)))
        gain[:, kept] = refinement.gain
        certificate = certify_tightly(self.plant, Feedback(refinement.gain, Cy), lower_bound)
        law = static_law(gain).fed_back(-through)
        return Refined(Controller(name, measured, law, True, certificate), start, origin, refinement)

    def worth_refining(self, controller: Controller) -> float:
        """By how much `refine` lowers a designed controller's norm at least, relative; 0 where not by what seven digits show."""
        gap = controller.certificate.gap
        if (
            not controller.designed
            or not controller.measured
            or self._entry(controller.name).design
            or not controller.certificate.stable
            or (gap is not None and gap <= SEEN)
        ):
            return 0.0
        rows, _ = measurements(self.vehicle, controller.measured)
        kept = independent_rows(self.plant, rows)
        share = worth_refining(self.plant, rows[kept], from_some(controller.law_on_states(self.vehicle).D, rows, kept))
        return share if share > SEEN else 0.0

    def redesign(self, vehicles: Sequence[Vehicle], name: str) -> list[Controller]:
        """A controller of this vehicle for many others like it: `design` for each, side by side, which is several times as fast.

        The others lend their parameters and weights; what is measured says this one. The gains are those of `design` up to
        where the central path is stopped: 3e-6 of the largest entry on the paper's car. Each certificate is true of its own gain,
        but the X of a proof comes from there, too: where rounding leaves it little room, as near a marginal loop, the bound
        may be looser or tighter than that of `design`, by up to a tenth. They come without a lower bound:
        `Designer(vehicle).lower_bound(measured)` has it.

        Args:
            vehicles: of this vehicle's kind.
            name: `state`, or a controller of this vehicle that its file gives no gain for.

        Returns:
            A controller for each vehicle, in their order.

        Raises:
            InputError: no controller has that name, its gain is given, or a vehicle is none, of another kind, or has a parameter
                or a weight that is missing, unknown or not allowed.
            BatchError: some vehicles have no such controller; the message names them by index, and the error carries the
                controllers of the others, `designs`, and why these have none, `failures`, each by index.
        """
        entry = self._entry(name)
        if entry.law is not None:
            raise InputError(f"controller {name!r} has its law and is not designed; `design` certifies it for a vehicle")
        if entry.design:
            raise InputError(f"controller {name!r} is not designed in two steps; design it for each vehicle by itself")
        sound = alike(self.vehicle, vehicles)
        plants = [generalized_plant(vehicle) for vehicle in sound]
        states = plant_states(self.vehicle)
        try:
            if name == "state" and not any(vehicle.filtered for vehicle in (self.vehicle, *sound)):
                designs = state_designs(self.plant, self.state_path, plants, states)
            else:
                Cy, *Cys = (measurements(each, entry.measured)[0] for each in (self.vehicle, *sound))
                designs = two_step_designs(self.plant, self.state_path, Cy, plants, Cys, states, name == "state")
        except BatchError as error:
            controllers = {i: _designed(sound[i], entry, design) for i, design in error.designs.items()}
            raise BatchError(f"controller {name!r}: {error}", controllers, error.failures) from error
        except DesignError as error:
            raise type(error)(f"controller {name!r}: {error}") from error
        return [_designed(vehicle, entry, design) for vehicle, design in zip(sound, designs, strict=True)]

    def checked(self, entry: ControllerEntry) -> tuple[Certificate, tuple[str, ...]]:
        """What is true of a law of the file by the proofs that its certificate brings, and what of that does not hold, in words.

        Raises:
            InputError: the certificate is malformed.
        """
        return checked(self.vehicle, self.plant, entry)

    def _entry(self, name: str) -> ControllerEntry:
        """What is to be designed or certified under a name."""
        name, model = unicodedata.normalize("NFC", str(name)), self.vehicle.linear_model
        if name == "passive":
            return ControllerEntry(name, (), static_law(np.zeros((len(model.inputs), 0))))
        if name == "state":
            return ControllerEntry(name, model.states)
        return self.vehicle.linear_entry(name)


def _designed(vehicle: Vehicle, entry: ControllerEntry, design: Design) -> Controller:
    """The controller of a gain on C_y x; a force that is in what is measured is taken out of it."""
    through = vehicle.linear_model.rows(entry.measured)[1]
    beside = STATE_ALONE if entry.name == "state" and vehicle.filtered else ""
    redundant = tuple(entry.measured[i] for i in design.redundant)
    return Controller(
        entry.name,
        entry.measured,
        static_law(design.gain).fed_back(-through),
        designed=True,
        certificate=design.certificate,
        state_step_gap=design.state_step_gap,
        optimum_gap=design.optimum_gap,
        moved=design.moved,
        redundant=redundant,
        case="; ".join(said for said in (design.case, beside) if said),
        instead=design.instead,
    )


def given(vehicle: Vehicle, name: str, measured: Sequence[str], law: LinearLaw) -> Controller:
    """A controller whose law is known, from what is measured to the forces, whatever its name, certified as it is.

    Raises:
        InputError: it has another number of signals or forces, or no loop.
    """
    expected = len(vehicle.linear_model.inputs), len(measured)
    if law.D.shape != expected:
        raise InputError(f"controller {name!r} has a D of shape {law.D.shape}; expected {expected}: forces, measured signals")
    designer = Designer(vehicle)
    entry = ControllerEntry(name, tuple(measured), law)
    return designer._given(entry, law)


def design(vehicle: Vehicle, name: str) -> Controller:
    """One controller of a vehicle; `Designer` shares work between several."""
    return Designer(vehicle).design(name)
