"""The H-infinity norm (18), by two routes that share nothing but the system.

- `level_set_norm`: imaginary eigenvalues of a Hamiltonian tell where the largest singular value crosses a level (Boyd,
  Balakrishnan, Kabamba 1989; Bruinsma, Steinbuch 1990). It cannot overlook a peak, up to the rounding of eigenvalues.
- `sweep_norm`: a frequency sweep that is dense around every pole, refined at every local maximum. It believes only values that
  the transfer function really takes.

`hinf_norm` runs both and says how far they are apart. The routes themselves find the peak on the imaginary axis (the L-infinity
norm), which exists for unstable systems too and is infinite where a pole lies on the axis.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from models.arrays import Array
from synth.plant import GeneralizedPlant

ZOOMS = 8  # of a bracket, fivefold; a maximum is flat: 5^-16 of the gain
EXACT = 1e-10  # relative; a level set this much higher that is empty ends the search


@dataclass(frozen=True)
class Norm:
    """An H-infinity norm.

    Attributes:
        value: the larger of the two routes; infinite where the system is unstable.
        peak_frequency: where it is reached [rad/s]; NaN where the system is unstable.
        level_set: the first route's value.
        sweep: the second route's value.
    """

    value: float
    peak_frequency: float
    level_set: float
    sweep: float

    @property
    def gap(self) -> float:
        """Relative distance of the two routes."""
        return abs(self.level_set - self.sweep) / self.value if 0 < self.value < np.inf else 0.0


def hinf_norm(system: GeneralizedPlant) -> Norm:
    """The H-infinity norm from w to z with u = 0, by both routes."""
    if not is_stable(system.A):
        return Norm(np.inf, np.nan, np.inf, np.inf)
    sweep, at_sweep = sweep_norm(system)
    level, at_level = level_set_norm(system)
    return Norm(max(sweep, level), at_sweep if sweep >= level else at_level, level, sweep)


def is_stable(A: Array) -> bool:
    """Whether every eigenvalue lies left of the imaginary axis, by more than rounding."""
    A, _ = balance(A)
    return bool(np.all(np.linalg.eigvals(A).real < -rounding(A)))


def balance(A: Array) -> tuple[Array, Array]:
    """A in the diagonal coordinates that make its rows and columns alike, and that diagonal S: S^-1 A S, S of shape (n,)."""
    if not len(A):
        return A, np.ones(0)
    balanced, (scale, _) = linalg.matrix_balance(A, permute=False, separate=True)
    return np.asarray(balanced), np.asarray(scale)


def gain_at(system: GeneralizedPlant, omega: Array) -> Array:
    """Largest singular value of T(j omega), shape (F,), for angular frequencies [rad/s] of shape (F,)."""
    T = system.frequency_response(omega)
    if 1 in T.shape[1:]:
        return np.linalg.norm(T.reshape(len(T), -1), axis=1)  # of a vector the singular value is its length
    return np.linalg.norm(T, 2, axis=(1, 2))


def transfer_matrix(A: Array, Bw: Array, C: Array, Dw: Array, omega: Array) -> Array:
    """Dw + C (j omega - A)^-1 Bw (19), complex, shape (F, d, r), for finite angular frequencies [rad/s] of shape (F,)."""
    n = len(A)
    shifted = np.broadcast_to(-A, (len(omega), n, n)).astype(complex)
    shifted[:, np.arange(n), np.arange(n)] += 1j * omega[:, None]
    return C @ np.linalg.solve(shifted, np.broadcast_to(Bw.astype(complex), (len(omega), *Bw.shape))) + Dw


def level_set_norm(system: GeneralizedPlant) -> tuple[float, float]:
    """The largest gain on the imaginary axis by level sets, and the frequency [rad/s] where it is reached.

    The eigenvalues only propose frequencies, whatever their real parts; the transfer function decides. So no tolerance has to
    tell an imaginary eigenvalue from one that rounding moved off the axis.
    """
    system, poles, on_axis = _prepared(system)
    if on_axis is not None:
        return np.inf, on_axis
    best, at = _highest(system, np.concatenate([[0.0], np.abs(poles), np.abs(np.imag(poles))]))
    if best == 0.0:
        return 0.0, 0.0
    for _ in range(100):  # quadratic convergence: 3 to 6 rounds
        proposed = level_crossings(system.A, system.Bw, system.C, system.Dw, best * (1 + EXACT))
        # Between two crossings of the level lies a higher value; a single (touching) crossing is tried as it is.
        higher, where = _highest(system, np.concatenate([proposed, (proposed[:-1] + proposed[1:]) / 2]))
        if higher <= best * (1 + EXACT):
            break
        best, at = higher, where
    return best, at


def level_crossings(A: Array, Bw: Array, C: Array, Dw: Array, level: float) -> Array:
    """Imaginary parts >= 0 of all eigenvalues of the Hamiltonian, ascending [rad/s], shape (k,), 1 <= k.

    Every frequency at which a singular value of Dw + C (s - A)^-1 Bw equals the level is among them.
    """
    n, (d, r) = len(A), Dw.shape
    if not Dw.any():
        hamiltonian = np.empty((2 * n, 2 * n))
        hamiltonian[:n, :n], hamiltonian[n:, n:] = A, -A.T
        hamiltonian[:n, n:], hamiltonian[n:, :n] = Bw @ Bw.T / level, -C.T @ C / level
        eigenvalues = np.linalg.eigvals(hamiltonian)
    else:
        # With w and z kept as unknowns nothing is inverted that is singular where the level is near the gain at infinity.
        pencil = np.zeros((2 * n + r + d, 2 * n + r + d))
        pencil[:n, :n], pencil[n : 2 * n, n : 2 * n] = A, -A.T
        pencil[:n, 2 * n : 2 * n + r], pencil[n : 2 * n, 2 * n + r :] = Bw, -C.T
        pencil[2 * n : 2 * n + d, :n], pencil[2 * n + d :, n : 2 * n] = C, Bw.T
        pencil[2 * n : 2 * n + d, 2 * n : 2 * n + r], pencil[2 * n + d :, 2 * n + r :] = Dw, Dw.T
        pencil[2 * n : 2 * n + d, 2 * n + r :], pencil[2 * n + d :, 2 * n : 2 * n + r] = -level * np.eye(d), -level * np.eye(r)
        dynamic = np.diag([1.0] * 2 * n + [0.0] * (r + d))
        with np.errstate(divide="ignore", invalid="ignore"):  # the eigenvalues at infinity
            eigenvalues = linalg.eigvals(pencil, dynamic)
        eigenvalues = eigenvalues[np.isfinite(eigenvalues)]
    return np.unique(np.append(np.abs(np.imag(eigenvalues)), 0.0))


def sweep_norm(system: GeneralizedPlant) -> tuple[float, float]:
    """The largest gain on the imaginary axis by a refined frequency sweep, and where it is reached [rad/s]."""
    system, poles, on_axis = _prepared(system)
    if on_axis is not None:
        return np.inf, on_axis
    size = np.abs(poles)
    floor = max(size.max(initial=0.0) * 1e-12, np.finfo(float).tiny)
    low, high = (np.log10(max(edge, floor)) for edge in (size.min(initial=1.0), size.max(initial=1.0)))
    # Around every pole, points spaced by its damping: no resonance is thinner than that.
    widths = np.linspace(-4, 4, 33)
    near = np.abs(np.imag(poles))[:, None] + np.abs(np.real(poles))[:, None] * widths
    coarse = np.logspace(low - 2, high + 2, int(40 * (high - low + 4)))
    omega = np.unique(np.concatenate([[0.0], coarse, near[near > 0]]))
    gains = gain_at(system, omega)

    best, at = float(gains.max()), float(omega[gains.argmax()])
    at_infinity = float(np.linalg.norm(system.Dw, 2))
    if at_infinity > best:
        best, at = at_infinity, np.inf
    inner = np.flatnonzero((gains[1:-1] >= gains[:-2]) & (gains[1:-1] >= gains[2:])) + 1
    inner = inner[gains[inner] > 0.9 * best]  # a local maximum far below the best grid point is no peak
    if len(inner):
        middle, width = omega[inner], np.maximum(omega[inner + 1] - omega[inner], omega[inner] - omega[inner - 1])
        height = gains[inner]
        for _ in range(ZOOMS):  # all of them at once
            near = np.maximum(middle + width * np.linspace(-1, 1, 11)[:, None], 0.0)
            there = gain_at(system, near.ravel()).reshape(near.shape)
            highest = there.argmax(axis=0), np.arange(len(middle))
            middle, height, width = near[highest], there[highest], width / 5
        if height.max() > best:
            best, at = float(height.max()), float(middle[height.argmax()])
    return best, at


def _prepared(system: GeneralizedPlant) -> tuple[GeneralizedPlant, Array, float | None]:
    """The system in balanced coordinates, its poles, and the frequency of a pole on the imaginary axis if there is one."""
    A, scale = balance(system.A)
    system = GeneralizedPlant(A=A, B=system.B, Bw=system.Bw / scale[:, None], C=system.C * scale, D=system.D, Dw=system.Dw)
    poles = np.linalg.eigvals(A)
    on_axis = np.abs(np.real(poles)) <= rounding(A)
    return system, poles, float(np.abs(np.imag(poles[on_axis])[0])) if np.any(on_axis) else None


def rounding(A: Array) -> float:
    """How far rounding moves the eigenvalues of a balanced matrix [rad/s]."""
    return 10 * np.finfo(float).eps * float(np.linalg.norm(A)) if len(A) else 0.0


def _highest(system: GeneralizedPlant, omega: Array) -> tuple[float, float]:
    """The largest gain among some frequencies and infinity, and where it is [rad/s]."""
    gains = gain_at(system, omega)
    best, at = float(gains.max()), float(omega[gains.argmax()])
    at_infinity = float(np.linalg.norm(system.Dw, 2))
    return (at_infinity, np.inf) if at_infinity > best else (best, at)
