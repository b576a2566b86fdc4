"""The name of earlier versions for one gain for several plants; `design_feedback` with `family` finds it now."""

import warnings
from collections.abc import Sequence

from models.common.arrays import Array
from models.common.errors import InputError
from synth.design.feedback import FeedbackDesign, design_feedback
from synth.plant.generalized import Plant


def slack_design(
    plants: Sequence[Plant], Cys: Sequence[Array], structure: Array | None = None, f: Sequence[float] = ()
) -> FeedbackDesign:
    """Returns one gain for several plants by `design_feedback` with `family`, which replaces this function.

    Args:
        plants: plants of equal size.
        Cys: measurement matrix of each plant, shape (q, n) each.
        structure: mask of ones and zeros, shape (m, q); None: every entry of the gain may be other than zero.
        f: no longer used.

    Raises:
        InputError: the plants do not fit one another, or a C_y or the structure does not fit.
        DesignError: no gain was found that stabilises all plants.

    Example:
        >>> from synth import GeneralizedPlant, design_feedback
        >>> C, D, Dw = [[1, 0], [0, 0]], [[0], [0.1]], [[0], [0]]
        >>> soft, hard = (GeneralizedPlant([[0, 1], [-k, -0.1]], [[0], [1]], [[0], [1]], C, D, Dw) for k in (3, 5))
        >>> f"{design_feedback(soft, [[0, 1]], family=[hard]).value:.3f}"
        '0.333'
    """
    warnings.warn(
        "`slack_design` goes with the next version; use `design_feedback` with `family`", DeprecationWarning, stacklevel=3
    )
    if not plants or len(plants) != len(Cys):
        raise InputError(f"Cys has {len(Cys)} matrices for {len(plants)} plants; give at least one plant, and one C_y for each")
    first, *others = (plant.measured(Cy) for plant, Cy in zip(plants, Cys, strict=True))
    return design_feedback(first, family=others, structure=structure)
