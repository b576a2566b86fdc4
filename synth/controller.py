"""The one door through which a vehicle's named signals come in: from a vehicle and a controller's name to a certified law."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, quoted
from models.controllers import ControllerEntry
from models.filters.filter import Filter
from models.law import LinearLaw
from models.linear_model import LinearModel
from models.vehicle import Vehicle
from synth.certificate.certificate import Certificate, certify
from synth.certificate.lower_bound import LowerBound
from synth.certificate.record import false_claims, read_proof
from synth.dynamic.loop import on_larger_plant
from synth.dynamic.weights import System, append, gain, with_weights
from synth.plant import Feedback, GeneralizedPlant


@dataclass(frozen=True, eq=False)
class Controller:
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

    @property
    def gain(self) -> Array:
        """What acts at once: D_c, and K of a static controller, shape (m, q) [N per measured unit]."""
        return self.law.D

    def law_on_states(self, vehicle: Vehicle) -> LinearLaw:
        """The law in continuous time on C_y x: a force that is in what is measured is solved for.

        Raises:
            InputError: it cannot be, or a discrete law has no continuous counterpart.
        """
        return self.law.continuous().fed_back(vehicle.linear_model.rows(self.measured)[1])

    def loop(self, vehicle: Vehicle) -> GeneralizedPlant:
        """The closed loop (16)-(17) with a vehicle that has these signals, from w to z."""
        plant, G = on_larger_plant(
            generalized_plant(vehicle), measurements(vehicle, self.measured)[0], self.law_on_states(vehicle)
        )
        return plant.closed_loop(G)

    def state_gain(self, vehicle: Vehicle) -> Array:
        """G = K C_y (6) of a static controller, for a vehicle that has these signals, shape (m, n).

        Raises:
            ValueError: it has states; `loop` is of any.
        """
        if self.law.states:
            raise ValueError(f"controller {self.name!r} has states, so no state gain; use loop(vehicle)")
        return self.law_on_states(vehicle).D @ vehicle.linear_model.rows(self.measured)[0]


def checked(vehicle: Vehicle, plant: GeneralizedPlant, entry: ControllerEntry) -> tuple[Certificate, tuple[str, ...]]:
    """What is true of a law by the proofs that its certificate brings, and what of that does not hold, in words.

    Args:
        vehicle: whose it is.
        plant: of the vehicle.
        entry: it gives its law.

    Raises:
        InputError: the certificate is malformed, or the law has no loop (`Controller.law_on_states`).
    """
    law, record = _law(entry), entry.certificate or {}
    try:
        X, eta, lower_bound = read_proof(record, plant, measurements(vehicle, entry.measured)[0], law.states)
        certificate = certify(*_closed(vehicle, plant, entry), X, eta, lower_bound, by_itself=plant)
    except InputError as error:
        raise InputError(f"[controllers.{entry.name}] {error}") from error
    return certificate, (*certificate.failures, *false_claims(record, certificate))


def certified(
    vehicle: Vehicle, plant: GeneralizedPlant, entry: ControllerEntry, lower_bound: LowerBound
) -> tuple[Certificate, tuple[str, ...]]:
    """What is true of a law with no proof of its own, and what that beside it claims in vain; arguments as for `checked`.

    Raises:
        InputError: the law has no loop.
    """
    try:
        certificate = certify(*_closed(vehicle, plant, entry), lower_bound=lower_bound, by_itself=plant)
    except InputError as error:
        raise InputError(f"[controllers.{entry.name}] {error}") from error
    wrong: tuple[str, ...] = ()
    if entry.certificate is not None:
        try:
            _, wrong = checked(vehicle, plant, entry)
        except InputError as error:
            wrong = (str(error),)
    return certificate, wrong


def _law(entry: ControllerEntry) -> LinearLaw:
    assert entry.law is not None, "it gives its law"
    return entry.law


def _closed(vehicle: Vehicle, plant: GeneralizedPlant, entry: ControllerEntry) -> tuple[GeneralizedPlant, Feedback]:
    Cy, through = measurements(vehicle, entry.measured)
    return on_larger_plant(plant, Cy, _law(entry).continuous().fed_back(through))


def on_readings(law: LinearLaw, model: LinearModel, measured: Sequence[str]) -> LinearLaw:
    """A law that was designed on C_y x, on what sensors read, where accelerations have the force in them.

    Forces that are measured are taken out of the readings; for the others the law is changed, so that its loop is the same.

    Args:
        law: on those of the measured signals that are no forces.
        model: of the vehicle.
        measured: the q signals.

    Raises:
        InputError: the loop through the measurements has no solution.
    """
    through, forces = model.rows(measured)[1], model.inputs
    others = [i for i, name in enumerate(measured) if name not in forces]
    B, D = np.zeros((law.states, len(measured))), np.zeros((len(law.D), len(measured)))
    B[:, others], D[:, others] = law.B, law.D
    unknown = np.zeros_like(through)
    unknown[others] = through[others]
    for i, name in enumerate(measured):
        if name in forces:
            of_force = through[others, forces.index(name)]
            B[:, i], D[:, i] = -law.B @ of_force, -law.D @ of_force
            unknown[:, forces.index(name)] = 0.0
    return LinearLaw(law.A, B, law.C, D, law.sample_period).fed_back(-unknown)


def generalized_plant(vehicle: Vehicle) -> GeneralizedPlant:
    """The plant (15) of a vehicle: its linear model, and the weighted signals of `[performance]` as z (34)-(37).

    Where a weight, or the road's spectrum, depends on frequency, the states of its filters follow those of the vehicle.
    """
    model = vehicle.linear_model
    weighted = [signal for signal, weight in vehicle.performance.items() if weight > 0]
    C, D = model.rows(weighted)
    weights = np.array([vehicle.performance[signal] for signal in weighted])[:, None]
    Br, Cr = _twist(model, weighted)
    plant = GeneralizedPlant(
        A=model.A,
        B=model.B,
        Bw=np.hstack([model.Bw, Br]),
        C=weights * C,
        D=weights * D,
        Dw=np.hstack([np.zeros((len(C), model.Bw.shape[1])), weights * Cr]),
    )
    if not vehicle.filtered:
        return plant
    outputs = append(*(_system(vehicle.filters.get(signal)) for signal in weighted))
    return with_weights(plant, outputs, append(*[_system(vehicle.road_filter)] * plant.Bw.shape[1]))


def _system(one: Filter | None) -> System:
    return gain(1.0) if one is None else System(*one.realisation)


def plant_states(vehicle: Vehicle) -> tuple[str, ...]:
    """The names of the states of a vehicle's plant: the vehicle's own, and those of its filters, in their order."""
    signals = [signal for signal, weight in vehicle.performance.items() if weight > 0 and signal in vehicle.filters]
    counts = {f"filter_of_{signal}": len(vehicle.filters[signal].realisation.A) for signal in signals}
    if vehicle.road_filter is not None:
        model = vehicle.linear_model
        k = len(vehicle.road_filter.realisation.A)
        counts |= {f"filter_of_{road}": k for road in model.disturbances}
        counts |= {f"filter_of_road_twist_{i + 1}": k for i in range(_twist(model, ())[0].shape[1])}
    filters = [f"{name}_{i + 1}" for name, count in counts.items() for i in range(count)]
    return (*vehicle.linear_model.states, *filters)


def measurements(vehicle: Vehicle, signals: Sequence[str]) -> tuple[Array, Array]:
    """C_y on the states of a vehicle's plant, shape (q, n), and what the forces do at once to what is measured, shape (q, m).

    No state of a filter is measured: those are of what is asked for, not of the vehicle.

    Raises:
        InputError: a signal this vehicle has not.
    """
    Cy, through = vehicle.linear_model.rows(signals)
    more = len(plant_states(vehicle)) - Cy.shape[1] if vehicle.filtered else 0
    return (np.hstack([Cy, np.zeros((len(Cy), more))]) if more else Cy), through


def _twist(model: LinearModel, signals: Sequence[str]) -> tuple[Array, Array]:
    """What the road's heights do where they act as such, as disturbances of their own, shapes (n, k) and (len(signals), k).

    From the road's velocity a lasting twist is an integral, which no controller bounds. As a disturbance beside the velocities it
    is bounded, and counts at the rate of wheel hop (`LinearModel.twist_rate`): a bound that holds for both together.
    """
    Cr = model.Cr[[model.outputs.index(signal) for signal in signals]]
    _, sizes, directions = np.linalg.svd(np.vstack([model.Br, model.Cr]))
    directions = directions[: int(np.sum(sizes > 1e-12 * sizes.max(initial=0.0)))] if np.any(sizes) else directions[:0]
    return model.Br @ directions.T / model.twist_rate, Cr @ directions.T / model.twist_rate


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
