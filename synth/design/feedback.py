"""Design of a controller for any plant. The arguments of `design_feedback` are the keys of a controller's section in a vehicle
file.

The arguments are checked first; `models/laws/combinations.py` lists which arguments can be combined. The result is a
`DesignProblem`, for which `synth.design.methods` chooses the design method. The functions for the design methods are in
separate files, and can also be called directly.
"""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.checks import Bound, NotNegative, Positive, PositiveTime
from models.common.errors import InputError, error_in, list_names, short_repr
from models.common.printed import digits, percent
from models.common.schema import read
from models.laws.combinations import check_together, is_order, section_parts
from models.laws.design_methods import DESIGNS, FULL, PATTERNS, PREVIEW, STATIC
from models.laws.design_request import LawStructure
from models.laws.goals import REGRET
from models.laws.law_structure import StructureSection
from models.laws.linear import MOST_STATES, LinearLaw
from synth.analysis.certificate import Certificate
from synth.analysis.lower_bounds.lower_bound import LowerBound
from synth.analysis.sampled_loop import HoldInterval, SampledDataProblem, hold_intervals
from synth.analysis.stabilisability import check_stabilisable, stabilisability_failures
from synth.design.methods import design as designed
from synth.design.problem import LARGEST_GAIN, DesignProblem, DesignResult
from synth.plant.generalized import Plant, check_continuous, check_inputs, real_matrix
from synth.plant.numerics import InfeasibleError, numerics

WHERE = "design_feedback:"
FEEDBACK = tuple(name for name in DESIGNS if name != PREVIEW)
FeedbackDesign = DesignResult  # public name of this class


