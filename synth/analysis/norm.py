"""H-infinity norm (18), computed by two methods that search for the peak gain, and the largest singular value at a frequency.

- `level_set_norm`: the imaginary eigenvalues of a Hamiltonian matrix are the frequencies at which a singular value crosses a
  level (Boyd, Balakrishnan, Kabamba 1989; Bruinsma, Steinbuch 1990). The method of level sets misses no peak, unless rounding
  changes the eigenvalues too much.
- `sweep_norm`: a frequency sweep that is dense near every pole and is refined at every local maximum. Each gain in the sweep is
    a gain of the transfer function at a frequency, so the result of the sweep never exceeds the norm.

`hinf_norm` uses both methods, and also returns the difference between the two results. The methods find the peak of the gain on
the imaginary axis (the L-infinity norm), or on an interval of this axis. The peak also exists for unstable systems; it is
infinite if a pole lies on the imaginary axis.

Both methods compute gains from the same transfer function. A modal form of the system, which is cheap to
evaluate, is used only to select frequencies. The returned gains are computed without the modal form, by solving a linear system
of equations.

The rounding errors of the gains are bounded to first order. The bound on the rounding error is large if a very large gain G
causes both fast and slow poles of the loop A + B G. If the bound is large, both methods refine their results in calculations
with twice the precision. For the refinement, the sum A + B G is used without rounding.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.extensions import FEATURES
from models.common.threads import one_thread
from synth.analysis.stability import balance, stability, stability_of_balanced
from synth.plant.generalized import Plant
from synth.plant.units import nearest_power

# number of tenfold refinements of a frequency interval; the gain is then accurate to 1e-12, because it is flat at a maximum
ZOOMS = 6
ILL_CONDITIONED = 1e6  # condition number of the eigenvectors above which the modal form has fewer than ten correct digits
ALIKE = 1e-9  # the modal form may be used to select frequencies if its error is below this multiple of the largest gain


def largest_singular_values(T: Array) -> Array:
    """Returns the largest singular value of each of F matrices, T of shape (F, d, r), as an array of shape (F,)."""
    if 1 in T.shape[1:]:
        # the singular value of a vector is the length of the vector
        return np.sqrt(np.sum(np.real(T) ** 2 + np.imag(T) ** 2, axis=(1, 2)))
    square = _smaller_square(T)
    if square.shape[1] == 2:  # the quadratic equation is solved for its larger root, for which no digits cancel
        a, b, c = np.real(square[:, 0, 0]), np.abs(square[:, 0, 1]), np.real(square[:, 1, 1])
        return np.sqrt((a + c) / 2 + np.hypot((a - c) / 2, b))
    # squaring the matrix does not reduce the accuracy of its largest singular value
    return np.sqrt(np.maximum(np.linalg.eigvalsh(square)[:, -1], 0.0))


def _smaller_square(T: Array) -> Array:
    """Returns T T' or T' T, whichever has fewer rows."""
    adjoint = T.conj().transpose(0, 2, 1)
    return T @ adjoint if T.shape[1] < T.shape[2] else adjoint @ T


class Gain:
    """Largest singular value of the transfer matrix T(j omega) of a continuous system, over an interval of frequencies, in
    balanced coordinates.

    Args:
        system: system from w to z, with u = 0.
        low: lower end of the interval, at least 0 [rad/s].
        high: upper end of the interval, above low [rad/s]; may be infinite.
    """

    def __init__(self, system: Plant, low: float = 0.0, high: float = np.inf) -> None:
        self.low, self.high = low, high
        A, scale = balance(system.A)
        beyond = np.zeros((len(A) + len(system.C), len(A))) if system.beyond is None else system.beyond * scale
        beyond[: len(A)] /= scale[:, None]
        self.system = system.unchecked(A=A, Bw=system.Bw / scale[:, None], C=system.C * scale, beyond=beyond)
        own_stability = stability_of_balanced(A)
        self.poles, self.vectors = own_stability.poles, own_stability.vectors
        self.at_infinity = float(np.linalg.norm(self.system.Dw, 2))
        # relative rounding error of a singular value of T, if T itself is exact
        self.last = (self.system.Dw.size + 4) * np.finfo(float).eps
        self.stable = own_stability.stable
        on_axis = np.abs(np.imag(self.poles[own_stability.on_axis]))
        on_axis = on_axis[(on_axis >= low) & (on_axis <= high)]
        self.on_axis = float(on_axis[0]) if len(on_axis) else None
        self.edges = np.array([low, high] if np.isfinite(high) else [low])

    def within(self, omega: Array) -> Array:
        """Returns the frequencies [rad/s], replacing each frequency outside the interval by the nearest end of the interval."""
        return np.minimum(np.maximum(omega, self.low), self.high)

    def at(self, omega: Array) -> Array:
        """Returns the largest singular value of the transfer matrix at each angular frequency `omega` [rad/s], shape (F,)."""
        return np.linalg.norm(self.system.frequency_response(omega), 2, axis=(1, 2))

    def about(self, omega: Array) -> Array:
        """Returns the gains of `at`, but computed from the modal form if this form's relative error is at most ALIKE."""
        return self.at(omega) if self._residues is None else self._by_modes(self._residues, omega)

    def climb(self, omega: Array, width: Array) -> tuple[float, float]:
        """Returns the highest gain within the distances `width` of the frequencies `omega`, and the frequency of this gain
        [rad/s].
        """
        at = self.climbed(self.about, omega, width)
        return float(self.at(at)[0]), float(at[0])

    def rounding(self, omega: Array) -> float:
        """Returns a first-order bound on the rounding errors of the gains that `at` computes at the frequencies `omega`
        [rad/s].

        Source: Higham 2002, Accuracy and Stability of Numerical Algorithms, section 7.2.
        """
        A, C, n = self.system.A, np.abs(self.system.C), len(self.system.A)
        R = np.abs(np.linalg.inv(1j * omega[:, None, None] * np.eye(n) - A))
        seen, driven = C @ R, R @ np.abs(self.system.Bw)
        lost = seen @ ((np.abs(A) + omega[:, None, None] * np.eye(n)) @ driven) + C @ driven
        return float((n + 2) * np.finfo(float).eps * np.linalg.norm(lost, axis=(1, 2)).max(initial=0.0))

    def grid_error(self, at: float) -> float:
        """Returns the relative amount by which the true peak may exceed the highest gain found, to second order.

        The true peak would lie between the frequency of the highest gain and a neighbouring frequency that was tried.
        """
        if not (np.isfinite(at) and len(self.poles)):
            return 0.0
        apart = np.spacing(at) + 10.0**-ZOOMS * float(self.width(np.array([at]))[0])
        return float(np.sum((apart / 2 / np.abs(1j * at - self.poles)) ** 2) / 2)

    def or_at_infinity(self, best: float, at: float) -> tuple[float, float]:
        """Returns the gain `best` or the gain at infinite frequency, whichever is larger, and its frequency: `at` or infinity.

        Infinite frequency is considered only if the interval is unbounded.
        """
        return (self.at_infinity, np.inf) if self.high == np.inf and self.at_infinity > best else (best, at)

    def climbed(self, gain: Callable[[Array], Array], omega: Array, width: Array, zooms: int = ZOOMS) -> Array:
        """Returns the frequency [rad/s] of the highest gain within the distances `width` of the frequencies `omega`, shape
        (1,).
        """
        steps = np.linspace(-1, 1, 21)[:, None]
        for _ in range(zooms):
            near = self.within(omega + width * steps)
            there = gain(near.ravel()).reshape(near.shape)
            omega, width = near[there.argmax(axis=0), np.arange(len(omega))], width / 10
        return omega[[gain(omega).argmax()]]

    def width(self, omega: Array) -> Array:
        """Returns the damping of the pole that is nearest to each frequency [rad/s]. No peak is narrower than this damping."""
        nearest = np.abs(omega[:, None] * 1j - self.poles).argmin(axis=1)
        return np.abs(np.real(self.poles[nearest]))

    def _by_modes(self, residues: Array, omega: Array) -> Array:
        T = (1 / (1j * omega[:, None] - self.poles)) @ residues
        return largest_singular_values(T.reshape(len(omega), *self.system.Dw.shape) + self.system.Dw)

    @cached_property
    def _residues(self) -> Array | None:
        """Residues C v w' Bw of the modes, shape (n, d r), where v and w are the right and left eigenvectors.

        The residues are None if the modal form loses too many digits.
        """
        if not len(self.system.A) or not np.linalg.cond(self.vectors) < ILL_CONDITIONED:
            return None
        seen, driven = (self.system.C @ self.vectors).T, np.linalg.solve(self.vectors, self.system.Bw.astype(complex))
        residues = (seen[:, :, None] * driven[:, None, :]).reshape(len(self.system.A), -1)
        probes = self.within(np.concatenate([[0.0], np.quantile(np.abs(self.poles), [0, 0.5, 1])]))
        true = self.at(probes)
        return residues if np.all(np.abs(self._by_modes(residues, probes) - true) <= ALIKE * true.max()) else None


