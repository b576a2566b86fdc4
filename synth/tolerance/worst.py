"""The worst norm of a law whose readings and forces are off: the largest that is met, and a bound that holds on the whole box."""

from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.law import LinearLaw
from synth.certificate.bounding import bounding_x
from synth.certificate.box import MOST, Box, BoxProof, ScaledGain, proves
from synth.certificate.certificate import eta_of
from synth.numerics import numerics
from synth.plant import GeneralizedPlant
from synth.tolerance.common import common_x
from synth.tolerance.found import Heights, climb, norm_at
from synth.tolerance.scaled import box_of, errors_of, scaled_gain

CLOSEST = 1e-4  # relative; how far above the largest norm met a bound is tried, and no closer
CLOSER = (0.1, 1e-2, 1e-3, CLOSEST)  # likewise in turn, where the box has to fall into parts for it
LOOSE = (1.0, 10.0)  # where the first of these fails
TRIALS = 600  # over the square of the number of states: how often an X is looked for at most
FEWEST = 6  # of them at least
SPARE = 1e-2  # of how far a bound is above a norm: what of it the first X leaves unused
EVERYWHERE = 1e-4  # of the disturbance's power: what disturbs states for the first X that w does not reach

Parts = list[tuple[Box, Array | None]]  # of a box, each with an X of (20) if one is known


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

    Raises:
        InputError: a matrix has the wrong shape, or is none of real finite numbers, or a tolerance is none from 0 to 1.
        DesignError: rounding leaves no answer.
    """
    gain = scaled_gain(plant, Cy, K, Dyw, through)
    return worst_in(gain, box_of(gain, d, e))


def worst_in(gain: ScaledGain, box: Box) -> WorstNorm:
    """The worst norm over a box of factors."""
    heights = Heights(gain)
    climb(heights, box)
    proof = _proof(heights, box)
    found = norm_at(gain, heights.at)
    return WorstNorm(found, *errors_of(gain, heights.at), proof.bound if proof is not None else np.inf, proof)


def _proof(heights: Heights, box: Box) -> BoxProof | None:
    """A bound on a box just above the largest norm met, if one can be proved; what is met on the way is remembered, too."""
    if len(box.free) > MOST or not np.isfinite(heights.highest):
        return None
    eta = eta_of(heights.highest * (1 + CLOSEST))
    if (X := _x_for(heights, box, eta)) is not None:
        return BoxProof(eta, [(box, X)])
    trials = max(FEWEST, TRIALS // len(heights.gain.plant.A) ** 2)
    parts: Parts | None = [(box, None)]
    best, left = None, trials
    for above in CLOSER:
        parts, left = _filled(heights, parts, above, left)
        if parts is None:
            break
        best = _proof_of(heights, parts, above)
    for above in LOOSE if best is None else ():
        parts, _ = _filled(heights, [(box, None)], above, trials)
        if parts is not None:
            return _proof_of(heights, parts, above)
    return best if np.isfinite(heights.highest) else None


def _proof_of(heights: Heights, parts: Parts, above: float) -> BoxProof:
    return BoxProof(eta_of(heights.highest * (1 + above)), [(part, X) for part, X in parts if X is not None])


def _filled(heights: Heights, parts: Parts, above: float, left: int) -> tuple[Parts | None, int]:
    """Parts with an X each that proves a bound so far above the largest norm met; None where that took too many trials.

    Args:
        heights: they know the largest norm met.
        parts: that fill the box, some with an X.
        above: relative.
        left: how often an X may be looked for.
    """
    todo, done = list(parts), Parts()
    while todo:
        part, X = todo.pop()
        eta = eta_of(heights.highest * (1 + above)) if np.isfinite(heights.highest) else 0.0
        if X is None or not proves(heights.gain, part, X, eta):
            if not left or not eta:
                return None, 0
            left, X = left - 1, _x_for(heights, part, eta)
        if X is not None:
            done.append((part, X))
        elif np.isfinite(heights.highest):
            todo += [(half, None) for half in part.halves(_axis(heights, part))]
    return done, left


def _x_for(heights: Heights, box: Box, eta: float) -> Array | None:
    """An X that proves a bound on a box; None where none is found."""
    gain, level = heights.gain, eta**-0.5
    norm = heights.norm(box.middle)
    if not norm < level or not gain.posed(box):
        return None
    A, Bw, C, Dw = gain.loops(box.middle)
    loop = GeneralizedPlant(A, np.zeros((len(A), 0)), Bw, C, np.zeros((len(C), 0)), Dw)
    try:
        start = bounding_x(loop, level, SPARE * min(level / norm - 1, 1.0), EVERYWHERE)
        X = common_x(gain, box, start, eta)
    except (np.linalg.LinAlgError, ValueError):  # too close to the norm for floats
        return None
    return X if X is not None and proves(gain, box, X, eta) else None


def _axis(heights: Heights, box: Box) -> int:
    """The factor along which the norm changes most from the middle of a box to its faces."""
    middle = heights.norm(box.middle)
    changes = []
    for axis in box.free:
        ends = []
        for end in (box.low, box.high):
            point = box.middle
            point[axis] = end[axis]
            ends.append(heights.norm(point))
        changes.append(max(abs(np.log(value / middle)) if np.isfinite(value) else np.inf for value in ends))
    return int(box.free[np.argmax(changes)])
