"""A stabilising static gain u = K y where the LMIs find none.

Two descents, tried from one start after another, for neither is sure: finding such a gain is a problem for which no sure and
quick method is known (Blondel, Gevers, Lindquist 1995).

- The largest real part of a pole falls steeply, but it is not Lipschitz, and the descent ends where poles meet.
- The norm of (s - A - B K C_y + shift)^-1 does not end there: it is finite while the shift exceeds every pole, and as it falls
  the poles go left and the shift follows.
"""

from collections.abc import Iterator

import numpy as np

from models.common.arrays import Array
from synth.plant import GeneralizedPlant
from synth.search.descent import along_edges, quasi_newton
from synth.search.landscape import Landscape

STABLE = -1e-4  # largest real part of a pole, relative to the largest pole of the plant, that is stable enough to start from
SHIFT_BEYOND = 0.03  # how far the shift lies right of the last pole, relative likewise

MOST_SHIFTS = 40
STALLED = 0.92, 5  # of the largest real part: where so many shifts leave more of it, the descent leads nowhere


def stabilising_starts(landscape: Landscape, limit: Array, starts: range) -> Iterator[Array]:
    """Points where the loop is stable, one or none from each start: from u = 0, which is the first, and random points.

    Args:
        landscape: of the plant.
        limit: largest entries, shape (m q,).
        starts: those to try, by number.
    """
    generator = np.random.default_rng(20261120)
    for start in range(starts.stop):
        x = generator.standard_normal(len(limit)) * 10 ** generator.uniform(-1.5, 1.5) if start else np.zeros(len(limit))
        if start not in starts:
            continue
        x = np.clip(x, -0.5 * limit, 0.5 * limit)
        found = stabilise(landscape, x, limit, patient=start % 2 == 1)
        if found is not None:
            yield found


def stabilise(landscape: Landscape, x: Array, limit: Array, patient: bool) -> Array | None:
    """A stable point from one start, or None: another start may lead to one.

    Args:
        landscape: of the plant.
        x: the start.
        limit: largest entries, shape (m q,).
        patient: by the second descent alone; otherwise it only takes over where the first ends.
    """
    rate = float(np.abs(np.linalg.eigvals(landscape.A)).max()) or 1.0

    def abscissa(x: Array, _: float = np.inf) -> tuple[float, Array]:
        value, slope = landscape.abscissa(x)
        return value / rate, slope / rate

    if not patient and abscissa(x)[0] > STABLE:
        x, _ = quasi_newton(abscissa, x, 100, STABLE)
    history = [abscissa(x)[0]]
    for _ in range(MOST_SHIFTS):
        left, shifts = STALLED
        lost = len(history) > shifts and history[-1] > left * history[-1 - shifts]
        if history[-1] <= 0.1 * STABLE or lost or np.any(np.abs(x) > limit):
            break
        x, _ = along_edges(shifted(landscape, (1.1 * history[-1] + SHIFT_BEYOND) * rate), x, limit, 10)
        history.append(abscissa(x)[0])
    inside = np.all(np.abs(x) <= limit) and np.isfinite(landscape.norm(x)[0])
    return x if inside else None


def shifted(landscape: Landscape, shift: float) -> Landscape:
    """The landscape of (s - A - B K C_y + shift)^-1, in the same coordinates."""
    n, m = landscape.B.shape
    eye, nothing = np.eye(n), np.zeros((n, n))
    plant = GeneralizedPlant(landscape.A - shift * eye, landscape.B, eye, eye, np.zeros((n, m)), nothing)
    moved = Landscape(plant, landscape.Cy)
    moved.scale, moved.Dyu, moved.before, moved.through = landscape.scale, landscape.Dyu, landscape.before, landscape.through
    return moved