EXACT = 1e-10  # the search ends if no gain exceeds the best gain by more than this relative amount
REFINED_PEAKS = 2  # number of the highest peaks near poles that are refined before the first level is tested
SEEN = 1e-9  # a norm is computed again with twice the precision if its relative rounding error exceeds this
CLEAR = 1.1  # smallest level at which the Hamiltonian matrix is well conditioned, as a multiple of the gain at infinity


@dataclass(frozen=True)
class Norm:
    """H-infinity norm of a system, computed by two methods.

    Attributes:
        value: larger of the norms found by the two methods; infinite if the system is not stable.
        peak_frequency: frequency of the peak [rad/s]; NaN if the system is not stable.
        level_set: norm that was found by the method of level sets.
        sweep: norm that was found by the frequency sweep.
        rounding: first-order bound on the relative error of `value`, caused by rounding or by a peak between neighbouring
            frequencies.
    """

    value: float
    peak_frequency: float
    level_set: float
    sweep: float
    rounding: float = 0.0

    @property
    def gap(self) -> float:
        """Relative difference between the norms found by the two methods."""
        return abs(self.level_set - self.sweep) / self.value if 0 < self.value < np.inf else 0.0


@one_thread()
def hinf_norm(system: Plant) -> Norm:
    """Returns the H-infinity norm from w to z for u = 0, computed by level sets and by a frequency sweep.

    Args:
        system: continuous or discrete system from w to z; for a plant with a controller, use `plant.closed_loop(...)`.

    Returns:
        The H-infinity norm, the peak frequency [rad/s] and the results of both methods, as a `Norm`. The norm is infinite if
        the system is not stable.

    Example:
        >>> from synth import GeneralizedPlant, Feedback, hinf_norm
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> loop = oscillator.closed_loop(Feedback(K=[[-2.0]], Cy=[[0, 1]]))
        >>> f"{hinf_norm(loop).value:.4f}"
        '0.2903'
    """
    unstable = Norm(np.inf, np.nan, np.inf, np.inf)
    if system.dt is not None:
        if not stability(system.A, system.dt).stable:
            return unstable
        gain = Gain(FEATURES.load("discrete plants").continuous_loop(system))
        return FEATURES.load("norms with twice the precision").discrete_by_both_routes(system, system.dt, gain)
    gain = Gain(system)
    return by_both_routes(gain) if gain.stable else unstable


