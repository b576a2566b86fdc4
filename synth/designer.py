"""The designs of a vehicle file: from a controller's name to a certified gain."""

import unicodedata
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.common.errors import InputError
from models.controllers import IDEAL, ControllerEntry, Hardware
from models.law import LinearLaw, static_law
from models.vehicle import Vehicle
from synth.certificate.bounding import certify_tightly
from synth.certificate.certificate import Certificate
from synth.certificate.lower_bound import LowerBound
from synth.controller import Controller, alike, certified, checked, on_readings
from synth.design import state_design, zero_l_design
from synth.designs.designed import designed, one_by_one
from synth.designs.goals import goals_design, promises_of
from synth.designs.in_the_mean import white_noise
from synth.designs.refined import Refined
from synth.designs.sampled import sampled_design
from synth.designs.shared import Shared
from synth.dynamic.loop import on_larger_plant
from synth.errors import BatchError, DesignError
from synth.fallback import two_steps_or_descent
from synth.full.named import named_design
from synth.goals.search import Told
from synth.implemented.claims import false_norm, norm_if_implemented, still_false
from synth.lmi.central import CentralPoint
from synth.lmi.output_feedback import independent_rows
from synth.plant import GeneralizedPlant
from synth.problem.problem import Problem, generalized_plant, measurements, plant_states
from synth.redesign import state_designs, two_step_designs
from synth.search.refine import SEEN, from_some, refine, worth_refining
from synth.search.static import static_output_feedback


