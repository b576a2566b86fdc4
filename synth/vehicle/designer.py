"""Design of the controllers of a vehicle file: the name of a controller leads to a certified control law.

Several designs of one vehicle share intermediate results. The main class of this module is `Designer`.
"""

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
from models.laws.design_request import DesignRequest
from models.laws.linear import LinearLaw, static_law
from models.vehicle.controllers import NOMINAL, ControllerEntry, DesignConditions
from models.vehicle.vehicle import Vehicle
from synth.analysis.certificate import Certificate, LaterBound
from synth.controller.controller import AnyController, Controller, certify_law, verify_record
from synth.controller.problem import Problem, generalized_plant, plant_states, problem
from synth.design.methods import design as design_for
from synth.design.problem import DesignProblem, Progress, quiet
from synth.design.two_step import state_path
from synth.lmi.central_path import CentralPoint
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError
from synth.vehicle.design_problem import controller_of, design_problem

if TYPE_CHECKING:
    from synth.analysis.lower_bounds.lower_bound import LowerBound, SampledBound
    from synth.vehicle.refined import RefinedController


class SharedDesignData:
    """Plant, central path and bounds that all designs for a vehicle with the same actuators share.

    Plant, central path and bounds are computed when they are first used.

    Attributes:
        plant: plant without measurement noise.
        states: names of the states of the plant.
    """

    def __init__(self, vehicle: Vehicle, hardware: DesignConditions = NOMINAL) -> None:
        self.vehicle, self.hardware, bandwidth = vehicle, hardware, hardware.bandwidth
        self.plant, self.states = generalized_plant(vehicle, bandwidth, loads=hardware.loads), plant_states(vehicle, bandwidth)
        self._bounds: dict[tuple[tuple[str, ...], tuple[float, ...]], LowerBound] = {}

    @cached_property
    def state_path(self) -> list[CentralPoint]:
        """Central path of (22). Measurement noise has no effect on the central path, because the state is assumed to be known."""
        return state_path(self.plant, self.states)

    @cached_property
    def beyond_control(self) -> "LowerBound":
        """Lower bound on the norm from the invariant point, a frequency at which no control can change a direction of z. The
        lower bound holds for any measurements without noise.
        """
        return FEATURES.load("lower bounds").bound_beyond_control(self.plant)

    def problem(self, measured: Sequence[str], noise: tuple[float, ...] = ()) -> Problem:
        """Returns the control problem of a controller that measures the signals `measured` with the noise `noise`.

        Raises:
            InputError: the vehicle does not have one of the measured signals.
        """
        return problem(self.vehicle, measured, replace(self.hardware, noise=noise), self.plant)

    def lower_bound(self, measured: Sequence[str], noise: tuple[float, ...] = ()) -> "LowerBound":
        """Returns the lower bound on the norm for controllers of any order that measure the signals `measured` with the noise
        `noise`.

        If the controller has no measurements, the lower bound for state feedback is returned. If the controller measures
        heights above a datum, the lower bound for any measurements is returned.
        """
        key = tuple(measured), noise
        if self.vehicle.linear_model.over_datum(measured):
            return self.beyond_control
        if key not in self._bounds:
            plant = self.problem(*key).of_states
            everything = key[0] == self.states and not np.any(plant.Dyw)
            try:
                path = self.state_path
            except DesignError:  # a plant may be checked even if no design exists for it
                path = []
            self._bounds[key] = FEATURES.load("lower bounds").find_lower_bound(
                plant.unmeasured if everything else plant, None, path, self.beyond_control
            )
        return self._bounds[key]


