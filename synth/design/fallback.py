"""Static gains by descent on the norm: descent replaces the two-step method if this method fails, or refines its result.

The two steps can fail in several ways: a central path ends early, the gain grows without limit, or a problem is too large.
Problem (25) of the paper may also have no solution for any of the matrices X that are tried. Even if the two steps fail, a
stabilising gain may exist, and the search in `static.py` does not need a central path. If no gain can exist, the reason is
found and reported first. Reasons why no gain can exist are a mode that no force affects or no measurement contains, and a pole
that no gain can change. If weighting filters or noise keep the norm of the two-step gain far above the lower bound, descent
continues from this gain.
"""

import contextlib
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.printed import brief, digits, percent, rough
from models.laws.linear import static_law
from synth.design.methods import FAR, insufficient
from synth.design.problem import DESCENT, LARGEST_GAIN, SEEN, TWO_STEPS, DesignProblem, DesignResult, Progress
from synth.design.two_step import (
    NO_GAIN,
    NO_SECOND_STEP,
    independently_measured,
    no_gain,
    with_redundant_rows,
    zero_l_design,
)
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError, NoSolutionError

if TYPE_CHECKING:
    from synth.analysis.lower_bounds.lower_bound import LowerBound
    from synth.design.descent.landscape import Work

# texts that name the method by which a lower norm was found
ITS_GAIN, SEARCHED = "descent from its gain", "descent from its gain and other starts"
EQUATION = "a Riccati equation for the state feedback"
BOTH = f"{TWO_STEPS} and {DESCENT}"
NEAR = 1e-3  # a result of the two steps is not refined if its relative gap to the lower bound is smaller than this
# relative gaps between a state feedback's norm and the lower bound, tried in this order
LEVELS = tuple(NEAR * 2 ** (k / 2) for k in range(11))
MOST_GROWTH = 2.0**100  # growth factor that is assumed if the starting gain is zero
# limits on the entries of a gain, tried in this order until the poles are slow enough for an actuator; as in `fixed_order.py`
LIMITS = (np.inf, 100.0, 10.0, 3.0)


def descent(problem: DesignProblem, progress: Progress) -> DesignResult:
    """Designs a static gain by descent on the norm if the two-step method finds no gain, or a gain whose norm is too large.

    Raises:
        DesignError: no gain with a valid certificate was found; the message gives the reason. Rounding may leave a certificate
            without a proved bound, for example for the large gains of a plant with 60 states.
    """
    plant, steps, failure = problem.plant, problem.start, problem.failure
    if steps is None:
        reason = NO_SECOND_STEP if isinstance(failure, NoSolutionError) else str(failure)
    elif not (reason := insufficient(problem, steps)):
        return steps
    _, _, kept = independently_measured(plant)
    independent, given = plant.rows(kept), (problem.largest_gain, problem.lower_bound)
    start = replace(steps, law=static_law(steps.gain[:, kept])) if steps is not None else reason
    from synth.design.static import design_by_descent

    # If the gain of the two steps is worse than no control, it is enough to find a gain whose poles an actuator can follow.
    limits = LIMITS if steps is not None and not np.any(plant.Dyw) and not plant.weights else LIMITS[:1]
    try:
        ends = design_by_descent(independent, start, *given, limits=limits, work=problem.work)
        result = next((end for end in ends if not end.certificate.beyond_actuators), ends[0])
        how = f"by descent on the norm from {result.origin}, with gains up to {problem.largest_gain:g}"
        if result.certificate.failures:
            raise DesignError("; ".join(result.certificate.failures))
        how += f"; {result.remark}" * bool(result.remarks)
    except InputError as error:
        left = _known_gain(independent, start, problem.lower_bound)
        if left is None:
            message = str(error) if str(error).startswith(NO_GAIN) else no_gain(f"descent on the norm, {error}")
            raise DesignError(f"{message}; reason for the descent: {failure or reason}") from error
        result, how = left
    unproved = "; rounding leaves no proof of a bound, but two methods agree on the norm" * (result.certificate.bound is None)
    instead = f"designed {how}{unproved}; reason: {reason}"
    return with_redundant_rows(replace(result, method=DESCENT, instead=instead, remarks=()), kept, len(plant.Cy), 0.0)


def refinement(problem: DesignProblem, progress: Progress) -> DesignResult:
    """Lowers the norm by descent, as `refine` does, if the norm of the two-step gain is more than 0.1 % above the lower bound.

    The gain may double for each 0.1 % by which the norm decreases. If all states are measured without noise, a Riccati equation
    gives another gain. The norm of the Riccati gain is as close to the lower bound as `largest_gain` allows or, without
    `largest_gain`, as the speed of actuators allows. If the norm is still more than 1 % above the lower bound, descents also
    start from other gains. The gain with the lowest norm is returned, unless the poles of its loop are too fast for an
    actuator.
    """
    from synth.design.static import bounded_work

    result, work = problem.start, problem.work or bounded_work(problem.plant)
    assert result is not None, "a design comes first"
    gap = result.certificate.gap
    if result.instead or (gap is not None and gap <= NEAR) or not result.certificate.norm.value:
        return result
    far = f", {percent(gap)} above the lower bound" if gap is not None else ""
    came = f"the two-step method reaches norm {digits(result.certificate.norm.value)}{far}; "
    lower, growth, origin, nearer = _refine_design(problem, result, work)
    came += origin
    stopped = nearer + (f"; {work.text}" if work.over else "")
    if lower is None:
        return replace(result, why=f"{came} finds no lower norm{stopped}", method=BOTH)
    if origin != EQUATION and lower.certificate.beyond_actuators and not result.certificate.beyond_actuators:
        at = f"{digits(lower.certificate.norm.value)} with poles too fast for actuators"
        return replace(result, why=f"{came} ends at {at}, so the gain of the two-step method is kept{stopped}", method=BOTH)
    return replace(lower, why=f"{came} lowers the norm with a gain {brief(growth)} times as large{stopped}", method=BOTH)


