"""Starting gains for a search over static gains: random gains, gains from a Riccati equation, and stabilising gains.

Computing the poles of a small matrix takes microseconds, but a descent from one starting gain takes tenths of a second. Random
gains are therefore drawn from every decade of magnitude up to the largest allowed gain. Every input and every measurement also
has its own random scale. Half of the gains have rank one, because gains that tend to infinity often have rank one in the limit.
In each decade, the norm is computed for some of the stabilising gains.

The state feedback u = G x that minimises the mean square of z under white noise needs all states x. With the available
measurements, K C_y is closest to G on average if K = G X C_y' (C_y X C_y')^-1, where X is the covariance of the state in the
loop with G. K may fail to stabilise the loop, so the stability of the loop with K is checked afterwards.

If all states are measured, the Riccati equation of the H-infinity norm gives a gain whose norm is as close to the lower bound
as required.

Two types of descent search for a stabilising gain, from several starting points in turn. Neither type of descent is certain to
find a stabilising gain, because no fast and certain method is known (Blondel, Gevers, Lindquist 1995).

- The first type of descent lowers the largest real part of the poles. The largest real part can be lowered quickly, but it is
  not Lipschitz continuous, and the descent stops at gains where poles coincide.
- The second type lowers the norm of (s - A - B K C_y + shift)^-1, which is finite while the shift exceeds the real part of
  every pole. As the norm falls, the poles move to the left, and the shift is reduced accordingly.
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

SMALLEST = -2  # exponent of ten of the smallest random gains, in the units of the landscape
SAMPLES = 1000  # number of random gains that are drawn in each decade of magnitude
WIDE = 30  # with more states than this, fewer random gains are drawn, so that computing their poles does not take longer
FEWEST = 20  # smallest number of random gains that are drawn, even for a large plant
CLOSER = 24  # number of stabilising gains in each decade for which the norm is computed
AT_ONCE = 100  # number of random gains whose poles are computed in one call
SPREAD = 1.5  # scales of inputs and measurements are varied by this many decades, upwards and downwards
SEED = 20261121


def survey(landscape: Landscape, limit: Array) -> list[Array]:
    """Returns, for each decade of gains, the best stabilising random gain, if there is any, in ascending order of size; shape
    (N,) each.
    """
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
    """Multiplies each entry of a point by random factors, and returns the best stable result; None if no result is stable.

    Args:
        x: centre of the random points, shape (N,).
        limit: largest absolute value of each entry, shape (N,).
        factor: standard deviation of the logarithms of the random factors.
        seed: seed of the random factors.
    """
    factors = np.exp(factor * np.random.default_rng(seed).standard_normal((_count(landscape), len(x))))
    return lowest(landscape, np.clip(x * factors, -limit, limit))


def lowest(landscape: Landscape, points: Array) -> Array | None:
    """Returns the point with the smallest norm among the first stable points; None if no point is stable.

    Args:
        landscape: landscape that gives the norm at each point.
        points: points to compare, shape (count, N).
    """
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
    """Returns the number of random gains that are drawn together in one batch."""
    return max(FEWEST, int(SAMPLES * min(1.0, (WIDE / len(landscape.plant.A)) ** 3)))


def _directions(generator: np.random.Generator, count: int, shape: tuple[int, int]) -> Array:
    """Returns random gains whose largest entry is one, shape (count, m, q)."""
    m, q = shape
    rows = 10 ** generator.uniform(-SPREAD, SPREAD, (count, m, 1))
    columns = 10 ** generator.uniform(-SPREAD, SPREAD, (count, 1, q))
    entries = generator.standard_normal((count, m, q))
    entries[::2] = generator.standard_normal((len(entries[::2]), m, 1)) * generator.standard_normal((len(entries[::2]), 1, q))
    gains = rows * entries * columns
    return gains / np.abs(gains).max(axis=(1, 2), keepdims=True)


# Costs that are added to every state and every force, relative to z. All these costs are tried, because the Riccati equation
# may have no solution for some of them
COUNTS = (1e-8, 1e-4, 1e-2)
# power of a disturbance that is added to every state, relative to the power of w, because w may not affect all states
EVERYWHERE = 1e-6


def projected_starts(landscape: Landscape) -> list[Array]:
    """Returns the points whose gains are closest to state feedbacks from Riccati equations, shape (N,) each."""
    plant = landscape.plant
    A, Cy, C, (n, m) = plant.A, plant.Cy, plant.C, plant.B.shape
    # a force of one unit moves the states about as fast as they move without control
    unit = size(A) / size(plant.B)
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


REGULAR = (0.0, 1e-6, 1e-3)  # relative costs of all forces, tried in this order until the equation has a solution


def state_feedback_start(landscape: Landscape, level: float) -> list[Array]:
    """Returns a list with one point: the gain of a state feedback whose norm is below a given level.

    The list is empty unless all states are measured without noise.
    """
    plant, (n, _) = landscape.plant, landscape.plant.B.shape
    if landscape.free is not None or landscape.noisy or plant.Cy.shape != (n, n):
        return []
    for share in REGULAR:
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            G = state_gain(plant, level, share)
            return [landscape.point_acting(np.linalg.solve(plant.Cy.T, G.T).T)]
    return []


# a point counts as stable if the largest real part of its poles, relative to the plant's fastest pole, is below this value
STABLE = -1e-4
# the stability limit is shifted to the right of the rightmost pole by this distance, relative to the plant's fastest pole
SHIFT_BEYOND = 0.03

MOST_SHIFTS = 40
ROUNDS = 100  # largest number of rounds in the descent that reduces the largest real part of the poles
OF_ALL = 2.0  # computing work for a norm from all states to all states, relative to the work for the plant's norm
# (share, number of shifts): the descent stops if, after so many shifts, the largest real part still exceeds this share of its
# earlier value
STALLED_SHIFTS = 0.92, 5


def stabilising_starts(landscape: Landscape, limit: Array, starts: range) -> Iterator[Array]:
    """Yields stable points, at most one for each starting point. The first starting point is u = 0, and the other starting
    points are random.

    Args:
        limit: largest absolute value of each entry, shape (N,).
        starts: indices of the starting points that are tried.
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
    """Lowers the largest real part of the poles of all loops by descent, and returns the final point, shape (N,).

    The loops are stable at the final point if the largest real part is negative.

    Args:
        landscapes: landscapes of the plants; a point represents the same gain in all landscapes.
        x: point from which the descent starts, shape (N,).
        free: indices of the entries of the point that may change.
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
    """Returns a stable point that is found by descent from one starting point; None if the descent fails.

    Args:
        limit: largest absolute value of each entry, shape (N,).
        patient: True to use only the second descent; False to start the second descent from the end of the first descent.
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
    """Returns the landscape of (s - A - B K C_y + shift)^-1, in the same coordinates as the landscape of the plant."""
    own, (n, m) = landscape.plant, landscape.plant.B.shape
    eye, nothing = np.eye(n), np.zeros((n, n))
    moved = Landscape(Plant(own.A - shift * eye, own.B, eye, eye, np.zeros((n, m)), nothing, Cy=own.Cy, Dyu=own.Dyu))
    moved.scale, moved.before = landscape.scale, landscape.before
    moved.free, moved.work, moved.price = landscape.free, landscape.work, OF_ALL * landscape.price
    return moved
