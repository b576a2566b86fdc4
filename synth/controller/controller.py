"""Controller of a vehicle: its control law, and the certificate for the control problem (`synth.controller.problem`)."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeGuard

import numpy as np

from models.common.arrays import Array
from models.common.checks import CheckedFields, check_arguments
from models.common.errors import InputError, error_in, list_names
from models.common.extensions import FEATURES
from models.document.document import Document
from models.document.text import ShownResult, facts
from models.laws.law import ControlLaw
from models.laws.linear import LinearLaw
from models.vehicle.controllers import NOMINAL, ControllerEntry, DesignConditions
from models.vehicle.vehicle import Vehicle
from synth.analysis.certificate import Certificate
from synth.analysis.specification import ROBUST
from synth.controller.problem import Problem, problem
from synth.plant.generalized import Plant

if TYPE_CHECKING:
    from models.document.figure import Figure
    from models.laws.preview import RoadPreview
    from models.laws.python_law import PythonController
    from models.laws.semi_active import SemiActive
    from synth.analysis.lower_bounds.lower_bound import LowerBound
    from synth.analysis.specification import Specification


SUFFIX = "_designed"  # suffix in the name of a designed controller that is saved as a section of a vehicle file


@dataclass(frozen=True, eq=False, repr=False)
class Controller(ControlLaw, CheckedFields, ShownResult):
    """Linear controller of a vehicle, with its certificate and notes about its design.

    Attributes:
        name: name of the controller's section in the vehicle file.
        measured: names of the q measured signals y; empty for `passive`.
        law: control law from y to the m forces; a static law is u = K y.
        designed: True if Roadproof designed the controller; False if the user supplied the law, or if the law is zero (as for
            `passive`).
        steps: result of the two-step method that produced the gain; None for other controllers.
        redundant: names of measured signals that are linear combinations of other measured signals; their gains are zero.
        certificate: certificate of the closed loop.
        degeneracy: text that explains why problem (22) of the paper has no optimum, or why every gain is optimal; else empty.
        fallback_method: text with the name of the fallback method, and the reason why the two-step method found no gain; empty
            if no fallback was used.
        remarks: additional notes. If the two-step method did not design the law, the notes give the gap between its norm and
            the optimum, or its objective.
        false_claims: descriptions of the claims that the vehicle file makes about the controller and that do not hold.
        hardware: sensor noise, actuator lag and loads that the certificate takes into account.
        sampled: True if the controller was designed for the sampled-data loop. The certificate still describes the ideal loop.
        specifications: specifications of the design or of its evaluation, in addition to the H-infinity norm.
        preview: additional force, computed from the road ahead and added to the force of the law; None without preview.
        code: `ExportedCode` that computes the forces in simulations; None if the law itself computes them.
    """

    linear: ClassVar[Literal[True]] = True
    user_code: ClassVar[Literal[False]] = False

    name: str
    measured: tuple[str, ...]
    law: LinearLaw
    designed: bool
    certificate: Certificate
    steps: Any = None
    redundant: tuple[str, ...] = ()
    degeneracy: str = ""
    fallback_method: str = ""
    remarks: tuple[str, ...] = ()
    false_claims: tuple[str, ...] = ()
    hardware: DesignConditions = NOMINAL
    sampled: bool = False
    specifications: "tuple[Specification, ...]" = ()
    preview: "RoadPreview | None" = None
    code: Any = None

    @classmethod
    def of(cls, entry: ControllerEntry, law: LinearLaw, certificate: Certificate, **more: Any) -> "Controller":
        """Returns the designed controller for a section of a vehicle file; `more` contains additional attributes of the
        controller.
        """
        return cls(entry.name, entry.measured, law, True, certificate, hardware=entry.hardware, **more)

    @property
    def kind(self) -> str:
        """Type of the law as text, with an article."""
        return "a linear law"

    @property
    def summary(self) -> Document:
        """Document with the measured signals, the law and the certificate."""
        states = f"{self.law.states} state{'s' * (self.law.states > 1)}"
        law = states if self.law.states else self.text if self.measured else "no force"
        made, certificate = "designed" if self.designed else "given", self.certificate
        rows = {"measures": ", ".join(self.measured) or "nothing", "law": law, **certificate.claims}
        return facts(f"controller {self.name}: {made}, {certificate.summary.title}", rows)

    @property
    def figures(self) -> "tuple[Figure, ...]":
        """Plot of the closed-loop gain against frequency."""
        return self.certificate.figures

    @property
    def states(self) -> int:
        """Number of states of the law."""
        return self.law.states

    @property
    def acts(self) -> bool:
        """True if the law can produce a force; False if its force is zero for all measurements; see `ControlLaw`."""
        return self.law.acts

    @property
    def growth(self) -> float:
        """Growth rate of the fastest growing state of the law itself [1/s]; see `ControlLaw`."""
        return self.law.growth

    @property
    def has_anti_windup(self) -> bool:
        """True if the law has anti-windup; see `ControlLaw`."""
        return self.law.anti_windup is not None

    def preview_samples(self, period: float) -> int:
        """Returns the number of road heights per wheel that the law reads; see `ControlLaw`."""
        return 0 if self.preview is None else self.preview.samples(period)

    def state_scale(self, period: float) -> float:
        """Returns the factor that converts the states in a simulation to the states of the law; see `ControlLaw`."""
        return self.law.of_state(period)

    @property
    def record(self) -> dict[str, Any]:
        """Name, measured signals, law, preview and code as a JSON object."""
        more = {"preview": self.preview, "code": self.code}
        parts = {name: part.record for name, part in more.items() if part is not None}
        return {"name": self.name, "measured": list(self.measured), **self.law.record, **parts}

    @property
    def text(self) -> str:
        """One-line description of the law."""
        ahead = "" if self.preview is None else f", and the road {self.preview.seconds:g} s ahead"
        return f"{self.law.text}{ahead}" if self.measured else "no control force"

    @property
    def ahead(self) -> float:
        """Preview time of the road [s]; 0 without a preview."""
        return 0.0 if self.preview is None else self.preview.seconds

    @property
    def feedback(self) -> "Controller":
        """The same controller without the force that is computed from the road ahead; the poles and stability margins do not
        change.
        """
        return self if self.preview is None else replace(self, preview=None)

    @property
    def without_noise(self) -> "Controller":
        """The same controller without sensor noise in `hardware`.

        The norms of the sampled-data loop then describe only the effect of the road.
        """
        return replace(self, hardware=replace(self.hardware, noise=()))

    @property
    def gain(self) -> Array:
        """Feedthrough D_c of the law, or K of a static law, shape (m, q) [N per unit of the measurement]."""
        return self.law.D

    @property
    def robustness(self) -> "tuple[Specification, ...]":
        """Specifications for the frequency-weighted uncertainties in the controller's section of the vehicle file."""
        return tuple(promise for promise in self.specifications if promise.what in ROBUST)

    @property
    def unmet_specifications(self) -> tuple[str, ...]:
        """Descriptions of the specifications that do not hold, or are not proved."""
        return tuple(f"specification not met: {promise.text}" for promise in self.specifications if not promise.holds)

    @property
    def failures(self) -> tuple[str, ...]:
        """Descriptions of the claims and specifications of the controller that do not hold."""
        return (*self.certificate.failures, *self.unmet_specifications)

    @check_arguments
    def problem(self, vehicle: Vehicle) -> Problem:
        """Returns the control problem with which the controller is evaluated on a vehicle.

        Args:
            vehicle: vehicle with the measured signals of the controller.

        Returns:
            Plant, weights, measurements and hardware, as a `Problem`.

        Raises:
            InputError: the vehicle does not have the measured signals, or its number of forces differs from the number in the
                law.
        """
        check_fits(vehicle, self)
        return problem(vehicle, self.measured, self.hardware)

    def law_on_states(self, vehicle: Vehicle) -> LinearLaw:
        """Returns the law in continuous time, as a law on C_y x; forces that are part of the measurements are eliminated.

        Raises:
            InputError: the algebraic loop has no solution, or a discrete law has no continuous counterpart.
        """
        return self.law.continuous().fed_back(self.problem(vehicle).plant.Dyu[: len(self.measured)])

    def loop(self, vehicle: Vehicle) -> Plant:
        """Returns the closed loop (16)-(17) from w to z for a vehicle with the measured signals of the controller."""
        return self.problem(vehicle).judged(self.law).loop

    def state_gain(self, vehicle: Vehicle) -> Array:
        """Returns the state gain G = K C_y of a static controller, equation (6) of the paper, shape (m, n).

        Args:
            vehicle: vehicle with the measured signals of the controller.

        Raises:
            ValueError: the law has states. The method `loop` also accepts laws with states.
        """
        if self.law.states:
            raise ValueError(f"controller {self.name!r} has states and therefore no state gain; use loop(vehicle)")
        C, through = vehicle.linear_model.rows(self.measured)
        return self.law.continuous().fed_back(through).D @ C


