"""What an actual disturbance reaches: a second route to the gain of a sampled loop, from below, that knows nothing of levels.

Of all disturbances that turn by an angle from sample to sample, those are tried that are a polynomial of low degree over each of
a few parts of the period. For such a one x is exact by matrix exponentials, and so is the energy of z: the largest gain among
them is the largest singular value of one matrix. It is a true gain, of that very disturbance (fast lifting, Keller, Anderson
1992, but of z itself, not of its samples). As a worst disturbance is smooth, and the gain stationary there, it falls short by the
power 2 (degree + 1) of the parts' length.
"""

import math

import numpy as np
from numpy.polynomial import legendre
from scipy import linalg

from models.common.arrays import Array
from synth.certificate.gain import largest_singular_values
from synth.certificate.stability import balance
from synth.sampled.lifted import in_own_units, with_inputs
from synth.sampled.loop import SampledLoop

DEGREE = 3
FEWEST, MOST = 4, 64  # parts of a piece of the period to begin with
LONGEST = 1.0  # times the fastest rate of the plant, a part
NODES = 12  # of a quadrature: of exp(2 t), the most that is asked of it, it leaves 1e-30
MOST_COLUMNS = 1200  # of the matrix: more take seconds
SHORT = 1e-7  # relative: what falls short by more may be said more closely


def reached_near(loop: SampledLoop, angle: float, norm: float) -> float:
    """What is reached at an angle by as many parts of the period as it takes to come near a norm, or as there can be."""
    fastest = np.abs(np.linalg.eigvals(balance(loop.plant.A)[0])).max(initial=0.0)
    each = len(loop.pieces) * (DEGREE + 1) * loop.plant.Bw.shape[1]
    most = max(FEWEST, MOST_COLUMNS // each)
    parts = int(min(max(FEWEST, np.ceil(loop.period * fastest / LONGEST)), MOST, most))
    found = 0.0
    while True:
        found = max(found, reached_gain(loop, angle, parts))
        if found >= norm * (1 - SHORT) or 2 * parts > most:
            return found
        parts *= 2


def reached_gain(loop: SampledLoop, angle: float, parts: int, degree: int = DEGREE) -> float:
    """The largest gain of a disturbance that is smooth in parts, a true lower bound of the loop's gain.

    Args:
        loop: stable.
        angle: by which the disturbance turns from sample to sample [rad]; NaN for one that lasts one period alone, and counts
            within it.
        parts: of every piece of the period.
        degree: of the polynomials.
    """
    plant, alone = loop.plant, math.isnan(angle)
    n = len(plant.A)
    width = n + len(loop.acting) * len(loop.asked)

    # Of [x; held inputs] now: what those at the sample make of it, and what every polynomial so far does.
    free, forced = np.eye(width), np.zeros((width, 0))
    seen_free, seen_forced = [], []
    for duration, acting in loop.acting:
        step, through, energy = _part(*with_inputs(plant, acting), plant.Dw, n, duration / parts, degree)
        for _ in range(parts):
            seen_free.append(energy[:, :width] @ free)
            seen_forced.append(np.hstack([energy[:, :width] @ forced, energy[:, width:]]))
            free, forced = step @ free, np.hstack([step @ forced, through])
    columns = forced.shape[1]
    padded = [np.hstack([rows, np.zeros((len(rows), columns - rows.shape[1]))]) for rows in seen_forced]
    direct = np.vstack(padded)
    if alone:
        return float(np.linalg.norm(direct, 2))
    matrix, start = loop.turning(free - np.eye(width), np.array([angle]))
    driven = np.vstack([forced[:n], np.zeros((matrix.shape[1] - n, columns))])
    whole = np.vstack(seen_free) @ (start[0] @ np.linalg.solve(matrix[0], driven)) + direct
    return float(largest_singular_values(whole[None])[0])


def _part(A: Array, Bw: Array, C: Array, Dw: Array, n: int, h: float, degree: int) -> tuple[Array, Array, Array]:
    """A part of h seconds: what it makes of the state, and of a polynomial; and a root of the energy of z, of both.

    The energy is never formed: where states have units far apart, its small parts drown in the rounding of its large ones. Its
    root is z at the nodes of a quadrature, which an orthogonal transformation makes small again: that keeps
    the digits of each column.

    A polynomial counts by its coefficients on Legendre's, of energy one each. Of the states the first n move.
    """
    size, r, k = len(A), Bw.shape[1], degree + 1
    A, Bw, C, scale = in_own_units(A, Bw, C, n)
    # w is the first of a chain of k integrators; at the start they hold its derivatives, in units of the part's length.
    derivatives = np.zeros((k, k))
    for j in range(k):
        polynomial = legendre.Legendre.basis(j, domain=[0, 1]) * math.sqrt((2 * j + 1) / h)
        derivatives[:, j] = [polynomial.deriv(i)(0.0) if i else polynomial(0.0) for i in range(k)]
    larger = np.zeros((size + k * r, size + k * r))
    larger[:size, :size], larger[:size, size : size + r] = A, Bw
    larger[size:, size:] = np.kron(np.eye(k, k=1), np.eye(r)) / h
    seen = np.hstack([C, Dw, np.zeros((len(C), (k - 1) * r))])
    # Of a time that is short to A z is nearly a polynomial, whose energy the quadrature has exactly; then that time is doubled.
    doublings = max(0, math.ceil(math.log2(max(h * float(np.linalg.norm(A, 1)), 1e-300))))
    short = h / 2**doublings
    nodes, weights = legendre.leggauss(NODES)
    there = linalg.expm(short * np.append((1 + nodes) / 2, 1.0)[:, None, None] * larger)
    step = there[-1]
    root = _small(np.vstack(np.sqrt(short * weights / 2)[:, None, None] * (seen @ there[:-1])))
    for _ in range(doublings):
        step, root = step @ step, _small(np.vstack([root, root @ step]))
    into = np.asarray(linalg.block_diag(np.diag(1 / scale), np.kron(derivatives, np.eye(r))))
    moved = scale[:, None] * step[:size] @ into
    return moved[:, :size], moved[:, size:], root @ into


def _small(root: Array) -> Array:
    """One with R' R as before and no more rows than columns."""
    return np.asarray(np.linalg.qr(root, mode="r"))
