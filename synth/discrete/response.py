"""What a discrete loop answers at a frequency, with twice the digits: Dw + C (z - A)^-1 Bw at a point of the unit circle.

The point is given by t = tan(omega dt / 2), a float: z = (1 + j t) / (1 - j t) lies on the circle exactly, and no digit of a sine
is in the answer. With both sides times 1 - j t it is ((I - A) + j t (I + A)) x = (1 - j t) Bw; beyond t = 1 by j t instead.
"""

import numpy as np

from models.common.arrays import Array
from synth.extended import added, multiplied, product
from synth.plant import GeneralizedPlant

LEFT = 1e-14  # relative; what moves by less has come to rest
MOST_TURNS = 12


def response_closely(system: GeneralizedPlant, t: float) -> tuple[Array, float]:
    """T at a point of the unit circle, complex, shape (d, r), and by how much its entries still moved in the last turn, at most.

    Args:
        system: discrete; `beyond` is part of what it is.
        t: tan(omega dt / 2), from 0 to infinity.

    Raises:
        LinAlgError: the system has a pole there, to rounding.
    """
    n, r = system.Bw.shape
    beyond = np.zeros((n + len(system.C), n)) if system.beyond is None else system.beyond
    A, eye = system.A, np.eye(n)
    minus, plus = added(eye, -A), added(eye, A)
    minus, plus = (minus[0], minus[1] - beyond[:n]), (plus[0], plus[1] + beyond[:n])
    if t <= 1:
        across = multiplied(np.full((n, n), t), plus[0])
        real, turned = minus, (across[0], across[1] + t * plus[1])
        right = np.vstack([system.Bw, -t * system.Bw])
    else:
        across = multiplied(np.full((n, n), 1 / t), minus[0])
        real, turned = plus, (-across[0], -across[1] - minus[1] / t)
        right = np.vstack([-system.Bw, -system.Bw / t])
    high, low = (np.block([[a, -b], [b, a]]) for a, b in zip(real, turned, strict=True))
    solution, rest = np.zeros((2, 2 * n, r))
    T, moved = np.zeros((len(system.C), r), complex), np.inf
    for _ in range(MOST_TURNS):
        into, lost = product(high, solution)
        change, off = added(right, -into)
        step = np.linalg.solve(high, change + (off - lost - high @ rest - low @ solution))
        solution, off = added(solution, step)
        solution, rest = added(solution, rest + off)
        parts = []
        for x, least in zip(np.split(solution, 2), np.split(rest, 2), strict=True):
            out, lost = product(system.C, x)
            parts.append(out + (lost + system.C @ least + beyond[n:] @ x))
        before, T = T, parts[0] + 1j * parts[1] + system.Dw
        moved = float(np.abs(T - before).max(initial=0.0))
        if moved <= LEFT * np.abs(T).max(initial=0.0):
            break
    return T, moved
