"""Full-order H-infinity output feedback: a law with as many states as the plant, and a norm close to the lower bound.

The laws come from Riccati equations (`riccati.py`). If the norm of the central law stays above the lower bound, or rounding
prevents a proof, descents are also tried. The best law for which a proof succeeds is returned. The central law of the Riccati
equations is one of a family of laws. If the regularisation raises the norm of the central law, another law of the family may be
closer to the bound and have slower poles. A controller with fewer states, even a static gain, also counts as a full-order
controller.

A discrete plant is mapped to a continuous plant for the design.
"""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from models.common.checks import Bound, Positive
from models.common.errors import InputError
from models.common.printed import about, brief, digits, percent, rough
from models.laws.linear import LinearLaw, static_law
from synth.analysis.bounding import certify_law
from synth.analysis.lower_bounds.lower_bound import LowerBound
from synth.analysis.stabilisability import stabilisability_failures, static_feedback_obstructions
from synth.design.descent.landscape import Landscape
from synth.design.descent.minimax import descend_norm
from synth.design.full_order.riccati import SHARES, WITHIN, RiccatiSearch, TradeOffPoint, lowest, pareto_front, select
from synth.design.full_order.stable import stable_laws
from synth.design.problem import LARGEST_GAIN, DesignProblem, DesignResult, Progress, as_designed
from synth.design.static import BOUND_TOLERANCE, static_output_feedback
from synth.lmi.full_order_bound import find_lower_bound
from synth.plant.discrete import continuous_image
from synth.plant.generalized import Plant, check_inputs, check_posed, gain_law, law_gain
from synth.plant.numerics import DesignError, InfeasibleError, numerics

RICCATI = "Riccati equations for the least norm"
SINGULAR = 1e-12  # a value below this relative size counts as zero


def discrete_law(law: LinearLaw, image: Plant, K0: Array, dt: float) -> LinearLaw:
    """Converts a law for the continuous counterpart of a discrete plant to a law for the discrete plant, with the same loop.

    The measurements of the continuous plant contain Dyu u, so the law first subtracts this term. Tustin's method then gives the
    discrete law, to which the gain K0 is added.

    Args:
        law: law in continuous time on the measurements y = C_y x + Dyw w of the continuous plant.
        image, K0: result of `continuous_image`.
        dt: sample period [s].

    Raises:
        DesignError: the law is infinite at s = infinity, which Tustin's method maps to z = -1.
        LinAlgError: the law has a pole at 2 / dt.
    """
    direct = law.D @ image.Dyu
    if np.linalg.svd(np.eye(len(direct)) + direct, compute_uv=False)[-1] <= SINGULAR * (1 + np.linalg.norm(direct, 2)):
        raise DesignError(
            "the full-order law would be infinite at z = -1, where the plant has a pole; remove this pole from the model, or "
            "design a static gain"
        )
    discrete = bilinear(law.fed_back(-image.Dyu), dt)
    return replace(discrete, D=discrete.D + K0)


def bilinear(law: LinearLaw, period: float) -> LinearLaw:
    """Returns the discrete law whose continuous counterpart by Tustin's method is the given law."""
    turned = np.linalg.inv(np.eye(law.states) - period / 2 * law.A)
    into = turned @ law.B
    return LinearLaw(
        turned @ (np.eye(law.states) + period / 2 * law.A),
        period * into,
        law.C @ turned,
        law.D + period / 2 * law.C @ into,
        period,
    )


BEYOND = 10.0  # largest gain that is tried; in this unit, a gain of 1 moves poles to the allowed speed
# factors that multiply a gain; each is about 5 % smaller than the previous one
SHARES_OF_GAIN = np.geomspace(1.0, 1e-3, 150)[1:]
STAGES, ROUNDS = 20, 60  # largest number of stages in the descent of a law, and largest number of rounds in each stage
LEAST_FALL = 3e-4  # the descent ends if a stage lowers the norm by less than this relative amount
MOST = 100  # largest number of entries for which the descent of a law takes no more than a few seconds


def numbers(search: RiccatiSearch) -> int:
    """Returns the number of entries in the matrices of a full-order law."""
    n, m = search.own.plant.B.shape
    return (n + m) * (n + len(search.own.plant.Cy))


