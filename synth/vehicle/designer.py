"""The designs of a vehicle file: from a controller's name to a certified gain, and what those of one vehicle share."""

import contextlib
import unicodedata
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from models.common.checks import AT_LEAST_ONE, check_arguments
from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.laws.combinations import check_command, goes
from models.laws.design_request import DesignRequest
from models.laws.linear import LinearLaw, static_law
from models.vehicle.controllers import NOMINAL, ControllerEntry, DesignConditions
from models.vehicle.vehicle import Vehicle
from synth.analysis.certificate import Certificate, LaterBound
from synth.controller.controller import AnyController, Controller, certify_law, verify_record
from synth.controller.problem import Problem, generalized_plant, plant_states, problem
from synth.controller.report import false_norm, instability_cured_by_sampling, norm_if_implemented
from synth.design.methods import design as design_for
from synth.design.problem import DesignProblem, Progress, quiet
from synth.design.two_step import state_path
from synth.lmi.central_path import CentralPoint
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError
from synth.vehicle.design_problem import controller_of, design_problem

if TYPE_CHECKING:
    from synth.analysis.lower_bound import LowerBound, SampledBound
    from synth.vehicle.refined import RefinedController


NOT_REFINED = "but --refine changes static gains, which have no integral; omit --refine"


class SharedDesignData:
    """The plant, central path and bounds that designs for one vehicle and its actuators share, computed when first used.

    Attributes:
        plant: the plant, without noise.
        states: names of its states.
    """

    def __init__(self, vehicle: Vehicle, hardware: DesignConditions = NOMINAL) -> None:
        self.vehicle, self.hardware, bandwidth = vehicle, hardware, hardware.bandwidth
        self.plant, self.states = generalized_plant(vehicle, bandwidth, loads=hardware.loads), plant_states(vehicle, bandwidth)
        self._bounds: dict[tuple[tuple[str, ...], tuple[float, ...]], LowerBound] = {}

    @cached_property
    def state_path(self) -> list[CentralPoint]:
        """The central path of (22). Noise on what is measured is nothing to one who knows the state."""
        return state_path(self.plant, self.states)

    @cached_property
    def beyond_control(self) -> "LowerBound":
        """Lower bound from the invariant point, which holds for any measurements without noise."""
        return FEATURES.load("lower bounds").bound_beyond_control(self.plant)

    def problem(self, measured: Sequence[str], noise: tuple[float, ...] = ()) -> Problem:
        """Returns the design problem of a controller that measures these signals with that noise.

        Raises:
            InputError: a signal this vehicle has not.
        """
        return problem(self.vehicle, measured, replace(self.hardware, noise=noise), self.plant)

    def lower_bound(self, measured: Sequence[str], noise: tuple[float, ...] = ()) -> "LowerBound":
        """Returns the lower bound for controllers of any order with these signals and noise; without any, for state feedback.

        For heights over the datum, it is the bound of any measurements.
        """
        key = tuple(measured), noise
        if self.vehicle.linear_model.over_datum(measured):
            return self.beyond_control
        if key not in self._bounds:
            plant = self.problem(*key).of_states
            everything = key[0] == self.states and not np.any(plant.Dyw)
            try:
                path = self.state_path
            except DesignError:  # what cannot be designed may be checked
                path = []
            self._bounds[key] = FEATURES.load("lower bounds").find_lower_bound(
                plant.unmeasured if everything else plant, None, path, self.beyond_control
            )
        return self._bounds[key]


