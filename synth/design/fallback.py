"""The two steps, and where they cannot be gone to their end, descent on the norm: a design either way, and said which.

A central path may break off, or have no end at a finite gain, and problems may be too large for it. That says nothing against a
gain: the strategy of `static.py` needs no path. Where there is no solution, as the second problem proves from every X, it is left
at that: that is an answer, and the descent has its own door. But for feedback of a vehicle's states where filters have states,
too: that is what others are held against, and is to be there. And where there is a solution that filters or noise leave far from
what could be had, the descent goes on from it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from models.common.arrays import Array
from models.common.printed import percent
from synth.analysis.lower_bound import LowerBound
from synth.design.two_step import Design, as_measurement_matrix, two_step_design, with_redundant_rows
from synth.lmi.central_path import CentralPoint
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError, InfeasibleError

KNOW_NO_NOISE = "they know no noise on what is measured"
FAR = 0.01  # relative; how far above what no controller beats the two steps may end where filters have states


def _lost(plant: GeneralizedPlant, steps: Design) -> str:
    """Why a design of the two steps is not left at that, in words; empty where it is.

    The X of (22) feeds back every state, those of filters too, which y does not have and no control moves; L (14) ties a gain
    to that X all the same. So with filters, and with them alone, the two steps are mended rather than believed.
    """
    gap = steps.certificate.gap
    if not plant.weights or (gap is not None and gap <= FAR):
        return ""
    far = f", {percent(gap)} above the lower bound" if gap is not None else ""
    return f"they come to {steps.certificate.norm.value:.7g}{far}, as their X feeds back the states of filters, which y has not"


def two_steps_or_descent(
    plant: GeneralizedPlant,
    Cy: Array,
    path: Callable[[], Sequence[CentralPoint]] = tuple,
    lower_bound: LowerBound | None = None,
    states: Sequence[str] = (),
    always: bool = False,
    Dyw: Array | None = None,
) -> Design:
    """Returns the result of `two_step_design`, or of a descent, with the reason, if the two steps fail.

    Args:
        plant, Cy, lower_bound, states: as for `two_step_design`.
        path: returns the central path of (22) if it is known already, or raises.
        always: descend also if the second problem has no solution.
        Dyw: shape (q, r), where noise is measured: the two steps know none, and are one of the starts of a descent.

    Raises:
        DesignError: neither finds a gain whose certificate holds; the message gives the reason. A certificate may lack a bound
            if rounding leaves no proof, as for the large gains of 60 states; then the result says so.
    """
    two_steps = None
    try:
        two_steps = two_step_design(plant, Cy, path(), lower_bound, states)
        reason = KNOW_NO_NOISE if Dyw is not None else _lost(plant, two_steps)
        if not reason:
            return two_steps
    except DesignError as error:
        if isinstance(error, InfeasibleError) and not always:
            raise
        reason = error
    from synth.design.static import LARGEST_GAIN, descended

    rows, kept = as_measurement_matrix(plant, Cy)
    start = replace(two_steps, gain=two_steps.gain[:, kept]) if two_steps is not None else str(reason)
    noise = Dyw[kept] if Dyw is not None else None
    try:
        by_descent = descended(plant, rows[kept], start, lower_bound=lower_bound, Dyw=noise)
    except DesignError as error:
        raise DesignError(f"{reason}; descent on the norm: {error}") from error
    certificate = by_descent.certificate
    if certificate.failures:
        raise DesignError(f"{reason}; descent on the norm: {'; '.join(certificate.failures)}")
    how = f"by descent on the norm from {by_descent.origin}, no gain larger than {LARGEST_GAIN:g}"
    unproved = "; rounding leaves no proof of a bound, the norm is what two routes agree on" if certificate.bound is None else ""
    instead = f"not by the two steps but {how}{unproved}, for {reason}"
    return with_redundant_rows(Design(by_descent.gain, certificate, instead=instead), kept, len(rows), 0.0)