def refined_law(search: RiccatiSearch, start: TradeOffPoint, fastest: float) -> list[TradeOffPoint]:
    """Improves a law by descent over laws of the same order. Returns the laws at the ends of all successful stages of the
    descent.

    Args:
        search: search for laws for the plant; the internal units of this search are used.
        start: law from which the descent starts.
        fastest: largest allowed magnitude of a pole, divided by the plant's own speed. If the poles with the starting law are
            faster, the speed of these poles is the limit.
    """
    if not start.own.states:
        return []
    own, (q, m) = search.own.plant, search.own.plant.Dyu.shape
    limit = max(fastest, start.speed_up)

    def point(gain: Array) -> TradeOffPoint | None:
        return search.judged(0.0, gain_law(gain, m, q))

    landscape = Landscape(own.with_states(start.own.states))
    x, enough = landscape.point(law_gain(start.own)), search.bound * (1 + BOUND_TOLERANCE)
    norm, best = landscape.norm(x)[0], list[TradeOffPoint]()
    # in the first stage, the largest entry of the law must not grow; in each later stage, it may double
    for stage in range(STAGES if np.isfinite(norm) else 0):
        most = float(np.abs(x).max()) * (2 if stage else 1)
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            x, reached = descend_norm(landscape, x, np.full(len(x), most), ROUNDS, enough)
            each = point(landscape.gain(x))
            if each is not None and each.speed_up <= limit:
                best.append(each)
                if enough < reached < norm * (1 - LEAST_FALL):
                    norm = reached
                    continue
        break
    return best


def static_gains(search: RiccatiSearch, fastest: float, rival: float) -> list[TradeOffPoint]:
    """Returns a static gain, and the best multiple of this gain with slow enough poles; an empty list if no gain stabilises the
    plant.

    Args:
        search: search for laws for the plant; the internal units of this search are used.
        fastest: largest allowed magnitude of a pole, divided by the plant's own speed.
        rival: norm with another law, in the units of the plant. The search ends early if the norm with a static gain is far
            above the norm `rival`.
    """
    own, points = search.own, list[TradeOffPoint | None]()
    if static_feedback_obstructions(own.plant):
        return []
    # In internal units, a gain of one moves the poles of a plant without feedthrough to about one. A faster loop needs a larger
    # gain.
    largest = max(LARGEST_GAIN, BEYOND * fastest * search.fastest / own.rate)
    with contextlib.suppress(InputError, np.linalg.LinAlgError):
        gain = static_output_feedback(own.plant, None, largest, LowerBound(search.bound), rival=rival * own.norm).gain
        points.append(search.judged(0.0, static_law(gain)))
        # If this gain gives poles that are too fast, a gain with slower poles lies on the line between no control and this
        # gain.
        fractions = (search.judged(0.0, static_law(share * gain)) for share in SHARES_OF_GAIN)
        points.append(lowest(each for each in fractions if each is not None and each.speed_up <= fastest))
    return [each for each in points if each is not None]


# Fastest allowed pole of a discrete loop. The unit is 1/dt in the continuous counterpart of the loop, where this pole
# corresponds to z = -1/3, twice as fast as z = 0. An actuator that sets a force at each sample can follow this pole
DEADBEAT = 4.0


