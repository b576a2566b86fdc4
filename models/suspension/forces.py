"""Forces of suspensions beyond their linear springs and dampers, for runs side by side."""

from collections.abc import Callable, Sequence

import numpy as np

from models.common.arrays import Array
from models.suspension.curve import Pieces
from models.vehicle.vehicle import Vehicle

Term = Callable[[Array, Array, Array], Array]  # force [N] by deflection [m], its rate [m/s], and all inputs
Terms = tuple[Sequence[Term], Sequence[tuple[int, Term]]]  # of all suspensions at once, and of single ones with their numbers


class SuspensionForces:
    """Forces that pull suspensions together at the wheels, of N vehicles of one kind, beyond those of their linear models.

    The linear model has the line of each spring and damper, and the force of each actuator at its motion ratio at rest.
    """

    def __init__(self, vehicles: Sequence[Vehicle]) -> None:
        """Takes N vehicles, or one for any number of runs."""
        first = vehicles[0]
        self._terms = [_terms(one) for one in vehicles]
        self.acts = [
            any(
                (
                    any(one.deflection == part.deflection and one.curve.bent for one in first.fitted),
                    part.deflection in first.stops,
                    part.force in first.dampers,
                    part.deflection in first.ratio_tables,
                )
            )
            for part in first.kind.suspensions
        ]

    def __call__(self, d: Array, v: Array, inputs: Array) -> Array:
        """Returns the forces [N], shape (..., N, s).

        Args:
            d, v: deflections [m] and their rates [m/s] at the wheels, shape (..., N, s).
            inputs: acting forces of actuators [N], and acting coefficients of adjustable dampers beyond the nominal ones
                [N s/m], shape (..., N, m).
        """
        if len(self._terms) == 1:
            return _sum(self._terms[0], d, v, inputs)
        rows = [_sum(terms, d[..., i, :], v[..., i, :], inputs[..., i, :]) for i, terms in enumerate(self._terms)]
        return np.stack(rows, axis=-2)


def _sum(terms: Terms, d: Array, v: Array, inputs: Array) -> Array:
    every, single = terms
    pulls = every[0](d, v, inputs) if every else np.zeros(d.shape)
    for term in every[1:]:
        pulls = pulls + term(d, v, inputs)
    for i, term in single:
        pulls[..., i] += term(d[..., i], v[..., i], inputs)
    return pulls


def _terms(vehicle: Vehicle) -> Terms:
    """Returns the forces of a vehicle."""
    parts, forces, dampers = vehicle.kind.suspensions, vehicle.linear_model.inputs, {one.force: one for one in vehicle.adjustable}
    places = {part.deflection: i for i, part in enumerate(parts)}
    bent = [(places[fitted.deflection], fitted) for fitted in vehicle.fitted if fitted.curve.bent]
    every, terms = list[Term](), list[tuple[int, Term]]()
    for damps in (False, True):
        some = {i: one.curve.pieces for i, one in bent if one.surface is None and one.damps == damps}
        if some:
            every.append(_curves([some.get(i) for i in range(len(parts))], damps))
    for i, one in bent:
        if one.surface is not None:
            terms.append((i, lambda d, v, inputs, beyond=one.beyond: beyond(d, v)))
    for name, stops in vehicle.stops.items():
        terms.append((places[name], lambda d, v, inputs, pull=stops.pull: pull(d)))
    for i, part in enumerate(parts):
        table = vehicle.ratio_tables.get(part.deflection)
        if part.force not in forces or (table is None and part.force not in dampers):
            continue
        j, at_rest = forces.index(part.force), vehicle.motion_ratios[part.force]
        shape = dampers[part.force].shape if part.force in dampers else None
        ratio = table or (lambda d, at_rest=at_rest: at_rest)

        def term(d: Array, v: Array, inputs: Array, j=j, at_rest=at_rest, shape=shape, ratio=ratio) -> Array:
            r, u = ratio(d), inputs[..., j]
            return (at_rest - r) * u if shape is None else r * u * shape(r * v)

        terms.append((i, term))
    return every, terms


def _curves(pieces: Sequence[Pieces | None], damp: bool) -> Term:
    """Returns the forces of all suspensions by their curves over velocity or deflection; None for a suspension without."""
    width = max(len(one.slope) for one in pieces if one is not None)
    stacked = np.zeros((4, len(pieces), width))
    for i, one in enumerate(pieces):
        if one is not None:
            stacked[:, i, : len(one.slope)] = one.slope, one.start, one.low, one.high
    (slope, start, low, high), ones = stacked, np.ones(width)

    def term(d: Array, v: Array, inputs: Array) -> Array:
        x = v if damp else d
        # This runs in each stage of a step: NumPy's `clip`, `sum` and `@` take twice as long.
        return np.minimum(np.maximum(slope * (x[..., None] - start), low), high).dot(ones)

    return term
