"""Laws that measure heights above the datum of a flat road, for theoretical studies.

Measured heights contain the road height z_r, which then acts on the vehicle through the law:

    x' = A x + B w + E z_r,    z = C x + D w + F z_r,    z_r' = w,

The matrices in these equations describe the closed loop. With xi = x + A^-1 E z_r, the equations become xi' = A xi + (B + A^-1
E) w and z = C xi + D w + (F - C A^-1 E) z_r. A finite norm therefore exists if F = C A^-1 E, because a constant road height
then does not affect z. With F = C A^-1 E, the norm is computed from a loop without additional states. If the road filter is
zero at 0 rad/s, z_r is a linear combination of the filter states, and the law measures this combination.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from models.common.errors import list_names
from models.kinds.linear_model import LinearModel
from models.vehicle.vehicle import Vehicle
from synth.analysis.stability import beside_weights, is_stable
from synth.controller.controller import AnyController
from synth.controller.integral_action import RETURNS
from synth.controller.problem import ClosedLoop, Problem, road_twist_inputs
from synth.plant.generalized import Plant

STUDY = "for study only: no sensor on a car measures heights over the datum of a flat road"


def loop_over_datum(problem: Problem, judged: ClosedLoop) -> ClosedLoop:
    """Returns the closed loop of a law that measures heights above a datum. An unstable loop is returned unchanged."""
    assert problem.of_heights is not None, "a height is measured"
    assert problem.rates is not None, "they come with the heights"
    of_heights, plant, loop = problem.of_heights, judged.plant, judged.loop
    if not is_stable(beside_weights(problem.plant, loop.A)):
        return judged
    (n, r), (k, w) = (len(plant.A), plant.Bw.shape[1]), (of_heights.shape[1], problem.rates[1].shape[1])
    C, D = np.eye(len(problem.plant.A), n).T @ problem.rates[0].T, np.eye(w, r).T @ problem.rates[1].T
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


def effects_of_heights(
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


def study_notes(vehicle: Vehicle, controller: AnyController) -> list[str]:
    """Returns notes about a law for theoretical study: no car can measure the signals of this law, and a finite norm may not
    exist.
    """
    shows = controller.problem(vehicle).judged(controller.law).unbounded_outputs if controller.linear is True else ()
    names = list_names([vehicle.weighted[i].name for i in shows])
    return [STUDY, *[f"no finite norm: a constant road height causes a constant {names}"] * bool(shows)]
