"""Design of any controller for any plant, with the keys of a controller's section as arguments.

The arguments are checked first, also against the table of `models/laws/combinations.py`. By default the two steps design a static
gain. If they find none, or end far above the lower bound, descent on the norm does (`fallback.py`). Every other method has its
own file and can be called directly.
"""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.checks import Bound, NotNegative, Positive, PositiveTime
from models.common.errors import InputError, error_in, listing, quoted
from models.common.printed import digits, percent
from models.common.schema import read
from models.document.document import Document
from models.document.figure import Figure
from models.document.text import Shown, facts
from models.laws.combinations import FULL, PATTERNS, QUADRATIC, STATIC, check_together, is_order, section_parts
from models.laws.goals import REGRET
from models.laws.law_structure import LawStructure, StructureSection
from models.laws.linear import MOST_STATES, LinearLaw, gain_text, states_text, static_law
from synth.analysis.bounding import certify_law
from synth.analysis.certificate import Certificate
from synth.analysis.lower_bound import LowerBound
from synth.analysis.sampled_loop import SampledDataProblem, hold_intervals
from synth.analysis.stability import is_stable, stabilisability_failures
from synth.design.fallback import check_stabilisable, near_lower_bound, two_steps_or_descent
from synth.design.two_step import LARGEST_GAIN
from synth.plant.generalized import Plant, check_continuous, check_inputs, real_matrix
from synth.plant.numerics import DesignError, InfeasibleError, numerics

WHERE = "design_feedback:"
SAMPLED = "sampled norm"
FEW = 4  # states; of more the matrices of a law are not shown
TWO_STEPS, DESCENT, BOTH = "the two steps", "descent on the norm", "the two steps and descent on the norm"


@dataclass(frozen=True, eq=False, repr=False)
class FeedbackDesign(Shown):
    """A controller of a plant, with its certificate, and the method that led to it.

    Attributes:
        law: law from the q measurements to the m forces, with A, B, C, D: x_c' = A x_c + B y, u = C x_c + D y, without a minus
            sign; a static one is u = K y. With a sample period the next x_c replaces x_c'.
        certificate: certificate of its loop, in continuous time or of the discrete plant. Noise is a part of w.
        method: method of the design.
        why: reason for that method, in words.
        remark: distance from the optimum, assumptions and left-out measurements, in words; empty without any.
        value: value of the objective that was minimised.
        criterion: name of that value: "norm", "sampled norm", "H2 norm", or a goal.
        sampled_lower_bound: bound on the sampled norm that no controller of any order beats at this sample period and delay; None
            without a sample period, or if none is proved.
    """

    law: LinearLaw
    certificate: Certificate
    method: str
    why: str
    remark: str
    value: float
    criterion: str = "norm"
    sampled_lower_bound: float | None = None

    @property
    def sampled_norm(self) -> float | None:
        """L2 gain of the loop that the computer closes, see `synth.sampled_norm`; None without a sample period."""
        return self.value if self.criterion == SAMPLED else None

    @property
    def gain(self) -> Array:
        """K of a static law, shape (m, q).

        Raises:
            InputError: the law has states.
        """
        if self.law.states:
            raise InputError(f"the law has {states_text(self.law)} and is not only a gain; use its attribute law")
        return self.law.D

    @property
    def shown(self) -> Document:
        """Returns law, method, reason and certificate as text."""
        law = _law_shown(self.law) if self.law.states else {"gain": gain_text(self.law.D)}
        value = {self.criterion: digits(self.value)} if self.criterion != "norm" else {}
        value |= {"sampled lower bound": digits(self.sampled_lower_bound)} if self.sampled_lower_bound is not None else {}
        rows = {**law, **value, **self.certificate.claims, "why": self.why, "remark": self.remark}
        return facts(f"feedback by {self.method}, {self.certificate.shown.title}", rows)

    @property
    def drawn(self) -> tuple[Figure, ...]:
        """The gain of the closed loop."""
        return self.certificate.drawn