class Designer:
    """Designs the controllers of one vehicle. The state-feedback step (22) is shared by them all, and done when first needed.

    With `search` given gains are compared with each vehicle's own best, too, which takes designs (`verify_specifications`).
    """

    @check_arguments
    def __init__(self, vehicle: Vehicle, search: bool = True) -> None:
        self.vehicle, self.search = vehicle, search
        self._shared: dict[DesignConditions, SharedDesignData] = {NOMINAL: SharedDesignData(vehicle)}
        self._sampled_bounds: dict[tuple[tuple[str, ...], tuple[float, ...]], SampledBound | None] = {}
        self._pushing: Designer | None = None  # of the vehicle with actuators that push, where it has adjustable dampers

    def __repr__(self) -> str:
        """Returns the kind and the file of its vehicle."""
        return f"Designer of {self.vehicle.summary.title}"

    def shared(self, hardware: DesignConditions = NOMINAL) -> SharedDesignData:
        """Returns the data that designs for these actuators and loads share."""
        key = replace(hardware, noise=())
        if key not in self._shared:
            self._shared[key] = SharedDesignData(self.vehicle, key)
        return self._shared[key]

    @property
    def plant(self) -> Plant:
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
    def beyond_control(self) -> "LowerBound":
        """Lower bound from the invariant point, which holds for any measurements."""
        return self.shared().beyond_control

    def problem(self, measured: Sequence[str], hardware: DesignConditions = NOMINAL) -> Problem:
        """Returns the problem that a controller with these measured signals is designed for and judged with."""
        return self.shared(hardware).problem(measured, hardware.noise)

    def lower_bound(self, measured: Sequence[str], hardware: DesignConditions = NOMINAL) -> "LowerBound":
        """Returns the lower bound for controllers of any order with these signals; without signals, for full state feedback."""
        return self.shared(hardware).lower_bound(measured, hardware.noise)

    def _later_bound(self, entry: ControllerEntry) -> Any:
        return LaterBound(lambda: self.lower_bound(entry.measured, entry.hardware))

    def sampled_bound(self, controller: Controller) -> "SampledBound | None":
        """Returns the lower bound of the sampled loop, for any controller with the measurements of one designed for it.

        None for other controllers, or if none is proved.
        """
        return self._sampled_bound(self._entry(controller.name)) if controller.sampled else None

    def _sampled_bound(self, entry: ControllerEntry) -> "SampledBound | None":
        key = entry.measured, entry.hardware.noise
        if key not in self._sampled_bounds:
            near = self.lower_bound(entry.measured, entry.hardware).gamma or 1.0
            self._sampled_bounds[key] = FEATURES.load("bounds of sampled loops").find_sampled_bound(
                FEATURES.load("norm as implemented").held_problem(self.vehicle, entry), near
            )
        return self._sampled_bounds[key]

    @check_arguments
    def design(self, name: str, zero_l: bool = False, on_progress: Progress = quiet) -> Controller:
        """The controller of that name: `passive`, `state`, or one of the vehicle file, designed unless the file gives its gain.

        Args:
            zero_l: L = 0 instead of (14), as in remark 4; for a controller that is designed from measurements.
            on_progress: callback that receives the progress of a design for goals.

        Raises:
            InputError: no controller has that name.
            DesignError: the controller could not be designed, or its certificate fails. A gain from the file is reported
                unchanged. If the two steps fail, descent on the norm continues; see `Controller.fallback_method`.
        """
        if (own := self.vehicle.with_actuators_of(name)) is not self.vehicle:
            self._pushing = self._pushing or Designer(own, self.search)
            return self._pushing.design(name, zero_l, on_progress)
        try:
            return self.judged(self._design(name, zero_l, on_progress))
        except InputError as error:
            if f"{name!r}" in str(error) or f".{name}]" in str(error):
                raise
            raise type(error)(f"controller {name!r}: {error}") from error

    def judged(self, controller: Controller) -> Controller:
        """Returns a controller with what is proved of it for the errors that its section weights by frequency, if any."""
        errors = self._entry(controller.name).errors
        if errors is None:
            return controller

        return FEATURES.load("weighted errors").with_robustness(self.vehicle, controller, errors)

    def _design(self, name: str, zero_l: bool, on_progress: Progress) -> Controller:
        """Designs a controller, or certifies a given one; see `design`."""
        entry = self._entry(name)
        if entry.law is not None:
            return self._given(entry, entry.law)
        if zero_l:
            check_command(f"controller {entry.name!r}", entry.parts, "zero_l")
        plant_problem = self.problem(entry.measured, entry.hardware)
        try:
            lower_bound = self._later_bound(entry)
            if entry.goals is not None:
                return FEATURES.load("goals").goals_design(
                    self.vehicle, entry, entry.goals, plant_problem, lower_bound, on_progress
                )
            problem = self.design_problem(entry, plant_problem, lower_bound, "zero_l" if zero_l else "")
            return controller_of(self.vehicle, entry, plant_problem, problem, design_for(problem, on_progress))
        except DesignError as error:
            raise type(error)(f"controller {name!r}: {error}") from error

    def design_problem(
        self, entry: ControllerEntry, plant_problem: Problem, lower_bound: "LowerBound", method: str = ""
    ) -> DesignProblem:
        """Returns the design problem of a section without goals.

        Args:
            plant_problem: plant and measurements that the controller is judged with.
            lower_bound: lower bound for any controller from these measurements.
            method: the only method to use; by default those that the problem leads to.
        """
        problem, shared = design_problem(self.vehicle, entry, plant_problem, lower_bound), self.shared(entry.hardware)
        if entry.request.two_steps:
            problem = replace(problem, path=lambda: shared.state_path)
        if entry.request.sampled and not entry.request.two_steps:
            return replace(problem, sampled_bound=self._sampled_bound(entry))
        if entry.request.sampled:
            continuous = replace(entry, source=replace(entry.request, sampled=False))
            ideal = self.design_problem(continuous, plant_problem, lower_bound)
            with contextlib.suppress(DesignError):
                law = controller_of(self.vehicle, continuous, plant_problem, ideal, design_for(ideal)).law
                problem = replace(problem, known=(law,))
            return problem
        if method == "zero_l":
            return replace(problem, plant=plant_problem.plant, method=method)
        if entry.name == "state" and len(plant_problem.plant.Cy) == len(plant_problem.plant.A):
            return replace(problem, plant=self.plant.measured(np.eye(len(self.plant.A))), method="state")
        return problem

    @check_arguments
    def certify(self, name: str, measured: Sequence[str], law: LinearLaw, hardware: DesignConditions = NOMINAL) -> Controller:
        """Certifies a known law from measurements to forces under any name, unchanged.

        Raises:
            InputError: the gain has another number of signals or forces, or there is no loop.
        """
        expected = len(self.vehicle.linear_model.inputs), len(measured)
        if law.D.shape != expected:
            raise InputError(f"controller {name!r} has a D of shape {law.D.shape}; expected {expected}: forces, measured signals")
        return self._given(ControllerEntry(name, tuple(measured), law, hardware=hardware), law)

    def _given(self, entry: ControllerEntry, law: LinearLaw) -> Controller:
        problem, hardware = self.problem(entry.measured, entry.hardware), entry.hardware
        try:
            certificate, wrong = certify_law(problem, entry, self._later_bound(entry))
        except InputError as error:
            raise self.vehicle.located(error) from error
        controller = Controller(entry.name, entry.measured, law, False, certificate, hardware=hardware)
        if entry.goals is not None:
            controller = replace(
                controller,
                specifications=FEATURES.load("goals").verify_specifications(self.vehicle, entry, entry.goals, law, self.search),
            )
        if entry.certificate:
            wrong += FEATURES.load("norm as implemented").false_sampled_bound(self.vehicle, entry)
        wrong += false_norm(entry.certificate, self.vehicle, lambda: norm_if_implemented(self.vehicle, controller))
        if wrong and not certificate.stable:  # sampling may cure it
            cured = instability_cured_by_sampling(self.vehicle, certificate, norm_if_implemented(self.vehicle, controller))
            wrong = tuple(each for each in wrong if each not in cured)
        if wrong:
            wrong = (
                (changed,)
                if (changed := FEATURES.load("changes since a certificate").changed_since(self.vehicle, entry))
                else wrong
            )
        return replace(controller, false_claims=wrong)

    @check_arguments
    def refine(self, name: str, zero_l: bool = False) -> "RefinedController":
        """The controller of that name with a lower norm, as far as it is worth a larger gain (`synth.design.descent.refine`).

        Where the two steps find no gain, it is the best that any start leads to.

        Raises:
            InputError: no controller has that name, or it has no gain to change, as `passive`.
            DesignError: the gain does not stabilise the vehicle, or no start leads to a gain.
        """

        entry = self._entry(name)
        measured = entry.measured
        if not measured:
            raise InputError(f"controller {name!r} measures nothing, so it has no gain to refine; give another controller")
        check_command(f"controller {entry.name!r}", entry.parts, "refine", DesignError)
        if self.vehicle.integrals:
            raise DesignError(f"controller {entry.name!r}: [performance] weights an integral, {NOT_REFINED}")
        try:
            start = self.design(name, zero_l)
        except DesignError:
            start = None
        problem, lower_bound = self.problem(measured, entry.hardware), self.lower_bound(measured, entry.hardware)
        if entry.request.sampled and start is None:
            self.design(name)  # raises the reason
        return FEATURES.load("refinement").refine_controller(self.vehicle, entry, problem, start, lower_bound)

    def worth_refining(self, controller: Controller) -> float:
        """Returns the relative decrease of a designed controller's norm that `refine` reaches at least; 0 below seven digits."""
        if (
            not controller.designed
            or controller.sampled  # whose design is refined
            or not controller.measured
            or not goes("refine", self._entry(controller.name).parts)
            or self.vehicle.integrals
            or not controller.certificate.stable
        ):
            return 0.0

        return FEATURES.load("refinement").worth(self.vehicle, controller, self.problem(controller.measured, controller.hardware))

    def checked(self, entry: ControllerEntry) -> tuple[Certificate, tuple[str, ...]]:
        """Recomputes the certificate of a law of the file from its proofs. Returns it with the claims that fail, in words.

        Raises:
            InputError: the certificate is malformed.
        """
        try:
            return verify_record(self.problem(entry.measured, entry.hardware), entry)
        except InputError as error:
            raise self.vehicle.located(error) from error

    def _entry(self, name: str) -> ControllerEntry:
        """Returns the entry to be designed or certified under a name."""
        name, model = unicodedata.normalize("NFC", str(name)), self.vehicle.linear_model
        if name == "passive":
            return ControllerEntry(name, (), static_law(np.zeros((len(model.inputs), 0))))
        if name == "state":
            return ControllerEntry(name, model.states, DesignRequest(sampled=self.vehicle.sampled))
        return self.vehicle.linear_entry(name)


