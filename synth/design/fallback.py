"""Static gains: the two steps, or descent on the norm if they cannot be completed. The result has the method and reason.

For any plant (`near_lower_bound`) descent also continues from the two steps if they end above a proved lower bound.

A central path may break off, or have no end at a finite gain, and problems may be too large for it. Problem (25) may have no
solution from any X tried. A gain may exist nevertheless: the strategy of `static.py` needs no path. Proofs that no gain exists
are checked and reported first: a mode that no force reaches or no measurement shows, or poles that no gain moves. If filters or
noise leave a solution far above the lower bound, the descent continues from it.
"""

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.printed import brief, digits, percent, rough
from models.laws.linear import static_law
from synth.analysis.certificate import Certificate
from synth.analysis.lower_bound import LowerBound
from synth.analysis.norm import hinf_norm
from synth.analysis.stability import is_stable, stabilisability_failures, static_feedback_obstructions
from synth.design.two_step import (
    LARGEST_GAIN,
    NO_GAIN,
    Design,
    independently_measured,
    no_gain,
    two_step_design,
    with_redundant_rows,
    zero_l_design,
)
from synth.lmi.central_path import CentralPoint
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError, InfeasibleError, NoSolutionError, numerics

if TYPE_CHECKING:
    from synth.design.descent.landscape import Work

KNOW_NO_NOISE = "the two-step method ignores measurement noise"
NOT_FROM_THESE = "problem (25) has no solution for the X of (22), but another gain may exist"
NEAR = 1e-3  # relative; two steps this close to what no controller beats are left at that
ITS_GAIN, SEARCHED = "descent from its gain", "descent from its gain and other starts"  # how a norm is lowered
EQUATION = "a Riccati equation for the state feedback"
BOUNDED = 20  # states; of more the lower bound takes minutes, and is not sought unasked
LEVELS = tuple(NEAR * 2 ** (k / 2) for k in range(11))  # relative; norms of state feedbacks above what no controller beats
ROUNDING = 1e-6  # relative; two steps that are above the norm without control by less are left at that
MOST_DOUBLINGS = 100  # of a gain from zero
LIMITS = (np.inf, 100.0, 10.0, 3.0)  # on a gain's entries, until poles are not beyond any actuator; as `fixed_order.py` has them
FAR = 0.01  # relative; how far above what no controller beats the two steps may end where filters have states


def check_stabilisable(plant: Plant, states: Sequence[str] = ()) -> None:
    """Raises an InfeasibleError if a single mode, or the poles' sum or product, keeps every static gain from stabilising."""
    reasons = list[str]()
    with contextlib.suppress(InputError):  # units in which an entry is too large: nothing is known against a gain
        reasons = stabilisability_failures(plant, states) or static_feedback_obstructions(plant)
    if reasons:
        raise InfeasibleError("; ".join(reasons))


def _lost(plant: Plant, steps: Design, largest_gain: float) -> str:
    """Why a design of the two steps is not left at that, in words; empty where it is.

    The X of (22) feeds back every state, those of filters too, which y does not have and no control moves; L (14) ties a gain
    to that X all the same. So with filters, and with them alone, the two steps are mended rather than believed.
    """
    norm, passive = steps.certificate.norm.value, _without_control(plant)
    if passive < norm * (1 - ROUNDING):
        return f"the two-step method ends at {digits(norm)}, above {digits(passive)} without control"
    entry = float(np.abs(steps.gain).max(initial=0.0))
    if largest_gain < LARGEST_GAIN and entry > largest_gain:
        return f"the two-step method needs a gain of {rough(entry)}, but {largest_gain:g} is the largest allowed"
    gap = steps.certificate.gap
    if not plant.weights or (gap is not None and gap <= FAR):
        return ""
    far = f", {percent(gap)} above the lower bound" if gap is not None else ""
    return f"the two-step method ends at {digits(norm)}{far}: its X needs filter states, which y lacks"


def _without_control(plant: Plant) -> float:
    """Returns the norm without control; infinite if the plant is unstable."""
    return (
        hinf_norm(plant.closed_loop(np.zeros((plant.B.shape[1], len(plant.A))))).value if is_stable(plant.A, plant.dt) else np.inf
    )