def by_both_routes(gain: Gain) -> Norm:
    """Returns the largest gain on a frequency interval, computed by both methods (level sets and frequency sweep).

    The system may be unstable, but it must have no pole on the frequency interval.
    """
    (sweep, at_sweep), (level, at_level) = by_sweep(gain), by_level_sets(gain)
    slowest = gain.poles[np.abs(np.real(gain.poles)).argmin()] if len(gain.poles) else 0.0
    ends = gain.within(np.array([0.0, np.abs(np.imag(slowest)), at_sweep, at_level]))
    ends, grid_error = ends[np.isfinite(ends)], gain.grid_error
    rounding = gain.rounding(ends)
    if rounding > SEEN * max(sweep, level):  # this error bound is often far too large, so the rounding error is measured
        precise = FEATURES.load("norms with twice the precision")
        rounding, grid_error = precise.rounding_error(gain, ends), partial(precise.missed_peak, gain)
        if rounding > SEEN * max(sweep, level):
            (sweep, at_sweep), (level, at_level) = (precise.refined_peak(gain, at) for at in (at_sweep, at_level))
            rounding = max(precise.error_of_precise_gain(gain, at) for at in (at_sweep, at_level))
    value, at = (sweep, at_sweep) if sweep >= level else (level, at_level)
    return Norm(value, at, level, sweep, rounding / value + grid_error(at) + gain.last if value else 0.0)