if TYPE_CHECKING:
    AnyController = Controller | PythonController | SemiActive  # each of these types of controllers can control a vehicle
else:
    # this is the base class; the modules of the other classes are imported only where these classes are used
    AnyController = ControlLaw


def is_linear(controller: AnyController, vehicle: Vehicle) -> TypeGuard[Controller]:
    """Returns True if a simulation with the controller is linear until a limit is reached, because the law is linear and does
    not act on semi-active dampers.
    """
    return controller.linear is True and not (vehicle.dampers and controller.acts)


def check_fits(vehicle: Vehicle, *controllers: AnyController) -> None:
    """Checks that controllers fit a vehicle: the vehicle must have the signals that the controllers measure, and as many forces
    as the controllers compute.

    Raises:
        InputError: a law does not fit the vehicle. The error message contains the name of the controller.
    """
    outputs, forces = vehicle.linear_model.outputs, len(vehicle.linear_model.inputs)
    for one in controllers:
        strange = [signal for signal in one.measured if signal not in outputs]
        wrong = f"measures {strange[0]!r}" if strange else ""
        if one.linear is True and one.law.D.shape != (forces, len(one.measured)):
            wrong = wrong or f"has a law of shape {one.law.D.shape}"
        if wrong:
            raise InputError(
                f"controller {one.name!r} {wrong}, so this controller belongs to another vehicle; choose one for this "
                f"{vehicle.kind.name}, which has {forces} force(s) and the signals {list_names(outputs)}"
            )