@numerics()
def full_order_design(
    plant: Plant,
    Cy: Array | None = None,
    Dyw: Array | None = None,
    lower_bound: LowerBound | None = None,
    states: Sequence[str] = (),
    fastest: Bound = np.inf,
    stable: bool = False,
    as_run: Callable[[LinearLaw], LinearLaw] = as_designed,
    fastest_pole: Positive | None = None,
) -> DesignResult:
    """Designs a full-order controller whose norm is within 0.1 % of the lower bound and that, if possible, is itself stable and
    slow.

    If no norm is that close to the bound, the result is the controller whose norm is closest to the bound.

    Closed-loop poles that are more than 100 times as fast as the plant must be justified by a lower norm. Each tenfold increase
    in the speed of the poles must lower the norm by at least 0.1 %.

    Args:
        plant: generalised plant with n states and m inputs.
        Cy: measurement matrix, shape (q, n). Default: the Cy of the plant.
        Dyw: direct effect of w on the measurements, shape (q, r). Default: zero if Cy is given, otherwise the Dyw of the plant.
        lower_bound: lower bound on the norm of every controller that uses the measurements. Default: the bound is computed.
        states: names of the states, used in error messages.
        fastest: limit on the magnitude of the closed-loop poles of a continuous plant, divided by the plant's own speed.
        stable: True if the law itself must be stable.
        as_run: function that converts a designed law to the law that is executed, for example to a law that subtracts forces
            from its measurements.
        fastest_pole: limit on the magnitude of the closed-loop poles [rad/s]; None for no limit.

    Returns:
        The law, its certificate, and the trade-off between norm and speed of the poles, which is a Pareto front in `trade`.

    Raises:
        InputError: a matrix does not fit the plant, no disturbance acts on the plant, or z is zero.
        InfeasibleError: no controller stabilises the plant from the measurements; the message describes the mode that cannot be
            stabilised.
        DesignError: no law was found whose loop is slow enough, and stable despite rounding; or, if `stable` is True, no such
            law is itself stable.

    Example:
        >>> from synth import GeneralizedPlant, full_order_design
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> design = full_order_design(oscillator, Cy=[[0, 1]])
        >>> design.law.states, f"{design.certificate.norm.value:.3f}", design.stable
        (2, '0.250', True)
    """
    check_inputs(plant)
    plant = plant.measured(Cy, Dyw)
    check_posed(plant)
    if reasons := "; ".join(stabilisability_failures(plant, states)):
        raise InfeasibleError(reasons)
    if plant.dt is not None and (fastest_pole is not None or fastest < np.inf):
        raise InputError(
            "the sample period of a discrete plant already limits the speed of the closed loop; omit fastest_pole and fastest"
        )
    below = find_lower_bound(plant) if lower_bound is None else lower_bound
    image = continuous_image(plant)
    search = RiccatiSearch(image[0], below.gamma, DEADBEAT / plant.dt if plant.dt is not None else 0.0)
    if fastest_pole is not None:
        fastest = min(fastest, fastest_pole / search.fastest)
    much = min(fastest, search.much)

    def proved(best: TradeOffPoint, trade: Sequence[TradeOffPoint]) -> DesignResult:
        reduced = search.reduced(best)
        law = reduced.law if plant.dt is None else discrete_law(reduced.law, *image, plant.dt)
        certificate = certify_law(plant, law, below)
        if certificate.failures:
            raise DesignError(f"its certificate fails: {'; '.join(certificate.failures)}")
        said = [_remark(reduced, trade, below), _speed(reduced, trade) if plant.dt is None else ""]
        remarks = tuple(text for text in said if text)
        return DesignResult(law, certificate, RICCATI, remarks=remarks, trade=tuple(trade))

    def nearest() -> DesignResult:
        lost, enough = list[Exception](), below.gamma * (1 + WITHIN)
        near = search.near(fastest)
        if near is not None and near.excess == 1:
            try:
                return proved(near, ())
            except (InputError, np.linalg.LinAlgError) as error:
                lost.append(error)
                near = None
        trade = pareto_front([*search.trade(much), *([near] if near is not None else [])])
        if fastest < np.inf:
            trade = pareto_front([*trade, *search.next_to(trade, fastest)])
        for limit in dict.fromkeys((much, fastest)) if numbers(search) <= MOST else ():
            best = select(trade, limit, enough)
            if best is not None and (lost or best.norm > enough):
                trade = pareto_front([*trade, *refined_law(search, best, limit)])
                best = select(trade, limit, enough)
            if limit == much and (lost or best is None or best.norm > enough):
                rival = best.norm if best is not None and not lost else np.inf
                trade = pareto_front([*trade, *static_gains(search, limit, rival)])
        left = trade
        while (best := select(left, fastest, enough)) is not None:
            try:
                return proved(best, trade)
            except (InputError, np.linalg.LinAlgError) as error:
                lost.append(error)
                left = [each for each in left if each is not best]
        if lost:
            raise DesignError(str(lost[0])) from lost[0]
        if trade:
            raise DesignError(
                f"no law was found that keeps all closed-loop poles within fastest_pole = {rough(fastest * search.fastest)} "
                f"rad/s; the slowest loop found needs fastest_pole = {rough(trade[0].pole)}: give at least this value"
            )
        raise DesignError(
            "no full-order controller was found whose loop is stable despite rounding (tried: noise and cost from "
            f"{SHARES[0]:.2g} to {SHARES[-1]:.0e} of the plant's own size); measure more signals, or use other units"
        )

    def fits(each: TradeOffPoint) -> bool:
        with contextlib.suppress(InputError):
            return not as_run(each.law).growth and each.speed_up <= fastest
        return False

    unconstrained = nearest()
    if not stable or not as_run(unconstrained.law).growth:
        return unconstrained
    found = stable_laws(search, fits, MOST)
    if numbers(search) <= MOST:
        found += static_gains(search, much, min((each.norm for each in found), default=np.inf))
    laws = pareto_front([each for each in found if fits(each)])
    size = (len(plant.A) + plant.B.shape[1]) * (len(plant.A) + len(plant.Cy))
    undescended = f"; no descent was tried: the law has {size} numbers, and {MOST} is the limit" * (size > MOST)
    while (best := select(laws, fastest)) is not None:
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            own = proved(best, laws)
            if not as_run(own.law).growth:
                against = _against(own, unconstrained, as_run) + undescended
                return replace(own, remarks=(*own.remarks, against))
        laws = [each for each in laws if each is not best]
    raise DesignError(f"every law found is unstable by itself{undescended}; omit stable = true, or measure more signals")