@numerics()
def two_steps_or_descent(
    plant: Plant,
    path: Callable[[], Sequence[CentralPoint]] = tuple,
    lower_bound: LowerBound | None = None,
    states: Sequence[str] = (),
    largest_gain: float = LARGEST_GAIN,
    work: "Work | None" = None,
) -> Design:
    """Returns the result of `two_step_design`, or of a descent, with the reason, if the two steps fail.

    Args:
        plant: plant with measurements. The two steps ignore their noise, and are one of the starts of a descent.
        path: returns the central path of (22) if it is known already, or raises.
        lower_bound, states: arguments of `two_step_design`.
        largest_gain: bound on the entries of the gain, as for `static_output_feedback`.
        work: counts the norms of the descent, as for `descended`.

    Raises:
        InputError: the plant has no input, or a matrix does not fit it.
        InfeasibleError: no static gain stabilises the plant; the message names the mode.
        DesignError: neither method finds a gain whose certificate holds; the message gives the reason. A certificate may lack a
            bound if rounding leaves no proof, as for the large gains of 60 states.
    """
    _, _, kept = independently_measured(plant)
    check_stabilisable(plant, states)
    two_steps = failure = None
    try:
        two_steps = two_step_design(plant, None, path(), lower_bound, states)
        reason = KNOW_NO_NOISE if np.any(plant.Dyw) else _lost(plant, two_steps, largest_gain)
        if not reason:
            return two_steps
    except InputError as error:  # nothing is disturbed or weighed, too: there may be a gain
        reason, failure = (NOT_FROM_THESE if isinstance(error, NoSolutionError) else str(error)), error
    start = replace(two_steps, gain=two_steps.gain[:, kept]) if two_steps is not None else reason
    few = plant.rows(kept)
    from synth.design.static import descended

    try:
        by_descent = descended(few, start, largest_gain, lower_bound, work=work)
        certificate, gain = by_descent.certificate, by_descent.gain
        how = f"by descent on the norm from {by_descent.origin}, with gains up to {largest_gain:g}"
        if certificate.failures:
            raise DesignError("; ".join(certificate.failures))
        how += f"; {by_descent.stopped}" * bool(by_descent.stopped)
    except InputError as error:
        left = _known_gain(few, start, lower_bound)
        if left is None:
            message = str(error) if str(error).startswith(NO_GAIN) else no_gain(f"descent on the norm, {error}")
            raise DesignError(f"{message}; reason for the descent: {failure or reason}") from error
        gain, certificate, how = left
    unproved = "; rounding leaves no proof of a bound, but two methods agree on the norm" if certificate.bound is None else ""
    instead = f"designed {how}{unproved}; reason: {reason}"
    return with_redundant_rows(Design(gain, certificate, instead=instead), kept, len(plant.Cy), 0.0)


@numerics()
def near_lower_bound(
    plant: Plant,
    lower_bound: LowerBound | None = None,
    states: Sequence[str] = (),
    largest_gain: float = LARGEST_GAIN,
) -> tuple[Design, str]:
    """Returns the result of `two_steps_or_descent`, or of a descent from there, and a remark on that descent.

    Two steps that end more than 0.1 % above the lower bound are refined, as by `refine`: each doubling of the gain is worth
    0.1 % of the norm. If all states are measured without noise, a Riccati equation has another gain, as near the bound as
    `largest_gain` allows, if that is given, or else actuators. Where that ends more than 1 % above the bound, descents begin
    elsewhere, too. The lower norm is kept, unless it takes poles beyond any actuator.

    Args:
        plant, states, largest_gain: arguments of `two_steps_or_descent`.
        lower_bound: lower bound for any controller from these measurements; None: computed for plants of at most 20 states.

    Returns:
        The design, and the words: empty where nothing goes on from the two steps.

    Raises:
        InputError, InfeasibleError, DesignError: errors of `two_steps_or_descent`.
    """
    check_stabilisable(plant, states)
    below = lower_bound
    if below is None and len(plant.A) <= BOUNDED:
        from synth.lmi.full_order_bound import find_lower_bound

        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            below = find_lower_bound(plant)
    from synth.design.static import bounded_work

    work = bounded_work(plant)
    design = two_steps_or_descent(plant, tuple, below, states, largest_gain, work)
    gap = design.certificate.gap
    if design.instead or (gap is not None and gap <= NEAR) or not design.certificate.norm.value:
        return design, ""
    far = f", {percent(gap)} above the lower bound" if gap is not None else ""
    came = f"the two-step method reaches norm {digits(design.certificate.norm.value)}{far}; "
    lower, growth, origin, nearer = _refined(plant, design, below, largest_gain, work)
    came += origin
    stopped = nearer + (f"; {work.text}" if work.over else "")
    if lower is None:
        return design, f"{came} finds no lower norm{stopped}"
    if origin != EQUATION and lower.certificate.beyond_actuators and not design.certificate.beyond_actuators:
        at = f"{digits(lower.certificate.norm.value)} with poles too fast for actuators"
        return design, f"{came} ends at {at}, so the gain of the two-step method is kept{stopped}"
    return lower, f"{came} lowers the norm with a gain {brief(growth)} times as large{stopped}"


