"""The H-infinity norm (18) of a stable system, by two routes that share nothing but the system.

- `level_set_norm`: imaginary eigenvalues of a Hamiltonian tell where the largest singular value crosses a level (Boyd,
  Balakrishnan, Kabamba 1989; Bruinsma, Steinbuch 1990). It cannot overlook a peak, up to the rounding of eigenvalues.
- `sweep_norm`: a frequency sweep that is dense around every pole, refined at every local maximum. It believes only values that
  the transfer function really takes.

`hinf_norm` runs both and says how far they are apart.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import optimize

from models.arrays import Array
from synth.plant import GeneralizedPlant


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
    """Whether every eigenvalue lies left of the imaginary axis."""
    return bool(np.all(np.linalg.eigvals(A).real < 0))


def gain_at(system: GeneralizedPlant, omega: Array) -> Array:
    """Largest singular value of T(j omega), shape (F,), for angular frequencies [rad/s] of shape (F,)."""
    return np.linalg.svd(system.frequency_response(omega), compute_uv=False)[:, 0]


def level_set_norm(system: GeneralizedPlant) -> tuple[float, float]:
    """The norm by level sets, and the frequency [rad/s] where it is reached. The system must be stable."""
    poles = np.linalg.eigvals(system.A)
    omega = np.concatenate([[0.0], np.abs(poles), np.abs(poles.imag)])
    gains = gain_at(system, omega)
    best, at = float(gains.max()), float(omega[gains.argmax()])
    at_infinity = float(np.linalg.norm(system.Dw, 2)) if system.Dw.size else 0.0
    if at_infinity > best:
        best, at = at_infinity, np.inf
    if best == 0.0:
        return 0.0, 0.0

    for _ in range(100):  # quadratic convergence: 3 to 6 rounds
        crossings = _crossings(system, best * (1 + 1e-10))
        if len(crossings) == 0:
            break
        # Between two crossings of the level lies a higher value; a single (touching) crossing is tried as it is.
        tried = np.concatenate([crossings, (crossings[:-1] + crossings[1:]) / 2])
        gains = gain_at(system, tried)
        if gains.max() <= best * (1 + 1e-10):
            break
        best, at = float(gains.max()), float(tried[gains.argmax()])
    return best, at


def _crossings(system: GeneralizedPlant, level: float) -> Array:
    """Frequencies at which a singular value of T equals the level, ascending [rad/s]."""
    A, Bw, C, Dw = system.A, system.Bw, system.C, system.Dw
    r, d = Bw.shape[1], len(C)
    R = level**2 * np.eye(r) - Dw.T @ Dw
    S = level**2 * np.eye(d) - Dw @ Dw.T
    AH = A + Bw @ np.linalg.solve(R, Dw.T @ C)
    # Balanced by the level, so that both off-diagonal blocks have the size of T.
    hamiltonian = np.block(
        [
            [AH, level * Bw @ np.linalg.solve(R, Bw.T)],
            [-level * C.T @ np.linalg.solve(S, C), -AH.T],
        ]
    )
    eigenvalues = np.linalg.eigvals(hamiltonian)
    # Rounding moves a double imaginary eigenvalue by the root of the machine precision. One too many is only tried in vain.
    tolerance = 1e-7 * np.maximum(np.abs(eigenvalues), 1e-7 * np.linalg.norm(hamiltonian, 2))
    return np.sort(eigenvalues.imag[(np.abs(eigenvalues.real) <= tolerance) & (eigenvalues.imag >= 0)])


def sweep_norm(system: GeneralizedPlant) -> tuple[float, float]:
    """The norm by a refined frequency sweep, and where it is reached [rad/s]. The system must be stable."""
    poles = np.linalg.eigvals(system.A)
    size = np.abs(poles)
    floor = max(size.max(initial=0.0) * 1e-12, np.finfo(float).tiny)
    low, high = np.log10(max(size.min(initial=1.0), floor)) - 2, np.log10(max(size.max(initial=1.0), floor)) + 2
    # Around every pole, points spaced by its damping: no resonance is thinner than that.
    widths = np.linspace(-4, 4, 33)
    near = np.abs(poles.imag)[:, None] + np.abs(poles.real)[:, None] * widths
    omega = np.unique(np.concatenate([[0.0], np.logspace(low, high, 400), near[near > 0]]))
    gains = gain_at(system, omega)

    best, at = float(gains.max()), float(omega[gains.argmax()])
    at_infinity = float(np.linalg.norm(system.Dw, 2)) if system.Dw.size else 0.0
    if at_infinity > best:
        best, at = at_infinity, np.inf
    inner = np.flatnonzero((gains[1:-1] >= gains[:-2]) & (gains[1:-1] >= gains[2:])) + 1
    for i in inner[gains[inner] > 0.9 * best]:  # a local maximum far below the best grid point is no peak
        refined: Any = optimize.minimize_scalar(
            lambda log_omega: -gain_at(system, np.array([np.exp(log_omega)]))[0],
            bounds=(np.log(max(omega[i - 1], omega[i] * 1e-3)), np.log(omega[i + 1])),
            method="bounded",
            options={"xatol": 1e-10},
        )
        if -refined.fun > best:
            best, at = float(-refined.fun), float(np.exp(refined.x))
    return best, at