class Designer:
    """Designs the controllers of one vehicle.

    All designs share the solution of the state-feedback problem (22), which is computed when it is first used.

    Args:
        vehicle: vehicle whose file defines the controllers.
        search: True to also compare gains from the vehicle file with the best controller of each vehicle, which requires
            additional designs (`verify_specifications`).

    Raises:
        InputError: an argument has the wrong type.
    """

    @check_arguments
    def __init__(self, vehicle: Vehicle, search: bool = True) -> None:
        self.vehicle, self.search = vehicle, search
        self._shared: dict[DesignConditions, SharedDesignData] = {NOMINAL: SharedDesignData(vehicle)}
        self._sampled_bounds: dict[tuple[tuple[str, ...], tuple[float, ...]], SampledBound | None] = {}
        # designer for the same vehicle with force actuators instead of semi-active dampers
        self._pushing: Designer | None = None

    def __repr__(self) -> str:
        """Returns text that states the type and the file of the vehicle."""
        return f"Designer of {self.vehicle.summary.title}"

    def shared(self, hardware: DesignConditions = NOMINAL) -> SharedDesignData:
        """Returns the data that all designs for the same actuators and loads share."""
        key = replace(hardware, noise=())
        if key not in self._shared:
            self._shared[key] = SharedDesignData(self.vehicle, key)
        return self._shared[key]

    @property
    def plant(self) -> Plant:
        """Plant without actuator lag and without measurement noise."""
        return self.shared().plant

    @property
    def state_path(self) -> list[CentralPoint]:
        """Central path of (22)."""
        return self.shared().state_path

    @property
    def state_feedback(self) -> CentralPoint:
        """State-feedback controller that is the optimum of problem (22)."""
        return self.state_path[-1]

    @property
    def beyond_control(self) -> "LowerBound":
        """Lower bound on the norm from the invariant point, a frequency at which no control can change a direction of z. The
        lower bound holds for any measurements.
        """
        return self.shared().beyond_control

    def problem(self, measured: Sequence[str], hardware: DesignConditions = NOMINAL) -> Problem:
        """Returns the control problem for which a controller with the measurements `measured` is designed and evaluated."""
        return self.shared(hardware).problem(measured, hardware.noise)

    def lower_bound(self, measured: Sequence[str], hardware: DesignConditions = NOMINAL) -> "LowerBound":
        """Returns the lower bound on the norm for controllers of any order with the measurements `measured`; without
        measurements, the bound for state feedback.
        """
        return self.shared(hardware).lower_bound(measured, hardware.noise)

    def _later_bound(self, entry: ControllerEntry) -> Any:
        return LaterBound(lambda: self.lower_bound(entry.measured, entry.hardware))

    def sampled_bound(self, controller: Controller) -> "SampledBound | None":
        """Returns a lower bound on the sampled-data norm for any controller with the same measurements as `controller`.

        The result is None if the controller was not designed for the sampled-data loop, or if no bound is proved.
        """
        return self._sampled_bound(self.entry(controller.name)) if controller.sampled else None

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
        """Returns a controller with its certificate. The controller is designed unless the vehicle file contains its control
        law.

        Args:
            name: name of a controller of the vehicle file, or `passive` or `state`.
            zero_l: True to use L = 0 instead of equation (14) in the two steps of an output-feedback design, as in remark 4 of
                the paper.
            on_progress: function that is called with the progress of the search if the controller is designed for goals.

        Returns:
            The controller, with its control law, certificate and notes.

        Raises:
            InputError: no controller has this name.
            DesignError: the controller could not be designed, or its certificate fails. A gain that the vehicle file contains
                is not changed by the design. If the two-step method fails, a numerical minimisation of the norm replaces this
                method; see `Controller.fallback_method`.
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
        """Adds to a controller the proved results for the frequency-weighted uncertainties that its section contains, if any."""
        errors = self.entry(controller.name).errors
        if errors is None:
            return controller

        return FEATURES.load("weighted errors").with_robustness(self.vehicle, controller, errors)

    def _design(self, name: str, zero_l: bool, on_progress: Progress) -> Controller:
        """Designs a controller, or certifies the control law that the vehicle file contains; see `design`."""
        entry = self.entry(name)
        if entry.law is not None:
            return self._given(entry, entry.law)
        if zero_l:
            FEATURES.load("combinations of options").check_command(f"controller {entry.name!r}", entry.parts, "zero_l")
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
        """Returns the design problem that a controller's section without goals defines.

        Args:
            entry: section of the vehicle file that defines the controller.
            plant_problem: plant and measurements with which the controller is evaluated.
            lower_bound: lower bound on the norm for any controller with the same measurements.
            method: name of the only design method to use. By default, all methods that suit the problem are used.
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
        """Certifies a known control law from measurements to forces, without changing the law.

        Args:
            name: name to give to the controller; any name is allowed.
            measured: names of the q measured signals.
            law: linear law from the q measurements to the m forces.
            hardware: sensor noise, actuator lag and loads that the certificate takes into account.

        Returns:
            Controller with the control law `law` and its certificate.

        Raises:
            InputError: the law has the wrong number of measurements or forces, or the algebraic loop of the law has no
                solution.
        """
        expected = len(self.vehicle.linear_model.inputs), len(measured)
        if law.D.shape != expected:
            raise InputError(
                f"controller {name!r} has a D of shape {law.D.shape}; expected {expected}: a row for each force, "
                "a column for each measured signal"
            )
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
        if wrong or entry.certificate:
            wrong = FEATURES.load("changes since a certificate").false_claims(self.vehicle, entry, controller, wrong)
        return replace(controller, false_claims=wrong)

    @check_arguments
    def refine(self, name: str, zero_l: bool = False) -> "RefinedController":
        """Lowers the norm of a controller, as long as the decrease justifies a larger gain, and returns the new controller.

        The method of refinement is explained in `synth.design.descent.refine`. If the two-step method finds no gain, the result
        is the best gain from several starting points.

        Args:
            name: name of a controller with a static gain.
            zero_l: True to use L = 0 instead of equation (14) in the two-step method.

        Raises:
            InputError: no controller has this name, or the controller has no gain to change, such as `passive`.
            DesignError: the gain does not stabilise the vehicle, or no starting point leads to a gain.
        """
        return FEATURES.load("refinement").refined_controller(self, name, zero_l)

    def worth_refining(self, controller: Controller) -> float:
        """Returns a cautious (low) estimate of the relative norm decrease that `refine` would achieve; 0 if the decrease is
        negligible.
        """
        refinement = FEATURES.load_if_known("refinement")
        return 0.0 if refinement is None else refinement.worth(self, controller)

    def checked(self, entry: ControllerEntry) -> tuple[Certificate, tuple[str, ...]]:
        """Recomputes the certificate of a control law in the vehicle file from the proofs in this file.

        The result contains the certificate, and a description of each claim in the file that is false.

        Raises:
            InputError: the certificate is malformed.
        """
        try:
            return verify_record(self.problem(entry.measured, entry.hardware), entry)
        except InputError as error:
            raise self.vehicle.located(error) from error

    def entry(self, name: str) -> ControllerEntry:
        """Returns the entry of a controller, selected by name: a controller in the vehicle file, `passive` or `state`."""
        name, model = unicodedata.normalize("NFC", str(name)), self.vehicle.linear_model
        if name == "passive":
            return ControllerEntry(name, (), static_law(np.zeros((len(model.inputs), 0))))
        if name == "state":
            return ControllerEntry(name, model.states, DesignRequest(sampled=self.vehicle.sampled))
        return self.vehicle.linear_entry(name)


