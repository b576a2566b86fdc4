"""A controller of a vehicle: its law, and what is proved of it for the problem that it is for (`synth.controller.problem`)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, quoted
from models.common.printed import Shown
from models.laws.linear import LinearLaw
from models.vehicle.controllers import IDEAL, ControllerEntry, Hardware
from models.vehicle.vehicle import Vehicle
from synth.analysis.certificate import Certificate, certify
from synth.analysis.lower_bound import LowerBound
from synth.analysis.record import false_claims, read_proof
from synth.controller.problem import Problem, problem
from synth.plant.generalized import GeneralizedPlant

if TYPE_CHECKING:
    from synth.analysis.specification import Promise


class Law(Protocol):
    """From what is measured to forces."""

    @property
    def record(self) -> dict[str, Any]:
        """It as JSON and TOML hold it."""
        ...


class Driver(Protocol):
    """A controller that drives a vehicle: a linear `Controller`, a `Programmed` law in Python, or a `SemiActive` law.

    Attributes:
        kind: of its law, in words, with an article.
    """

    kind: ClassVar[str]

    @property
    def name(self) -> str:
        """As asked for."""
        ...

    @property
    def measured(self) -> tuple[str, ...]:
        """The signals y that it measures, q of them."""
        ...

    @property
    def law(self) -> Law:
        """Its law."""
        ...

    @property
    def states(self) -> int:
        """How many states its linear law has; 0 if it is not linear."""
        ...

    @property
    def record(self) -> dict[str, Any]:
        """Name, signals and law as JSON has them."""
        ...

    @property
    def text(self) -> str:
        """Its law on one line."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class Controller(Shown):
    """A linear controller with what is known of it.

    Attributes:
        name: as asked for.
        measured: the signals y, q of them. Empty for `passive`.
        law: from them to the m forces; a static one is u = K y.
        designed: whether it was designed here; otherwise the law was given (or is zero, for `passive`).
        state_step_gap: how far from the optimum of (22), relative in gamma, the X was taken that L (14) comes from: 0 at the
            limit of the central path, more where the second problem is infeasible from there.
        optimum_gap: how far from the optimum of its own problem, relative in gamma, the gain was taken: 0 at the limit, more
            where the optimum is reached only by gains beyond any actuator.
        moved: how far the gain still moved from the point of its path before, relative to its largest entry; a hundredth of it is
            about what is left to the limit.
        redundant: the signals among `measured` that follow from the others; their gain is zero.
        certificate: what is true of it.
        case: what is the case where (22) has no optimum, or every gain is one, in words; else empty.
        instead: how else the gain was found, and why the two steps did not lead to one, in words; empty where they did.
        remarks: of another design than by two steps, how near it came or what it is the best of, in words.
        false_claims: what of the certificate that came with its gain does not hold, in words.
        hardware: what of sensors and actuators its certificate knows.
        sampled: whether it was designed for the loop that the computer closes; its certificate is of the ideal one.
        promises: what it was designed for instead of the least norm, or is judged by beside it; empty where neither.
    """

    name: str
    measured: tuple[str, ...]
    law: LinearLaw
    designed: bool
    certificate: Certificate
    state_step_gap: float = 0.0
    optimum_gap: float = 0.0
    moved: float = 0.0
    redundant: tuple[str, ...] = ()
    case: str = ""
    instead: str = ""
    remarks: tuple[str, ...] = ()
    false_claims: tuple[str, ...] = ()
    hardware: Hardware = IDEAL
    sampled: bool = False
    promises: "tuple[Promise, ...]" = ()
    kind: ClassVar[str] = "a linear law"

    @property
    def shown(self) -> tuple[str, dict[str, str]]:
        """What it measures, its law, and what its certificate says."""
        title, proved = self.certificate.shown
        law = f"{self.law.states} states" if self.law.states else f"gain {self.gain.tolist()}" if self.measured else "no force"
        return f"controller {self.name}: {'designed' if self.designed else 'given'}, {title}", {
            "measures": ", ".join(self.measured) or "nothing",
            "law": law,
            **proved,
        }

    @property
    def states(self) -> int:
        """How many states its law has."""
        return self.law.states

    @property
    def record(self) -> dict[str, Any]:
        """Name, signals and law as JSON has them."""
        return {"name": self.name, "measured": list(self.measured), **self.law.record}

    @property
    def text(self) -> str:
        """Its law on one line."""
        return self.law.text if self.measured else "no control force"

    @property
    def gain(self) -> Array:
        """What acts at once: D_c, and K of a static controller, shape (m, q) [N per measured unit]."""
        return self.law.D

    @property
    def broken(self) -> tuple[str, ...]:
        """The promises that are not kept, or not proved to be, in words."""
        return tuple(f"not kept: {promise.text}" for promise in self.promises if not promise.holds)

    def problem(self, vehicle: Vehicle) -> Problem:
        """What it is judged with, of a vehicle that has these signals."""
        return problem(vehicle, self.measured, self.hardware)

    def law_on_states(self, vehicle: Vehicle) -> LinearLaw:
        """The law in continuous time on C_y x: a force that is in what is measured is solved for.

        Raises:
            InputError: it cannot be, or a discrete law has no continuous counterpart.
        """
        return self.law.continuous().fed_back(self.problem(vehicle).through)

    def loop(self, vehicle: Vehicle) -> GeneralizedPlant:
        """The closed loop (16)-(17) with a vehicle that has these signals, from w to z."""
        plant, G = self.problem(vehicle).closed(self.law)
        return plant.closed_loop(G)

    def state_gain(self, vehicle: Vehicle) -> Array:
        """G = K C_y (6) of a static controller, for a vehicle that has these signals, shape (m, n).

        Raises:
            ValueError: it has states; `loop` is of any.
        """
        if self.law.states:
            raise ValueError(f"controller {self.name!r} has states, so no state gain; use loop(vehicle)")
        C, through = vehicle.linear_model.rows(self.measured)
        return self.law.continuous().fed_back(through).D @ C