def certify_given(
    vehicle: Vehicle, name: str, measured: Sequence[str], law: LinearLaw, hardware: DesignConditions = NOMINAL
) -> Controller:
    """Certifies a known law; `Designer.certify` shares work between several."""
    return Designer(vehicle).certify(name, measured, law, hardware)


def driver_of(vehicle: Vehicle, name: str) -> AnyController:
    """Returns a controller of any kind, whose law the vehicle file gives."""
    return vehicle.driver(name, Designer(vehicle, search=False).design)


def design(vehicle: Vehicle, name: str) -> Controller:
    """Designs one controller of a vehicle; `Designer` shares work between several."""
    return Designer(vehicle).design(name)


def design_controllers(vehicle: Vehicle, names: str | Annotated[Sequence[str], AT_LEAST_ONE]) -> list[Controller]:
    """Returns controllers of a vehicle by name, each with its certificate. They share the state-feedback step (22).

    Args:
        vehicle: vehicle whose file defines the controllers.
        names: names of controllers of the file, `passive` or `state`; a single name gives a list of one.

    Raises:
        InputError: a name is unknown, or none is given.
        DesignError: no such controller exists, or none could be proved; the message gives the reason.

    Example:
        >>> from models import read_vehicle
        >>> from synth import design_controllers
        >>> passive, controller = design_controllers(read_vehicle("quarter_car"), ["passive", "I"])
        >>> controller.measured, controller.gain.shape
        (('suspension_deflection', 'sprung_velocity'), (1, 2))
        >>> f"norm {controller.certificate.norm.value:.6f}, proved to be at most {controller.certificate.bound:.3f}"
        'norm 7.843188, proved to be at most 7.871'
    """
    designer = Designer(vehicle)
    return [designer.design(name) for name in ([names] if isinstance(names, str) else names)]
