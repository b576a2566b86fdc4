"""The worst norm of a law whose readings and forces are off: the largest that is met, and a bound that holds on the whole box."""

from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.law import LinearLaw
from synth.certificate.box import Box, BoxProof, ScaledGain
from synth.numerics import numerics
from synth.plant import GeneralizedPlant
from synth.tolerance.found import Heights, climb, norm_at
from synth.tolerance.proved import proof_at, proof_near
from synth.tolerance.scaled import box_of, errors_of, scaled_gain


@dataclass(frozen=True, eq=False)
class WorstNorm:
    """The worst norm over a box of errors.

    Attributes:
        found: the largest norm met; infinite where a loop in the box is unstable.
        readings: the errors there, relative, shape (q,).
        forces: likewise, shape (m,).
        proved: what no norm in the box exceeds, stability included; infinite where that is not proved.
        proof: of that; None where there is none.
    """

    found: float
    readings: Array
    forces: Array
    proved: float
    proof: BoxProof | None

    @property
    def gap(self) -> float:
        """How far what is proved lies above what is found, relative; infinite where nothing is proved."""
        return self.proved / self.found - 1 if np.isfinite(self.proved) and self.found else np.inf

    @property
    def unstable(self) -> bool:
        """Whether a loop in the box is unstable: with the errors that are named here."""
        return bool(np.isinf(self.found))


@numerics()
def worst_norm(
    plant: GeneralizedPlant,
    Cy: Array,
    K: Array | LinearLaw,
    d: Array | float,
    e: Array | float = 0.0,
    Dyw: Array | None = None,
    through: Array | None = None,
    enough: float | None = None,
) -> WorstNorm:
    """The worst norm where each reading is off by up to +-d and each force by up to +-e, relative and each by itself.

    K_ij becomes K_ij (1 + a_j) (1 + b_i) with |a_j| <= d_j, |b_i| <= e_i.

    Args:
        plant: n states, m inputs; continuous or discrete.
        Cy: shape (q, n).
        K: the gain, shape (m, q); or a law with states, which then stands between two diagonal scalings.
        d: one for all readings, or one for each, shape (q,).
        e: one for all forces, or one for each, shape (m,).
        Dyw: shape (q, r); zero where it is not given.
        through: what the forces do to what is measured at once, shape (q, m); zero where it is not given.
        enough: a bound that is asked about, which is tried by itself where no closer one is proved below it.

    Raises:
        InputError: a matrix has the wrong shape, or is none of real finite numbers, or a tolerance is none from 0 to 1.
        DesignError: rounding leaves no answer.
    """
    gain = scaled_gain(plant, Cy, K, Dyw, through)
    return worst_in(gain, box_of(gain, d, e), enough)


def worst_in(gain: ScaledGain, box: Box, enough: float | None = None) -> WorstNorm:
    """The worst norm over a box of factors; arguments as for `worst_norm`."""
    heights = Heights(gain)
    climb(heights, box)
    proof = proof_near(heights, box)
    if enough is not None and heights.highest < enough and (proof is None or proof.bound > enough):
        proof = proof_at(heights, box, enough) or proof
    found = norm_at(gain, heights.at)
    return WorstNorm(found, *errors_of(gain, heights.at), proof.bound if proof is not None else np.inf, proof)
