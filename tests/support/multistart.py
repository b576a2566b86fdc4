"""Descents from many starts for a static gain, by BFGS on a norm from a dense grid: independent of the project's own searches."""

from collections.abc import Callable

import numpy as np

from models.common.arrays import Array
from synth.plant.generalized import GeneralizedPlant

LARGEST = 1e5  # of |K_ij|, as for the designs
STARTS = 30
SIZES = (-2.0, 2.0)  # decades, of a start, in units in which 1 moves the poles as fast as the plant's own


class Loops:
    """The loops of one plant, continuous or discrete: spectral abscissa or radius, and the norm, each with its slope."""

    def __init__(self, plant: GeneralizedPlant, Cy: Array) -> None:
        self.plant, self.Cy = plant, Cy
        self.shape = plant.B.shape[1], len(Cy)
        rate = np.abs(np.linalg.eigvals(plant.A)).max() if plant.dt is None else 1.0
        self.unit = rate / np.outer(np.linalg.norm(plant.B, axis=0), np.linalg.norm(Cy, axis=1))

    def gain(self, x: Array) -> Array:
        """K of a point, shape (m, q)."""
        return x.reshape(self.shape) * self.unit

    def growth(self, x: Array) -> tuple[float, Array]:
        """The growth of the fastest mode, below 0 if the loop is stable, and its slope."""
        A = self.plant.A + self.plant.B @ self.gain(x) @ self.Cy
        poles, V = np.linalg.eig(A)
        discrete = self.plant.dt is not None
        i = int(np.argmax(np.abs(poles) if discrete else np.real(poles)))
        W = np.linalg.inv(V)
        slope = np.outer(W[i] @ self.plant.B, self.Cy @ V[:, i])
        turn = np.conj(poles[i]) / abs(poles[i]) if discrete else 1.0
        value = abs(poles[i]) - 1 if discrete else np.real(poles[i])
        return float(value), np.real(turn * slope * self.unit).ravel()

    def norm(self, x: Array) -> tuple[float, Array]:
        """The logarithm of the largest gain over a grid about every pole, refined, and its slope; infinite if unstable."""
        plant, K = self.plant, self.gain(x)
        A, C = plant.A + plant.B @ K @ self.Cy, plant.C + plant.D @ K @ self.Cy
        if not np.isfinite(A).all():
            return np.inf, np.zeros_like(x)
        poles, V = np.linalg.eig(A)
        discrete = plant.dt is not None
        if (np.abs(poles).max() >= 1) if discrete else (np.real(poles).max() >= 0):
            return np.inf, np.zeros_like(x)
        grid = np.abs(np.angle(poles)) if discrete else np.abs(poles)
        width = 1 - np.abs(poles) if discrete else -np.real(poles)
        about = np.abs(
            (np.abs(np.imag(np.log(poles + 0j))) if discrete else np.abs(np.imag(poles)))[:, None]
            + width[:, None] * np.linspace(-2, 2, 9)
        )
        ends = (
            np.linspace(0, np.pi, 40) if discrete else np.append(np.geomspace(grid.min() / 100 + 1e-9, grid.max() * 100, 60), 0.0)
        )
        omega = np.unique(np.concatenate([about.ravel(), grid, ends]))
        omega = omega[omega <= np.pi] if discrete else omega
        with np.errstate(all="ignore"):
            inverse = np.linalg.inv(V)
        seen, driven = C @ V, inverse @ plant.Bw

        def responses(omega: Array) -> Array:
            s = np.exp(1j * omega) if discrete else 1j * omega
            return (seen / (s[:, None, None] - poles)) @ driven + plant.Dw

        gains = np.linalg.norm(responses(omega), 2, axis=(1, 2))
        for _ in range(3):
            i = int(np.argmax(gains))
            low, high = omega[max(i - 1, 0)], omega[min(i + 1, len(omega) - 1)]
            omega = np.unique(np.append(np.linspace(low, high, 13), omega[i]))
            gains = np.linalg.norm(responses(omega), 2, axis=(1, 2))
        at = omega[int(np.argmax(gains))]
        s = np.exp(1j * at) if discrete else 1j * at
        resolvent = np.linalg.inv(s * np.eye(len(A)) - A)
        U, S, Vh = np.linalg.svd(C @ resolvent @ plant.Bw + plant.Dw)
        left = U[:, 0].conj() @ (C @ resolvent @ plant.B + plant.D)
        right = self.Cy @ resolvent @ plant.Bw @ Vh[0].conj()
        return float(np.log(S[0])), np.real(np.outer(left, right) * self.unit).ravel() / S[0]


