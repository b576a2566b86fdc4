"""Filters of z and w in a vehicle's plant: frequency-dependent weights, integrals and the road filter of `[performance]`.

The states of the filters are the last states of the plant. The pole of a weight at 0 is a state of the vehicle's linear model
instead, see `LinearModel.with_integrals`.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, list_names
from models.kinds.linear_model import LinearModel
from models.laws.filter import Filter
from models.vehicle.vehicle import Vehicle
from synth.controller.problem import plant_states, road_twist_inputs
from synth.plant.augmented import append, gain, with_weights
from synth.plant.generalized import Plant
from synth.plant.state_space import StateSpace

SINGULAR = 1e-12  # a singular value of a balanced matrix counts as zero if its ratio to the largest one is smaller than this


def with_filters(
    plant: Plant, vehicle: Vehicle, model: LinearModel, weighted: Sequence[str], weights: Array, loads: int
) -> Plant:
    """Returns the plant of a vehicle with the filters of z and w.

    Args:
        plant: plant without filters.
        vehicle: vehicle of the plant.
        model: linear model of the plant, whose last states are the integrals that z contains.
        weighted: names of the signals in z.
        weights: matrix from these signals to z.
        loads: number of loads, which are the last disturbances and have no filter.

    Raises:
        InputError: z contains a height that has no norm.
    """
    over_datum = [signal for signal in weighted if signal in model.heights]
    if over_datum:
        _check_heights(vehicle, over_datum[0])
    outputs = append(*(_system(row.filter) for row in vehicle.weighted))
    roads = [_system(vehicle.road_filter)] * (plant.Bw.shape[1] - loads)
    disturbances = append(*roads, *[gain(1.0)] * loads)
    if not over_datum:
        return _with_integrals(with_weights(plant, outputs, disturbances), vehicle, model)
    # If w = F v with F(0) = 0, the transfer function F / s from v to the road height has the same states as F, with C A^-1
    # instead of C.
    of_height = np.array([model.Cr[model.outputs.index(signal)] * (signal in over_datum) for signal in weighted])
    states = len(disturbances.A) // len(roads)
    height = np.kron(np.eye(len(roads)), np.linalg.solve(roads[0].A.T, roads[0].C.T).T) if states else np.zeros((len(roads), 0))
    return _with_integrals(with_weights(plant, outputs, disturbances, weights @ of_height @ height), vehicle, model)


def states_with_filters(vehicle: Vehicle, model: LinearModel) -> tuple[str, ...]:
    """Returns the names of the states of a vehicle's plant with filters. For the model, see `with_filters`."""
    counts = {f"filter_of_{row.name}": len(row.filter.remainder.A) for row in vehicle.weighted if row.filter is not None}
    if vehicle.road_filter is not None:
        k = len(vehicle.road_filter.realisation.A)
        counts |= {f"filter_of_{road}": k for road in model.disturbances}
        counts |= {f"filter_of_road_twist_{i + 1}": k for i in range(len(road_twist_inputs(model)))}
    filters = [f"{name}_{i + 1}" for name, count in counts.items() for i in range(count)]
    return (*model.states, *filters)


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


def check_integrals(vehicle: Vehicle, model: LinearModel) -> None:
    """Raises an InputError if z contains the integral of a height, or of a signal that no constant force can change."""
    for name, terms in vehicle.integrals.items():
        what = f"[performance] weights the integral of {name.removeprefix('integral_of_')}"
        if heights := [signal for signal in terms if signal in model.heights]:
            raise InputError(
                f"{what}, but {heights[0]} is a height above a fixed datum. No law returns this height to zero, so its "
                "integral has no norm; weight a sum of deflections instead, because such a sum is a height above the road"
            )
        plain = vehicle.linear_model
        rows = np.array([terms.get(signal, 0.0) for signal in plain.outputs])
        pencil = np.block([[plain.A, plain.B], [(rows @ plain.C)[None], (rows @ plain.D)[None]]])
        balanced = pencil / np.maximum(np.abs(pencil).max(axis=1, keepdims=True), np.finfo(float).tiny)
        balanced = balanced / np.maximum(np.abs(balanced).max(axis=0, keepdims=True), np.finfo(float).tiny)
        if np.linalg.matrix_rank(balanced, SINGULAR) < np.linalg.matrix_rank(balanced[:-1], SINGULAR) + 1:
            raise InputError(
                f"{what}, but no constant force changes this signal. So the integral cannot return to zero, and has no "
                "norm; weight the integral of a suspension deflection, or use a filter without a pole at 0"
            )


def _check_heights(vehicle: Vehicle, signal: str) -> None:
    """Raises an InputError if z contains a height for which no norm exists, or which the warp of the road changes."""
    model, road = vehicle.linear_model, vehicle.road_filter
    if np.any(model.Br):
        raise InputError(
            f"[performance] {signal} is a height above a fixed datum. Such a height has no norm, because this "
            f"{vehicle.kind.name} responds to road warp; give this signal the weight 0"
        )
    if road is None or all(above[-1] for above, _ in road.sections):
        raise InputError(
            f"[performance] {signal} has no norm, because this height above a fixed datum can rise without bound with "
            "the road; give weight 0 to only log this signal, or give `road` a filter that is 0 at 0 rad/s"
        )


def _system(one: Filter | None) -> StateSpace:
    return gain(1.0) if one is None else StateSpace.of_law(one.remainder)


def filter_lines(vehicle: Vehicle) -> list[str]:
    """Returns notes about the filters in z and w, and about their poles."""
    texts = [f"{row.name} filtered by {row.filter.words}" for row in vehicle.weighted if row.filter is not None]
    texts += [f"w filtered by {vehicle.road_filter.words} to get the road's velocity"] if vehicle.road_filter is not None else []
    states = vehicle.road_filter is not None or any(name.startswith("filter_of_") for name in plant_states(vehicle))
    poles = "; the poles of these filters do not depend on control and are not listed" if states else ""
    lines = [f"norms include filters: {', '.join(texts)}{poles}"]
    if vehicle.integrals:
        names = list_names([name.removeprefix("integral_of_") for name in vehicle.integrals])
        lines.append(
            f"designs that measure {names} use the integral of each such signal as a state; norms of the sampled-data loop "
            "do not include integrals"
        )
    return lines
