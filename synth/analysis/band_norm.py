"""The norm of a loop within a band of frequencies: computed, and proved by the generalized KYP lemma (Iwasaki, Hara 2005).

The norm is computed like the one on the whole axis (`synth/analysis/norm.py`), by the same two routes. It lies between two
levels: one that the gain reaches at a frequency of the band, and one slightly above, which no frequency of the band exceeds.
For the second, all eigenvalues of the Hamiltonian propose frequencies, whatever their real parts. Between two proposed
frequencies, and between one and an edge, the gain lies above the level everywhere or nowhere.

**A norm in a band says nothing of stability**, nor of other frequencies. For a stable loop, the norm is the largest amplification
of a sinusoid in the band. An unstable loop has a largest singular value too, but no sinusoid ever settles in it: there the number
is that of a formula, and nothing else.

No gain from w to z at a frequency from w1 to w2 reaches gamma if there are a Hermitian P and a Hermitian Q > 0 with

    [ A  Bw ]* [ -Q                P + j (w1 + w2)/2 Q ] [ A  Bw ]     [ C  Dw ]' [ C  Dw ]
    [ I  0  ]  [ *                 -w1 w2 Q            ] [ I  0  ]  +  [       ]  [       ]  -  gamma^2 [ 0 0; 0 I ]  <  0.

If x = (j w - A)^-1 Bw v, the first term is (w - w1)(w2 - w) x* Q x >= 0 for w in the band, and the second is
|z|^2 - gamma^2 |v|^2. The converse is true too, so the lemma is not conservative. For an open band, w2 infinite, Q
replaces -Q, 0 the mean, and -w1^2 Q the last entry: (w^2 - w1^2) x* Q x >= 0.

**The lemma does not imply stability**: P need not be positive. Stability follows from another LMI, (20).

P and Q are taken as they are, and the matrix is computed without rounding (`analysis/rigorous.py`), from the plant's own numbers
and the gain's. A Hermitian matrix S + j K is positive definite if and only if the real one [S -K; K S] is.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, quoted
from synth.analysis.norm import EXACT, Gain, Norm, by_both_routes, discrete_by_both_routes, proposals
from synth.analysis.rigorous import SMALLEST, Definiteness, definiteness, floats, identity, integers, product, zeros
from synth.analysis.stability import Stability, stability
from synth.plant.discrete import continuous_loop, mapped_frequency, true_frequency
from synth.plant.generalized import Feedback, GeneralizedPlant, check_continuous
from synth.plant.numerics import DesignError, numerics


@dataclass(frozen=True, eq=False)
class BandNorm:
    """The largest gain within a band, its frequency and a level that bounds it.

    Attributes:
        value: reached at `peak_frequency`; infinite if a pole lies on the axis within the band.
        peak_frequency: in the band [rad/s]; an edge counts.
        level: slightly above the value; no gain within the band exceeds it.
        low: where the band begins [rad/s].
        high: where it ends [rad/s]; may be infinite.
        gap: relative distance of the two routes to the value.
        rounding: relative error of the value by rounding, to first order.
        stability: of the loop. If it is not stable, no sinusoid settles and the value is no amplification.
    """

    value: float
    peak_frequency: float
    level: float
    low: float
    high: float
    gap: float
    rounding: float
    stability: Stability

    @property
    def words(self) -> str:
        """The norm in the band on one line."""
        band = f"{self.low / (2 * np.pi):.4g} to {self.high / (2 * np.pi):.4g} Hz"
        if not np.isfinite(self.value):
            return f"infinite from {band}: a pole at {self.peak_frequency:.4g} rad/s, to rounding, does not decay"
        text = f"at most {self.value:.7g} from {band}, reached at {self.peak_frequency:.5g} rad/s"
        return text if self.stability.stable else f"{text}, of a loop in which no sinusoid settles: {self.stability.words}"


@numerics()
def norm_in_band(loop: GeneralizedPlant, low: float, high: float) -> BandNorm:
    """Returns the largest gain from w to z with u = 0 at any frequency from low to high.

    Args:
        loop: continuous or discrete; a controlled one is `plant.closed_loop(...)`.
        low: from 0 [rad/s].
        high: above low [rad/s]; may be infinite. The gain of a discrete loop repeats beyond pi / dt.

    Raises:
        InputError: the band is empty or out of range.
        DesignError: a discrete loop has a pole at z = -1.

    Example:
        >>> from synth import GeneralizedPlant, Feedback, norm_in_band
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> loop = oscillator.closed_loop(Feedback(K=[[-2.0]], Cy=[[0, 1]]))
        >>> band = norm_in_band(loop, low=3.0, high=6.0)
        >>> f"{band.value:.4f}, proved to be at most {band.level:.4f}"
        '0.1450, proved to be at most 0.1450'
    """
    gain = _gain(loop, low, high)
    if gain.on_axis is not None:
        norm = Norm(np.inf, true_frequency(gain.on_axis, loop.dt), np.inf, np.inf)
    else:
        norm = by_both_routes(gain) if loop.dt is None else discrete_by_both_routes(loop, loop.dt, gain)
    level, margin = norm.value, max(2 * EXACT, norm.gap, norm.rounding)
    if 0 < level < np.inf:
        while _exceeded(gain, level := norm.value * (1 + margin)):
            margin *= 10
    found = stability(loop.A, loop.dt)
    return BandNorm(norm.value, norm.peak_frequency, level, low, high, norm.gap, float(norm.rounding), found)


@numerics()
def stays_below(loop: GeneralizedPlant, low: float, high: float, level: float) -> bool:
    """Returns True if no gain at a frequency from low to high exceeds a level, up to the rounding of eigenvalues.

    Args:
        loop: continuous or discrete.
        low: as for `norm_in_band`.
        high: likewise.
        level: above 0.

    Raises:
        InputError: the band is empty, or the level is not positive and finite.
        DesignError: a discrete loop has a pole at z = -1.
    """
    if not (_is_number(level) and 0 < level < np.inf):
        raise InputError(f"level = {quoted(level)} is no gain to stay below; give a finite number above 0")
    gain = _gain(loop, low, high)
    return gain.on_axis is None and not _exceeded(gain, level)


def check_band(low: float, high: float) -> None:
    """Raises an InputError if 0 <= low < high [rad/s] is violated."""
    if not (_is_number(low) and _is_number(high) and 0 <= low < high):
        raise InputError(
            f"from {quoted(low)} to {quoted(high)} rad/s is no band; give where it begins, from 0, and where it ends, above that"
        )


def _gain(loop: GeneralizedPlant, low: float, high: float) -> Gain:
    check_band(low, high)
    if loop.dt is None:
        return Gain(loop, low, high)
    if low * loop.dt >= np.pi:
        raise InputError(
            f"the band begins at {low:g} rad/s, and a loop sampled every {loop.dt:g} s has frequencies up to "
            f"{np.pi / loop.dt:g} rad/s; begin below that"
        )
    try:
        mapped = continuous_loop(loop)
    except np.linalg.LinAlgError:
        raise DesignError(
            "the loop has a pole at z = -1, where nothing decays, and no continuous loop does in a band what it does; give one "
            "without"
        ) from None
    return Gain(mapped, mapped_frequency(low, loop.dt), mapped_frequency(high, loop.dt))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.integer | np.floating)


def _exceeded(gain: Gain, level: float) -> bool:
    """Returns True if the gain exceeds the level at some frequency of its interval."""
    if gain.high == np.inf and gain.at_infinity > level:
        return True
    return bool(np.any(gain.at(proposals(gain, level)[0]) > level))


@dataclass(frozen=True, eq=False)
class BandProof:
    """The proof of a bound on the gain within a band.

    Attributes:
        P: Hermitian, shape (n, n).
        Q: likewise.
        bound: gamma.
        low: w1 [rad/s].
        high: w2 [rad/s]; may be infinite.
        positive: of Q.
        negative: of the lemma's matrix, with its sign turned.
    """

    P: Array
    Q: Array
    bound: float
    low: float
    high: float
    positive: Definiteness
    negative: Definiteness

    @property
    def holds(self) -> bool:
        """True if both inequalities are proved."""
        return self.positive.proved and self.negative.proved


def prove_in_band(
    plant: GeneralizedPlant, G: Array | Feedback, P: Array, Q: Array, bound: float, low: float, high: float
) -> BandProof:
    """Checks if P and Q prove a bound within a band for the loop A + B G, C + D G.

    Args:
        plant: continuous, n states, m inputs.
        G: shape (m, n), or a gain from measurements.
        P: complex, shape (n, n); its Hermitian part counts.
        Q: likewise.
        bound: gamma, above 0.
        low: w1, from 0 [rad/s].
        high: w2, above low [rad/s]; may be infinite.

    Raises:
        InputError: the plant is discrete, the band is empty, or a number is out of range.
    """
    check_continuous(plant)
    check_band(low, high)
    P, Q = ((matrix + matrix.conj().T) / 2 for matrix in (P, Q))
    try:
        if not (SMALLEST <= bound <= 1 / SMALLEST and all(np.all(np.abs(matrix) <= 1 / SMALLEST) for matrix in (P, Q))):
            raise OverflowError
        matrix = _lemma(plant, G, P, Q, bound, low, high)
    except OverflowError:
        sizes = " and ".join(f"{np.abs(matrix).max(initial=0.0):g}" for matrix in (P, Q))
        raise InputError(
            f"the bound {bound:g} with P and Q of sizes {sizes} is out of range, and proves nothing; give a bound from "
            f"{SMALLEST:g} to {1 / SMALLEST:g} and no larger entries"
        ) from None
    return BandProof(P, Q, bound, low, high, definiteness(_real(np.real(Q), np.imag(Q))), definiteness(-matrix))


def _lemma(plant: GeneralizedPlant, G: Array | Feedback, P: Array, Q: Array, bound: float, low: float, high: float) -> Array:
    """Returns the lemma's matrix as a real one of twice the size; computed in integers, every entry rounded once."""
    n, m = plant.B.shape
    r = plant.Bw.shape[1]
    K, Cy = (G.K, G.Cy) if isinstance(G, Feedback) else (G, np.eye(n))
    (system, unit), (gain, per), (rows, over) = integers(plant.system_matrix), integers(K), integers(Cy)
    one = unit * per * over  # [A_G Bw; C_G Dw] is integers over it
    loop = system * (per * over)
    loop[:, :n] += product(system[:, n : n + m], product(gain, rows))
    loop = np.hstack([loop[:, :n], loop[:, n + m :]])
    top, z = np.vstack([loop[:n], np.hstack([identity(n) * one, zeros(n, r)])]), loop[n:]

    ends = [Fraction(low), Fraction(high) if np.isfinite(high) else None]
    first, second = ends[0], ends[1]
    outer, mean, inner = (1, Fraction(0), -(first**2)) if second is None else (-1, (first + second) / 2, -first * second)
    square = Fraction(bound) ** 2
    (p, q), s = _alike(P, Q)  # P and Q are (real, imaginary) integers over s
    # All of the multiplier's entries over s times the denominators of mean and inner; gamma^2 beside them.
    parts = mean.denominator * inner.denominator
    mean_in, inner_in = mean.numerator * inner.denominator, inner.numerator * mean.denominator
    cross = p[0] * parts - mean_in * q[1], p[1] * parts + mean_in * q[0]
    real = np.block([[outer * parts * q[0], cross[0]], [cross[0].T, inner_in * q[0]]])
    imaginary = np.block([[outer * parts * q[1], cross[1]], [-cross[1].T, inner_in * q[1]]])
    scale = s * parts  # of the multiplier; M is over one^2 scale and the denominator of gamma^2
    M = (product(top.T, product(real, top)) + scale * product(z.T, z)) * square.denominator
    M[np.arange(n, n + r), np.arange(n, n + r)] -= square.numerator * one**2 * scale
    turned = product(top.T, product(imaginary, top)) * square.denominator
    return floats(_real(M, turned), Fraction(1, one**2 * scale * square.denominator))


def _alike(P: Array, Q: Array) -> tuple[list[tuple[Array, Array]], int]:
    """Returns the real and imaginary parts of two matrices as integers over one power of two."""
    whole, scale = integers(np.stack([np.real(P), np.imag(P), np.real(Q), np.imag(Q)]))
    return [(whole[0], whole[1]), (whole[2], whole[3])], scale


def _real(S: Array, K: Array) -> Array:
    """Returns the real symmetric matrix that is positive definite if and only if S + j K is."""
    return np.block([[S, -K], [K, S]])