class Designer:
    """Designs the controllers of one vehicle. The state-feedback step (22) is shared by them all, and done when first needed.

    With `search` gains that are given are held against each vehicle's own best, too, which takes designs (`promises_of`).
    """

    def __init__(self, vehicle: Vehicle, search: bool = True) -> None:
        self.vehicle, self.search = vehicle, search
        self._shared: dict[Hardware, Shared] = {IDEAL: Shared(vehicle)}

    def shared(self, hardware: Hardware = IDEAL) -> Shared:
        """What designs for such actuators, under such loads, share."""
        key = replace(hardware, noise=())
        if key not in self._shared:
            self._shared[key] = Shared(self.vehicle, key)
        return self._shared[key]

    @property
    def plant(self) -> GeneralizedPlant:
        """The plant of forces that act at once, without noise."""
        return self.shared().plant

    @property
    def state_path(self) -> list[CentralPoint]:
        """The central path of (22)."""
        return self.shared().state_path

    @property
    def state_feedback(self) -> CentralPoint:
        """The optimum of (22)."""
        return self.state_path[-1]

    @property
    def beyond_control(self) -> LowerBound:
        """What no control force changes, whatever is measured."""
        return self.shared().beyond_control

    def problem(self, measured: Sequence[str], hardware: Hardware = IDEAL) -> Problem:
        """What a controller that measures these signals is designed for and judged with."""
        return self.shared(hardware).problem(measured, hardware.noise)

    def lower_bound(self, measured: Sequence[str], hardware: Hardware = IDEAL) -> LowerBound:
        """What no controller that measures these signals beats, of whatever order; for none of them, full state feedback."""
        return self.shared(hardware).lower_bound(measured, hardware.noise)

    def design(self, name: str, zero_l: bool = False, told: Told = lambda goal, within: None) -> Controller:
        """The controller of that name: `passive`, `state`, or one of the vehicle file, designed unless the file gives its gain.

        Args:
            name: of the controller.
            zero_l: L = 0 instead of (14), as in remark 4; for a controller that is designed from measurements.
            told: called with what a design for goals has reached, as it goes on.

        Raises:
            InputError: no controller has that name.
            DesignError: it could not be designed, or its certificate fails. A gain from the file is reported as it is. Where the
                two steps cannot be gone to their end, descent on the norm goes on instead, and the result says so.
        """
        entry = self._entry(name)
        if entry.law is not None:
            return self._given(entry, entry.law)
        hardware = entry.hardware
        if (entry.design or entry.sampled or entry.goals or hardware.noise) and zero_l:
            why = "is designed for noise, which (25) does not know," if hardware.noise else "is not designed in two steps"
            why = "is designed for the sampled loop" if entry.sampled else why
            raise InputError(f"controller {name!r} {why} so that there is no L; design it as it is")
        posed = self.problem(entry.measured, hardware)
        try:
            lower_bound = self.lower_bound(entry.measured, hardware)
            if entry.design:
                return self._named(entry, posed, lower_bound)
            if entry.goals is not None:
                return goals_design(self.vehicle, entry, entry.goals, posed, lower_bound, told)
            if entry.sampled:
                return sampled_design(
                    self.vehicle, entry, posed, lower_bound, lambda: self._in_two_steps(entry, posed, lower_bound)
                )
            return self._in_two_steps(entry, posed, lower_bound, zero_l)
        except DesignError as error:
            raise type(error)(f"controller {name!r}: {error}") from error

    def _in_two_steps(self, entry: ControllerEntry, posed: Problem, lower_bound: LowerBound, zero_l: bool = False) -> Controller:
        """A static gain for the ideal loop, or the DesignError that says why there is none."""
        shared = self.shared(entry.hardware)
        if entry.name == "state" and not self.vehicle.filtered:
            found = state_design(self.plant, self.state_path, lower_bound)
        elif zero_l:
            found = zero_l_design(posed.plant, posed.Cy, lower_bound)
        else:
            always = entry.name == "state" or posed.Dyw is not None
            found = two_steps_or_descent(
                posed.plant, posed.Cy, lambda: shared.state_path, lower_bound, shared.states, always, posed.Dyw
            )
        return designed(self.vehicle, entry, found)

    def _given(self, entry: ControllerEntry, law: LinearLaw) -> Controller:
        posed, hardware = self.problem(entry.measured, entry.hardware), entry.hardware
        try:
            certificate, wrong = certified(posed, entry, self.lower_bound(entry.measured, hardware))
        except InputError as error:
            raise self.vehicle.found_wrong(error) from error
        kept = promises_of(self.vehicle, entry, law, self.search)
        found = Controller(entry.name, entry.measured, law, False, certificate, hardware=hardware, promises=kept)
        wrong += false_norm(entry.certificate, self.vehicle, lambda: norm_if_implemented(self.vehicle, found))
        return replace(found, false_claims=still_false(self.vehicle, found, wrong))

    def _named(self, entry: ControllerEntry, posed: Problem, lower_bound: LowerBound) -> Controller:
        """A controller that is designed in another way than by two steps."""
        hardware, (Cy, Dyw) = entry.hardware, posed.rows(posed.of_state)
        states, noise = self.shared(hardware).states, white_noise(self.vehicle, entry, posed)
        found = named_design(entry.design, posed.plant, Cy, lower_bound, states, noise, Dyw)
        law = on_readings(found.law, posed)
        certificate = replace(found.certificate, below=lower_bound)
        return Controller(entry.name, entry.measured, law, True, certificate, remarks=found.remarks, hardware=hardware)

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
        if entry.sampled:
            raise DesignError(
                f"controller {name!r} is designed for the sampled loop, and it is the ideal one's norm that is refined"
            )
        if entry.design or entry.goals or (entry.law is not None and entry.law.states):
            raise DesignError(f"controller {name!r} is no static gain of the least norm, which is what is refined")
        try:
            start = self.design(name, zero_l)
        except DesignError:
            start = None
        posed = self.problem(measured, entry.hardware)
        kept = independent_rows(posed.plant, posed.Cy)
        (Cy, Dyw), origin, lower_bound = posed.rows(kept), "", self.lower_bound(measured, entry.hardware)
        if start is None:
            found = static_output_feedback(posed.plant, Cy, lower_bound=lower_bound, Dyw=Dyw)
            K, origin = found.gain, found.origin
        else:
            K = from_some(start.law_on_states(self.vehicle).D, posed.Cy, kept)
        refinement = refine(posed.plant, Cy, K, Dyw)
        gain = np.zeros((len(K), len(measured)))
        gain[:, kept] = refinement.gain
        certificate = certify_tightly(
            *on_larger_plant(posed.plant, Cy, static_law(refinement.gain), Dyw), lower_bound, by_itself=posed.plant
        )
        law = static_law(gain).fed_back(-posed.through)
        refined = Controller(name, measured, law, True, certificate, hardware=entry.hardware)
        return Refined(refined, start, origin, refinement)

    def worth_refining(self, controller: Controller) -> float:
        """By how much `refine` lowers a designed controller's norm at least, relative; 0 where not by what seven digits show."""
        gap = controller.certificate.gap
        if (
            not controller.designed
            or not controller.measured
            or (entry := self._entry(controller.name)).design
            or entry.goals
            or controller.sampled
            or not controller.certificate.stable
            or (gap is not None and gap <= SEEN)
        ):
            return 0.0
        posed = self.problem(controller.measured, controller.hardware)
        kept = independent_rows(posed.plant, posed.Cy)
        Cy, Dyw = posed.rows(kept)
        K = from_some(controller.law_on_states(self.vehicle).D, posed.Cy, kept)
        share = worth_refining(posed.plant, Cy, K, Dyw)
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
        if entry.design or entry.sampled or entry.goals or entry.hardware != IDEAL:
            raise InputError(f"controller {name!r} is not designed in two steps alone; design it for each vehicle by itself")
        sound = alike(self.vehicle, vehicles)
        if any(vehicle.filtered for vehicle in (self.vehicle, *sound)):  # there the two steps are not the end of a design
            named = [replace(vehicle, controllers=self.vehicle.controllers) for vehicle in sound]
            return one_by_one(name, [lambda each=each: Designer(each).design(name) for each in named])
        plants = [generalized_plant(vehicle) for vehicle in sound]
        states = plant_states(self.vehicle)
        try:
            if name == "state":
                designs = state_designs(self.plant, self.state_path, plants, states)
            else:
                Cy, *Cys = (measurements(each, entry.measured)[0] for each in (self.vehicle, *sound))
                designs = two_step_designs(self.plant, self.state_path, Cy, plants, Cys, states)
        except BatchError as error:
            controllers = {i: designed(sound[i], entry, design) for i, design in error.designs.items()}
            raise BatchError(f"controller {name!r}: {error}", controllers, error.failures) from error
        except DesignError as error:
            raise type(error)(f"controller {name!r}: {error}") from error
        return [designed(vehicle, entry, design) for vehicle, design in zip(sound, designs, strict=True)]

    def checked(self, entry: ControllerEntry) -> tuple[Certificate, tuple[str, ...]]:
        """What is true of a law of the file by the proofs that its certificate brings, and what of that does not hold, in words.

        Raises:
            InputError: the certificate is malformed.
        """
        try:
            return checked(self.problem(entry.measured, entry.hardware), entry)
        except InputError as error:
            raise self.vehicle.found_wrong(error) from error

    def _entry(self, name: str) -> ControllerEntry:
        """What is to be designed or certified under a name."""
        name, model = unicodedata.normalize("NFC", str(name)), self.vehicle.linear_model
        if name == "passive":
            return ControllerEntry(name, (), static_law(np.zeros((len(model.inputs), 0))))
        if name == "state":
            return ControllerEntry(name, model.states, sampled=self.vehicle.sampled)
        return self.vehicle.linear_entry(name)


def given(vehicle: Vehicle, name: str, measured: Sequence[str], law: LinearLaw, hardware: Hardware = IDEAL) -> Controller:
    """A controller whose law is known, from what is measured to the forces, whatever its name, certified as it is.

    Raises:
        InputError: it has another number of signals or forces, or no loop.
    """
    expected = len(vehicle.linear_model.inputs), len(measured)
    if law.D.shape != expected:
        raise InputError(f"controller {name!r} has a D of shape {law.D.shape}; expected {expected}: forces, measured signals")
    return Designer(vehicle)._given(ControllerEntry(name, tuple(measured), law, hardware=hardware), law)


def design(vehicle: Vehicle, name: str) -> Controller:
    """One controller of a vehicle; `Designer` shares work between several."""
    return Designer(vehicle).design(name)
