"""Starts of a search over static gains: random gains of every size, a Riccati equation, and a stabilising gain.

Poles of small matrices cost microseconds, descents cost tenths of a second. So random gains are drawn from every decade of size
up to the largest allowed, each with a size of its own for every input and measurement. Half of them have rank one, as gains that
tend to infinity often have in the limit. The stabilising gains of each decade are examined more closely.

The state feedback u = G x that is best for z under white noise needs all of x. With the available measurements, K C_y comes
closest to it on average for K = G X C_y' (C_y X C_y')^-1, where X is the covariance of the loop that G closes. Nothing guarantees
that K stabilises; this is checked afterwards.

If all states are measured, the Riccati equation of the H-infinity norm has a gain as close to the lower bound as is wanted.

Two descents, tried from one start after another, for neither is sure: finding such a gain is a problem for which no sure and
quick method is known (Blondel, Gevers, Lindquist 1995).

- The largest real part of a pole falls steeply, but it is not Lipschitz, and the descent ends where poles meet.
- The norm of (s - A - B K C_y + shift)^-1 does not end there: it is finite while the shift exceeds every pole, and as it falls
  the poles go left and the shift follows.
"""

import contextlib
from collections.abc import Iterator, Sequence

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError
from synth.design.descent.landscape import Landscape
from synth.design.descent.minimax import descend_norm, quasi_newton
from synth.design.full_order.riccati import state_gain
from synth.plant.generalized import Plant
from synth.plant.units import size

SMALLEST = -2  # decade of the first sample, in the landscape's units
SAMPLES = 1000  # of each decade
WIDE = 30  # states; with more there are fewer samples, so that their poles cost the same
FEWEST = 20  # samples
CLOSER = 24  # stable ones of each decade whose norm is computed
AT_ONCE = 100  # samples whose poles are computed in one call, until there are enough stable ones
SPREAD = 1.5  # decades either way, of the size of one input or measurement
SEED = 20261121


def survey(landscape: Landscape, limit: Array) -> list[Array]:
    """Returns the best stable sample of every decade of size that has one, smallest first, each of shape (N,) like `limit`."""
    generator, count = np.random.default_rng(SEED), _count(landscape)
    samples = []
    for decade in range(SMALLEST, int(np.ceil(np.log10(limit.max())))):
        directions = landscape.of_entries(_directions(generator, count, landscape.shape))
        points = directions * 10.0 ** (decade + generator.random((count, 1)))
        best = lowest(landscape, points[np.all(np.abs(points) <= limit, axis=1)])
        if best is not None:
            samples.append(best)
    return samples


def around(landscape: Landscape, x: Array, limit: Array, factor: float, seed: int) -> Array | None:
    """Returns the best stable sample around a point, with a random factor for every entry; None if no sample is stable.

    Args:
        x: the point, shape (N,).
        limit: largest entries, shape (N,).
        factor: standard deviation of the logarithms.
    """
    factors = np.exp(factor * np.random.default_rng(seed).standard_normal((_count(landscape), len(x))))
    return lowest(landscape, np.clip(x * factors, -limit, limit))


def lowest(landscape: Landscape, points: Array) -> Array | None:
    """Returns the point with the smallest norm among the first stable ones of `points`, shape (count, N), or None."""
    stable = points[:0]
    for some in np.split(points, range(AT_ONCE, len(points), AT_ONCE)):
        loops = landscape.plant.A + landscape.plant.B @ landscape.acting(some) @ landscape.plant.Cy
        stable = np.concatenate([stable, some[np.real(np.linalg.eigvals(loops)).max(axis=1) < 0]])
        if len(stable) >= CLOSER:
            break
    best, height = None, np.inf
    for x in stable[:CLOSER]:
        there, _ = landscape.norm(x, height)
        if there < height:
            best, height = x, there
    return best


def _count(landscape: Landscape) -> int:
    """Returns the number of samples of a kind."""
    return max(FEWEST, int(SAMPLES * min(1.0, (WIDE / len(landscape.plant.A)) ** 3)))


def _directions(generator: np.random.Generator, count: int, shape: tuple[int, int]) -> Array:
    """Gains whose largest entry is one, shape (count, m, q)."""
    m, q = shape
    rows = 10 ** generator.uniform(-SPREAD, SPREAD, (count, m, 1))
    columns = 10 ** generator.uniform(-SPREAD, SPREAD, (count, 1, q))
    entries = generator.standard_normal((count, m, q))
    entries[::2] = generator.standard_normal((len(entries[::2]), m, 1)) * generator.standard_normal((len(entries[::2]), 1, q))
    gains = rows * entries * columns
    return gains / np.abs(gains).max(axis=(1, 2), keepdims=True)


COUNTS = (1e-8, 1e-4, 1e-2)  # of z's power: what every state and force counts besides, so that there is a solution
EVERYWHERE = 1e-6  # of the disturbance's power: what disturbs states that w does not reach


