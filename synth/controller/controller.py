"""A controller of a vehicle: its law, and its certificate for the problem it solves (`synth.controller.problem`)."""

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
    from synth.analysis.lower_bound import LowerBound
    from synth.analysis.specification import Specification


SUFFIX = "_designed"  # of the name of a design that becomes a section of a vehicle file


@dataclass(frozen=True, eq=False, repr=False)
class Controller(ControlLaw, CheckedFields, ShownResult):
    """A linear controller with its certificate and the notes of its design.

    Attributes:
        name: section of the vehicle file.
        measured: the q measured signals y. Empty for `passive`.
        law: the law from y to the m forces; a static one is u = K y.
        designed: True if it was designed here; otherwise the law was given (or is zero, for `passive`).
        steps: the `Design` in two steps that its gain is from; None for other laws.
        redundant: the signals among `measured` that follow from the others; their gain is zero.
        certificate: certificate of the closed loop.
        degeneracy: degeneracy of (22) (no optimum, or every gain optimal), in words, or empty.
        fallback_method: the fallback method and why the two steps found no gain, in words, or empty.
        remarks: notes in words: for designs other than by two steps, the distance from the optimum or what was optimised.
        false_claims: claims of the given certificate that do not hold, in words.
        hardware: sensor noise, actuator lag and loads that its certificate takes into account.
        sampled: True if it was designed for the sampled loop; its certificate is of the ideal one.
        specifications: specifications of its design or evaluation, in addition to the least norm.
        preview: force from the road ahead, in addition to that of its law; None without.
        code: the `ExportedCode` that computes its outputs in runs; None if its own law does.
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
        """Returns the designed controller of a section of the vehicle file; `more` are other attributes."""
        return cls(entry.name, entry.measured, law, True, certificate, hardware=entry.hardware, **more)

    @property
    def kind(self) -> str:
        """Kind of its law, in words, with an article."""
        return "a linear law"

    @property
    def summary(self) -> Document:
        """Measured signals, law and certificate."""
        states = f"{self.law.states} state{'s' * (self.law.states > 1)}"
        law = states if self.law.states else self.text if self.measured else "no force"
        made, certificate = "designed" if self.designed else "given", self.certificate
        rows = {"measures": ", ".join(self.measured) or "nothing", "law": law, **certificate.claims}
        return facts(f"controller {self.name}: {made}, {certificate.summary.title}", rows)

    @property
    def figures(self) -> "tuple[Figure, ...]":
        """The gain of the closed loop."""
        return self.certificate.figures

    @property
    def states(self) -> int:
        """Number of states of the law."""
        return self.law.states

    @property
    def acts(self) -> bool:
        """See `ControlLaw`."""
        return self.law.acts

    @property
    def growth(self) -> float:
        """See `ControlLaw`."""
        return self.law.growth

    @property
    def has_anti_windup(self) -> bool:
        """See `ControlLaw`."""
        return self.law.anti_windup is not None

    def preview_samples(self, period: float) -> int:
        """See `ControlLaw`."""
        return 0 if self.preview is None else self.preview.samples(period)

    def state_scale(self, period: float) -> float:
        """See `ControlLaw`."""
        return self.law.of_state(period)

    @property
    def record(self) -> dict[str, Any]:
        """Returns name, signals, law and code as a JSON object."""
        more = {"preview": self.preview, "code": self.code}
        parts = {name: part.record for name, part in more.items() if part is not None}
        return {"name": self.name, "measured": list(self.measured), **self.law.record, **parts}

    @property
    def text(self) -> str:
        """The law on one line."""
        ahead = "" if self.preview is None else f", and the road {self.preview.seconds:g} s ahead"
        return f"{self.law.text}{ahead}" if self.measured else "no control force"

    @property
    def ahead(self) -> float:
        """Time by which the road is known ahead [s]; 0 without a preview."""
        return 0.0 if self.preview is None else self.preview.seconds

    @property
    def feedback(self) -> "Controller":
        """The controller without its force from the road ahead; it has the same poles and margins."""
        return self if self.preview is None else replace(self, preview=None)

    @property
    def without_noise(self) -> "Controller":
        """The same controller, whose norms as implemented are of the road alone, without the noise of its sensors."""
        return replace(self, hardware=replace(self.hardware, noise=()))

    @property
    def gain(self) -> Array:
        """Feedthrough D_c, or K of a static controller, shape (m, q) [N per measured unit]."""
        return self.law.D

    @property
    def robustness(self) -> "tuple[Specification, ...]":
        """The specifications of errors that its section weights by frequency."""
        return tuple(promise for promise in self.specifications if promise.what in ROBUST)

    @property
    def unmet_specifications(self) -> tuple[str, ...]:
        """The specifications that are not kept, or not proved, in words."""
        return tuple(f"specification not kept: {promise.text}" for promise in self.specifications if not promise.holds)

    @property
    def failures(self) -> tuple[str, ...]:
        """The claims of its certificate and its specifications that do not hold, in words."""
        return (*self.certificate.failures, *self.unmet_specifications)

    @check_arguments
    def problem(self, vehicle: Vehicle) -> Problem:
        """Returns the problem that the controller is judged with, for a vehicle that has these signals.

        Raises:
            InputError: the vehicle has other signals or forces.
        """
        check_fits(vehicle, self)
        return problem(vehicle, self.measured, self.hardware)

    def law_on_states(self, vehicle: Vehicle) -> LinearLaw:
        """Returns the law in continuous time on C_y x, solved for forces that are part of the measurements.

        Raises:
            InputError: the loop has no solution, or a discrete law has no continuous counterpart.
        """
        return self.law.continuous().fed_back(self.problem(vehicle).plant.Dyu[: len(self.measured)])

    def loop(self, vehicle: Vehicle) -> Plant:
        """Returns the closed loop (16)-(17) with a vehicle that has these signals, from w to z."""
        return self.problem(vehicle).judged(self.law).loop

    def state_gain(self, vehicle: Vehicle) -> Array:
        """Returns G = K C_y (6) of a static controller, for a vehicle that has these signals, shape (m, n).

        Raises:
            ValueError: the law has states; `loop` accepts any law.
        """
        if self.law.states:
            raise ValueError(f"controller {self.name!r} has states and therefore no state gain; use loop(vehicle)")
        C, through = vehicle.linear_model.rows(self.measured)
        return self.law.continuous().fed_back(through).D @ C


if TYPE_CHECKING:
    AnyController = Controller | PythonController | SemiActive  # a controller that drives a vehicle
else:
    AnyController = ControlLaw  # its base, as the laws of the others are imported where they are used


def is_linear(controller: AnyController, vehicle: Vehicle) -> TypeGuard[Controller]:
    """Returns True if a run is linear until a limit is reached: its law is, and acts on no adjustable dampers."""
    return controller.linear is True and not (vehicle.dampers and controller.acts)


def check_fits(vehicle: Vehicle, *controllers: AnyController) -> None:
    """Refuses controllers of another vehicle: with signals or a number of forces that this one does not have.

    Raises:
        InputError: the law does not fit the vehicle; the message contains the controller's name.
    """
    outputs, forces = vehicle.linear_model.outputs, len(vehicle.linear_model.inputs)
    for one in controllers:
        strange = [signal for signal in one.measured if signal not in outputs]
        wrong = f"measures {strange[0]!r}" if strange else ""
        if one.linear is True and one.law.D.shape != (forces, len(one.measured)):
            wrong = wrong or f"has a law of shape {one.law.D.shape}"
        if wrong:
            raise InputError(
                f"controller {one.name!r} {wrong}, so it belongs to another vehicle; this {vehicle.kind.name} has {forces} "
                f"force(s) and the signals {list_names(outputs)}"
            )


def check_feedback_alone(controller: Controller, what: str) -> None:
    """Refuses a controller that answers the road ahead where only its feedback would be held.

    Args:
        what: holder of the controller, for the message.

    Raises:
        InputError: the controller has a preview.
    """
    if controller.preview is not None:
        raise InputError(
            f"controller {controller.name!r} has a preview of the road, but {what} contains only feedback of measured signals; "
            "choose a controller without preview"
        )


def verify_record(problem: Problem, entry: ControllerEntry) -> tuple[Certificate, tuple[str, ...]]:
    """Recomputes the certificate of a law from the given proofs. Returns it with the claims that fail, in words.

    Args:
        problem: the problem that it is judged with.
        entry: section of the vehicle file with its law.

    Raises:
        InputError: the certificate is malformed, or the law has no loop (`Controller.law_on_states`).
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
    """Certifies a law with a given lower bound. Returns the certificate and false claims; arguments as for `verify_record`.

    Raises:
        InputError: the law has no loop.
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
    """Returns a law designed on C_y x as a law on sensor readings, of which accelerations contain the force.

    Measured forces are subtracted from the readings; for others the law is changed, so that the loop stays the same. Integrals
    of readings become states of the law.

    Args:
        law: law from the measured signals that depend on the state.
        problem: the problem that it was designed for, with all q signals.

    Raises:
        InputError: the loop through the measurements has no solution.
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
