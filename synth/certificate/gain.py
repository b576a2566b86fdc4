"""The largest singular value of a transfer function on the imaginary axis: computed, climbed, and what rounding did to it.

Where to look is decided with the modes of the system, a frequency of which costs next to nothing; every value that is returned
was computed without them, from a linear system of equations.
"""

from collections.abc import Callable
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from synth.certificate.stability import balance, stability_of_balanced
from synth.extended import transfer_matrix_closely
from synth.plant import GeneralizedPlant

ZOOMS = 6  # of a bracket, tenfold; a maximum is flat: 10^-12 of the gain
CLOSE_ZOOMS = 8  # where the gain has twice the digits: 10^-16 of it
WITHIN = 1e-4  # of the damping of the nearest pole; so close to its top it is a parabola
ILL_CONDITIONED = 1e6  # of the eigenvectors; beyond it the modes give fewer than ten digits
ALIKE = 1e-9  # relative to the largest gain; where the modes are as close to the transfer function they may say where to look


def transfer_matrix(A: Array, Bw: Array, C: Array, Dw: Array, omega: Array) -> Array:
    """Dw + C (j omega - A)^-1 Bw (19), complex, shape (F, d, r), for finite angular frequencies [rad/s] of shape (F,)."""
    n = len(A)
    shifted = np.broadcast_to(-A, (len(omega), n, n)).astype(complex)
    shifted[:, np.arange(n), np.arange(n)] += 1j * omega[:, None]
    return C @ np.linalg.solve(shifted, np.broadcast_to(Bw.astype(complex), (len(omega), *Bw.shape))) + Dw


def largest_singular_values(T: Array) -> Array:
    """Of each of a stack of matrices, shape (F,) for (F, d, r)."""
    if 1 in T.shape[1:]:
        return np.sqrt(np.sum(np.real(T) ** 2 + np.imag(T) ** 2, axis=(1, 2)))  # of a vector the singular value is its length
    square = _smaller_square(T)
    if square.shape[1] == 2:  # a quadratic equation, and nothing cancels in its larger root
        a, b, c = np.real(square[:, 0, 0]), np.abs(square[:, 0, 1]), np.real(square[:, 1, 1])
        return np.sqrt((a + c) / 2 + np.hypot((a - c) / 2, b))
    return np.sqrt(np.maximum(np.linalg.eigvalsh(square)[:, -1], 0.0))  # the largest one keeps its digits when squared


def highest(T: Array, above: float) -> tuple[float, int]:
    """The largest singular value of a whole stack of matrices, shape (F, d, r), and the index of the one that has it.

    Only what exceeds `above` is looked at: 0 at no index where nothing does. No singular value exceeds the root of the sum of the
    squares of all entries, which costs little.
    """
    squares = (np.real(T) ** 2 + np.imag(T) ** 2).reshape(len(T), -1).sum(axis=1)
    among = np.flatnonzero(~(squares <= above * above))
    if not len(among):
        return 0.0, -1
    gains = largest_singular_values(T[among])
    i = int(gains.argmax())
    return float(gains[i]), int(among[i])


def _smaller_square(T: Array) -> Array:
    """T T' or T' T, the smaller one."""
    adjoint = T.conj().transpose(0, 2, 1)
    return T @ adjoint if T.shape[1] < T.shape[2] else adjoint @ T


