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
from synth.certificate.norm import largest_singular_values
from synth.certificate.stability import balance
from synth.sampled.lifted import with_inputs
from synth.sampled.loop import SampledLoop

DEGREE = 3
FEWEST, MOST = 4, 64  # parts of a piece of the period to begin with
LONGEST = 1.0  # times the fastest rate of the plant, a part
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
        step, through, energy = _part(*with_inputs(plant, acting), plant.Dw, duration / parts, degree)
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


def _part(A: Array, Bw: Array, C: Array, Dw: Array, h: float, degree: int) -> tuple[Array, Array, Array]:
    """A part of h seconds: what it makes of the state, and of a polynomial; and a root of the energy of z, of both.

    A polynomial counts by its coefficients on Legendre's, of energy one each.
    """
    n, r, k = len(A), Bw.shape[1], degree + 1
    # w is the first of a chain of k integrators; at the start they hold its derivatives, in units of the part's length.
    derivatives = np.zeros((k, k))
    for j in range(k):
        polynomial = legendre.Legendre.basis(j, domain=[0, 1]) * math.sqrt((2 * j + 1) / h)
        derivatives[:, j] = [polynomial.deriv(i)(0.0) if i else polynomial(0.0) for i in range(k)]
    larger = np.zeros((n + k * r, n + k * r))
    larger[:n, :n], larger[:n, n : n + r] = A, Bw
    larger[n:, n:] = np.kron(np.eye(k, k=1), np.eye(r)) / h
    seen = np.hstack([C, Dw, np.zeros((len(C), (k - 1) * r))])
    size = len(larger)
    # Van Loan 1978: of [-A' C'C; 0 A], the exponential holds that of A, and the energy; of a short time, as -A' grows.
    doublings = max(0, math.ceil(math.log2(max(h * float(np.linalg.norm(balance(A)[0], 1)), 1e-300))))
    both = linalg.expm(h / 2**doublings * np.block([[-larger.T, seen.T @ seen], [np.zeros((size, size)), larger]]))
    step = both[size:, size:]
    energy = step.T @ both[:size, size:]
    for _ in range(doublings):
        step, energy = step @ step, energy + step.T @ energy @ step
    into = np.asarray(linalg.block_diag(np.eye(n), np.kron(derivatives, np.eye(r))))
    values, vectors = np.linalg.eigh(into.T @ (energy + energy.T) @ into / 2)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    moved = step[:n] @ into
    return moved[:, :n], moved[:, n:], root
