"""The design problem of a vehicle: its plant (15) and the measurements of a controller, from named signals.

The plant is the linear model with the weighted signals of `[performance]` as z. A controller may add the noise of its sensors and
loads on the body, which are disturbances beside the road, and its actuators' lag, whose states join the vehicle's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.kinds.linear_model import LinearModel
from models.laws.linear import LinearLaw
from models.vehicle.controllers import DesignConditions
from models.vehicle.vehicle import Vehicle
from synth.plant.augmented import System, append, gain, on_larger_plant, with_weights
from synth.plant.generalized import Feedback, GeneralizedPlant

if TYPE_CHECKING:
    from models.vehicle.filter import Filter


@dataclass(frozen=True, eq=False)
class Problem:
    """The plant and measurements that a controller is designed for and judged with: y = C_y x + `feedthrough` u + Dyw w.

    Attributes:
        plant: n states, m inputs, r disturbances, of which loads and then the measurement noises are the last.
        Cy: shape (q, n).
        feedthrough: feedthrough from the forces to the measurements, shape (q, m).
        Dyw: shape (q, r); None without noise and without loads in the measurements.
        forces: input by index of each measurement that is a force without lag, and so independent of the state.
    """

    plant: GeneralizedPlant
    Cy: Array
    feedthrough: Array
    Dyw: Array | None = None
    forces: Mapping[int, int] = field(default_factory=dict)

    @property
    def state_measurements(self) -> list[int]:
        """Indices of the measurements that are not in `forces`."""
        return [i for i in range(len(self.Cy)) if i not in self.forces]

    def select_rows(self, kept: Sequence[int]) -> tuple[Array, Array | None]:
        """Returns C_y and Dyw of some of the measurements."""
        return self.Cy[kept], self.Dyw[kept] if self.Dyw is not None else None

    def closed_loop(self, law: LinearLaw) -> tuple[GeneralizedPlant, Feedback]:
        """Returns the plant with a law's states, and the law as a gain on it; a discrete law by its Tustin counterpart.

        Raises:
            InputError: the loop through the measurements has no solution, or the law no counterpart.
        """
        return on_larger_plant(self.plant, self.Cy, law.continuous().fed_back(self.feedthrough), self.Dyw)


def problem(
    vehicle: Vehicle, measured: Sequence[str], hardware: DesignConditions, plant: GeneralizedPlant | None = None
) -> Problem:
    """Returns the problem that a controller with these measured signals is designed for and judged with.

    Args:
        measured: the q signals.
        hardware: sensor noise, actuator lag and loads.
        plant: `generalized_plant` for its actuators, if it is known already.

    Raises:
        InputError: a signal this vehicle has not.
    """
    plant = plant or generalized_plant(vehicle, hardware.bandwidth, loads=hardware.loads)
    Cy, through = measurements(vehicle, measured, hardware.bandwidth)
    inputs = vehicle.linear_model.inputs
    at_once = hardware.bandwidth is None
    forces = {i: inputs.index(name) for i, name in enumerate(measured) if at_once and name in inputs}
    (q, _), (d, r) = Cy.shape, plant.Dw.shape
    felt = _of_loads(vehicle.linear_model, hardware.loads)[1][[vehicle.linear_model.outputs.index(name) for name in measured]]
    of_loads = np.hstack([np.zeros((q, r - felt.shape[1])), felt])
    model = vehicle.linear_model
    if model.tyres_damp:
        of_loads[:, : model.Dw.shape[1]] = model.Dw[[model.outputs.index(name) for name in measured]]
        if vehicle.road_filter is not None and np.any(of_loads[:, : model.Dw.shape[1]]):
            raise InputError(
                "an unsprung_acceleration is measured, which jumps with the road's velocity by the damping of the tyre, and that "
                "velocity has a filter in [performance] road; leave one of the three out"
            )
    if not any(hardware.noise):
        return Problem(plant, Cy, through, of_loads if np.any(of_loads) else None, forces)
    noisy = [i for i, rms in enumerate(hardware.noise) if rms]
    k = len(noisy)
    Dyw = np.hstack([of_loads, np.diag(hardware.noise)[:, noisy]])
    wide = replace(plant, Bw=np.hstack([plant.Bw, np.zeros((len(plant.A), k))]), Dw=np.hstack([plant.Dw, np.zeros((d, k))]))
    return Problem(wide, Cy, through, Dyw, forces)


def _of_loads(model: LinearModel, loads: Sequence[tuple[str, float]]) -> tuple[Array, Array]:
    """Returns the effect of loads on states and outputs, scaled to the loads that count as 1 m/s of w, shapes (n, l), (p, l)."""
    some, scale = [model.loads.index(name) for name, _ in loads], np.array([value for _, value in loads])
    return model.Bl[:, some] * scale, model.Dl[:, some] * scale


def generalized_plant(
    vehicle: Vehicle, bandwidth: float | None = None, acting: bool = False, loads: Sequence[tuple[str, float]] = ()
) -> GeneralizedPlant:
    """Returns the plant (15) of a vehicle: its linear model, and the weighted signals of `[performance]` as z (34)-(37).

    The states of frequency-dependent weights and of the road filter follow those of the vehicle, of which the forces behind a lag
    are the last.

    Args:
        bandwidth: corner frequency of its actuators' lag [rad/s]; None for forces that act at once.
        acting: behind a lag, z weights the acting control force, as in the built system. Else it weights the requested force,
            which the controller decides.
        loads: on the body, each with the value that counts as 1 m/s of w; disturbances after those of the road.
    """
    model = vehicle.linear_model.behind_lag(bandwidth)
    weighted = [signal for signal, weight in vehicle.performance.items() if weight > 0]
    C, D = model.rows(weighted)
    if bandwidth is not None and not acting:
        of_force = np.array([[signal in model.inputs] for signal in weighted])
        C, D = np.where(of_force, 0.0, C), np.where(of_force, vehicle.linear_model.rows(weighted)[1], D)
    weights = np.array([vehicle.performance[signal] for signal in weighted])[:, None]
    Br, Cr = _twist(model, weighted)
    Bl, Dl = _of_loads(model, loads)
    Dl, Dw = (matrix[[model.outputs.index(signal) for signal in weighted]] for matrix in (Dl, model.Dw))
    plant = GeneralizedPlant(
        A=model.A,
        B=model.B,
        Bw=np.hstack([model.Bw, Br, Bl]),
        C=weights * C,
        D=weights * D,
        Dw=np.hstack([weights * Dw, weights * Cr, weights * Dl]),
    )
    over_datum = [signal for signal in weighted if signal in model.heights]
    if over_datum:
        _check_heights(vehicle, over_datum[0])
    if not vehicle.filtered:
        return plant
    outputs = append(*(_system(vehicle.filters.get(signal)) for signal in weighted))
    roads = [_system(vehicle.road_filter)] * (plant.Bw.shape[1] - len(loads))
    disturbances = append(*roads, *[gain(1.0)] * len(loads))
    if not over_datum:
        return with_weights(plant, outputs, disturbances)
    # Where w = F v with F(0) = 0, the road's height F v / s has the states of F, and C A^-1 in place of C.
    of_height = np.array([model.Cr[model.outputs.index(signal)] * (signal in over_datum) for signal in weighted])
    states = len(disturbances.A) // len(roads)
    height = np.kron(np.eye(len(roads)), np.linalg.solve(roads[0].A.T, roads[0].C.T).T) if states else np.zeros((len(roads), 0))
    return with_weights(plant, outputs, disturbances, weights * of_height @ height)


def _check_heights(vehicle: Vehicle, signal: str) -> None:
    """Refuses to weigh a height that no norm bounds, or that a twist of the road moves.

    Raises:
        InputError: see above.
    """
    model, road = vehicle.linear_model, vehicle.road_filter
    if np.any(model.Br):
        raise InputError(f"[performance] {signal} of a {vehicle.kind.name}, which feels the road's twist, has no norm; give 0")
    if road is None or all(above[-1] for above, _ in road.sections):
        raise InputError(
            f"[performance] {signal} is a height over the datum of a flat road, which a road of bounded velocity moves without "
            "bound: it has no norm; give 0 to have it in logs, or road = a filter that is 0 at 0 rad/s, whose height is bounded"
        )


def _system(one: "Filter | None") -> System:
    return gain(1.0) if one is None else System(*one.realisation)


def plant_states(vehicle: Vehicle, bandwidth: float | None = None) -> tuple[str, ...]:
    """Returns the names of the states of a vehicle's plant: the vehicle's own, then those of its filters.

    Args:
        bandwidth: as for `generalized_plant`.
    """
    model = vehicle.linear_model.behind_lag(bandwidth)
    signals = [signal for signal, weight in vehicle.performance.items() if weight > 0 and signal in vehicle.filters]
    counts = {f"filter_of_{signal}": len(vehicle.filters[signal].realisation.A) for signal in signals}
    if vehicle.road_filter is not None:
        k = len(vehicle.road_filter.realisation.A)
        counts |= {f"filter_of_{road}": k for road in model.disturbances}
        counts |= {f"filter_of_road_twist_{i + 1}": k for i in range(_twist(model, ())[0].shape[1])}
    filters = [f"{name}_{i + 1}" for name, count in counts.items() for i in range(count)]
    return (*model.states, *filters)


def measurements(vehicle: Vehicle, signals: Sequence[str], bandwidth: float | None = None) -> tuple[Array, Array]:
    """Returns C_y on the states of a vehicle's plant, shape (q, n), and the feedthrough of the forces, shape (q, m).

    Filter states are not measured: they belong to the weights, not to the vehicle.

    Args:
        signals: the q signals.
        bandwidth: as for `generalized_plant`; behind a lag the feedthrough is zero.

    Raises:
        InputError: a signal this vehicle has not.
    """
    Cy, through = vehicle.linear_model.behind_lag(bandwidth).rows(signals)
    more = len(plant_states(vehicle, bandwidth)) - Cy.shape[1] if vehicle.filtered else 0
    return (np.hstack([Cy, np.zeros((len(Cy), more))]) if more else Cy), through


def _twist(model: LinearModel, signals: Sequence[str]) -> tuple[Array, Array]:
    """Returns the effect of the road's twist as a disturbance of its own, shapes (n, k) and (len(signals), k).

    As an integral of the road's velocity a lasting twist is unbounded. As a disturbance beside the velocities it is bounded, and
    scaled by the rate of wheel hop (`LinearModel.twist_rate`): the bound holds for both together.
    """
    Cr = model.Cr[[model.outputs.index(signal) for signal in signals]]
    Cr = Cr * np.array([[signal not in model.heights] for signal in signals]).reshape(-1, 1)
    directions = road_twist_inputs(model)
    return model.Br @ directions.T / model.twist_rate, Cr @ directions.T / model.twist_rate


def road_twist_inputs(model: LinearModel) -> Array:
    """Returns the combinations of road heights under the wheels that act by their height, orthonormal, shape (k, r)."""
    by_road = [i for i, name in enumerate(model.outputs) if name not in model.heights]
    _, sizes, directions = np.linalg.svd(np.vstack([model.Br, model.Cr[by_road]]))
    return directions[: int(np.sum(sizes > 1e-12 * sizes.max(initial=0.0)))] if np.any(sizes) else directions[:0]