def _refined(
    plant: Plant, design: Design, below: LowerBound | None, largest_gain: float, work: "Work"
) -> tuple[Design | None, float, str, str]:
    """Returns a design of a lower norm, the growth of the gain, the start, and a remark; None if no design is found.

    From the gain of the two steps, and of a Riccati equation if all states are measured, the norm falls within one valley. Where
    that ends far above the lower bound others are searched, too.
    """
    from synth.analysis.bounding import certify_law
    from synth.design.descent.refine import SEEN, WORTH, refine
    from synth.design.static import descended

    q = len(plant.Cy)
    kept = [i for i in range(q) if i not in design.redundant]
    few, start = plant.rows(kept), design.gain[:, kept]
    lowest, faster, growth, size, origin = design, None, 1.0, float(np.abs(start).max(initial=0.0)), ITS_GAIN
    equation, nearer = _state_feedback(few, below, largest_gain)
    search = partial(descended, few, replace(design, gain=start), largest_gain, below, work=work)
    gains: list[tuple[str, Callable[[], Array]]] = [(EQUATION, lambda K=K: K) for K in equation]
    gains.append((ITS_GAIN, lambda: refine(few, None, start).gain))
    gains += [(SEARCHED, lambda most=most: search(most=most).gain) for most in LIMITS]
    for name, gain_of in gains:
        fast = True
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            gain = gain_of()
            grown = float(np.abs(gain).max(initial=0.0)) / size if size else np.inf
            certificate = certify_law(few, static_law(gain), below)
            fast = certificate.beyond_actuators and not (name == EQUATION or design.certificate.beyond_actuators)
            price = WORTH * min(math.log2(max(grown / growth, 1.0)), MOST_DOUBLINGS)
            lower = certificate.norm.value < lowest.certificate.norm.value * (1 - max(SEEN, price))
            if lower and not certificate.failures and grown * size <= largest_gain:
                found = with_redundant_rows(Design(gain, certificate, case=design.case), kept, q, 0.0)
                if fast:
                    faster = faster or found
                else:
                    lowest, faster, growth, origin = found, faster, grown, name
        gap = lowest.certificate.gap
        near = gap is not None and gap <= FAR and (lowest is not design or name != EQUATION)
        if near or (name == SEARCHED and not fast):
            break
    return lowest if lowest is not design else faster, growth, origin, nearer


def _state_feedback(plant: Plant, below: LowerBound | None, largest_gain: float) -> tuple[list[Array], str]:
    """Returns the state feedback of a Riccati equation nearest to the lower bound that is not too fast, and why none is nearer.

    Poles beyond any actuator are accepted if a largest gain is given. None is returned unless all states are measured.
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


def _known_gain(plant: Plant, two_steps: Design | str, lower_bound: LowerBound | None) -> tuple[Array, Certificate, str] | None:
    """Returns a certified gain where descents find none, and how it is known; None if no gain is known."""

    def of_two_steps() -> Array | None:
        return two_steps.gain if isinstance(two_steps, Design) else None

    def of_zero_l() -> Array | None:
        return zero_l_design(plant).gain

    def no_control() -> Array | None:
        return np.zeros((plant.B.shape[1], len(plant.Cy))) if is_stable(plant.A, plant.dt) else None

    from synth.analysis.bounding import certify_law

    for how, known in (
        ("by the two-step method without changes", of_two_steps),
        ("by the second step with L = 0", of_zero_l),
        ("without control, as the plant is stable", no_control),
    ):
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            gain = known()
            if gain is not None:
                certificate = certify_law(plant, static_law(gain), lower_bound)
                if not certificate.failures:
                    return gain, certificate, how
    return None