@numerics()
def design_feedback(
    plant: Plant,
    Cy: Array | None = None,
    Dyw: Array | None = None,
    *,
    order: str | int | None = None,
    design: str | None = None,
    stable: bool = False,
    fastest_pole: Positive | None = None,
    noise: Sequence[float] = (),
    sample_period: PositiveTime | None = None,
    delay: NotNegative = 0.0,
    minimise: Mapping[str, Any] | None = None,
    bounds: Sequence[Mapping[str, Any]] = (),
    tolerance: Mapping[str, float] | None = None,
    family: Sequence[Plant] = (),
    structure: Array | str | None = None,
    pid: Mapping[str, float] | None = None,
    largest_gain: Bound | None = None,
    lower_bound: LowerBound | None = None,
    states: Sequence[str] = (),
) -> FeedbackDesign:
    """Designs a controller for any plant. The result contains a certificate, the design method, and the reason why this method
    was chosen.

    By default, the design is a static gain with the smallest H-infinity norm, computed by the paper's two-step method. Descent
    follows if the norm is then more than 0.1 % above the lower bound, or if the two steps find no gain. The arguments are the
    keys of a controller's section in a vehicle file, and can be combined in the same way as these keys. The measurements of a
    plant are named y1, y2, ..., its forces u1, u2, ..., and the rows of z are named z1, z2, ...

    Args:
        plant: generalised plant with n states and m inputs; continuous, or discrete with sample period dt.
        Cy: measurement matrix of y = C_y x + Dyw w, shape (q, n). Default: the C_y of the plant, or all states if the plant has
            no measurements.
        Dyw: direct effect of w on the measurements, shape (q, r). Default: zero if Cy is given, otherwise the Dyw of the plant.
        order: "static" (default), "full" for a law with as many states as the plant, or a smaller number of states.
        design: "lqr", "lqg" or "h2" to minimise the mean square of z instead of the H-infinity norm.
        stable: True if the law itself must be stable; only for a law with an `order`.
        fastest_pole: largest magnitude of the closed-loop poles [rad/s], for order = "full" of a continuous plant; None for no
            limit.
        noise: rms noise of each measurement, shape (q,). In an H-infinity design, noise is an additional disturbance, scaled by
            its rms value. For LQG, the noise is white; see `lqg_design`.
        sample_period: sample period of the computer that closes the loop of a continuous plant and holds the forces [s].
        delay: delay from a measurement to the force computed from it [sample periods].
        minimise: the norm to minimise, for example {"band": [4.0, 8.0]} [Hz] or {"signals": {"z1": 1.0}}.
        bounds: bounds on other quantities, for example [{"norm": 8.6}, {"decay": 1.2}, {"gain": 2e4}].
        tolerance: relative gain errors of measurements and forces that the design must tolerate, for example {"y1": 0.1,
            "force": 0.05}.
        family: additional plants for which the same gain is designed. The largest norm of all plants is minimised. If a plant
            has no measurements of its own, Cy defines its measurements.
        structure: mask of the gain, shape (m, q): one if a measurement may act on a force, otherwise zero. If `order` is a
            number of states, each force has its own law with this number of states. The text "pi" or "pid" selects a PI or PID
            law from each measurement to its force.
        pid: time constant [s] of the low-pass filter on the derivative of a "pid" law, for example {"filter": 0.01}.
        largest_gain: largest |K_ij| allowed for a static gain with the smallest norm, in the units of the plant. Default: 1e5.
        lower_bound: lower bound on the norm of every controller that uses the measurements, if known; the certificate contains
            this bound.
        states: names of the states, used in error messages.

    Returns:
        The law (u = +K y for a gain), its certificate, and texts in `method`, `why` and `remark`. If a sample period is given,
        the result then also contains the norm of the sampled-data loop and a lower bound on this norm.

    Raises:
        InputError: a matrix does not fit the plant, the plant has no input, or two arguments exclude each other.
        InfeasibleError: no controller of the required type stabilises the plant; the message describes the mode that cannot be
            stabilised.
        DesignError: no method found a controller; the message gives the reason.

    Example:
        >>> from synth import GeneralizedPlant, design_feedback
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> found = design_feedback(oscillator, Cy=[[0, 1]])
        >>> found.gain.shape, f"{found.certificate.norm.value:.4f}", found.method
        ((1, 1), '0.2500', 'the two steps')
        >>> design_feedback(oscillator, Cy=[[0, 1]], order="full").law.states
        2
    """
    for name, value, allowed in (("order", order, (STATIC, FULL)), ("design", design, FEEDBACK)):
        if value is not None and value not in allowed and not (name == "order" and is_order(value)):
            states = f", or a number of states from 0 to {MOST_STATES}" if name == "order" else ""
            raise InputError(f"{WHERE} {name} = {short_repr(value)} is not known; known values: {list_names(allowed)}{states}")
    goals = {"minimise": minimise, "tolerance": tolerance, "structure": structure}
    goals = {name: _plain(value) for name, value in goals.items() if value is not None}
    goals |= {"bounds": _plain(bounds)} if len(bounds) else {}
    of_law = (is_order(order) and order) or goals.get("structure") in PATTERNS
    own = {"structure": goals.pop("structure")} if of_law and "structure" in goals else {}
    own |= {"pid": _plain(pid)} if pid is not None else {}
    heard = "Dyw" if Dyw is not None else "noise" if len(noise) and design != "lqg" else ""
    check_together(WHERE, _parts(order, design, stable, heard, sample_period, goals | own, family, fastest_pole))
    check_inputs(plant)
    plant = plant.measured(Cy if Cy is not None or len(plant.Cy) else np.eye(len(plant.A)), Dyw)
    rms = _rms(plant, noise)
    if delay and sample_period is None:
        raise InputError(
            f"{WHERE} delay = {delay:g} samples needs a sample period, but none is given; give sample_period in seconds"
        )
    if pid is not None and own.get("structure") not in PATTERNS:
        raise InputError(f'{WHERE} pid = {short_repr(_plain(pid))} applies only to structure = "pid"; give both, or omit pid')
    by_descent_alone = order != FULL and not of_law and design is None and sample_period is None and not goals and not len(family)
    if largest_gain is not None and not by_descent_alone:
        raise InputError(
            f"{WHERE} largest_gain applies only when a static gain is designed for the least norm; omit largest_gain, or bound "
            'the gain with bounds = [{"gain": ...}]'
        )
    problem = DesignProblem(
        _with_noise(plant, rms),
        order=FULL if order == FULL else STATIC,
        structure=_structure(plant, {"order": order} | own) if of_law else None,
        design=design or "",
        stable=stable,
        fastest_pole=fastest_pole,
        largest_gain=LARGEST_GAIN if largest_gain is None else largest_gain,
        lower_bound=lower_bound,
        states=tuple(states),
    )
    if sample_period is not None:
        return _design_sampled(problem, plant, rms, hold_intervals(float(sample_period), float(delay)))
    if problem.structure is None and (goals or len(family)):
        return _for_goals(problem, plant, rms, goals, family)
    if design is not None:
        check_continuous(plant)
    if design == "lqg":  # LQG also assumes a white noise, which is not part of w
        problem = replace(problem, plant=plant, noise=tuple(rms) if len(rms) else None)
    if design is None and problem.structure is None and order != FULL:
        return _static(problem)
    result = designed(problem)
    why = f'design = "{design}"' if design is not None else 'order = "full"'
    return result if result.why else replace(result, why=why)


def _parts(
    order: str | int | None,
    design: str | None,
    stable: bool,
    heard: str,
    sample_period: float | None,
    goals: Mapping[str, Any],
    family: Sequence[Plant],
    fastest_pole: float | None,
) -> dict[str, str]:
    """Returns those of the requested options that are in the table of compatible options, written as the user wrote them."""
    flags = {"stable": stable, "noise": bool(heard), "sampled": sample_period is not None}
    named = {"order": order, "design": design, "fastest_pole": fastest_pole}
    section = {name: value for name, value in named.items() if value is not None} | flags | dict(goals)
    parts = section_parts(section | ({"family": family} if len(family) else {}), ())
    written = {"noise": heard, "sampled": "sample_period", "stable": "stable = True"}
    return {part: written.get(part, text) for part, text in parts.items()}


def _plain(value: Any) -> Any:
    """Converts tables, lists and numbers in the arguments to the types that a vehicle file uses."""
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


