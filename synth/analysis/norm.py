"""The H-infinity norm (18), by two routes to its peak, and the largest singular value at a frequency.

- `level_set_norm`: the imaginary eigenvalues of a Hamiltonian are the frequencies at which a singular value crosses a level
  (Boyd, Balakrishnan, Kabamba 1989; Bruinsma, Steinbuch 1990). The route misses no peak, up to the rounding of eigenvalues.
- `sweep_norm`: a frequency sweep that is dense around every pole, refined at every local maximum. The transfer function takes
  each of its values, so it is never above the norm.

`hinf_norm` runs both and returns their distance. The routes find the peak on the imaginary axis (the L-infinity norm), or on an
interval of it. That peak exists for unstable systems, too, and is infinite if a pole lies on the axis.

Both routes share the transfer function. The modes of the system, which are cheap to evaluate, only propose frequencies. The
returned values are computed without them, from a linear system of equations.

The rounding of the values is bounded, to first order. The bound is large for a huge gain, whose loop A + B G has fast and slow
poles. Then both routes refine their results with twice the digits, on the loop before it was rounded.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.extensions import FEATURES
from models.common.threads import one_thread
from synth.analysis.stability import balance, stability, stability_of_balanced
from synth.plant.double_double import CONVERGED_CHANGE, MOST_TURNS, exact_product, exact_sum, product
from synth.plant.generalized import Plant

ZOOMS = 6  # tenfold refinements of a bracket: 1e-12 of the gain, as a maximum is flat
CLOSE_ZOOMS = 8  # with twice the digits: 1e-16 of the gain
WITHIN = 1e-4  # step of a parabola through a peak, as a share of the damping of the nearest pole
ILL_CONDITIONED = 1e6  # of the eigenvectors; beyond it the modes give fewer than ten digits
ALIKE = 1e-9  # relative to the largest gain; modes this close to the transfer function may propose frequencies


def largest_singular_values(T: Array) -> Array:
    """Returns the largest singular value of each matrix of a stack, shape (F,) for (F, d, r)."""
    if 1 in T.shape[1:]:
        return np.sqrt(np.sum(np.real(T) ** 2 + np.imag(T) ** 2, axis=(1, 2)))  # the singular value of a vector is its length
    square = _smaller_square(T)
    if square.shape[1] == 2:  # a quadratic equation, without cancellation in its larger root
        a, b, c = np.real(square[:, 0, 0]), np.abs(square[:, 0, 1]), np.real(square[:, 1, 1])
        return np.sqrt((a + c) / 2 + np.hypot((a - c) / 2, b))
    return np.sqrt(np.maximum(np.linalg.eigvalsh(square)[:, -1], 0.0))  # the largest one keeps its digits when squared


def highest(T: Array, above: float) -> tuple[float, int]:
    """Returns the largest singular value of a whole stack of matrices, shape (F, d, r), and the index of its matrix.

    Only values above `above` count: 0 and the index -1 if no value is. The cheap Frobenius norm excludes most matrices.
    """
    squares = (np.real(T) ** 2 + np.imag(T) ** 2).reshape(len(T), -1).sum(axis=1)
    among = np.flatnonzero(~(squares <= above * above))
    if not len(among):
        return 0.0, -1
    gains = largest_singular_values(T[among])
    i = int(gains.argmax())
    return float(gains[i]), int(among[i])


def _smaller_square(T: Array) -> Array:
    """Returns T T' or T' T, the smaller one."""
    adjoint = T.conj().transpose(0, 2, 1)
    return T @ adjoint if T.shape[1] < T.shape[2] else adjoint @ T


def transfer_matrix_closely(system: Plant, omega: Array) -> tuple[Array, Array]:
    """Returns Dw + C (j omega - A)^-1 Bw (19) with twice the digits, and an estimate of its error.

    The residual of the linear system is computed with twice the digits and solved for again, until the answer converges
    (Higham 2002, Accuracy and Stability of Numerical Algorithms, chapter 12). It fails if A leaves floats no digit at all.

    Args:
        system: system from w to z, whose `beyond` counts.
        omega: angular frequencies [rad/s], shape (F,).

    Returns:
        T, complex, shape (F, d, r), and the largest change of its entries in the last iteration, shape (F,).
    """
    (n, r), Bw, A, C = system.Bw.shape, system.Bw, system.A, system.C
    beyond = np.zeros((n + len(C), n)) if system.beyond is None else system.beyond
    A_low, C_low = beyond[:n], beyond[n:]
    turned = omega[:, None, None]
    shifted, right = 1j * turned * np.eye(n) - A, np.hstack([Bw, np.zeros((n, r))])
    high, low = np.zeros((2, len(omega), n, 2 * r))  # real parts beside imaginary ones
    T, moved = np.zeros((len(omega), len(C), r), dtype=complex), np.full(len(omega), np.inf)
    for _ in range(MOST_TURNS):
        by, into = exact_product(turned, _times_j(high)), product(A, high)
        change, lost = exact_sum(into[0], -by[0])
        residual, rest = exact_sum(right, change)
        residual += rest + lost + into[1] - by[1] + A @ low + A_low @ high - turned * _times_j(low)
        step = np.linalg.solve(shifted, residual[..., :r] + 1j * residual[..., r:])
        high, lost = exact_sum(high, np.concatenate([np.real(step), np.imag(step)], axis=-1))
        high, low = exact_sum(high, low + lost)
        out, lost = product(C, high)
        out = out + lost + C @ low + C_low @ high
        before, T = T, out[..., :r] + 1j * out[..., r:] + system.Dw
        moved = np.abs(T - before).max(axis=(1, 2), initial=0.0)
        if np.all(moved <= CONVERGED_CHANGE * np.abs(T).max(axis=(1, 2), initial=0.0)):
            break
    return T, moved


def _times_j(x: Array) -> Array:
    r = x.shape[-1] // 2
    return np.concatenate([-x[..., r:], x[..., :r]], axis=-1)


class Gain:
    """The largest singular value of T(j omega) of a continuous system, in balanced coordinates, on an interval of the axis.

    Args:
        system: system from w to z, with u = 0.
        low: start of the interval [rad/s], from 0.
        high: end of the interval [rad/s], above low; may be infinite.
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
        self.last = (self.system.Dw.size + 4) * np.finfo(float).eps  # relative rounding of a singular value of an exact T
        self.stable = own_stability.stable
        on_axis = np.abs(np.imag(self.poles[own_stability.on_axis]))
        on_axis = on_axis[(on_axis >= low) & (on_axis <= high)]
        self.on_axis = float(on_axis[0]) if len(on_axis) else None
        self.edges = np.array([low, high] if np.isfinite(high) else [low])

    def within(self, omega: Array) -> Array:
        """Returns frequencies [rad/s] clipped to the interval."""
        return np.minimum(np.maximum(omega, self.low), self.high)

    def at(self, omega: Array) -> Array:
        """Returns the largest singular value at angular frequencies [rad/s] of shape (F,), shape (F,)."""
        return np.linalg.norm(self.system.frequency_response(omega), 2, axis=(1, 2))

    def about(self, omega: Array) -> Array:
        """Returns `at` computed by the modes, to ALIKE; `at` itself if they give fewer digits."""
        return self.at(omega) if self._residues is None else self._by_modes(self._residues, omega)

    def at_poles(self) -> float:
        """Returns the largest gain at infinity, at the interval's edges and where poles are: at most the norm, and near it."""
        upper = self.poles[np.imag(self.poles) >= 0]
        omega = self.within(np.concatenate([self.edges, np.abs(upper), np.imag(upper)]))
        gains = largest_singular_values(self.system.frequency_response(omega))
        return max(float(gains.max()), self.at_infinity if self.high == np.inf else 0.0)

    def climb(self, omega: Array, width: Array) -> tuple[float, float]:
        """Returns the highest gain within some widths of some frequencies, and its frequency [rad/s]."""
        at = self._climbed(self.about, omega, width)
        return float(self.at(at)[0]), float(at[0])

    def rounding(self, omega: Array) -> float:
        """Returns a bound on the rounding of `at` at frequencies [rad/s], to first order.

        (Higham 2002, Accuracy and Stability of Numerical Algorithms, section 7.2.)
        """
        A, C, n = self.system.A, np.abs(self.system.C), len(self.system.A)
        R = np.abs(np.linalg.inv(1j * omega[:, None, None] * np.eye(n) - A))
        seen, driven = C @ R, R @ np.abs(self.system.Bw)
        lost = seen @ ((np.abs(A) + omega[:, None, None] * np.eye(n)) @ driven) + C @ driven
        return float((n + 2) * np.finfo(float).eps * np.linalg.norm(lost, axis=(1, 2)).max(initial=0.0))

    def rounded(self, omega: Array) -> float:
        """Returns the largest rounding of `at` at frequencies [rad/s], measured with twice the digits."""
        gains, missing = self.at_double_double(omega)
        return float((np.abs(self.at(omega) - gains) + missing).max())

    def at_double_double(self, omega: Array) -> tuple[Array, Array]:
        """Returns `at` with twice the digits, shape (F,), and bounds on its error."""
        T, missing = transfer_matrix_closely(self.system, omega)
        return largest_singular_values(T), missing

    def missing(self, at: float) -> float:
        """Returns the error bound of `at_double_double` at a frequency; 0 at infinity."""
        return float(self.at_double_double(np.array([at]))[1][0]) if np.isfinite(at) else 0.0

    def grid_error(self, at: float) -> float:
        """Returns the relative excess of a peak between the best frequency and the next one tried, to second order."""
        if not (np.isfinite(at) and len(self.poles)):
            return 0.0
        apart = np.spacing(at) + 10.0**-ZOOMS * float(self._width(np.array([at]))[0])
        return float(np.sum((apart / 2 / np.abs(1j * at - self.poles)) ** 2) / 2)

    def missed_closely(self, at: float) -> float:
        """Returns `grid_error` measured with twice the digits, if rounding may have moved poles and misled the search.

        Near a resonance the gain to the power of -2 is a parabola, fitted here through three frequencies.
        """
        if not (np.isfinite(at) and len(self.poles)):
            return 0.0
        if at > 0 and at in (self.low, self.high):  # an edge was tried itself, and a peak beyond it does not count
            return self.grid_error(at)
        step = max(float(np.spacing(at)), WITHIN * float(self._width(np.array([at]))[0]))
        (below, here, above), _ = self.at_double_double(np.array([at - step, at, at + step]))
        left, right = (here / below) ** 2, (here / above) ** 2
        bent, slope = left + right - 2, (right - left) / 2
        lowest = min(1 - slope**2 / (2 * bent) if bent > 0 else 1.0, left, right)
        return float(lowest**-0.5 - 1)

    def refined_peak(self, at: float) -> tuple[float, float]:
        """Returns the highest gain with twice the digits near a frequency or near any pole, and its frequency [rad/s]."""
        omega = np.concatenate([[self.low], np.abs(self.poles), np.abs(np.imag(self.poles)), [at] if np.isfinite(at) else []])
        omega = self.within(omega)
        gains, _ = self.at_double_double(omega)
        high = np.unique(omega[gains > 0.9 * gains.max()])
        there = self._climbed(lambda near: self.at_double_double(near)[0], high, self._width(high), CLOSE_ZOOMS)
        best, there = float(self.at_double_double(there)[0][0]), float(there[0])
        return self.or_at_infinity(best, there)

    def or_at_infinity(self, best: float, at: float) -> tuple[float, float]:
        """Returns the higher of a gain at a frequency and the gain at infinity, if the interval contains infinity."""
        return (self.at_infinity, np.inf) if self.high == np.inf and self.at_infinity > best else (best, at)

    def _climbed(self, gain: Callable[[Array], Array], omega: Array, width: Array, zooms: int = ZOOMS) -> Array:
        """Returns the frequency of the highest gain within some widths of some frequencies [rad/s], shape (1,)."""
        steps = np.linspace(-1, 1, 21)[:, None]
        for _ in range(zooms):
            near = self.within(omega + width * steps)
            there = gain(near.ravel()).reshape(near.shape)
            omega, width = near[there.argmax(axis=0), np.arange(len(omega))], width / 10
        return omega[[gain(omega).argmax()]]

    def _width(self, omega: Array) -> Array:
        """Returns the damping of the pole nearest to each frequency [rad/s]: no peak is narrower."""
        nearest = np.abs(omega[:, None] * 1j - self.poles).argmin(axis=1)
        return np.abs(np.real(self.poles[nearest]))

    def _by_modes(self, residues: Array, omega: Array) -> Array:
        T = (1 / (1j * omega[:, None] - self.poles)) @ residues
        return largest_singular_values(T.reshape(len(omega), *self.system.Dw.shape) + self.system.Dw)

    @cached_property
    def _residues(self) -> Array | None:
        """C v w' Bw of every mode, with its right and left eigenvectors v and w, shape (n, d r); None if digits are lost."""
        if not len(self.system.A) or not np.linalg.cond(self.vectors) < ILL_CONDITIONED:
            return None
        seen, driven = (self.system.C @ self.vectors).T, np.linalg.solve(self.vectors, self.system.Bw.astype(complex))
        residues = (seen[:, :, None] * driven[:, None, :]).reshape(len(self.system.A), -1)
        probes = self.within(np.concatenate([[0.0], np.quantile(np.abs(self.poles), [0, 0.5, 1])]))
        true = self.at(probes)
        return residues if np.all(np.abs(self._by_modes(residues, probes) - true) <= ALIKE * true.max()) else None


