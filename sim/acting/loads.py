"""What loads pushed a body with in a run, over time."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from models.loads.load import Load
from models.roads.loaded import Loaded
from models.roads.road import Road
from models.signals import HEAVE_LOAD, PITCH_LOAD, ROLL_LOAD, Signal
from models.vehicle import Vehicle
from sim.response.response import Response

WAYS = {one.name: one for one in (HEAVE_LOAD, PITCH_LOAD, ROLL_LOAD)}


def pushed(vehicle: Vehicle, road: Road, time: Array) -> Response | None:
    """All of them together in each of their ways, then each by itself where there are several; None of a road without any.

    As they act: held over a step at what they are midway through it.

    Args:
        vehicle: its parameters count.
        road: with loads, or without.
        time: equidistant sample times [s], shape (T,).
    """
    if not isinstance(road, Loaded):
        return None
    midway = time + (time[1] - time[0]) / 2
    ways = [name for name in WAYS if any(name in load.ways for load in road.on_body)]
    together, alone, signals = {name: np.zeros(len(time)) for name in ways}, [], []
    for load, called in zip(road.on_body, _called(road.on_body), strict=True):
        for name, one in load.over(midway, vehicle.parameters).items():
            together[name] = together[name] + one
            meaning = f"{WAYS[name].meaning}: of {load.label}"
            signals.append(replace(WAYS[name], name=f"{called}_{name}", meaning=meaning))
            alone.append(one)
    if len(road.on_body) == 1:
        return Response(time, tuple(WAYS[name] for name in ways), np.stack([*together.values()], axis=-1))
    found: list[Signal] = [*(WAYS[name] for name in ways), *signals]
    return Response(time, tuple(found), np.stack([*together.values(), *alone], axis=-1))


def _called(loads: Sequence[Load]) -> list[str]:
    """A name for each: its kind, with a number where there are several of that."""
    kinds = [load.text.partition(":")[0] if load.label == load.text else "file" for load in loads]
    counted = [f"{kind}_{kinds[: i + 1].count(kind)}" for i, kind in enumerate(kinds)]
    return [name if kinds.count(kind) > 1 else kind for kind, name in zip(kinds, counted, strict=True)]
