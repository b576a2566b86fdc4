"""The proof of a norm within a band: the generalized KYP lemma (Iwasaki, Hara 2005), checked by numpy alone.

No gain from w to z at a frequency from w1 to w2 reaches gamma if there are a Hermitian P and a Hermitian Q > 0 with

    [ A  Bw ]* [ -Q                P + j (w1 + w2)/2 Q ] [ A  Bw ]     [ C  Dw ]' [ C  Dw ]
    [ I  0  ]  [ *                 -w1 w2 Q            ] [ I  0  ]  +  [       ]  [       ]  -  gamma^2 [ 0 0; 0 I ]  <  0.

Where x = (j w - A)^-1 Bw v the first term is (w - w1)(w2 - w) x* Q x >= 0 for w in the band, and what is left is
|z|^2 - gamma^2 |v|^2. The converse is true too, so that of a gain that is known nothing is lost. Of an open band, w2 infinite, Q
stands in the place of -Q, 0 in that of the mean, and -w1^2 Q in the last: (w^2 - w1^2) x* Q x >= 0.

**It does not imply stability**: P need not be positive. That a loop is stable is another LMI's, (20), to say.

P and Q are taken as they are, and the matrix is computed without rounding (`exact.py`), from the plant's own numbers and the
gain's. A Hermitian matrix S + j K is positive definite if and only if the real one [S -K; K S] is.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from synth.band.norm import check_band
from synth.certificate.definite import SMALLEST, Definiteness, definiteness
from synth.certificate.exact import floats, identity, integers, product, zeros
from synth.plant import Feedback, GeneralizedPlant, check_continuous


@dataclass(frozen=True, eq=False)
class BandProof:
    """The proof of a bound within a band.

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
        """Whether both are proved."""
        return self.positive.proved and self.negative.proved


def prove_in_band(
    plant: GeneralizedPlant, G: Array | Feedback, P: Array, Q: Array, bound: float, low: float, high: float
) -> BandProof:
    """Whether P and Q prove a bound within a band for the loop A + B G, C + D G.

    Args:
        plant: continuous, n states, m inputs.
        G: shape (m, n), or a gain from measurements.
        P: complex, shape (n, n); its Hermitian part counts.
        Q: likewise.
        bound: gamma, above 0.
        low: w1, from 0 [rad/s].
        high: w2, above low [rad/s]; may be infinite.

    Raises:
        InputError: the plant is discrete, the band is none, or a number is out of range.
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
    """The lemma's matrix as a real one of twice its size; by integers, every entry rounded once."""
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
    """Real and imaginary parts of two matrices as integers over one power of two."""
    whole, scale = integers(np.stack([np.real(P), np.imag(P), np.real(Q), np.imag(Q)]))
    return [(whole[0], whole[1]), (whole[2], whole[3])], scale


def _real(S: Array, K: Array) -> Array:
    """The real symmetric matrix that is definite where S + j K is."""
    return np.block([[S, -K], [K, S]])
