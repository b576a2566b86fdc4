"""Forces of suspensions that MuJoCo has no element for, of runs side by side, as pulls of `sim.physics.part_steps`."""

from collections.abc import Hashable, Iterable, Sequence
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.vehicle.vehicle import Vehicle


class MotionRatios:
    """Motion ratios of the suspensions of N vehicles of one kind, over their deflections.

    Attributes:
        at_rest: the ratios at rest, shape (N, s).
    """

    def __init__(self, vehicles: Sequence[Vehicle]) -> None:
        suspensions = vehicles[0].kind.suspensions
        self.at_rest = np.array([[part.motion_ratio(one.parameters) for part in suspensions] for one in vehicles])
        places = [
            (n, i, one.ratio_tables.get(part.deflection)) for n, one in enumerate(vehicles) for i, part in enumerate(suspensions)
        ]
        tables = [(table.key, n * len(suspensions) + i, table) for n, i, table in places if table is not None]
        self._alike = [(some[2][0], at) for at, some in _alike(tables, self.at_rest.size)]

    def __call__(self, d: Array) -> Array:
        """Returns the ratios at deflections [m], both of shape (N, s)."""
        ratios, flat = self.at_rest.copy(), d.ravel()
        for table, at in self._alike:
            ratios.reshape(-1)[at] = table(flat[at])
        return ratios


class FittedPulls:
    """Pulls of N vehicles without own states: dampers over velocity and deflection, and what acts at a ratio over travel.

    These are bump stops, and actuators and adjustable dampers beyond their ratio at rest. What is alike is evaluated together.
    """

    states = 0
    inertance: Array | None = None

    def __init__(self, vehicles: Sequence[Vehicle]) -> None:
        """Finds the parts of the vehicles, which have them at the same places."""
        first, count = vehicles[0], len(vehicles)
        suspensions, inputs = first.kind.suspensions, first.linear_model.inputs
        places = {part.deflection: i for i, part in enumerate(suspensions)}
        self._none, self._ratios = np.zeros((count, 0)), MotionRatios(vehicles)
        surfaces, stops = [], []  # each with its key and its index in an array of shape (N, s)
        for n, one in enumerate(vehicles):
            for fitted in one.fitted:
                if (surface := fitted.surface) is not None:
                    base = surface.base or surface
                    factor = 1.0 if base is surface else surface.slope / base.slope
                    surfaces.append((base.key, n * len(places) + places[fitted.deflection], base, factor))
            for name in one.stops.keys() & one.ratio_tables.keys():
                key = one.ratio_tables[name].key, one.limits, name
                stops.append((key, n * len(places) + places[name], one.stops[name]))
        self._surfaces = [(some[2][0], at, np.array(some[3])) for at, some in _alike(surfaces, count * len(places))]
        self._stops = [(some[2][0], at) for at, some in _alike(stops, count * len(places))]
        pushed = [part for part in suspensions if part.deflection in first.ratio_tables and part.force in inputs]
        over_travel = [(places[part.deflection], part.force) for part in pushed]
        self._pushing = [(i, inputs.index(name)) for i, name in over_travel if name not in first.dampers]
        self._damping = []
        for i, name in over_travel:
            shapes = [next(one for one in each.adjustable if one.force == name) for each in vehicles if name in each.dampers]
            groups = _alike([(id(one.damper.pair), n, one.shape) for n, one in enumerate(shapes)], count)
            self._damping += [(i, inputs.index(name), at, some[2][0]) for at, some in groups]

    def __call__(self, d: Array, v: Array, inputs: Array, z: Array) -> tuple[Array, Array]:
        """See `Pulls`."""
        pulls, flat_d, flat_v = np.zeros(d.shape), d.ravel(), v.ravel()
        flat = pulls.reshape(-1)
        for base, at, factors in self._surfaces:
            flat[at] = factors * base.beyond(flat_v[at], flat_d[at])
        for stops, at in self._stops:
            flat[at] += stops.pull(flat_d[at])
        if self._pushing or self._damping:
            ratios = self._ratios(d)
            for i, j in self._pushing:
                pulls[:, i] -= (ratios[:, i] - self._ratios.at_rest[:, i]) * inputs[:, j]
            for i, j, at, shape in self._damping:
                r = ratios[at, i]
                pulls[at, i] += r * inputs[at, j] * shape(r * v[at, i])
        return pulls, self._none


def _alike(parts: Iterable[tuple[Any, ...]], size: int) -> list[tuple[Array | slice, list[tuple[Any, ...]]]]:
    """Returns the parts of each key: their indices in an array of a size, and all their entries, column by column.

    Args:
        parts: each part's key, its index, and further entries.
    """
    groups: dict[Hashable, list[tuple[Any, ...]]] = {}
    for one in sorted(parts, key=lambda part: part[1]):
        groups.setdefault(one[0], []).append(one)
    return [
        (slice(None) if len(some) == size else np.array([one[1] for one in some]), list(zip(*some, strict=True)))
        for some in groups.values()
    ]