def _law_shown(law: LinearLaw) -> dict[str, str]:
    """Returns a law with states as text: how many, if they are stable by themselves, and its matrices if they are few."""
    stable = is_stable(law.A, law.sample_period)
    matrices = {name: gain_text(getattr(law, name)) for name in "ABCD"} if law.states <= FEW else {}
    return {"law": f"{states_text(law)}; {'' if stable else 'not '}stable by itself"} | matrices


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
    """Returns a controller of any plant, with its proofs, the method that found it, and the reason for that method.

    By default it is a static gain for the least norm: by the two steps, followed by descent if they end more than 0.1 % above the
    lower bound, or by descent alone if they find none. The arguments are the keys of a controller's section in a vehicle file,
    and can be combined as there. A plant by itself has no names: its measurements are y1, y2, ..., its forces u1, u2, ..., the
    rows of z are z1, z2, ...

    Args:
        plant: n states, m inputs; continuous, or discrete by its dt.
        Cy: measurements y = C_y x + Dyw w, shape (q, n). Default: those of the plant, or without any every state.
        Dyw: shape (q, r); zero where it is not given.
        order: "static", the default, "full" for a law of as many states as the plant, or a number of states between these.
        design: "lqr", "lqg" or "h2", with the least mean square instead of the least norm.
        stable: True for a law with an order that is stable by itself.
        fastest_pole: largest magnitude of the loop's poles [rad/s], for order = "full" of a continuous plant; None for no limit.
        noise: rms of each measurement's noise, shape (q,), which counts as much as 1 of w; for LQG of white noise, see
            `lqg_design`.
        sample_period: period of the computer that closes the loop of a continuous plant and holds the forces [s].
        delay: delay from a measurement to its force [samples].
        minimise: the norm that is minimised, as in {"band": [4.0, 8.0]} [Hz] or {"signals": {"z1": 1.0}}.
        bounds: bounds such as [{"norm": 8.6}, {"decay": 1.2}, {"gain": 2e4}].
        tolerance: largest relative errors, as in {"y1": 0.1, "force": 0.05}.
        family: further plants that the same gain is for; the largest norm of all counts. Their default measurements are Cy.
        structure: ones where a measurement may act on a force, else zeros, shape (m, q); with a number of states each force has
            a law of its own with so many. Or "pi" or "pid", a law of that kind from each measurement to a force.
        pid: time constant of the derivative's low-pass for "pid" [s], such as {"filter": 0.01}.
        largest_gain: bound on |K_ij| of a static gain of the least norm; 1e5 where it is not given.
        lower_bound: lower bound for any controller from these measurements, if known, for the certificate.
        states: names of the states, for messages.

    Returns:
        A `FeedbackDesign`: the law, u = +K y for a gain, its certificate, method, why and remark; with a sample period also the
        sampled norm and its lower bound.

    Raises:
        InputError: a matrix does not fit the plant, it has no input, or two arguments exclude each other.
        InfeasibleError: no such controller stabilises the plant; the message names the mode.
        DesignError: no method found one; the message gives the reason.

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
    for name, value, allowed in (("order", order, (STATIC, FULL)), ("design", design, QUADRATIC)):
        if value is not None and value not in allowed and not (name == "order" and is_order(value)):
            states = f", or a number of states from 0 to {MOST_STATES}" if name == "order" else ""
            raise InputError(f"{WHERE} {name} = {quoted(value)} is not known; known: {listing(allowed)}{states}")
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
    asked = _Asked(plant, noise, lower_bound, tuple(states))
    if delay and sample_period is None:
        raise InputError(f"{WHERE} delay = {delay:g} samples needs a sample period; give sample_period in seconds")
    if pid is not None and own.get("structure") not in PATTERNS:
        raise InputError(f'{WHERE} pid = {quoted(_plain(pid))} needs structure = "pid"; give both')
    by_descent_alone = order != FULL and not of_law and design is None and sample_period is None and not goals and not len(family)
    if largest_gain is not None and not by_descent_alone:
        raise InputError(
            f"{WHERE} largest_gain applies only to a static gain of the least norm; omit it, or give goals "
            'bounds = [{"gain": ...}]'
        )
    law_structure = asked.structure({"order": order} | own) if of_law else None
    if sample_period is not None:
        return asked.sampled(float(sample_period), float(delay), order == FULL, stable, law_structure)
    if law_structure is not None:
        return asked.structured(law_structure, stable)
    if goals or len(family):
        return asked.for_goals(goals, family)
    if design is not None:
        return asked.quadratic(design)
    if order == FULL:
        return asked.full(stable, fastest_pole)
    return asked.static(LARGEST_GAIN if largest_gain is None else largest_gain)


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
    """Returns the requested parts of the table, each as it is written."""
    flags = {"stable": stable, "noise": bool(heard), "sampled": sample_period is not None}
    named = {"order": order, "design": design, "fastest_pole": fastest_pole}
    section = {name: value for name, value in named.items() if value is not None} | flags | dict(goals)
    parts = section_parts(section | ({"family": family} if len(family) else {}), ())
    written = {"noise": heard, "sampled": "sample_period", "stable": "stable = True"}
    return {part: written.get(part, text) for part, text in parts.items()}


def _plain(value: Any) -> Any:
    """Returns tables, lists and numbers as in a vehicle file."""
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


def _distance(certificate: Certificate) -> str:
    """Returns the gap between a norm and the lower bound, in words; empty if it is zero."""
    if certificate.gap is not None and percent(certificate.gap) == percent(0):
        return "no controller has a lower norm"
    if certificate.gap is not None:
        return f"its norm is {percent(certificate.gap)} above the lower bound {digits(certificate.lower_bound)}"
    return "no lower bound of the norm is known" if certificate.norm.value > certificate.norm_rounding else ""


class _Asked:
    """A plant with what is measured, checked, and every way to design for it."""

    def __init__(self, plant: Plant, noise: Sequence[float], lower_bound: LowerBound | None, states: tuple[str, ...]) -> None:
        self.plant, self.lower_bound, self.states = plant, lower_bound, states
        self.noise = real_matrix([list(noise)], "noise", "(q,)")[0]
        if len(noise) and (self.noise.shape != (len(plant.Cy),) or not np.all(self.noise >= 0)):
            raise InputError(
                f"{WHERE} noise = {quoted([*noise])} is not allowed; give {len(plant.Cy)} numbers from 0 upwards, one for each "
                "measurement"
            )

    def loud(self, plant: Plant) -> Plant:
        """Returns a plant with the noise of the measurements as further disturbances."""
        some = self.noise > 0
        return plant.with_disturbances(np.diag(self.noise)[:, some]) if np.any(some) else plant

    def static(self, largest_gain: float) -> FeedbackDesign:
        """A static gain, by the two steps, and by descent from there or in their place."""
        result, went_on = near_lower_bound(self.loud(self.plant), self.lower_bound, self.states, largest_gain)
        certificate, left_out = result.certificate, [f"y{i + 1}" for i in result.redundant]
        said = [result.case, f"{', '.join(left_out)} depends on the others: its gain is zero" if left_out else ""]
        why = result.instead or went_on or "the two-step method finds a gain whose certificate holds"
        method = DESCENT if result.instead else BOTH if went_on else TWO_STEPS
        remark = "; ".join(text for text in [*said, _distance(certificate)] if text)
        return FeedbackDesign(static_law(result.gain), certificate, method, why, remark, certificate.norm.value)

    def full(self, stable: bool, fastest_pole: float | None) -> FeedbackDesign:
        """Returns a law of full order; if none with the least norm is found, that of the least mean square, or a gain."""
        from synth.design.full_order.full_order import full_order_design

        plant = self.loud(self.plant)
        method, why = "Riccati equations for the least norm", 'order = "full"'
        try:
            given = plant, None, None, self.lower_bound, self.states
            found = full_order_design(*given, stable=stable, fastest_pole=fastest_pole)
            law, certificate, remark = found.law, found.certificate, found.remark
        except InfeasibleError:
            raise
        except DesignError as error:
            if stable or fastest_pole is not None:
                raise
            left = self._instead_of_full(plant)
            if left is None:
                raise
            (law, certificate, method), remark = left, ""
            why = f"Riccati equations for the least norm failed: {error}"
        return FeedbackDesign(law, certificate, method, why, remark, certificate.norm.value)

    def _instead_of_full(self, plant: Plant) -> tuple[LinearLaw, Certificate, str] | None:
        from synth.design.full_order.quadratic import h2_design

        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            h2 = h2_design(plant, states=self.states)
            return h2.law, replace(h2.certificate, below=self.lower_bound), "H2, of full order"
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            gain = two_steps_or_descent(plant, tuple, self.lower_bound, self.states)
            return static_law(gain.gain), gain.certificate, DESCENT if gain.instead else TWO_STEPS
        return None

    def structure(self, section: Mapping[str, Any]) -> LawStructure | None:
        """The structure of a law, of measurements y1, y2, ... and forces u1, u2, ..., in the words of a section."""
        q, m = self.plant.Dyu.shape
        measured, corners = [f"y{i + 1}" for i in range(q)], {f"u{i + 1}": "" for i in range(m)}
        asked = read(WHERE, StructureSection, section, measured=measured, corners=corners)
        with error_in(WHERE):
            return asked.law_structure(measured, corners)

    def structured(self, structure: LawStructure, stable: bool) -> FeedbackDesign:
        """A law of a given order or structure, by descent."""
        from synth.design.fixed_order.fixed_order import fixed_order_design

        result = fixed_order_design(self.loud(self.plant), structure, self.lower_bound, self.states, stable)
        why = f"from {result.origin}, for {structure.text}"
        return FeedbackDesign(result.law, result.certificate, DESCENT, why, result.remark, result.certificate.norm.value)

    def quadratic(self, name: str) -> FeedbackDesign:
        """The law of the least mean square."""
        from synth.design.full_order.quadratic import quadratic_design

        plant = self.loud(self.plant) if name == "h2" else self.plant
        check_continuous(plant)
        noise = tuple(self.noise) if name == "lqg" and len(self.noise) else None
        result = quadratic_design(name, plant, self.states, noise)
        certificate = replace(result.certificate, below=self.lower_bound)
        how = "a Riccati equation" if name == "lqr" else "two Riccati equations"
        return FeedbackDesign(result.law, certificate, how, f'design = "{name}"', result.remark, result.h2_norm, "H2 norm")

    def sampled(self, period: float, delay: float, full: bool, stable: bool, structure: LawStructure | None) -> FeedbackDesign:
        """A gain or a law for the loop that a computer closes."""
        check_continuous(self.plant)
        if np.any(self.plant.Dyw):
            raise InputError(
                f"{WHERE} Dyw has no effect between samples; with sample_period omit Dyw and give noise, one rms value for each"
            )
        from synth.design.static import bounded_work

        if reasons := stabilisability_failures(self.plant, self.states):
            raise InfeasibleError("; ".join(reasons))
        rms = self.noise if np.any(self.noise) else None
        problem = SampledDataProblem(self.plant, hold_intervals(period, delay), rms)
        plant = self.loud(self.plant)
        known, near, work = list[Array](), 1.0, bounded_work(self.plant)
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            if full:
                from synth.lmi.full_order_bound import find_lower_bound

                near = (self.lower_bound or find_lower_bound(plant)).gamma or 1.0
            else:
                ideal = two_steps_or_descent(plant, tuple, self.lower_bound, self.states, work=work)
                known, near = [ideal.gain], ideal.certificate.norm.value or 1.0
        from synth.lmi.sampled_bound import find_sampled_bound

        if full:
            from synth.design.full_order.sampled_data import lowest_level, sampled_full_order

            near, _ = lowest_level(problem, near, 0.0)
            bound = find_sampled_bound(problem, near)
            result = sampled_full_order(problem, bound, near, self.states, stable)
            law, norm, method, why, remark = result.law, result.norm, "Riccati equations for the sampled loop", "", result.remark
        elif structure is not None:
            from synth.design.fixed_order.sampled_data import sampled_fixed_order

            bound = find_sampled_bound(problem, near)
            result = sampled_fixed_order(problem, bound, near, self.states, stable, structure, work)
            law, norm, remark = result.law, result.norm, result.remark
            method, why = "descent on the sampled norm", f"for {structure.text}"
        else:
            from synth.design.sampled_data import held_design

            gain = held_design(problem, near, known, work)
            law, norm, bound = static_law(gain.gain), gain.norm, find_sampled_bound(problem, near)
            distance = percent(norm / bound.level - 1) if bound and bound.level else ""
            remark = f"norm {distance} above the lower bound of the sampled loop" if distance else "no lower bound is proved"
            method = "descent on the sampled norm" if gain.instead else "the two steps for the sampled loop"
            why = (
                f"the two-step method was not used: {gain.instead}"
                if gain.instead
                else "the two-step method finds a gain of this sampled norm"
            )
        certificate = certify_law(plant, law.continuous(), self.lower_bound)
        said = [remark, "the certificate is that of the ideal loop, without sampling and delay"]
        return FeedbackDesign(
            law,
            certificate,
            method,
            why or 'order = "full"',
            "; ".join(text for text in said if text),
            norm,
            SAMPLED,
            None if bound is None else bound.level,
        )

    def for_goals(self, section: Mapping[str, Any], family: Sequence[Plant]) -> FeedbackDesign:
        """A gain for goals, of the plant and of a family."""
        from synth.design.multi_objective.plant_goals import goals_of_plants
        from synth.design.multi_objective.two_step_starts import remarks, run_search, with_individual_optima

        for each in family:
            check_inputs(each)
        own = self.plant
        plants = [self.loud(own), *(self.loud(each if len(each.Cy) else each.measured(own.Cy, own.Dyw)) for each in family)]
        goals, problem = goals_of_plants(WHERE, section, plants)
        for each in plants:
            check_stabilisable(each, self.states)
        result = run_search(with_individual_optima(problem) if goals.over == REGRET else problem)
        law, notes = static_law(result.gain), [*remarks(result)]
        certificate = certify_law(plants[0], law, self.lower_bound)
        if unproved := result.unproved:
            notes.append(f"stability with all errors is not proved for member {', '.join(map(str, unproved))}")
        over = "largest ratio to a plant's own best" if goals.over == REGRET else f"goal, {goals.minimise.text}"
        why = f"the goals are {listing([*section, *['family'] * bool(family)])}"
        return FeedbackDesign(law, certificate, "descent for goals", why, "; ".join(notes), result.goal, over)
