"""Former function for the design of one gain for several plants. Use `design_feedback` with `family` instead."""

import warnings
from collections.abc import Sequence

from models.common.arrays import Array
from models.common.errors import InputError
from synth.design.feedback import FeedbackDesign, design_feedback
from synth.plant.generalized import Plant


def slack_design(
    plants: Sequence[Plant], Cys: Sequence[Array], structure: Array | None = None, f: Sequence[float] = ()
) -> FeedbackDesign:
    """Designs one static gain for several plants. Deprecated: use `design_feedback` with `family` instead.

    Args:
        plants: plants with the same numbers of states, inputs, disturbances and outputs.
        Cys: measurement matrix of each plant, each of shape (q, n).
        structure: mask of the gain, shape (m, q), with zeros for entries that are fixed to zero. Default: no entry is fixed.
        f: ignored; kept for compatibility.

    Returns:
        Result of `design_feedback`.

    Raises:
        InputError: the plants differ in size, or a C_y or the structure does not fit the plants.
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
        raise InputError(
            f"Cys has {len(Cys)} matrices for {len(plants)} plants; give at least one plant, and one matrix C_y for each plant"
        )
    first, *others = (plant.measured(Cy) for plant, Cy in zip(plants, Cys, strict=True))
    return design_feedback(first, family=others, structure=structure)