class Gain:
    """The largest singular value of T(j omega) of a continuous system, in balanced coordinates, on a stretch of the axis.

    Args:
        system: its w and z; u = 0.
        low: where the stretch begins [rad/s], from 0.
        high: where it ends [rad/s], above low; may be infinite.
    """

    def __init__(self, system: GeneralizedPlant, low: float = 0.0, high: float = np.inf) -> None:
        self.low, self.high = low, high
        self.A, scale = balance(system.A)
        self.Bw, self.C, self.Dw = system.Bw / scale[:, None], system.C * scale, system.Dw
        beyond = np.zeros((len(self.A) + len(self.C), len(self.A))) if system.beyond is None else system.beyond * scale
        self.A_beyond, self.C_beyond = beyond[: len(self.A)] / scale[:, None], beyond[len(self.A) :]
        found = stability_of_balanced(self.A)
        self.poles, self.vectors = found.poles, found.vectors
        self.at_infinity = float(np.linalg.norm(self.Dw, 2))
        self.last = (self.Dw.size + 4) * np.finfo(float).eps  # what a singular value loses, relative, be T without error
        self.stable = found.stable
        on_axis = np.abs(np.imag(self.poles[found.on_axis]))
        on_axis = on_axis[(on_axis >= low) & (on_axis <= high)]
        self.on_axis = float(on_axis[0]) if len(on_axis) else None
        self.edges = np.array([low, high] if np.isfinite(high) else [low])

    def within(self, omega: Array) -> Array:
        """Frequencies [rad/s], those that lie beside the stretch at its nearer edge."""
        return np.minimum(np.maximum(omega, self.low), self.high)

    def at(self, omega: Array) -> Array:
        """At angular frequencies [rad/s] of shape (F,), shape (F,)."""
        return np.linalg.norm(transfer_matrix(self.A, self.Bw, self.C, self.Dw, omega), 2, axis=(1, 2))

    def about(self, omega: Array) -> Array:
        """The same by the modes, to ALIKE; where they give fewer digits it is `at`."""
        return self.at(omega) if self._residues is None else self._by_modes(self._residues, omega)

    def climb(self, omega: Array, width: Array) -> tuple[float, float]:
        """The highest gain within some widths of some frequencies, and where it is [rad/s]: all of them at once."""
        at = self._climbed(self.about, omega, width)
        return float(self.at(at)[0]), float(at[0])

    def rounding(self, omega: Array) -> float:
        """What rounding did to `at` at frequencies [rad/s] at most, to first order.

        (Higham 2002, Accuracy and Stability of Numerical Algorithms, section 7.2.)
        """
        n = len(self.A)
        R = np.abs(np.linalg.inv(1j * omega[:, None, None] * np.eye(n) - self.A))
        seen, driven = np.abs(self.C) @ R, R @ np.abs(self.Bw)
        lost = seen @ ((np.abs(self.A) + omega[:, None, None] * np.eye(n)) @ driven) + np.abs(self.C) @ driven
        return float((n + 2) * np.finfo(float).eps * np.linalg.norm(lost, axis=(1, 2)).max(initial=0.0))

    def rounded(self, omega: Array) -> float:
        """What rounding did to `at` at frequencies [rad/s] at most, measured with twice the digits."""
        gains, missing = self.closely(omega)
        return float((np.abs(self.at(omega) - gains) + missing).max())

    def closely(self, omega: Array) -> tuple[Array, Array]:
        """`at` with twice the digits, shape (F,), and what may be missing in it."""
        T, missing = transfer_matrix_closely((self.A, self.A_beyond), self.Bw, (self.C, self.C_beyond), self.Dw, omega)
        return largest_singular_values(T), missing

    def missing(self, at: float) -> float:
        """What is missing in the gain at a frequency, be it infinite, when it is computed with twice the digits."""
        return float(self.closely(np.array([at]))[1][0]) if np.isfinite(at) else 0.0

    def beside(self, at: float) -> float:
        """How much higher the gain may be between the best frequency that was tried and the next, relative, to second order."""
        if not (np.isfinite(at) and len(self.poles)):
            return 0.0
        apart = np.spacing(at) + 10.0**-ZOOMS * float(self._width(np.array([at]))[0])
        return float(np.sum((apart / 2 / np.abs(1j * at - self.poles)) ** 2) / 2)

    def between(self, at: float) -> float:
        """The same, measured with twice the digits: where rounding may have moved poles and led the search.

        About a resonance the gain to the power of -2 is a parabola: that through three frequencies says how high it rises.
        """
        if not (np.isfinite(at) and len(self.poles)):
            return 0.0
        if at > 0 and at in (self.low, self.high):  # an edge was tried itself, and beyond it nothing counts
            return self.beside(at)
        step = max(float(np.spacing(at)), WITHIN * float(self._width(np.array([at]))[0]))
        (below, here, above), _ = self.closely(np.array([at - step, at, at + step]))
        left, right = (here / below) ** 2, (here / above) ** 2
        bent, slope = left + right - 2, (right - left) / 2
        lowest = min(1 - slope**2 / (2 * bent) if bent > 0 else 1.0, left, right)
        return float(lowest**-0.5 - 1)

    def polished(self, at: float) -> tuple[float, float]:
        """The highest gain with twice the digits near a frequency or near any pole, and where it is [rad/s]."""
        omega = np.concatenate([[self.low], np.abs(self.poles), np.abs(np.imag(self.poles)), [at] if np.isfinite(at) else []])
        omega = self.within(omega)
        gains, _ = self.closely(omega)
        high = np.unique(omega[gains > 0.9 * gains.max()])
        there = self._climbed(lambda near: self.closely(near)[0], high, self._width(high), CLOSE_ZOOMS)
        best, there = float(self.closely(there)[0][0]), float(there[0])
        return self.or_at_infinity(best, there)

    def or_at_infinity(self, best: float, at: float) -> tuple[float, float]:
        """The higher of a gain at a frequency and that at infinity, where the stretch has it."""
        return (self.at_infinity, np.inf) if self.high == np.inf and self.at_infinity > best else (best, at)

    def _climbed(self, gain: Callable[[Array], Array], omega: Array, width: Array, zooms: int = ZOOMS) -> Array:
        """Where a gain is highest within some widths of some frequencies [rad/s], shape (1,)."""
        steps = np.linspace(-1, 1, 21)[:, None]
        for _ in range(zooms):
            near = self.within(omega + width * steps)
            there = gain(near.ravel()).reshape(near.shape)
            omega, width = near[there.argmax(axis=0), np.arange(len(omega))], width / 10
        return omega[[gain(omega).argmax()]]

    def _width(self, omega: Array) -> Array:
        """How far the damping of the nearest pole is from frequencies: no peak is thinner."""
        nearest = np.abs(omega[:, None] * 1j - self.poles).argmin(axis=1)
        return np.abs(np.real(self.poles[nearest]))

    def _by_modes(self, residues: Array, omega: Array) -> Array:
        T = (1 / (1j * omega[:, None] - self.poles)) @ residues
        return largest_singular_values(T.reshape(len(omega), *self.Dw.shape) + self.Dw)

    @cached_property
    def _residues(self) -> Array | None:
        """C v w' Bw of every mode, with its right and left eigenvectors v and w, shape (n, d r); None where digits are lost."""
        if not len(self.A) or not np.linalg.cond(self.vectors) < ILL_CONDITIONED:
            return None
        seen, driven = (self.C @ self.vectors).T, np.linalg.solve(self.vectors, self.Bw.astype(complex))
        residues = (seen[:, :, None] * driven[:, None, :]).reshape(len(self.A), -1)
        probes = self.within(np.concatenate([[0.0], np.quantile(np.abs(self.poles), [0, 0.5, 1])]))
        true = self.at(probes)
        return residues if np.all(np.abs(self._by_modes(residues, probes) - true) <= ALIKE * true.max()) else None