EXACT = 1e-10  # relative; the search ends if the level set this far above the best gain is empty
REFINED_PEAKS = 2  # number of the highest peaks near poles that are refined before the first level set
SEEN = 1e-9  # relative; beyond this rounding a norm is computed with twice the digits
CLEAR = 1.1  # times the gain at infinity: smallest level for which the Hamiltonian is well conditioned


@dataclass(frozen=True)
class Norm:
    """An H-infinity norm.

    Attributes:
        value: the larger of the two routes; infinite if the system is not stable.
        peak_frequency: frequency of the peak [rad/s]; NaN if the system is not stable.
        level_set: the first route's value.
        sweep: the second route's value.
        rounding: relative error of the value, to first order: by rounding, and by a peak between neighbouring floats.
    """

    value: float
    peak_frequency: float
    level_set: float
    sweep: float
    rounding: float = 0.0

    @property
    def gap(self) -> float:
        """Relative difference between the two routes."""
        return abs(self.level_set - self.sweep) / self.value if 0 < self.value < np.inf else 0.0


@one_thread()
def hinf_norm(system: Plant) -> Norm:
    """Returns the H-infinity norm from w to z with u = 0, by both routes.

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
        return discrete_by_both_routes(system, system.dt, Gain(FEATURES.load("discrete plants").continuous_loop(system)))
    gain = Gain(system)
    return by_both_routes(gain) if gain.stable else unstable


def by_both_routes(gain: Gain) -> Norm:
    """Returns the largest gain on an interval of the axis by both routes; the system may be unstable, but has no pole there."""
    (sweep, at_sweep), (level, at_level) = by_sweep(gain), by_level_sets(gain)
    slowest = gain.poles[np.abs(np.real(gain.poles)).argmin()] if len(gain.poles) else 0.0
    ends = gain.within(np.array([0.0, np.abs(np.imag(slowest)), at_sweep, at_level]))
    ends, grid_error = ends[np.isfinite(ends)], gain.grid_error
    rounding = gain.rounding(ends)
    if rounding > SEEN * max(sweep, level):  # this bound is often far too large, so the rounding is measured
        rounding, grid_error = gain.rounded(ends), gain.missed_closely
    if rounding > SEEN * max(sweep, level):
        (sweep, at_sweep), (level, at_level) = gain.refined_peak(at_sweep), gain.refined_peak(at_level)
        rounding = max(gain.missing(at) for at in (at_sweep, at_level))
    value, at = (sweep, at_sweep) if sweep >= level else (level, at_level)
    return Norm(value, at, level, sweep, rounding / value + grid_error(at) + gain.last if value else 0.0)


def discrete_by_both_routes(system: Plant, dt: float, gain: Gain) -> Norm:
    """Returns the largest gain of a discrete system by both routes.

    They run on its bilinear image, which only proposes frequencies. The gain there is that of the discrete system.
    """
    norms, discrete = [], FEATURES.load("discrete plants")
    for route in (by_level_sets, by_sweep):
        value, at = route(gain)
        T, missing = discrete.response_closely(system, at * dt / 2)
        true = float(np.linalg.norm(T, 2))
        norms.append((true, at, (abs(true - value) + missing) / true if true else 0.0))
    (level, _, _), (sweep, _, _) = norms
    value, at, rounding = max(norms)
    return Norm(
        value, discrete.true_frequency(at, dt), level, sweep, rounding + gain.grid_error(at) + gain.last if value else 0.0
    )


def gain_at(system: Plant, omega: float) -> float:
    """Returns the largest singular value at a frequency [rad/s], with twice the digits."""
    if system.dt is not None:
        discrete = FEATURES.load("discrete plants")
        at = discrete.mapped_frequency(omega, system.dt) * system.dt / 2
        return float(np.linalg.norm(discrete.response_closely(system, at)[0], 2))
    return float(Gain(system).at_double_double(np.array([omega]))[0][0])


def level_set_norm(system: Plant) -> tuple[float, float]:
    """Returns the largest gain of a continuous system on the imaginary axis by level sets, and its frequency [rad/s].

    The eigenvalues only propose frequencies; the transfer function decides. So no tolerance has to tell an imaginary eigenvalue
    from one that rounding moved off the axis.
    """
    return by_level_sets(Gain(system))


def by_level_sets(gain: Gain) -> tuple[float, float]:
    """Returns the largest gain on an interval by level sets, and its frequency [rad/s]; infinite if a pole lies on it."""
    if gain.on_axis is not None:
        return np.inf, gain.on_axis
    omega = gain.within(np.concatenate([gain.edges, np.abs(gain.poles), np.abs(np.imag(gain.poles))]))
    width = np.concatenate([0.0 * gain.edges, *[np.abs(np.real(gain.poles))] * 2])
    highest = np.argsort(gain.about(omega))[-REFINED_PEAKS:]
    best, at = gain.or_at_infinity(*gain.climb(omega[highest], width[highest]))
    if best == 0.0:
        return 0.0, 0.0
    for _ in range(100):  # quadratic convergence: 1 to 3 rounds
        proposed, apart = proposals(gain, best * (1 + EXACT))
        gains = gain.about(proposed)
        if gain.at(proposed[[gains.argmax()]])[0] <= best * (1 + EXACT):
            break
        highest = gains.argsort()[-REFINED_PEAKS:]
        best, at = gain.climb(proposed[highest], apart[highest])
    return best, at


def proposals(gain: Gain, level: float) -> tuple[Array, Array]:
    """Returns the crossings of a level and the points between them, shape (k,), and half their spacing, shape (k,) [rad/s].

    Between two crossings, or a crossing and an edge, the gain lies above the level everywhere, or nowhere. So if any gain is
    above the level, one of these is.
    """
    crossings = level_crossings(gain.system, level)
    crossings = np.concatenate([gain.edges[:1], crossings[(crossings > gain.low) & (crossings < gain.high)], gain.edges[1:]])
    proposed = np.concatenate([crossings, (crossings[:-1] + crossings[1:]) / 2])
    return proposed, np.concatenate([np.zeros(len(crossings)), np.diff(crossings) / 2])


def level_crossings(system: Plant, level: float) -> Array:
    """Returns the imaginary parts >= 0 of all eigenvalues of the Hamiltonian, ascending from 0 [rad/s], shape (k,), 1 <= k.

    They contain every frequency at which a singular value of Dw + C (s - A)^-1 Bw equals the level.
    """
    A, Bw, C, Dw = system.A, system.Bw, system.C, system.Dw
    n, (d, r) = len(A), Dw.shape
    through = bool(Dw.any())
    if not through or level > CLEAR * np.linalg.norm(Dw, 2):
        # The Hamiltonian, from which w and z are eliminated.
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
        # A pencil with w and z as unknowns, as their elimination is singular if the level is the gain at infinity. The error of
        # its eigenvalues grows with its largest entry, so units of time, states and z (powers of two) make the entries similar.
        rate, of_z = _power_of_two(float(np.linalg.norm(A, 2))), _power_of_two(level)
        A, Bw, C, Dw, level = A / rate, Bw / rate, C / of_z, Dw / of_z, level / of_z
        of_states = _power_of_two(float(np.sqrt(np.linalg.norm(Bw) / (np.linalg.norm(C) or 1.0))))
        Bw, C = Bw / of_states, C * of_states
        pencil = np.zeros((2 * n + r + d, 2 * n + r + d))
        pencil[:n, :n], pencil[n : 2 * n, n : 2 * n] = A, -A.T
        pencil[:n, 2 * n : 2 * n + r], pencil[n : 2 * n, 2 * n + r :] = Bw, -C.T
        pencil[2 * n : 2 * n + d, :n], pencil[2 * n + d :, n : 2 * n] = C, Bw.T
        pencil[2 * n : 2 * n + d, 2 * n : 2 * n + r], pencil[2 * n + d :, 2 * n + r :] = Dw, Dw.T
        pencil[2 * n : 2 * n + d, 2 * n + r :], pencil[2 * n + d :, 2 * n : 2 * n + r] = -level * np.eye(d), -level * np.eye(r)
        dynamic = np.diag([1.0] * 2 * n + [0.0] * (r + d))
        with np.errstate(divide="ignore", invalid="ignore"):  # the eigenvalues at infinity
            eigenvalues = linalg.eigvals(pencil, dynamic)
        eigenvalues = rate * eigenvalues[np.isfinite(eigenvalues)]
    proposed = np.imag(eigenvalues)
    return np.append(0.0, np.sort(proposed[proposed > 0]))  # they come in conjugate pairs


def _power_of_two(size: float) -> float:
    """Returns the power of two next to a size; 1 if the size is 0 or not finite."""
    return 2.0 ** round(np.log2(size)) if 0 < size < np.inf else 1.0


def sweep_norm(system: Plant) -> tuple[float, float]:
    """Returns the largest gain on the imaginary axis by a refined frequency sweep, and its frequency [rad/s]."""
    return by_sweep(Gain(system))


def by_sweep(gain: Gain) -> tuple[float, float]:
    """Returns the largest gain on an interval by a sweep, and its frequency [rad/s]; infinite if a pole lies on it."""
    if gain.on_axis is not None:
        return np.inf, gain.on_axis
    size = np.abs(gain.poles)
    floor = max(size.max(initial=0.0) * 1e-12, np.finfo(float).tiny)
    low, high = (np.log10(max(edge, floor)) for edge in (size.min(initial=1.0), size.max(initial=1.0)))
    # Around every pole, points spaced by its damping: no resonance is narrower than that.
    widths = np.linspace(-4, 4, 33)
    upper = gain.poles[np.imag(gain.poles) >= 0]
    near = np.imag(upper)[:, None] + np.abs(np.real(upper))[:, None] * widths
    coarse = np.logspace(low - 2, high + 2, int(40 * (high - low + 4)))
    omega = np.concatenate([gain.edges, coarse, near[near > 0]])
    omega = np.unique(omega[(omega >= gain.low) & (omega <= gain.high)])
    gains = gain.about(omega)

    start = np.array([gains.argmax()])
    # A local maximum far below the best grid point cannot be the peak.
    inner = np.flatnonzero((gains[1:-1] >= gains[:-2]) & (gains[1:-1] >= gains[2:]) & (gains[1:-1] > 0.9 * gains[start])) + 1
    tops = np.unique(np.concatenate([start, inner]))
    padded = np.concatenate([omega[:1], omega, omega[-1:]])
    return gain.or_at_infinity(*gain.climb(omega[tops], np.maximum(padded[tops + 2] - omega[tops], omega[tops] - padded[tops])))
