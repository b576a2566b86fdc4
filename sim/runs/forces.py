"""Histories of forces that are attached to a log: loads on the body, and forces that a Python control law requested."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.kinds.signals import Signal, load_signal
from models.roads.loads.load import Load
from models.roads.loads.road_with_loads import RoadWithLoads
from models.roads.road import Road
from models.vehicle.vehicle import Vehicle
from sim.drive.response import Response


def load_histories(vehicle: Vehicle, road: Road, time: Array) -> Response | None:
    """Returns the external loads over time: the sum in each direction and, if there are several loads, each load;

    None if there are no loads.

    The loads are constant during each step, at their value midway through the step, as in the simulation.
    """
    if not isinstance(road, RoadWithLoads):
        return None
    midway = time + (time[1] - time[0]) / 2
    acting = [load.at(midway, vehicle.parameters, vehicle.kind) for load in road.on_body]
    ways = {load.name: load_signal(load.name) for load in vehicle.kind.loads if any(load.name in one for one in acting)}
    together, alone, signals = {name: np.zeros(len(time)) for name in ways}, [], []
    for load, called, force in zip(road.on_body, _load_names(road.on_body), acting, strict=True):
        for name, one in force.items():
            together[name] = together[name] + one
            meaning = f"{ways[name].meaning}: of {load.label}"
            signals.append(replace(ways[name], name=f"{called}_{name}", meaning=meaning))
            alone.append(one)
    if len(road.on_body) == 1:
        return Response(time, tuple(ways.values()), np.stack([*together.values()], axis=-1))
    all_signals: list[Signal] = [*ways.values(), *signals]
    return Response(time, tuple(all_signals), np.stack([*together.values(), *alone], axis=-1))


def _load_names(loads: Sequence[Load]) -> list[str]:
    """Returns a name for each load: the type of the load, followed by a number if there are several loads of the same type."""
    kinds = [load.text.partition(":")[0] if load.label == load.text else "file" for load in loads]
    counted = [f"{kind}_{kinds[: i + 1].count(kind)}" for i, kind in enumerate(kinds)]
    return [name if kinds.count(kind) > 1 else kind for kind, name in zip(kinds, counted, strict=True)]


LONGEST = 26  # largest number of characters of a number in the text, including its separator


def written_forces(names: Sequence[str], forces: Array) -> bytes:
    """Returns forces [N], shape (T, m), as text whose heading contains the names of the forces."""
    rows = (",".join(map(repr, row)) for row in forces.tolist())
    return "\n".join([",".join(names), *rows, ""]).encode()


def read_forces(content: bytes, names: Sequence[str], samples: int) -> Array:
    """Reads forces [N], shape (T, m), from a text.

    Raises:
        InputError: the names of the forces or the number of samples in the text differ from the expected ones.
    """
    heading, m = (",".join(names) + "\n").encode(), len(names)
    if not content.startswith(heading) or len(content) > len(heading) + LONGEST * m * samples:
        raise InputError(f"the logged forces of the law are not a table of {', '.join(names)} with {samples} samples")
    try:
        rows = content.decode("ascii").split("\n")[1:-1]
        forces = np.array([[float(number) for number in row.split(",")] for row in rows]).reshape(samples, m)
    except ValueError:
        raise InputError(f"the logged forces of the law are not {samples} rows of {m} numbers") from None
    if not np.all(np.isfinite(forces)):
        raise InputError("a logged force of the law is not finite")
    return forces
