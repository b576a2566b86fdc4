"""Where to start from: gains of every size, thousands at once.

Poles of small matrices cost microseconds, descents cost tenths of a second. So random gains are drawn from every decade of size
up to the largest allowed, each with a size of its own for every input and measurement. Half of them have rank one, as gains that
tend to infinity often have in the limit. Of each decade those that stabilise are looked at more closely.
"""

import numpy as np

from models.common.arrays import Array
from synth.search.landscape import Landscape

SMALLEST = -2  # decade of the first sample, in the landscape's units
SAMPLES = 1000  # of each decade
WIDE = 30  # states; with more there are fewer samples, so that their poles cost the same
FEWEST = 20  # samples
CLOSER = 24  # stable ones of each decade whose norm is computed
AT_ONCE = 100  # samples whose poles are computed in one call, until there are enough stable ones
SPREAD = 1.5  # decades either way, of the size of one input or measurement
SEED = 20261121


def survey(landscape: Landscape, limit: Array) -> list[Array]:
    """The best stable sample of every decade of size that has one, smallest first, each of shape (m q,).

    Args:
        landscape: of the plant.
        limit: largest entries, shape (m q,).
    """
    generator, count = np.random.default_rng(SEED), _count(landscape)
    found = []
    for decade in range(SMALLEST, int(np.ceil(np.log10(limit.max())))):
        points = _directions(generator, count, landscape.shape) * 10.0 ** (decade + generator.random((count, 1)))
        best = lowest(landscape, points[np.all(np.abs(points) <= limit, axis=1)])
        if best is not None:
            found.append(best)
    return found


def around(landscape: Landscape, x: Array, limit: Array, factor: float, seed: int) -> Array | None:
    """The best stable sample of those that differ from a point by random factors, one for every entry; None where none is stable.

    Args:
        landscape: of the plant.
        x: the point, shape (m q,).
        limit: largest entries, shape (m q,).
        factor: standard deviation of the logarithms.
        seed: of the samples.
    """
    factors = np.exp(factor * np.random.default_rng(seed).standard_normal((_count(landscape), len(x))))
    return lowest(landscape, np.clip(x * factors, -limit, limit))


def lowest(landscape: Landscape, points: Array) -> Array | None:
    """The point with the smallest norm among the first stable ones of many, shape (m q,); None where none is stable.

    Args:
        landscape: of the plant.
        points: shape (N, m q).
    """
    stable = points[:0]
    for some in np.split(points, range(AT_ONCE, len(points), AT_ONCE)):
        loops = landscape.A + landscape.B @ landscape.acting(some) @ landscape.Cy
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
    """How many samples there are of a kind."""
    return max(FEWEST, int(SAMPLES * min(1.0, (WIDE / len(landscape.A)) ** 3)))


def _directions(generator: np.random.Generator, count: int, shape: tuple[int, int]) -> Array:
    """Gains whose largest entry is one, shape (count, m q)."""
    m, q = shape
    rows = 10 ** generator.uniform(-SPREAD, SPREAD, (count, m, 1))
    columns = 10 ** generator.uniform(-SPREAD, SPREAD, (count, 1, q))
    entries = generator.standard_normal((count, m, q))
    entries[::2] = generator.standard_normal((len(entries[::2]), m, 1)) * generator.standard_normal((len(entries[::2]), 1, q))
    gains = (rows * entries * columns).reshape(count, m * q)
    return gains / np.abs(gains).max(axis=1, keepdims=True)