def _distance(certificate: Certificate) -> str:
    """Returns the gap between a norm and its lower bound, as text; empty if the norm is zero."""
    if certificate.gap is not None and percent(certificate.gap) == percent(0):
        return "no controller has a lower norm"
    reason = f"; {certificate.below.reason}" if certificate.below is not None and certificate.below.reason else ""
    if certificate.gap is not None:
        return f"its norm is {percent(certificate.gap)} above the lower bound {digits(certificate.lower_bound)}{reason}"
    return f"no lower bound of the norm is known{reason}" if certificate.norm.value > certificate.norm_rounding else ""


def _rms(plant: Plant, noise: Sequence[float]) -> Array:
    """Returns the rms noise of each measurement, shape (q,); an empty array if there is no noise.

    Raises:
        InputError: the noise does not have exactly one value >= 0 for each measurement.
    """
    rms = real_matrix([list(noise)], "noise", "(q,)")[0]
    if len(noise) and (rms.shape != (len(plant.Cy),) or not np.all(rms >= 0)):
        raise InputError(
            f"{WHERE} noise = {short_repr([*noise])} is not allowed; give {len(plant.Cy)} numbers from 0 upwards, one for each "
            "measurement"
        )
    return rms


def _with_noise(plant: Plant, rms: Array) -> Plant:
    """Returns the plant with the noise of its measurements as additional disturbances."""
    some = rms > 0
    return plant.with_disturbances(np.diag(rms)[:, some]) if np.any(some) else plant


def _structure(plant: Plant, section: Mapping[str, Any]) -> LawStructure | None:
    """Returns the structure of a law with measurements y1, y2, ... and forces u1, u2, ..., read from the keys of a section."""
    q, m = plant.Dyu.shape
    measured, corners = [f"y{i + 1}" for i in range(q)], {f"u{i + 1}": "" for i in range(m)}
    asked = read(WHERE, StructureSection, section, measured=measured, corners=corners)
    with error_in(WHERE):
        return asked.law_structure(measured, corners)


def _static(problem: DesignProblem) -> DesignResult:
    """Designs a static gain by the two-step method; descent then refines this gain, or replaces it."""
    from synth.design.static import bounded_work

    result = designed(replace(problem, work=bounded_work(problem.plant)))
    left_out = [f"y{i + 1}" for i in result.redundant]
    redundant = f"{', '.join(left_out)} depends on the others: its gain is zero" if left_out else ""
    why = result.instead or result.why or "the two-step method finds a gain whose certificate holds"
    texts = result.case, redundant, _distance(result.certificate)
    return replace(result, why=why, remarks=tuple(text for text in texts if text))


def _design_sampled(problem: DesignProblem, plant: Plant, rms: Array, pieces: tuple[HoldInterval, ...]) -> DesignResult:
    """Designs a gain or a law for the sampled-data loop."""
    check_continuous(plant)
    if np.any(plant.Dyw):
        raise InputError(
            f"{WHERE} Dyw has no effect with sample_period; omit Dyw, and give noise instead, with one rms value for each signal"
        )
    from synth.design.static import bounded_work

    if reasons := stabilisability_failures(plant, problem.states):
        raise InfeasibleError("; ".join(reasons))
    held = SampledDataProblem(plant, pieces, rms if np.any(rms) else None)
    known, near, work = list[LinearLaw](), 1.0, bounded_work(plant)
    with contextlib.suppress(InputError, np.linalg.LinAlgError):
        if problem.order == FULL:
            from synth.lmi.full_order_bound import find_lower_bound

            near = (problem.lower_bound or find_lower_bound(problem.plant)).gamma or 1.0
        else:
            static = DesignProblem(problem.plant, lower_bound=problem.lower_bound, states=problem.states, alternatives=False)
            ideal = designed(replace(static, work=work))
            known, near = [ideal.law], ideal.certificate.norm.value or 1.0
    result = designed(replace(problem, sampled=held, known=known, near=near, work=work))
    texts = *result.remarks, "the certificate is that of the ideal loop, without sampling and delay"
    return replace(result, why=result.why or 'order = "full"', remarks=texts)


def _for_goals(
    problem: DesignProblem, plant: Plant, rms: Array, section: Mapping[str, Any], family: Sequence[Plant]
) -> DesignResult:
    """Designs a static gain for goals that apply to the plant and to a family of further plants."""
    from synth.design.multi_objective.design import with_individual_optima
    from synth.design.multi_objective.plant_goals import goals_of_plants

    for each in family:
        check_inputs(each)
    measured = [each if len(each.Cy) else each.measured(plant.Cy, plant.Dyw) for each in family]
    plants = [problem.plant, *(_with_noise(each, rms) for each in measured)]
    goals, plant_problem = goals_of_plants(WHERE, section, plants)
    for each in plants:
        check_stabilisable(each, problem.states)
    result = designed(replace(problem, goals=with_individual_optima(plant_problem) if goals.over == REGRET else plant_problem))
    over = "largest ratio to a plant's own best" if goals.over == REGRET else f"goal, {goals.minimise.text}"
    why = f"the goals are {list_names([*section, *['family'] * bool(family)])}"
    return replace(result, why=why, criterion=over)