class InterruptedDesign(KeyboardInterrupt):
    """Ctrl-C, with a controller that is there all the same.

    Attributes:
        controller: certified.
        said: what of it is not as it would have been.
    """

    def __init__(self, controller: Controller, said: str) -> None:
        super().__init__()
        self.controller, self.said = controller, said


def checked(posed: Problem, entry: ControllerEntry) -> tuple[Certificate, tuple[str, ...]]:
    """What is true of a law by the proofs that its certificate brings, and what of that does not hold, in words.

    Args:
        posed: what it is judged with.
        entry: it gives its law.

    Raises:
        InputError: the certificate is malformed, or the law has no loop (`Controller.law_on_states`).
    """
    law, record = _law(entry), entry.certificate or {}
    try:
        X, eta, lower_bound = read_proof(record, posed.plant, posed.Cy, law.states, posed.Dyw)
        certificate = certify(*posed.closed(law), X, eta, lower_bound, by_itself=posed.plant)
    except InputError as error:
        raise InputError(f"[controllers.{entry.name}] {error}") from error
    return certificate, (*certificate.failures, *false_claims(record, certificate))


def certified(posed: Problem, entry: ControllerEntry, lower_bound: LowerBound) -> tuple[Certificate, tuple[str, ...]]:
    """What is true of a law with no proof of its own, and what that beside it claims in vain; arguments as for `checked`.

    Raises:
        InputError: the law has no loop.
    """
    try:
        certificate = certify(*posed.closed(_law(entry)), lower_bound=lower_bound, by_itself=posed.plant)
    except InputError as error:
        raise InputError(f"[controllers.{entry.name}] {error}") from error
    wrong: tuple[str, ...] = ()
    if entry.certificate is not None:
        try:
            _, wrong = checked(posed, entry)
        except InputError as error:
            wrong = (str(error),)
    return certificate, wrong


def _law(entry: ControllerEntry) -> LinearLaw:
    assert entry.law is not None, "it gives its law"
    return entry.law


def on_readings(law: LinearLaw, posed: Problem) -> LinearLaw:
    """A law that was designed on C_y x, on what sensors read, where accelerations have the force in them.

    Forces that are measured are taken out of the readings; for the others the law is changed, so that its loop is the same.

    Args:
        law: on those of the measured signals that say something of the state.
        posed: what it was designed for, with all q signals.

    Raises:
        InputError: the loop through the measurements has no solution.
    """
    through, others = posed.through, posed.of_state
    q = len(through)
    B, D = np.zeros((law.states, q)), np.zeros((len(law.D), q))
    B[:, others], D[:, others] = law.B, law.D
    unknown = np.zeros_like(through)
    unknown[others] = through[others]
    for i, force in posed.forces.items():
        of_force = through[others, force]
        B[:, i], D[:, i] = -law.B @ of_force, -law.D @ of_force
        unknown[:, force] = 0.0
    return LinearLaw(law.A, B, law.C, D, law.sample_period).fed_back(-unknown)


def alike(one: Vehicle, vehicles: Sequence[Vehicle]) -> list[Vehicle]:
    """Vehicles of the kind of one, checked.

    Raises:
        InputError: one is no vehicle, of another kind, or has a parameter or a weight that is missing, unknown or not allowed.
    """
    sound: list[Vehicle] = []
    for i, vehicle in enumerate(vehicles):
        if not isinstance(vehicle, Vehicle):
            raise InputError(f"vehicle {i} is {quoted(vehicle)}; expected a Vehicle, as `read_vehicle` reads one")
        if vehicle.kind.name != one.kind.name:
            raise InputError(f"vehicle {i} is a {vehicle.kind.name}; expected {one.kind.name}, as the vehicle that is redesigned")
        try:
            sound.append(vehicle.checked())
        except InputError as error:
            raise InputError(f"vehicle {i}: {error}") from error
    return sound
