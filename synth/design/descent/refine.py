"""`--refine`: descent on the norm from a gain designed with LMIs, while the decrease justifies a larger gain (`growth.py`)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.printed import brief, digits, percent
from models.laws.linear import static_law
from synth.analysis.norm import hinf_norm
from synth.analysis.stability import is_stable
from synth.design.descent.growth import WORTH, lower_by_growth
from synth.design.descent.landscape import Landscape
from synth.design.descent.minimax import descend_norm
from synth.design.problem import SEEN
from synth.plant.generalized import Plant, check_inputs, real_matrix
from synth.plant.numerics import DesignError, numerics

ROUNDS = 60  # largest number of rounds in a stage; most stages end sooner
GLANCE = 5  # number of rounds from which `worth_refining` estimates the possible decrease


@dataclass(frozen=True, eq=False)
class Refinement:
    """Result of a refinement, with the trade-off between the norm and the size of the gain.

    Attributes:
        gain: gain matrix K, shape (m, q).
        before: norm before the refinement.
        after: norm after the refinement.
        growth: largest gain entry after the refinement, divided by the largest entry before, in internal units of the loop.
        refused_stage: relative decrease of gamma, and growth of the gain, in the first stage that was undone. None if no stage
            was undone, or if the undone stage did not lower gamma.
        what: name of the norm that the refinement lowers.
    """

    gain: Array
    before: float
    after: float
    growth: float
    refused_stage: tuple[float, float] | None
    what: str = "gamma"

    @property
    def trade_off_text(self) -> str:
        """Trade-off between the norm and the size of the gain, as text."""
        text = f"{self.what} {digits(self.before)} -> {digits(self.after)} ({percent(1 - self.after / self.before)} less), "
        text += f"largest gain multiplied by {brief(self.growth)}"
        if self.refused_stage is not None:
            bought, growth = self.refused_stage
            text += (
                f"; a further decrease of {self.what} by {percent(bought)} was not accepted, because this decrease needs "
                f"{brief(growth)} times the gain"
            )
        return text


@numerics()
def refine(plant: Plant, Cy: Array | None, K: Array, Dyw: Array | None = None) -> Refinement:
    """Lowers the H-infinity norm by descent from a stabilising gain, as long as the decrease justifies the growth of the gain.

    Args:
        plant: generalised plant with n states and m inputs.
        Cy: measurement matrix, shape (q, n). Default: the Cy of the plant.
        K: gain of u = K y from which the descent starts, shape (m, q).
        Dyw: direct effect of w on the measurements, shape (q, r). Default: zero if Cy is given, otherwise the Dyw of the plant.

    Returns:
        The refined gain, and the norms before and after the refinement.

    Raises:
        InputError: a matrix does not fit the plant.
        DesignError: K does not stabilise the plant.

    Example:
        >>> from synth import GeneralizedPlant, refine
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> refinement = refine(oscillator, Cy=[[0, 1]], K=[[-1.0]])
        >>> f"{refinement.before:.4f} to {refinement.after:.4f}"
        '0.4808 to 0.2500'
    """
    check_inputs(plant)
    plant = plant.measured(Cy, Dyw)
    shape = (plant.B.shape[1], len(plant.Cy))
    K = real_matrix(K, "K", str(shape))
    if K.shape != shape:
        raise InputError(f"K has shape {K.shape}; expected {shape}: one row for each force, one column for each measured signal")
    return lower_norm(Landscape(plant), plant, K)


def lower_norm(landscape: Landscape, plant: Plant, K: Array) -> Refinement:
    """Performs `refine` with a landscape of the plant. No stage begins after the limit on the computing work is exceeded."""
    x = start = landscape.point(K)
    before, _ = landscape.norm(x)
    if not np.isfinite(before):
        raise DesignError("a gain that does not stabilise the plant cannot be refined; design one first")
    if before == 0:
        return Refinement(K, before, before, 1.0, None)

    def lower(x: Array, norm: float, largest: float) -> tuple[Array, float]:
        return (x, norm) if landscape.work.over else descend_norm(landscape, x, np.full(len(x), largest), ROUNDS)

    x, norm, refused = lower_by_growth(x, before, lower, lambda norm, reached: 1 - reached / norm)
    first, size = float(np.abs(start).max()), float(np.abs(x).max())
    # The descent uses the norms that the landscape computes. The start and the end are compared by the norms of the actual
    # closed loops. For a discrete plant, these norms are also returned.
    gain = landscape.gain(x)
    own_before, own_after = own_norm(plant, K), own_norm(plant, gain)
    first_norm, last_norm = (before, norm) if plant.dt is None else (own_before, own_after)
    if np.array_equal(x, start) or own_after > own_before:
        return Refinement(K, first_norm, first_norm, 1.0, refused)
    return Refinement(gain, first_norm, last_norm, size / first if first else 1.0, refused)


def own_norm(plant: Plant, K: Array) -> float:
    """Returns the norm of the closed loop with a gain, confirmed by two methods; infinite if the loop is not stable."""
    loop = plant.closed(static_law(K))
    return hinf_norm(loop).value if is_stable(loop.A, loop.dt) else np.inf


@numerics()
def worth_refining(plant: Plant, K: Array) -> float:
    """Returns a quick, low estimate of the relative decrease of the norm by `refine`, from the first rounds of the descent.

    Args:
        K: a stabilising gain, shape (m, q).
    """
    landscape = Landscape(plant)
    x = landscape.point(K)
    before, _ = landscape.norm(x)
    if not 0 < before < np.inf:
        return 0.0
    size = float(np.abs(x).max())
    _, reached = descend_norm(landscape, x, np.full(len(x), size), GLANCE)
    if reached < before * (1 - SEEN):
        return 1 - reached / before
    # The norm decreases only with a larger gain. The estimate is then the decrease for the first doubling of the gain, if this
    # decrease is worthwhile.
    landscape = Landscape(plant)
    x, norm = descend_norm(landscape, x, np.full(len(x), size), ROUNDS)
    _, reached = descend_norm(landscape, x, np.full(len(x), 2 * float(np.abs(x).max())), GLANCE)
    return 1 - reached / before if reached < norm * (1 - WORTH) else 1 - norm / before


def from_some(gain: Array, rows: Array, kept: Sequence[int]) -> Array:
    """Returns a gain that uses only independent measurements and gives the same forces as the supplied gain, shape (m,
    len(kept)).
    """
    left_out = [i for i in range(len(rows)) if i not in kept]
    return gain[:, kept] + gain[:, left_out] @ rows[left_out] @ np.linalg.pinv(rows[kept]) if left_out else gain