def riccati(problem: DesignProblem, progress: Progress) -> DesignResult:
    """Designs a full-order law with the smallest H-infinity norm."""
    return full_order_design(
        problem.plant,
        lower_bound=problem.lower_bound,
        states=problem.states,
        stable=problem.stable,
        as_run=problem.as_run,
        fastest_pole=problem.fastest_pole,
    )


def _against(own: DesignResult, other: DesignResult, as_run: Callable[[LinearLaw], LinearLaw]) -> str:
    """Describes how the best law that is itself stable compares with an unstable law."""
    norms = [each.certificate.norm.value for each in (own, other)]
    share = norms[0] / norms[1] - 1
    price = "the norm does not rise" if share <= WITHIN else f"the norm rises by {percent(share)}"
    slowest = f", its slowest pole {rough(_slowest(as_run(own.law)))} 1/s" if own.law.states else ", without states"
    growth = rough(as_run(other.law).growth)
    return f"stable by itself{slowest}; compared with {digits(norms[1])} of an unstable law (+{growth} 1/s), {price}"


def _slowest(law: LinearLaw) -> float:
    """Returns the real part of a law's slowest pole, converted to continuous time [1/s]."""
    poles = np.linalg.eigvals(law.A)
    return float(poles.real.max()) if law.sample_period is None else float(np.log(np.abs(poles).max()) / law.sample_period)


def _remark(best: TradeOffPoint, trade: Sequence[TradeOffPoint], below: LowerBound) -> str:
    """Describes the gap between a norm and its lower bound, and the poles of a law with a smaller gap; empty if the gap is
    small.
    """
    bound = below.gamma
    if bound and best.norm <= bound * (1 + WITHIN):
        return ""
    above = f"the norm is {percent(best.norm / bound - 1)} above the lower bound" if bound else "no lower bound is proved"
    above += f" ({below.reason})" if below.reason else ""
    least = min((each.norm for each in trade), default=best.norm) * (1 + WITHIN)
    if best.norm <= least:
        return f"{above}: no faster controller that was tried comes closer; the bound may be out of reach"
    nearer = min((each for each in trade if each.norm <= least), key=lambda each: each.speed_up)
    other = f"the law found closest to the bound, with norm {digits(nearer.norm)}, has a pole of {brief(nearer.pole)} rad/s"
    return f"{above}: {other}, but the fastest pole of this law is {brief(best.pole)} rad/s"


def _speed(best: TradeOffPoint, trade: Sequence[TradeOffPoint]) -> str:
    """Describes the sample period that a fast pole requires, and the norm of a slower law; empty if no pole is fast."""
    if best.excess == 1:
        return ""
    slower = next((each for each in reversed(trade) if each.excess == 1), None)
    more = f"; fastest_pole = {_upwards(slower.pole):g} gives a slower law of norm {digits(slower.norm)}" if slower else ""
    return (
        f"its fastest pole is {brief(best.pole)} rad/s, {about(best.speed_up)} times the fastest of the plant: a computer with a "
        f"sample period of {1 / best.pole:.1g} s or more cannot run this law{more}"
    )


def _upwards(pole: float) -> float:
    """Returns the magnitude of a pole, rounded up to two digits."""
    unit = 10.0 ** (np.floor(np.log10(pole)) - 1)
    return float(np.ceil(pole / unit) * unit)
