"""Control problem of a vehicle: its plant (15) and the measurements of a controller, defined by the names of signals.

The plant is the linear model of the vehicle, with the weighted signals of `[performance]` as z. The vehicle file's section of a
controller may add sensor noise and loads on the body, which are disturbances in addition to the road. The section may also add
actuator lag, whose states are added to the states of the vehicle.

If z contains the integral of a signal, this integral is a state of the plant. The integral counts as measured if its signals
are measured, because a law can integrate its measurements as the plant does. The first states of a law with such an integral
are also states of the plant, and the closed loop contains them only once (`integral_action.py`).

A law in a theoretical study may measure heights above the datum of a flat road. Measured heights contain the road height z_r,
which then acts on the vehicle through the law:

    x' = A x + B w + E z_r,    z = C x + D w + F z_r,    z_r' = w,

The matrices in these equations describe the closed loop. With xi = x + A^-1 E z_r, the equations become xi' = A xi + (B + A^-1
E) w and z = C xi + D w + (F - C A^-1 E) z_r. A finite norm therefore exists if F = C A^-1 E, because a constant road height
then does not affect z. With F = C A^-1 E, the norm is computed from a loop without additional states. If the road filter is
zero at 0 rad/s, z_r is a linear combination of the filter states, and the law measures this combination.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.kinds.linear_model import LinearModel
from models.laws.linear import LinearLaw
from models.vehicle.controllers import DesignConditions
from models.vehicle.vehicle import Vehicle
from synth.analysis.certificate import Certificate, certify
from synth.analysis.norm import Norm
from synth.analysis.stability import beside_weights, is_stable
from synth.plant.augmented import append, gain, with_weights
from synth.plant.generalized import Feedback, Plant
from synth.plant.state_space import StateSpace

if TYPE_CHECKING:
    from models.laws.filter import Filter
    from synth.analysis.lower_bounds.lower_bound import LowerBound


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """Closed loop of a law, represented as a static gain on a larger plant.

    Attributes:
        plant: plant that includes the states of the law, except for those that the plant already contains.
        G: static gain on the plant with the states of the law.
        plant_without_law: plant without the states of the law.
        states: names of the states of the plant without the law.
        law_states: number of states of the law, which follow the states of the plant.
        with_road_heights: closed loop with the road heights as its last states, if a constant road height affects z. The loop
            with road heights has no finite norm. None otherwise.
        unbounded_outputs: indices of the entries of z that a constant road height affects.
    """

    plant: Plant
    G: Feedback
    plant_without_law: Plant
    states: tuple[str, ...]
    law_states: int
    with_road_heights: Plant | None = None
    unbounded_outputs: tuple[int, ...] = ()

    @property
    def loop(self) -> Plant:
        """Closed loop from w to z."""
        return self.with_road_heights or self.plant.closed_loop(self.G)

    def certificate(
        self, X: Array | None = None, eta: float | None = None, lower_bound: "LowerBound | None" = None
    ) -> Certificate:
        """Returns the certificate of the loop. For the arguments, see `certify`.

        If a constant road height affects z, the norm is infinite and no bound exists.
        """
        if self.with_road_heights is None:
            return certify(self.plant, self.G, X, eta, lower_bound, plant_without_law=self.plant_without_law)
        found = certify(self.plant, self.G, lower_bound=lower_bound, plant_without_law=self.plant_without_law)
        return replace(found, loop=self.with_road_heights, norm=Norm(np.inf, np.nan, np.inf, np.inf))


@dataclass(frozen=True, eq=False)
class Problem:
    """Plant and measurements for which a controller is designed and evaluated.

    Attributes:
        plant: plant with n states, m inputs, q measurements and r disturbances. The last disturbances are the loads, followed
            by the measurement noises.
        forces: measured forces without lag, which do not depend on the state; index of the measurement, and index of the
            measured force.
        integrated: factors with which the measurements enter each measured integral, shape (j, q - j). The measured integrals
            are the last j measurements. None if no integral is measured.
        integrals: indices of the states of the plant that are integrals.
        measured_integrals: indices of the plant states that are measured integrals, in the order of the rows of `integrated`.
        states: names of the states of the plant.
        of_heights: gain from the road heights to the measurements, shape (q, r), if the road heights are integrals of the
            disturbances. None if no height above a datum is measured, or if the road heights are states of the plant.
        rates: two matrices, from the plant's states and from its disturbances to the road velocities; None if `of_heights` is
            None.
    """

    plant: Plant
    forces: Mapping[int, int] = field(default_factory=dict)
    integrated: Array | None = None
    integrals: tuple[int, ...] = ()
    measured_integrals: tuple[int, ...] = ()
    states: tuple[str, ...] = ()
    of_heights: Array | None = None
    rates: tuple[Array, Array] | None = None

    @property
    def state_measurements(self) -> list[int]:
        """Indices of the measurements that depend on the state: all measurements except `forces`."""
        return [i for i in range(len(self.plant.Cy)) if i not in self.forces]

    @property
    def of_states(self) -> Plant:
        """Plant with only the measurements that depend on the state, C_y x + Dyw w. A design method computes a law for the
        plant with these measurements.
        """
        return self.plant.rows(self.state_measurements).without_feedthrough

    def closed_loop(self, law: LinearLaw) -> tuple[Plant, Feedback]:
        """Returns the plant with the states of a law, and the law as a static gain on this plant.

        A discrete law is represented by its continuous counterpart (Tustin's method).

        Raises:
            InputError: the algebraic loop has no solution, or a discrete law has no continuous counterpart.
        """
        judged = self.judged(law)
        return judged.plant, judged.G

    def on_readings(self, law: LinearLaw) -> LinearLaw:
        """Converts a law on measurements and measured integrals to a law on the measurements only.

        The integrals become the first states of the law.
        """
        if self.integrated is None:
            return law

        return FEATURES.load("integral action").with_integrators(law, self.integrated)

    def judged(self, law: LinearLaw) -> "ClosedLoop":
        """Returns the closed loop of a law on the measurements. The certificate of the law describes the closed loop that is
        returned.

        Raises:
            InputError: the algebraic loop has no solution, or a discrete law has no continuous counterpart.
        """
        law = law.continuous()
        if not self.integrals:
            larger, G = self.plant.with_law(law)
            judged = ClosedLoop(larger, G, self.plant, self.states, law.states)
            return judged if self.of_heights is None else self._over_datum(judged, self.of_heights)
        integral_action = FEATURES.load("integral action")
        kept = integral_action.integrators_of(law, self.integrated)
        mine = integral_action.on_integrals(law, self.integrated, kept)
        larger, G = self.plant.with_law(mine)
        lacking = [i for i in self.integrals if not any(self.measured_integrals[row] == i for row in kept)]
        rows = integral_action.settled_integrals(larger.closed_loop(G), self.plant, lacking) if lacking else None
        if rows is None:
            return ClosedLoop(larger, G, self.plant, self.states, mine.states)
        stay = np.setdiff1d(np.arange(len(larger.A)), lacking)
        own = np.setdiff1d(np.arange(len(self.plant.A)), lacking)
        C = larger.C[:, stay] + larger.C[:, lacking] @ rows
        short = replace(larger, A=larger.A[np.ix_(stay, stay)], B=larger.B[stay], Bw=larger.Bw[stay], C=C)
        p = self.plant.unmeasured
        base = replace(p, A=p.A[np.ix_(own, own)], B=p.B[own], Bw=p.Bw[own], C=p.C[:, own])
        return ClosedLoop(short, Feedback(G.K, G.Cy[:, stay]), base, tuple(self.states[i] for i in own), mine.states)

    def _over_datum(self, judged: ClosedLoop, of_heights: Array) -> ClosedLoop:
        """Returns the closed loop of a law that measures heights above a datum. An unstable loop is returned unchanged."""
        RETURNS = FEATURES.load("integral action").RETURNS
        assert self.rates is not None, "they come with the heights"
        plant, loop = judged.plant, judged.loop
        if not is_stable(beside_weights(self.plant, loop.A)):
            return judged
        (n, r), (k, w) = (len(plant.A), plant.Bw.shape[1]), (of_heights.shape[1], self.rates[1].shape[1])
        C, D = np.eye(len(self.plant.A), n).T @ self.rates[0].T, np.eye(w, r).T @ self.rates[1].T
        K = judged.G.K[:, : len(of_heights)]
        # If gains cancel, the rounding error of their sum is proportional to `terms`
        read, terms = K @ of_heights, np.abs(K) @ np.abs(of_heights)
        E, F = plant.B @ read, plant.D @ read
        inverse = np.linalg.inv(loop.A)
        shift = inverse @ E
        size = np.abs(plant.D) @ terms + np.abs(loop.C) @ np.abs(inverse) @ np.abs(plant.B) @ terms
        left = np.abs(F - loop.C @ shift)
        if np.all(left <= RETURNS * size):
            return replace(judged, plant=replace(plant, A=plant.A + shift @ C.T, Bw=plant.Bw + shift @ D.T))
        lasting = Plant.without_inputs(
            A=np.block([[loop.A, E], [C.T, np.zeros((k, k))]]),
            Bw=np.vstack([loop.Bw, D.T]),
            C=np.hstack([loop.C, F]),
            Dw=loop.Dw,
        )
        shows = np.flatnonzero(np.any(left > RETURNS * size, axis=1)).tolist()
        return replace(judged, with_road_heights=lasting, unbounded_outputs=tuple(shows))


def problem(vehicle: Vehicle, measured: Sequence[str], hardware: DesignConditions, plant: Plant | None = None) -> Problem:
    """Returns the control problem for which a controller with the given measured signals is designed and evaluated.

    Args:
        vehicle: vehicle of the controller.
        measured: names of the q measured signals.
        hardware: sensor noise, actuator lag and loads.
        plant: `generalized_plant` of the vehicle for the given hardware, if already computed.

    Raises:
        InputError: the vehicle does not have a measured signal.
    """
    plant = plant or generalized_plant(vehicle, hardware.bandwidth, loads=hardware.loads)
    integrated = measured_integrals(vehicle, measured)
    named = (*measured, *integrated)
    Cy, through = measurements(vehicle, named, hardware.bandwidth)
    inputs = vehicle.linear_model.inputs
    at_once = hardware.bandwidth is None
    forces = {i: inputs.index(name) for i, name in enumerate(measured) if at_once and name in inputs}
    q, r = len(Cy), plant.Dw.shape[1]
    model = vehicle.linear_model.with_integrals(vehicle.integrals)
    rows = [model.outputs.index(name) for name in named]
    felt = _of_loads(model, hardware.loads)[1][rows]
    of_loads = np.hstack([np.zeros((q, r - felt.shape[1])), felt])
    if model.tyres_damp:
        of_loads[:, : model.Dw.shape[1]] = model.Dw[rows]
        if vehicle.road_filter is not None and np.any(of_loads[:, : model.Dw.shape[1]]):
            raise InputError(
                "a measured unsprung_acceleration contains the road's velocity because of tyre_damping, so the "
                "filter [performance] road cannot apply to this velocity; omit the measurement, tyre_damping or the "
                "filter"
            )
    S = np.array([[terms.get(name, 0.0) for name in measured] for terms in integrated.values()]) if integrated else None
    of_heights = rates = None
    if np.any(model.Cr[rows]):
        more, by_twist, of_heights, rates = _heights_read(vehicle, model, rows, plant)
        Cy, of_loads = Cy + more, of_loads + by_twist
    states = plant_states(vehicle, hardware.bandwidth)
    mine, weighed = (tuple(states.index(name) for name in some) for some in (integrated, vehicle.integrals))
    plant = replace(plant, Cy=Cy, Dyu=through, Dyw=of_loads)
    if any(hardware.noise):
        noisy = [i for i, rms in enumerate(hardware.noise) if rms]
        plant = plant.with_disturbances(np.eye(q, len(measured)) @ np.diag(hardware.noise)[:, noisy])
    return Problem(plant, forces, S, weighed, mine, states, of_heights, rates)


def _heights_read(
    vehicle: Vehicle, model: LinearModel, rows: Sequence[int], plant: Plant
) -> tuple[Array, Array, Array | None, tuple[Array, Array]]:
    """Returns the contributions of measured heights to Cy and Dyw, and the attributes `of_heights` and `rates` of a `Problem`.

    The measured heights contain the warp of the road, which is a separate disturbance. The other part of the measured heights
    is the integral of the road velocities.
    """
    Cr, road, directions = model.Cr[rows], vehicle.road_filter, road_twist_inputs(model)
    by_twist, by_height, r = Cr @ directions.T / model.twist_rate, Cr - Cr @ directions.T @ directions, Cr.shape[1]
    (C, D), held = road_rates(vehicle, plant), np.zeros((r, len(plant.A)))
    if road is not None and not all(above[-1] for above, _ in road.sections):
        A = road.realisation.A
        states = slice(len(held[0]) - len(C) * len(A), len(held[0]) - (len(C) - r) * len(A))
        held[:, states] = C[:r, states] @ np.kron(np.eye(r), np.linalg.inv(A))
    integral = None if held.any() else by_height
    return by_height @ held + by_twist @ C[r:], by_twist @ D[r:], integral, (C[:r], D[:r])


def road_rates(vehicle: Vehicle, plant: Plant) -> tuple[Array, Array]:
    """Returns the matrices from a plant's states, and from its disturbances, to the road inputs.

    The rows are the road velocities, followed by the road warps.
    """
    model, road = vehicle.linear_model, vehicle.road_filter
    roads, n = len(model.disturbances) + len(road_twist_inputs(model)), len(plant.A)
    C, D = np.zeros((roads, n)), np.eye(roads, plant.Bw.shape[1])
    if road is None:
        return C, D
    of_filters = np.kron(np.eye(roads), road.realisation.C)
    C[:, n - of_filters.shape[1] :] = of_filters
    return C, D * road.realisation.D


def measured_integrals(vehicle: Vehicle, measured: Sequence[str]) -> dict[str, Mapping[str, float]]:
    """Returns, by name, the integrals in z whose signals are all measured, with the factor of each signal in the integral."""
    return {name: terms for name, terms in vehicle.integrals.items() if set(terms) <= set(measured)}


def _of_loads(model: LinearModel, loads: Sequence[tuple[str, float]]) -> tuple[Array, Array]:
    """Returns the effects of loads on states and outputs, shapes (n, l) and (p, l), scaled so that the specified value of each
    load counts as w = 1 m/s.
    """
    some, scale = [model.loads.index(name) for name, _ in loads], np.array([value for _, value in loads])
    return model.Bl[:, some] * scale, model.Dl[:, some] * scale


def generalized_plant(
    vehicle: Vehicle, bandwidth: float | None = None, acting: bool = False, loads: Sequence[tuple[str, float]] = ()
) -> Plant:
    """Returns the plant (15) of a vehicle: its linear model, with the weighted signals of `[performance]` as z, see (34)-(37).

    The states of the vehicle come first; the last of these states are the forces after actuator lag. The last states belong to
    frequency-dependent weights and to the road filter.

    Args:
        vehicle: vehicle of the plant.
        bandwidth: corner frequency of the actuator lag [rad/s]; None for forces without lag.
        acting: True if z contains the force after the lag, as in the sampled-data loop. Otherwise, z contains the force that
            the controller requests.
        loads: loads on the body; each load has a value that counts as w = 1 m/s. The loads are the last disturbances, after the
            road.
    """
    model, rows = _design_model(vehicle, bandwidth), vehicle.weighted
    _check_integrals(vehicle, model)
    weighted = list(dict.fromkeys(signal for row in rows for signal in row.terms))
    C, D = model.rows(weighted)
    if bandwidth is not None and not acting:
        of_force = np.array([[signal in model.inputs] for signal in weighted])
        C, D = np.where(of_force, 0.0, C), np.where(of_force, vehicle.linear_model.rows(weighted)[1], D)
    Br, Cr = _twist(model, weighted)
    Bl, Dl = _of_loads(model, loads)
    Dl, Dw = (matrix[[model.outputs.index(signal) for signal in weighted]] for matrix in (Dl, model.Dw))
    weights = np.array([[row.weight * row.terms.get(signal, 0.0) for signal in weighted] for row in rows])
    plant = Plant(
        A=model.A,
        B=model.B,
        Bw=np.hstack([model.Bw, Br, Bl]),
        C=weights @ C,
        D=weights @ D,
        Dw=np.hstack([weights @ Dw, weights @ Cr, weights @ Dl]),
    )
    over_datum = [signal for signal in weighted if signal in model.heights]
    if over_datum:
        _check_heights(vehicle, over_datum[0])
    if not vehicle.filtered:
        return plant
    outputs = append(*(_system(row.filter) for row in rows))
    roads = [_system(vehicle.road_filter)] * (plant.Bw.shape[1] - len(loads))
    disturbances = append(*roads, *[gain(1.0)] * len(loads))
    if not over_datum:
        return _with_integrals(with_weights(plant, outputs, disturbances), vehicle, model)
    # If w = F v with F(0) = 0, the transfer function F / s from v to the road height has the same states as F, with C A^-1
    # instead of C.
    of_height = np.array([model.Cr[model.outputs.index(signal)] * (signal in over_datum) for signal in weighted])
    states = len(disturbances.A) // len(roads)
    height = np.kron(np.eye(len(roads)), np.linalg.solve(roads[0].A.T, roads[0].C.T).T) if states else np.zeros((len(roads), 0))
    return _with_integrals(with_weights(plant, outputs, disturbances, weights @ of_height @ height), vehicle, model)


def _design_model(vehicle: Vehicle, bandwidth: float | None) -> LinearModel:
    """Returns the linear model with actuator lag. The last states of the model are the integrals that z contains."""
    return vehicle.linear_model.behind_lag(bandwidth).with_integrals(vehicle.integrals)


def _with_integrals(plant: Plant, vehicle: Vehicle, model: LinearModel) -> Plant:
    """Adds to z the integrals for which `[performance]` has a weight. The integrals are already states of the plant."""
    if not vehicle.integrals:
        return plant
    C = plant.C.copy()
    for i, row in enumerate(vehicle.weighted):
        if row.filter is not None and row.filter.residue:
            name = next(name for name, terms in vehicle.integrals.items() if terms == row.terms)
            C[i, model.states.index(name)] += row.weight * row.filter.residue
    return replace(plant, C=C)


def _check_integrals(vehicle: Vehicle, model: LinearModel) -> None:
    """Raises an InputError if z contains the integral of a height, or of a signal that no constant force can change."""
    for name, terms in vehicle.integrals.items():
        what = f"[performance] weights the integral of {name.removeprefix('integral_of_')}"
        if heights := [signal for signal in terms if signal in model.heights]:
            raise InputError(
                f"{what}, but {heights[0]} is a height above the datum of a flat road. No law returns this height to "
                "zero, so it has no norm; weight a sum of deflections instead, which is a height above the road"
            )
        plain = vehicle.linear_model
        rows = np.array([terms.get(signal, 0.0) for signal in plain.outputs])
        pencil = np.block([[plain.A, plain.B], [(rows @ plain.C)[None], (rows @ plain.D)[None]]])
        balanced = pencil / np.maximum(np.abs(pencil).max(axis=1, keepdims=True), np.finfo(float).tiny)
        balanced = balanced / np.maximum(np.abs(balanced).max(axis=0, keepdims=True), np.finfo(float).tiny)
        if np.linalg.matrix_rank(balanced, SINGULAR) < np.linalg.matrix_rank(balanced[:-1], SINGULAR) + 1:
            raise InputError(
                f"{what}, which no constant force changes. No law can return this integral to zero, so it has no "
                "norm; weight the integral of a suspension deflection, or use a filter without a pole at 0"
            )


SINGULAR = 1e-12  # a singular value of a balanced matrix counts as zero if its ratio to the largest one is smaller than this


def _check_heights(vehicle: Vehicle, signal: str) -> None:
    """Raises an InputError if z contains a height for which no norm exists, or which the warp of the road changes."""
    model, road = vehicle.linear_model, vehicle.road_filter
    if np.any(model.Br):
        raise InputError(
            f"[performance] {signal} has no norm, because this {vehicle.kind.name} responds to road warp; give this "
            "signal the weight 0"
        )
    if road is None or all(above[-1] for above, _ in road.sections):
        raise InputError(
            f"[performance] {signal} is a height above the datum of a flat road, which can rise without bound, so the "
            "signal has no norm; give weight 0 to only log it, or give `road` a filter that is 0 at 0 rad/s"
        )


def _system(one: "Filter | None") -> StateSpace:
    return gain(1.0) if one is None else StateSpace.of_law(one.remainder)


def plant_states(vehicle: Vehicle, bandwidth: float | None = None) -> tuple[str, ...]:
    """Returns the names of the states of a vehicle's plant: the states of the vehicle, followed by the states of its filters."""
    model = _design_model(vehicle, bandwidth)
    if not vehicle.filtered:
        return model.states
    counts = {f"filter_of_{row.name}": len(row.filter.remainder.A) for row in vehicle.weighted if row.filter is not None}
    if vehicle.road_filter is not None:
        k = len(vehicle.road_filter.realisation.A)
        counts |= {f"filter_of_{road}": k for road in model.disturbances}
        counts |= {f"filter_of_road_twist_{i + 1}": k for i in range(_twist(model, ())[0].shape[1])}
    filters = [f"{name}_{i + 1}" for name, count in counts.items() for i in range(count)]
    return (*model.states, *filters)


def measurements(vehicle: Vehicle, signals: Sequence[str], bandwidth: float | None = None) -> tuple[Array, Array]:
    """Returns the measurement matrix C_y of a vehicle's plant, shape (q, n), and the feedthrough of the forces, shape (q, m).

    Filter states are not measured, because they belong to the weights and not to the vehicle.

    Args:
        vehicle: vehicle of the plant.
        signals: names of the q measured signals, in the order of the rows of C_y.
        bandwidth: corner frequency of the actuator lag, as in `generalized_plant` [rad/s]. With actuator lag, the feedthrough
            is zero.

    Raises:
        InputError: the vehicle does not have a measured signal.
    """
    Cy, through = _design_model(vehicle, bandwidth).rows(signals)
    more = len(plant_states(vehicle, bandwidth)) - Cy.shape[1] if vehicle.filtered else 0
    return (np.hstack([Cy, np.zeros((len(Cy), more))]) if more else Cy), through


def _twist(model: LinearModel, signals: Sequence[str]) -> tuple[Array, Array]:
    """Returns the effects of the road's warp on the states and on signals, shapes (n, k) and (len(signals), k).

    If the warp were the integral of a road velocity, its effect could be unbounded, because a constant warp has a lasting
    effect on the vehicle. The warp is therefore a separate disturbance. The warp is scaled by the rate of wheel hop
    (`LinearModel.twist_rate`), so that a bound holds for warp and road velocities together.
    """
    Cr = model.Cr[[model.outputs.index(signal) for signal in signals]]
    Cr = Cr * np.array([[signal not in model.heights] for signal in signals]).reshape(-1, 1)
    directions = road_twist_inputs(model)
    return model.Br @ directions.T / model.twist_rate, Cr @ directions.T / model.twist_rate


def road_twist_inputs(model: LinearModel) -> Array:
    """Returns the road warps, which are the combinations of the road heights under r wheels that affect the vehicle even if
    they are constant.

    The k rows are orthonormal, shape (k, r).
    """
    by_road = [i for i, name in enumerate(model.outputs) if name not in model.heights]
    _, sizes, directions = np.linalg.svd(np.vstack([model.Br, model.Cr[by_road]]))
    return directions[: int(np.sum(sizes > 1e-12 * sizes.max(initial=0.0)))] if np.any(sizes) else directions[:0]