def level_set_norm(system: Plant) -> tuple[float, float]:
    """Returns the largest gain of a continuous system on the imaginary axis, found by level sets, and its frequency [rad/s].

    Eigenvalues only select frequencies, and the transfer function gives the gains. The method therefore needs no tolerance to
    decide whether an eigenvalue is imaginary.
    """
    return by_level_sets(Gain(system))


def by_level_sets(gain: Gain) -> tuple[float, float]:
    """Returns the largest gain on a frequency interval, found by level sets, and its frequency [rad/s].

    The gain is infinite if a pole lies on the interval.
    """
    if gain.on_axis is not None:
        return np.inf, gain.on_axis
    omega = gain.within(np.concatenate([gain.edges, np.abs(gain.poles), np.abs(np.imag(gain.poles))]))
    width = np.concatenate([0.0 * gain.edges, *[np.abs(np.real(gain.poles))] * 2])
    highest = np.argsort(gain.about(omega))[-REFINED_PEAKS:]
    best, at = gain.or_at_infinity(*gain.climb(omega[highest], width[highest]))
    if best == 0.0:
        return 0.0, 0.0
    for _ in range(100):  # the iteration converges quadratically, in 1 to 3 steps
        proposed, apart = proposals(gain, best * (1 + EXACT))
        gains = gain.about(proposed)
        if gain.at(proposed[[gains.argmax()]])[0] <= best * (1 + EXACT):
            break
        highest = gains.argsort()[-REFINED_PEAKS:]
        best, at = gain.climb(proposed[highest], apart[highest])
    return best, at


def proposals(gain: Gain, level: float) -> tuple[Array, Array]:
    """Returns frequencies at which the gain may exceed the level, and the widths of the searches around these frequencies,
    shapes (k,) [rad/s].

    The frequencies are the crossings of the level, the ends of the interval, and the midpoints between neighbouring
    frequencies. Between two neighbouring crossings of the level, the gain is either everywhere above the level or nowhere.
    Therefore, if the gain exceeds the level anywhere, it exceeds the level at one of the returned frequencies.
    """
    crossings = level_crossings(gain.system, level)
    crossings = np.concatenate([gain.edges[:1], crossings[(crossings > gain.low) & (crossings < gain.high)], gain.edges[1:]])
    proposed = np.concatenate([crossings, (crossings[:-1] + crossings[1:]) / 2])
    return proposed, np.concatenate([np.zeros(len(crossings)), np.diff(crossings) / 2])