def check_feedback_alone(controller: Controller, what: str) -> None:
    """Checks that a controller has no preview, because only the feedback of the controller can be represented.

    Args:
        controller: controller to check.
        what: text that states where the controller is used; the error message contains this text.

    Raises:
        InputError: the controller has a preview.
    """
    if controller.preview is not None:
        raise InputError(
            f"controller {controller.name!r} has a preview of the road, but {what} can contain only feedback of "
            "measured signals; choose a controller without preview"
        )


def verify_record(problem: Problem, entry: ControllerEntry) -> tuple[Certificate, tuple[str, ...]]:
    """Recomputes the certificate of a law from the proofs in the vehicle file.

    Args:
        problem: control problem with which the controller is evaluated.
        entry: section of the vehicle file with the law.

    Returns:
        The certificate, and descriptions of the claims that fail.

    Raises:
        InputError: the certificate is malformed, or the algebraic loop has no solution (`Controller.law_on_states`).
    """
    records = FEATURES.load("certificates as data")

    law, record = _law(entry), entry.certificate or {}
    with error_in(f"[controllers.{entry.name}]"):
        judged = problem.judged(law)
        of_law = len(judged.plant.A) - len(problem.plant.A)
        X, eta, lower_bound = records.read_proof(record, problem.plant, of_law)
        certificate = judged.certificate(X, eta, lower_bound)
    return certificate, (*certificate.failures, *records.false_claims(record, certificate))


def certify_law(problem: Problem, entry: ControllerEntry, lower_bound: "LowerBound") -> tuple[Certificate, tuple[str, ...]]:
    """Certifies a law with a lower bound that is already known.

    For the other arguments and the return values, see `verify_record`.

    Raises:
        InputError: the algebraic loop has no solution.
    """
    with error_in(f"[controllers.{entry.name}]"):
        certificate = problem.judged(_law(entry)).certificate(lower_bound=lower_bound)
    wrong: tuple[str, ...] = ()
    if entry.certificate is not None:
        try:
            _, wrong = verify_record(problem, entry)
        except InputError as error:
            wrong = (str(error),)
    return certificate, wrong


def _law(entry: ControllerEntry) -> LinearLaw:
    assert entry.law is not None, "it gives its law"
    return entry.law


def on_readings(law: LinearLaw, problem: Problem) -> LinearLaw:
    """Converts a law designed for C_y x to a law for the sensor signals, because measured accelerations also contain the effect
    of the control force.

    If the force is measured, its effect is subtracted from the measurements. If the force is not measured, the law is changed
    so that the closed loop remains the same. Integrals of measurements become states of the law.

    Args:
        law: law whose inputs are only those measured signals that depend on the state.
        problem: control problem for which the law was designed, with all q measured signals.

    Raises:
        InputError: the algebraic loop through the measurements has no solution.
    """
    through, others = problem.plant.Dyu, problem.state_measurements
    q = len(through)
    B, D = np.zeros((law.states, q)), np.zeros((len(law.D), q))
    B[:, others], D[:, others] = law.B, law.D
    unknown = np.zeros_like(through)
    unknown[others] = through[others]
    for i, force in problem.forces.items():
        of_force = through[others, force]
        B[:, i], D[:, i] = -law.B @ of_force, -law.D @ of_force
        unknown[:, force] = 0.0
    return problem.on_readings(LinearLaw(law.A, B, law.C, D, law.sample_period).fed_back(-unknown))