def projected_starts(landscape: Landscape) -> list[Array]:
    """Returns points closest to the state feedback of a Riccati equation, shape (N,) each; none if rounding prevents it."""
    plant = landscape.plant
    A, Cy, C, (n, m) = plant.A, plant.Cy, plant.C, plant.B.shape
    unit = size(A) / size(plant.B)  # of the forces, with which they move the states as fast as these move
    B, D = plant.B * unit, plant.D * unit
    noise = plant.Bw @ plant.Bw.T
    noise += EVERYWHERE * size(noise) * np.eye(n)
    weight = size(np.hstack([C, D])) ** 2
    starts = []
    for counts in COUNTS:
        try:
            P = linalg.solve_continuous_are(
                A, B, C.T @ C + counts * weight * np.eye(n), D.T @ D + counts * weight * np.eye(m), s=C.T @ D
            )
            G = -np.linalg.solve(D.T @ D + counts * weight * np.eye(m), B.T @ P + D.T @ C)
            X = linalg.solve_continuous_lyapunov(A + B @ G, -noise)
            K = unit * G @ X @ Cy.T @ np.linalg.inv(Cy @ X @ Cy.T)
        except (np.linalg.LinAlgError, ValueError):
            continue
        if np.all(np.isfinite(K)):
            starts.append(landscape.point_acting(K))
    return starts


REGULAR = (0.0, 1e-6, 1e-3)  # costs of forces, with which the equation may have a solution


def state_feedback_start(landscape: Landscape, level: float) -> list[Array]:
    """Returns the point of a state feedback whose norm is below a level; none unless all states are measured without noise."""
    plant, (n, _) = landscape.plant, landscape.plant.B.shape
    if landscape.free is not None or landscape.noisy or plant.Cy.shape != (n, n):
        return []
    for share in REGULAR:
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            G = state_gain(plant, level, share)
            return [landscape.point_acting(np.linalg.solve(plant.Cy.T, G.T).T)]
    return []


STABLE = -1e-4  # largest real part of a pole, relative to the largest pole of the plant, that is stable enough to start from
SHIFT_BEYOND = 0.03  # how far the shift lies right of the last pole, relative likewise

MOST_SHIFTS = 40
ROUNDS = 100  # of the descent on the largest real part
OF_ALL = 2.0  # times the work of a norm of the plant's: that from every state to every state
STALLED_SHIFTS = 0.92, 5  # of the largest real part: where so many shifts leave more of it, the descent leads nowhere


def stabilising_starts(landscape: Landscape, limit: Array, starts: range) -> Iterator[Array]:
    """Points where the loop is stable, one or none from each start: from u = 0, which is the first, and random points.

    Args:
        limit: largest entries, shape (N,).
        starts: numbers of the starts to try.
    """
    generator = np.random.default_rng(20261120)
    for start in range(starts.stop):
        x = generator.standard_normal(len(limit)) * 10 ** generator.uniform(-1.5, 1.5) if start else np.zeros(len(limit))
        if start not in starts:
            continue
        if landscape.work.over:
            return
        x = np.clip(x, -0.5 * limit, 0.5 * limit)
        stable = stabilise(landscape, x, limit, patient=start % 2 == 1)
        if stable is not None:
            yield stable


def lower_poles(landscapes: Sequence[Landscape], x: Array, free: Array) -> Array:
    """Returns a point at which the largest real part of a pole of any of the loops is smaller, negative if may be, shape (N,).

    Args:
        landscapes: landscapes of the plants, with the same points.
        free: indices of the entries of a point that may move.
    """
    rate, moved = _rate(landscapes[0]), x.copy()

    def abscissa(t: Array) -> tuple[float, Array]:
        moved[free] = t
        value, slope = max((landscape.abscissa(moved) for landscape in landscapes), key=lambda each: each[0])
        return value / rate, slope[free] / rate

    if np.isfinite(abscissa(x[free])[0]):
        moved[free] = quasi_newton(abscissa, x[free], ROUNDS, STABLE)[0]
    return moved


def _rate(landscape: Landscape) -> float:
    return float(np.abs(np.linalg.eigvals(landscape.plant.A)).max()) or 1.0


def stabilise(landscape: Landscape, x: Array, limit: Array, patient: bool) -> Array | None:
    """Returns a stable point from one start, or None if this start leads to none.

    Args:
        limit: largest entries, shape (N,).
        patient: True for the second descent alone; otherwise the second begins where the first ends.
    """
    rate = _rate(landscape)
    x = x if patient else lower_poles([landscape], x, np.arange(len(x)))
    history = [landscape.abscissa(x)[0] / rate]
    for _ in range(MOST_SHIFTS):
        left, shifts = STALLED_SHIFTS
        lost = len(history) > shifts and history[-1] > left * history[-1 - shifts]
        if history[-1] <= 0.1 * STABLE or lost or landscape.work.over or np.any(np.abs(x) > limit):
            break
        x, _ = descend_norm(shifted_landscape(landscape, (1.1 * history[-1] + SHIFT_BEYOND) * rate), x, limit, 10)
        history.append(landscape.abscissa(x)[0] / rate)
    inside = np.all(np.abs(x) <= limit) and np.isfinite(landscape.norm(x)[0])
    return x if inside else None


def shifted_landscape(landscape: Landscape, shift: float) -> Landscape:
    """The landscape of (s - A - B K C_y + shift)^-1, in the same coordinates."""
    own, (n, m) = landscape.plant, landscape.plant.B.shape
    eye, nothing = np.eye(n), np.zeros((n, n))
    moved = Landscape(Plant(own.A - shift * eye, own.B, eye, eye, np.zeros((n, m)), nothing, Cy=own.Cy, Dyu=own.Dyu))
    moved.scale, moved.before = landscape.scale, landscape.before
    moved.free, moved.work, moved.price = landscape.free, landscape.work, OF_ALL * landscape.price
    return moved
