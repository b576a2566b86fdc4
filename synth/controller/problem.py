"""Control problem of a vehicle: its plant (15) and the measurements of a controller, defined by the names of signals.

The plant is the linear model of the vehicle, with the weighted signals of `[performance]` as z. The vehicle file's section of a
controller may add sensor noise and loads on the body, which are disturbances in addition to the road. The section may also add
actuator lag, whose states are added to the states of the vehicle.

If z contains the integral of a signal, this integral is a state of the plant. The integral counts as measured if its signals
are measured, because a law can integrate its measurements as the plant does. The first states of a law with such an integral
are also states of the plant, and the closed loop contains them only once (`integral_action.py`).

A law in a theoretical study may measure heights above the datum of a flat road (`measured_heights.py`).
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
from synth.plant.generalized import Feedback, Plant

if TYPE_CHECKING:
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
            return judged if self.of_heights is None else FEATURES.load("measured heights").loop_over_datum(self, judged)
        return FEATURES.load("integral action").loop_with_integrals(self, law)


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
                "tyre_damping adds the road's velocity to the measured unsprung_acceleration, but [performance] road "
                "cannot filter this velocity; omit the measurement, tyre_damping or [performance] road"
            )
    S = np.array([[terms.get(name, 0.0) for name in measured] for terms in integrated.values()]) if integrated else None
    of_heights = rates = None
    if np.any(model.Cr[rows]):
        more, by_twist, of_heights, rates = FEATURES.load("measured heights").effects_of_heights(vehicle, model, rows, plant)
        Cy, of_loads = Cy + more, of_loads + by_twist
    states = plant_states(vehicle, hardware.bandwidth)
    mine, weighed = (tuple(states.index(name) for name in some) for some in (integrated, vehicle.integrals))
    plant = replace(plant, Cy=Cy, Dyu=through, Dyw=of_loads)
    if any(hardware.noise):
        noisy = [i for i, rms in enumerate(hardware.noise) if rms]
        plant = plant.with_disturbances(np.eye(q, len(measured)) @ np.diag(hardware.noise)[:, noisy])
    return Problem(plant, forces, S, weighed, mine, states, of_heights, rates)


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
    if vehicle.integrals:
        FEATURES.load("filters in plants").check_integrals(vehicle, model)
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
    if not (vehicle.filtered or set(weighted) & set(model.heights)):
        return plant
    return FEATURES.load("filters in plants").with_filters(plant, vehicle, model, weighted, weights, len(loads))


def _design_model(vehicle: Vehicle, bandwidth: float | None) -> LinearModel:
    """Returns the linear model with actuator lag. The last states of the model are the integrals that z contains."""
    return vehicle.linear_model.behind_lag(bandwidth).with_integrals(vehicle.integrals)


def plant_states(vehicle: Vehicle, bandwidth: float | None = None) -> tuple[str, ...]:
    """Returns the names of the states of a vehicle's plant: the states of the vehicle, followed by the states of its filters."""
    model = _design_model(vehicle, bandwidth)
    return FEATURES.load("filters in plants").states_with_filters(vehicle, model) if vehicle.filtered else model.states


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