def _refine_design(problem: DesignProblem, design: DesignResult, work: "Work") -> tuple[DesignResult | None, float, str, str]:
    """Returns a design with a lower norm (or None), the growth factor of the gain, the name of the method, and a remark.

    The descents start from the gain of the two-step method and, if all states are measured, from the gain of a Riccati
    equation. Each descent ends in a local minimum. If the norm at a local minimum is far above the lower bound, the search
    continues for other minima.
    """
    from synth.analysis.bounding import certify_law
    from synth.design.descent.growth import price
    from synth.design.descent.refine import refine
    from synth.design.static import design_by_descent

    q, below, largest_gain = len(problem.plant.Cy), problem.lower_bound, problem.largest_gain
    fast = design.certificate.beyond_actuators
    kept = [i for i in range(q) if i not in design.redundant]
    independent, start = problem.plant.rows(kept), design.gain[:, kept]
    lowest, faster, growth, size, origin = design, None, 1.0, float(np.abs(start).max(initial=0.0)), ITS_GAIN
    equation, nearer = _state_feedback(independent, below, largest_gain)
    steps, limits = replace(design, law=static_law(start)), LIMITS[:1] if fast else LIMITS
    searches: list[tuple[str, Callable[[], list[Array]]]] = [
        (EQUATION, lambda: equation),
        (ITS_GAIN, lambda: [refine(independent, None, start).gain]),
        (
            SEARCHED,
            lambda: [end.gain for end in design_by_descent(independent, steps, largest_gain, below, limits=limits, work=work)],
        ),
    ]
    for name, gains in searches:
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            for gain in gains():
                grown = float(np.abs(gain).max(initial=0.0)) / size if size else np.inf
                certificate = certify_law(independent, static_law(gain), below)
                worth = price(min(max(grown / growth, 1.0), MOST_GROWTH))
                lower = certificate.norm.value < lowest.certificate.norm.value * (1 - max(SEEN, worth))
                if lower and not certificate.failures and grown * size <= largest_gain:
                    found = with_redundant_rows(DesignResult(static_law(gain), certificate, case=design.case), kept, q, 0.0)
                    if certificate.beyond_actuators and not (name == EQUATION or fast):
                        faster = faster or found
                    else:
                        lowest, faster, growth, origin = found, faster, grown, name
        gap = lowest.certificate.gap
        if gap is not None and gap <= FAR and (lowest is not design or name != EQUATION):
            break
    return lowest if lowest is not design else faster, growth, origin, nearer


def _state_feedback(plant: Plant, below: "LowerBound | None", largest_gain: float) -> tuple[list[Array], str]:
    """Returns the gain of a Riccati equation with the lowest norm and slow enough poles, and the reason why no lower norm was
    found.

    If `largest_gain` is set, poles that are too fast for an actuator are accepted. The list of gains is empty unless all
    states are measured.
    """
    from synth.analysis.bounding import certify_law
    from synth.design.descent.landscape import Landscape
    from synth.design.descent.starts import state_feedback_start

    landscape, why = Landscape(plant), ""
    for share in LEVELS:
        for x in state_feedback_start(landscape, below.gamma * (1 + share)) if below is not None else ():
            K = landscape.gain(x)
            entry, beyond = float(np.abs(K).max()), "with poles too fast for actuators; give largest_gain to allow them"
            if entry > largest_gain:
                beyond = f"but {largest_gain:g} is the largest allowed"
            elif largest_gain < LARGEST_GAIN or not certify_law(plant, static_law(K), below).beyond_actuators:
                return [K], why
            why = why or f"; {percent(share)} above the bound needs a gain of {rough(entry)}, {beyond}"
    return [], why


def _known_gain(plant: Plant, two_steps: DesignResult | str, lower_bound: "LowerBound | None") -> tuple[DesignResult, str] | None:
    """Returns a certified gain that needs no descent, and a text that states how the gain was found; None if there is no such
    gain.
    """
    from synth.analysis.bounding import certify_law

    nothing = static_law(np.zeros((plant.B.shape[1], len(plant.Cy))))
    for how, law in (
        ("by the two-step method without changes", lambda: two_steps.law if isinstance(two_steps, DesignResult) else None),
        ("by the second step with L = 0", lambda: zero_l_design(plant).law),
        ("without control, as the plant is stable", lambda: nothing),
    ):
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            known = law()
            if known is not None and not (certificate := certify_law(plant, known, lower_bound)).failures:
                return DesignResult(known, certificate), how
    return None