def certify_given(
    vehicle: Vehicle, name: str, measured: Sequence[str], law: LinearLaw, hardware: DesignConditions = NOMINAL
) -> Controller:
    """Certifies a known law.

    To certify several laws of a vehicle, use `Designer.certify`, which computes shared results only once.
    """
    return Designer(vehicle).certify(name, measured, law, hardware)


def driver_of(vehicle: Vehicle, name: str) -> AnyController:
    """Returns a controller of any type whose control law the vehicle file contains."""
    return vehicle.driver(name, Designer(vehicle, search=False).design)


def design(vehicle: Vehicle, name: str) -> Controller:
    """Designs one controller of a vehicle.

    To design several controllers, use `Designer`, which computes shared results only once.
    """
    return Designer(vehicle).design(name)


def design_controllers(vehicle: Vehicle, names: str | Annotated[Sequence[str], AT_LEAST_ONE]) -> list[Controller]:
    """Designs or certifies controllers of a vehicle, which are selected by name. All designs share the solution of the
    state-feedback problem (22).

    Args:
        vehicle: vehicle whose file defines the controllers.
        names: names of controllers in the vehicle file, `passive` or `state`. A single controller's name may be given without a
            list.

    Returns:
        The controllers, in the order of the names, each with its control law and certificate.

    Raises:
        InputError: the name of a controller is unknown, or the list of names is empty.
        DesignError: a controller could not be designed or certified; the message gives the reason.

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
