"""The H-infinity norm (18), by two routes to its peak.

- `level_set_norm`: imaginary eigenvalues of a Hamiltonian tell where the largest singular value crosses a level (Boyd,
  Balakrishnan, Kabamba 1989; Bruinsma, Steinbuch 1990). It cannot overlook a peak, up to the rounding of eigenvalues.
- `sweep_norm`: a frequency sweep that is dense around every pole, refined at every local maximum. It believes only values that
  the transfer function really takes.

`hinf_norm` runs both and says how far they are apart. The routes themselves find the peak on the imaginary axis (the L-infinity
norm), or on a stretch of it, which exists for unstable systems too and is infinite where a pole lies on the axis.

What they share is the transfer function. Where to look is decided with the modes of the system, a frequency of which costs next
to nothing; every value that is returned was computed without them, from a linear system of equations.

What rounding may have done to the values is bounded, to first order. Where that could be seen, as with a huge gain, whose loop
A + B G holds fast poles beside slow ones, both routes go on from where they ended with twice the digits, on the loop as it was
before it was rounded. So two routes that agree are not two that err alike.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.threads import one_thread
from synth.certificate.gain import Gain
from synth.certificate.stability import stability
from synth.discrete.bilinear import continuous_loop, mapped_frequency, true_frequency
from synth.discrete.response import response_closely
from synth.plant import GeneralizedPlant

EXACT = 1e-10  # relative; a level set this much higher that is empty ends the search
CLIMBED = 2  # of the poles' peaks, the highest: as many are climbed before the first level set
SEEN = 1e-9  # relative; more than this rounding may not do to a norm, or it is computed with twice the digits
CLEAR = 1.1  # times the gain at infinity: a level above it is far enough for the Hamiltonian to be formed


@dataclass(frozen=True)
class Norm:
    """An H-infinity norm.

    Attributes:
        value: the larger of the two routes; infinite where the system is not stable.
        peak_frequency: where it is reached [rad/s]; NaN where the system is not stable.
        level_set: the first route's value.
        sweep: the second route's value.
        rounding: relative; how far from the true norm the value may be, to first order: by rounding, and where the peak lies
            between the frequencies that were tried, as floats are too far apart to hold that of a damping of 1e-12.
    """

    value: float
    peak_frequency: float
    level_set: float
    sweep: float
    rounding: float = 0.0

    @property
    def gap(self) -> float:
        """Relative distance of the two routes."""
        return abs(self.level_set - self.sweep) / self.value if 0 < self.value < np.inf else 0.0


@one_thread()
def hinf_norm(system: GeneralizedPlant) -> Norm:
    """The H-infinity norm from w to z with u = 0, by both routes."""
    unstable = Norm(np.inf, np.nan, np.inf, np.inf)
    if system.dt is not None:
        stable = stability(system.A, system.dt).stable
        return discrete_by_both_routes(system, system.dt, Gain(continuous_loop(system))) if stable else unstable
    gain = Gain(system)
    return by_both_routes(gain) if gain.stable else unstable


def by_both_routes(gain: Gain) -> Norm:
    """The largest gain on a stretch of the axis by both routes, whether the system is stable or not; no pole lies on it."""
    (sweep, at_sweep), (level, at_level) = by_sweep(gain), by_level_sets(gain)
    slowest = gain.poles[np.abs(np.real(gain.poles)).argmin()] if len(gain.poles) else 0.0
    ends = gain.within(np.array([0.0, np.abs(np.imag(slowest)), at_sweep, at_level]))
    ends, beside = ends[np.isfinite(ends)], gain.beside
    rounding = gain.rounding(ends)
    if rounding > SEEN * max(sweep, level):  # a bound that is often far too large: so it is measured, and all else, too
        rounding, beside = gain.rounded(ends), gain.between
    if rounding > SEEN * max(sweep, level):
        (sweep, at_sweep), (level, at_level) = gain.polished(at_sweep), gain.polished(at_level)
        rounding = max(gain.missing(at) for at in (at_sweep, at_level))
    value, at = (sweep, at_sweep) if sweep >= level else (level, at_level)
    return Norm(value, at, level, sweep, rounding / value + beside(at) + gain.last if value else 0.0)


def discrete_by_both_routes(system: GeneralizedPlant, dt: float, gain: Gain) -> Norm:
    """The same of a discrete system: both routes on the continuous one for it, and what they find measured on the system itself.

    So the map only says where to look, and what it and rounding did to the values is seen.
    """
    found = []
    for route in (by_level_sets, by_sweep):
        value, at = route(gain)
        T, missing = response_closely(system, at * dt / 2)
        true = float(np.linalg.norm(T, 2))
        found.append((true, at, (abs(true - value) + missing) / true if true else 0.0))
    (level, _, _), (sweep, _, _) = found
    value, at, rounding = max(found)
    return Norm(value, true_frequency(at, dt), level, sweep, rounding + gain.beside(at) + gain.last if value else 0.0)


def gain_at(system: GeneralizedPlant, omega: float) -> float:
    """The largest singular value at a frequency [rad/s], with twice the digits."""
    if system.dt is not None:
        return float(np.linalg.norm(response_closely(system, mapped_frequency(omega, system.dt) * system.dt / 2)[0], 2))
    return float(Gain(system).closely(np.array([omega]))[0][0])


def level_set_norm(system: GeneralizedPlant) -> tuple[float, float]:
    """The largest gain of a continuous system on the imaginary axis by level sets, and the frequency [rad/s] where it is reached.

    The eigenvalues only propose frequencies, whatever their real parts; the transfer function decides. So no tolerance has to
    tell an imaginary eigenvalue from one that rounding moved off the axis.
    """
    return by_level_sets(Gain(system))


def by_level_sets(gain: Gain) -> tuple[float, float]:
    """The largest gain on a stretch of the axis as `level_set_norm` finds it, and where [rad/s]; infinite at a pole on it."""
    if gain.on_axis is not None:
        return np.inf, gain.on_axis
    omega = gain.within(np.concatenate([gain.edges, np.abs(gain.poles), np.abs(np.imag(gain.poles))]))
    width = np.concatenate([0.0 * gain.edges, *[np.abs(np.real(gain.poles))] * 2])
    highest = np.argsort(gain.about(omega))[-CLIMBED:]
    best, at = gain.or_at_infinity(*gain.climb(omega[highest], width[highest]))
    if best == 0.0:
        return 0.0, 0.0
    for _ in range(100):  # quadratic convergence: 1 to 3 rounds
        proposed, apart = proposals(gain, best * (1 + EXACT))
        gains = gain.about(proposed)
        if gain.at(proposed[[gains.argmax()]])[0] <= best * (1 + EXACT):
            break
        highest = gains.argsort()[-CLIMBED:]
        best, at = gain.climb(proposed[highest], apart[highest])
    return best, at


def proposals(gain: Gain, level: float) -> tuple[Array, Array]:
    """Frequencies of a stretch of which one has a gain above a level, if any has, and how far each is from the next [rad/s].

    Between two crossings of the level, or a crossing and an edge, the gain lies above it everywhere, or nowhere; a single
    (touching) crossing is tried as it is. Both of shape (k,).
    """
    crossings = level_crossings(gain.A, gain.Bw, gain.C, gain.Dw, level)
    crossings = np.concatenate([gain.edges[:1], crossings[(crossings > gain.low) & (crossings < gain.high)], gain.edges[1:]])
    proposed = np.concatenate([crossings, (crossings[:-1] + crossings[1:]) / 2])
    return proposed, np.concatenate([np.zeros(len(crossings)), np.diff(crossings) / 2])


def level_crossings(A: Array, Bw: Array, C: Array, Dw: Array, level: float) -> Array:
    """Imaginary parts >= 0 of all eigenvalues of the Hamiltonian, ascending from 0 [rad/s], shape (k,), 1 <= k.

    Every frequency at which a singular value of Dw + C (s - A)^-1 Bw equals the level is among them.
    """
    n, (d, r) = len(A), Dw.shape
    through = bool(Dw.any())
    if not through or level > CLEAR * np.linalg.norm(Dw, 2):
        # [A Bw; -C' -A'] with w and z, unknowns of their own in the pencil below, put in.
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
        # With w and z kept as unknowns nothing is inverted that is singular where the level is near the gain at infinity. The
        # eigenvalues lose digits of the pencil's largest entry: so time, states and z are first counted in units that make the
        # entries alike, of powers of two, which round nothing.
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
    """The power of two next to a size; 1 where it is 0 or not finite."""
    return 2.0 ** round(np.log2(size)) if 0 < size < np.inf else 1.0


def sweep_norm(system: GeneralizedPlant) -> tuple[float, float]:
    """The largest gain on the imaginary axis by a refined frequency sweep, and where it is reached [rad/s]."""
    return by_sweep(Gain(system))


def by_sweep(gain: Gain) -> tuple[float, float]:
    """The largest gain on a stretch of the axis as `sweep_norm` finds it, and where [rad/s]; infinite at a pole on it."""
    if gain.on_axis is not None:
        return np.inf, gain.on_axis
    size = np.abs(gain.poles)
    floor = max(size.max(initial=0.0) * 1e-12, np.finfo(float).tiny)
    low, high = (np.log10(max(edge, floor)) for edge in (size.min(initial=1.0), size.max(initial=1.0)))
    # Around every pole, points spaced by its damping: no resonance is thinner than that.
    widths = np.linspace(-4, 4, 33)
    upper = gain.poles[np.imag(gain.poles) >= 0]
    near = np.imag(upper)[:, None] + np.abs(np.real(upper))[:, None] * widths
    coarse = np.logspace(low - 2, high + 2, int(40 * (high - low + 4)))
    omega = np.concatenate([gain.edges, coarse, near[near > 0]])
    omega = np.unique(omega[(omega >= gain.low) & (omega <= gain.high)])
    gains = gain.about(omega)

    start = np.array([gains.argmax()])
    # A local maximum far below the best grid point is no peak.
    inner = np.flatnonzero((gains[1:-1] >= gains[:-2]) & (gains[1:-1] >= gains[2:]) & (gains[1:-1] > 0.9 * gains[start])) + 1
    tops = np.unique(np.concatenate([start, inner]))
    padded = np.concatenate([omega[:1], omega, omega[-1:]])
    return gain.or_at_infinity(*gain.climb(omega[tops], np.maximum(padded[tops + 2] - omega[tops], omega[tops] - padded[tops])))