def best_of_many(
    plant: GeneralizedPlant, Cy: Array, seed: int, starts: int = STARTS, also: tuple[Array, ...] = ()
) -> list[Array]:
    """The ends of descents from many starts, shapes (m, q), the lowest norm first; an end is stable, with |K_ij| <= 1e5."""
    loops, generator, ends = Loops(plant, Cy), np.random.default_rng(seed), []
    points = [generator.standard_normal(loops.unit.size) * 10 ** generator.uniform(*SIZES) for _ in range(starts)]
    for x in [K.ravel() / loops.unit.ravel() for K in also] + points:
        if loops.norm(x)[0] == np.inf:
            x = _until_stable(loops, x)
            if x is None:
                continue
        for _ in range(2):  # BFGS stalls on an edge; from there again
            x = bfgs(loops.norm, x, 80)
        K = loops.gain(x)
        if np.abs(K).max() <= LARGEST:
            ends.append((loops.norm(x)[0], K))
    return [K for _, K in sorted(ends, key=lambda end: end[0])]


def _until_stable(loops: Loops, x: Array) -> Array | None:
    x = bfgs(loops.growth, x, 100, 0.0)
    return x if loops.norm(x)[0] < np.inf else None


def bfgs(function: Callable[[Array], tuple[float, Array]], x: Array, rounds: int, below: float = -np.inf) -> Array:
    """BFGS with a weak Wolfe search, which copes with edges."""
    H, (value, slope) = np.eye(len(x)), function(x)
    H = H * 0.1 / max(float(np.linalg.norm(slope)), 1e-12)
    for _ in range(rounds):
        if value < below:
            break
        d = -H @ slope
        fall = float(slope @ d)
        if not fall < -1e-9:
            break
        low, high, t, best = 0.0, np.inf, 1.0, None
        for _ in range(20):
            there, its = function(x + t * d)
            if not there <= value + 1e-4 * t * fall:
                high = t
            else:
                best = t, there, its
                if its @ d >= 0.5 * fall:
                    break
                low = t
            t = (low + high) / 2 if np.isfinite(high) else 2 * t
        if best is None:
            break
        t, there, its = best
        s, y = t * d, its - slope
        if (c := float(s @ y)) > 0:
            E = np.eye(len(x)) - np.outer(s, y) / c
            H = E @ H @ E.T + np.outer(s, s) / c
        x, value, slope = x + s, there, its
    return x


def random_case(seed: int) -> tuple[GeneralizedPlant, Array, float]:
    """A plant of 1 to 10 states, what is measured, and a sample period; every second is unstable, though not with the right gain.

    Every third has uneven units; every second pair has accelerations in z, which forces reach at once.
    """
    g = np.random.default_rng([20261127, seed])
    n = 1 + seed % 10
    m, q, r, d = (int(g.integers(1, min(n, 3) + 1)) for _ in range(4))
    A = g.standard_normal((n, n))
    A = A - (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(n)
    B, Cy, Bw = g.standard_normal((n, m)), g.standard_normal((q, n)), g.standard_normal((n, r))
    if seed % 2:  # the loop of a hidden gain is as stable as the others
        while True:
            free = A - B @ (2 * g.standard_normal((m, q))) @ Cy
            if np.linalg.eigvals(free).real.max() > 0.1:
                break
        A = free
    seen, reached = g.standard_normal((d, n)), np.zeros((d, m))
    if seed // 2 % 2:
        seen, reached = seen @ A, seen @ B
    C, D = np.vstack([seen, np.zeros((m, n))]), np.vstack([reached, 0.1 * np.eye(m)])
    if seed % 3 == 0:
        T, U, Y = (np.diag(10 ** g.uniform(-3, 3, size)) for size in (n, m, q))
        inverse = np.linalg.inv(T)
        A, B, Bw, C, Cy, D = inverse @ A @ T, inverse @ B @ U, inverse @ Bw, C @ T, Y @ Cy @ T, D @ U
    fastest = float(np.abs(np.linalg.eigvals(A)).max())
    return GeneralizedPlant(A, B, Bw, C, D, np.zeros((len(C), r))), Cy, float(10 ** g.uniform(-2, -0.5)) / fastest