def level_crossings(system: Plant, level: float) -> Array:
    """Returns the nonnegative imaginary parts of the eigenvalues of the Hamiltonian matrix in ascending order [rad/s], shape
    (k,).

    The first value of the result is 0. The values include every frequency at which a singular value of Dw + C (s - A)^-1 Bw
    equals the level.
    """
    A, Bw, C, Dw = system.A, system.Bw, system.C, system.Dw
    n, (d, r) = len(A), Dw.shape
    through = bool(Dw.any())
    if not through or level > CLEAR * np.linalg.norm(Dw, 2):
        # Hamiltonian matrix of the loop, from which w and z are eliminated
        into, out, moved = Bw / level, C, A
        if through:
            size = np.linalg.inv(np.eye(r) - (Dw / level).T @ (Dw / level))
            into = into @ size
            out, moved = C + Dw @ size @ (Dw.T @ C) / level**2, A + into @ (Dw.T @ C) / level
        hamiltonian = np.empty((2 * n, 2 * n))
        hamiltonian[:n, :n], hamiltonian[n:, n:] = moved, -moved.T
        hamiltonian[:n, n:], hamiltonian[n:, :n] = into @ Bw.T, -C.T @ out / level
        eigenvalues = np.linalg.eigvals(hamiltonian)
    else:
        # The pencil keeps w and z as unknowns. Eliminating w and z would be impossible if the level equals the gain at
        # infinity. The errors of the eigenvalues grow with the largest entry. The units of time, states and z are therefore
        # powers of two that give the entries similar sizes.
        rate, of_z = nearest_power(float(np.linalg.norm(A, 2))), nearest_power(level)
        A, Bw, C, Dw, level = A / rate, Bw / rate, C / of_z, Dw / of_z, level / of_z
        of_states = nearest_power(float(np.sqrt(np.linalg.norm(Bw) / (np.linalg.norm(C) or 1.0))))
        Bw, C = Bw / of_states, C * of_states
        pencil = np.zeros((2 * n + r + d, 2 * n + r + d))
        pencil[:n, :n], pencil[n : 2 * n, n : 2 * n] = A, -A.T
        pencil[:n, 2 * n : 2 * n + r], pencil[n : 2 * n, 2 * n + r :] = Bw, -C.T
        pencil[2 * n : 2 * n + d, :n], pencil[2 * n + d :, n : 2 * n] = C, Bw.T
        pencil[2 * n : 2 * n + d, 2 * n : 2 * n + r], pencil[2 * n + d :, 2 * n + r :] = Dw, Dw.T
        pencil[2 * n : 2 * n + d, 2 * n + r :], pencil[2 * n + d :, 2 * n : 2 * n + r] = -level * np.eye(d), -level * np.eye(r)
        dynamic = np.diag([1.0] * 2 * n + [0.0] * (r + d))
        with np.errstate(divide="ignore", invalid="ignore"):  # computing eigenvalues at infinity divides by zero
            eigenvalues = linalg.eigvals(pencil, dynamic)
        eigenvalues = rate * eigenvalues[np.isfinite(eigenvalues)]
    proposed = np.imag(eigenvalues)
    # The eigenvalues form conjugate pairs, so the positive imaginary parts are sufficient
    return np.append(0.0, np.sort(proposed[proposed > 0]))


def sweep_norm(system: Plant) -> tuple[float, float]:
    """Returns the largest gain on the imaginary axis, found by a refined frequency sweep, and its frequency [rad/s]."""
    return by_sweep(Gain(system))


def by_sweep(gain: Gain) -> tuple[float, float]:
    """Returns the largest gain on a frequency interval, found by a frequency sweep, and its frequency [rad/s].

    The gain is infinite if a pole lies on the interval.
    """
    if gain.on_axis is not None:
        return np.inf, gain.on_axis
    size = np.abs(gain.poles)
    floor = max(size.max(initial=0.0) * 1e-12, np.finfo(float).tiny)
    low, high = (np.log10(max(edge, floor)) for edge in (size.min(initial=1.0), size.max(initial=1.0)))
    # The spacing of the frequencies around a pole is relative to its damping, because no resonance is narrower than the damping
    widths = np.linspace(-4, 4, 33)
    upper = gain.poles[np.imag(gain.poles) >= 0]
    near = np.imag(upper)[:, None] + np.abs(np.real(upper))[:, None] * widths
    coarse = np.logspace(low - 2, high + 2, int(40 * (high - low + 4)))
    omega = np.concatenate([gain.edges, coarse, near[near > 0]])
    omega = np.unique(omega[(omega >= gain.low) & (omega <= gain.high)])
    gains = gain.about(omega)

    start = np.array([gains.argmax()])
    # A local maximum far below the best grid point cannot be the highest peak.
    inner = np.flatnonzero((gains[1:-1] >= gains[:-2]) & (gains[1:-1] >= gains[2:]) & (gains[1:-1] > 0.9 * gains[start])) + 1
    tops = np.unique(np.concatenate([start, inner]))
    padded = np.concatenate([omega[:1], omega, omega[-1:]])
    return gain.or_at_infinity(*gain.climb(omega[tops], np.maximum(padded[tops + 2] - omega[tops], omega[tops] - padded[tops])))
