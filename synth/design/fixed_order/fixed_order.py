"""Design of laws with a given order or structure and the smallest norm, by descent from several starting points.

A law with k states is a special case of a law with k + 1 states, so the search increases the order step by step, beginning with
a static gain. For each order, the starting points of the search are

- full-order laws, reduced to the order of the search (`reduction.py`): laws with nearly the smallest norm, and laws with slower
  poles;
- the law with one state less, extended by a state that receives the measurements but has no effect yet;
- random laws of every magnitude, if no other starting point is stable.

The search is the same as for static gains (`design/static.py`), but the plant includes the law's states. The gain has the zeros
that the structure requires (`pattern.py`). If the resulting poles are too fast for an actuator, the search is repeated with a
smaller limit on the gain. The search stops early if the law for some order reaches the lower bound. A law that reaches the
lower bound early has fewer states than allowed.
"""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy import linalg

from models.common.errors import InputError
from models.laws.design_methods import PID
from models.laws.design_request import LawStructure
from models.laws.law_structure import FILTER, GAINS, ITS_GAINS, pid_tables
from models.laws.linear import FEWER, LinearLaw
from synth.analysis.bounding import certify_law
from synth.analysis.certificate import FASTEST, Certificate
from synth.analysis.lower_bounds.lower_bound import LowerBound
from synth.analysis.norm import hinf_norm
from synth.analysis.stabilisability import stabilisability_failures
from synth.design.descent.landscape import Work
from synth.design.fixed_order.pattern import StructuredGain, gains_on_filters, in_equal_units, structured_gain
from synth.design.fixed_order.reduction import reductions
from synth.design.full_order.full_order import DEADBEAT, discrete_law, full_order_design
from synth.design.full_order.riccati import LARGEST, WITHIN, RiccatiSearch
from synth.design.full_order.stable import LIGHTLY, descend_stable
from synth.design.multi_objective.design import multi_objective_design
from synth.design.multi_objective.problem import FamilyMember, GainErrors, MultiObjectiveProblem, NormSpecification
from synth.design.problem import DESCENT, DesignProblem, DesignResult, Progress, as_designed
from synth.design.static import LAST_ROUNDS, MOST, Candidate, GainSearch, bounded_work
from synth.lmi.full_order_bound import find_lower_bound
from synth.plant.discrete import continuous_image
from synth.plant.generalized import Plant, check_inputs, check_posed
from synth.plant.numerics import DesignError, InfeasibleError, numerics
from synth.plant.units import speed

# limits on the entries of a gain, tried in this order until the poles are slow enough. In these units, a gain of 1 moves poles
# to about the speed of the plant's own poles
LIMITS = (100.0, 10.0, 3.0)
AT_LIMIT = 0.999  # an entry above this share of its limit counts as stopped by the limit
# if a limit stopped a descent, the descent continues with the limit multiplied by one of these factors
WIDER = (1e4, 100.0, 10.0)
POLES = (0.1, 1.0, 10.0)  # initial poles of a state that is added to the law, relative to the plant's speed
READS = 0.1  # initial gain from the measurements to a state that is added to the law, in the units of `LIMITS`
SHARES = (1e-1, 1e-2, 1e-3)  # relative amounts of noise and control cost that are added in the design of full-order laws
MARGINS = (1e-2, 1e-1, 1.0)  # relative margins of gamma above its smallest feasible value, in the design of full-order laws
STARTS_OF_A_KIND = 4  # number of starting points from each method; a descent begins at each of these points
FEW = 2  # number of stabilising gains from which a static gain is searched, if a law with states is also allowed
SHIFTS = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  # distances by which the poles of a law are shifted, relative to the plant's speed
SEED = 20261126
NO_LAW = "no law of this structure with a stable loop was found; measure more signals, or allow more states"
CAPPED_REMARK = "an entry of the law is at the limit of the search: a larger entry may give a lower norm, but faster poles"
ONE_STATE = LawStructure(1)


class End(NamedTuple):
    """Law at the end of a search, its certificate, and a description of the starting point from which the search found this
    law.
    """

    law: LinearLaw
    origin: str
    certificate: Certificate


@numerics()
def fixed_order_design(
    plant: Plant,
    structure: LawStructure = ONE_STATE,
    lower_bound: LowerBound | None = None,
    states: Sequence[str] = (),
    stable: bool = False,
    as_run: Callable[[LinearLaw], LinearLaw] = as_designed,
    known: Sequence[LinearLaw] = (),
    on_found: Callable[[LinearLaw], None] = lambda law: None,
    work: Work | None = None,
) -> DesignResult:
    """Designs a law of a given order or structure, with the smallest norm that descents find.

    Args:
        plant: generalised plant with n states, m inputs and q measurements, continuous or discrete. Only a continuous plant may
            have Dyu.
        structure: structure of the law.
        lower_bound: lower bound on the norm of every controller that uses the measurements. Default: the bound is computed.
        states: names of the states, used in error messages.
        stable: True if the law itself must be stable.
        as_run: function that converts a designed law to the law that is executed, as in `full_order_design`.
        known: laws of the required structure that were already found; they may have fewer states. If `known` contains laws, the
            search starts only from these laws.
        on_found: function that is called with the best law of each order before the search for the next order.
        work: counter of the computing work that is spent on norms. If the work exceeds the limit of the counter, the best law
            found so far is returned. The default limit is about 14 s of processor time for a plant with 8 states.

    Returns:
        The law with its certificate, and the name of the starting point from which the search found the law. The law may have
        fewer states than the structure allows.

    Raises:
        InputError: a matrix does not fit the plant, or the law would have more states than the plant.
        InfeasibleError: no law of the required order or structure stabilises the plant; the message describes the mode that
            cannot be stabilised.
        DesignError: no law was found.

    Example:
        >>> from models.laws.law_structure import LawStructure
        >>> from synth import GeneralizedPlant
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> found = fixed_order_design(oscillator.measured([[1, 0]]), LawStructure(1))
        >>> found.law.states, f"{found.certificate.norm.value:.3f}"
        (1, '0.105')
    """
    check_inputs(plant)
    plant = plant.measured()
    check_posed(plant)
    n, m = plant.B.shape
    if structure.order > n:
        raise InputError(f'order = {structure.order} exceeds the {n} states of the plant; give at most {n}, or order = "full"')
    counted = bounded_work(plant) if work is None else work
    search = _Search(plant, lower_bound, stable, as_run, counted)
    search.check_stabilisable(structure, states)
    best = search.designed(structure, states, known, on_found)
    stopped = counted.text if counted.over else ""
    remarks = [_remark(structure, best.law, m, stopped), CAPPED_REMARK if search.capped else "", stopped]
    given = best.law, best.certificate, DESCENT
    return DesignResult(*given, remarks=tuple(text for text in remarks if text), origin=best.origin)


def design_structured(problem: DesignProblem, progress: Progress) -> DesignResult:
    """Designs a law of a given order or structure by descent."""
    structure = problem.structure
    assert structure is not None, "it is for a structure"

    def on_found(law: LinearLaw) -> None:
        progress(hinf_norm(problem.plant.closed(law)).value, True)

    given = problem.plant, structure, problem.lower_bound, problem.states, problem.stable, problem.as_run, problem.known
    result = fixed_order_design(*given, on_found=on_found, work=problem.work)
    return replace(result, why=f"from {result.origin}, for {structure.text}")


def _remark(structure: LawStructure, law: LinearLaw, m: int, stopped: str) -> str:
    if structure.kind:
        return f"{ITS_GAINS}{gains_text(structure, law)}"
    states = structure.states(m)
    if law.states < states:
        few = f"{states} states" if states > 1 else "1 state"
        designed = {0: "none is", 1: "1 is"}.get(law.states, f"{law.states} are")
        why = "more states were not searched" if stopped else "its norm is close to the lower bound"
        return f"{FEWER} {few} {designed} used: {why}"
    return ""


def gains_text(structure: LawStructure, law: LinearLaw) -> str:
    """Returns the gains of a PI or PID law in the format of `pid` in a vehicle file, one table per force."""
    filter = {FILTER: structure.filter} if structure.kind == PID else {}
    return pid_tables([dict(zip(GAINS, each, strict=False)) | filter for each in gains_on_filters(structure, law)])


class _Search:
    """Search for a law of given order or structure, for one plant."""

    def __init__(
        self,
        plant: Plant,
        lower_bound: LowerBound | None,
        stable: bool,
        as_run: Callable[[LinearLaw], LinearLaw],
        work: Work | None = None,
    ) -> None:
        self.plant = plant
        self.below = lower_bound if lower_bound is not None else find_lower_bound(plant)
        self.stable, self.as_run = stable, as_run
        self.fastest, _ = speed(plant)
        self.capped, self.enough, self.work = False, 0.0, work or Work()
        self.most = FASTEST if plant.dt is None else max(FASTEST, DEADBEAT / plant.dt / self.fastest)

    def check_stabilisable(self, structure: LawStructure, states: Sequence[str]) -> None:
        """Raises an InfeasibleError if a mode of the plant, or the integrator of a PI or PID law, prevents stabilisation."""
        if reasons := "; ".join(stabilisability_failures(self.plant, states)):
            raise InfeasibleError(reasons)
        if structure.kind:
            problem = structured_gain(structure, self.plant)
            if stabilisability_failures(problem.plant):
                raise InfeasibleError(
                    f'structure = "{structure.kind}" integrates a signal that no constant force changes, so the pole at 0 stays '
                    "in the loop and no norm is finite; measure a signal that a constant force "
                    "changes, such as a deflection, or omit the integral"
                )

    def certified(self, law: LinearLaw) -> Certificate:
        """Returns the certificate of a law."""
        return certify_law(self.plant, law, self.below)

    def designed(
        self,
        structure: LawStructure,
        states: Sequence[str],
        known: Sequence[LinearLaw],
        on_found: Callable[[LinearLaw], None],
    ) -> End:
        """Searches one order after the other, and returns the law with the smallest norm; see `fixed_order_design` for the
        arguments.

        The law found for each order is also a starting point for the next order.
        """
        if structure.kind:
            return self.of_filters(structure, known)
        if known:
            return self.ended(structure, [(law, "a known law") for law in known], whole=False, sought=0)
        order, found = structure.order, None
        reduced = self.full_laws(states, order == len(self.plant.A)) if order else []
        for one in (replace(structure, order=k) for k in range(order + 1)):
            last = one.order == order
            if found is not None:
                on_found(found.law)
                if self.work.over or found.certificate.norm.value <= self.enough:
                    break
            if 0 < one.order < order and self.work.done > self.work.limit / 2:
                continue  # the rest of the available work is reserved for the requested order
            starts = [(law, "a reduced law of full order") for full in reduced for law in self.parts(one, full) if one.order]
            if found is not None:
                starts += [(law, "a law with one state less") for law in self.appended(one, found.law)]
            sought = MOST if last and found is None else 0 if one.order else FEW
            with contextlib.suppress(DesignError, np.linalg.LinAlgError):
                found = self.ended(one, starts, "" if one.order or last else "a static gain", last, sought)
        if found is None:
            raise DesignError(self.no_law)
        return found

    @property
    def no_law(self) -> str:
        """Text of the error that explains why no law was found."""
        return f"{NO_LAW}; {self.work.text}" if self.work.over else NO_LAW

    def of_filters(self, structure: LawStructure, known: Sequence[LinearLaw]) -> End:
        """Designs a PI or PID law by a descent that keeps the decay rate of the loop at no less than a tenth of its initial
        value.

        Without this limit on the decay rate, the integral gain often tends to zero, because the norm over all frequencies does
        not require an integral.

        Raises:
            DesignError: no gain that makes the loop stable was found.
        """
        plant_problem = structured_gain(structure, self.plant)
        shape = plant_problem.free.shape
        problem = MultiObjectiveProblem(
            members=(FamilyMember((plant_problem.plant,)),),
            minimise=NormSpecification(),
            tolerance=GainErrors(np.zeros(shape[1]), np.zeros(shape[0])),
            structure=plant_problem.free,
        )
        gain = multi_objective_design(problem, [plant_problem.gain(law) for law in known]).gain
        origin = (
            "many starts, each ended before the gain grows too much; the loop keeps at least a tenth of the decay rate "
            "at its start"
        )
        end = self.beyond_rounding(plant_problem.law(gain), origin)
        if end.certificate.failures:
            raise DesignError(f"its certificate fails: {'; '.join(end.certificate.failures)}")
        return end

    def full_laws(self, states: Sequence[str], best: bool) -> list[LinearLaw]:
        """Returns full-order laws: some make the closed-loop poles slow, and some make the poles faster and the norm closer to
        the lower bound.

        The list is empty if measurements contain the control forces.

        Args:
            best: True to include the law of `full_order_design` itself.
        """
        if np.any(self.plant.Dyu):
            return []
        laws, image, gamma = list[LinearLaw](), continuous_image(self.plant), LARGEST
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            riccati = RiccatiSearch(image[0], self.below.gamma)
            for share in SHARES:
                gamma = riccati.smallest(share, gamma)
                if gamma < LARGEST:
                    some = [riccati.traded(share, gamma * (1 + margin)) for margin in MARGINS]
                    laws += [each.law for each in some if each is not None]
        laws = laws if self.plant.dt is None else [discrete_law(law, *image, self.plant.dt) for law in laws]
        if best:
            with contextlib.suppress(InputError, np.linalg.LinAlgError):
                most = self.most if self.plant.dt is None else np.inf
                given = self.plant, None, None, self.below, states, most, self.stable, self.as_run
                laws.append(full_order_design(*given).law)
        return laws

    def parts(self, structure: LawStructure, full: LinearLaw) -> list[LinearLaw]:
        """Reduces a full-order law to laws of the required structure.

        If each force has its own law, the law of each force is reduced separately.
        """
        reduce = partial(reductions, self.plant)
        if structure.rows is None:
            return [*reduce(full, structure.order)]
        each = list[list[LinearLaw]]()
        for force, read in zip(np.eye(len(full.D)), np.array(structure.rows, dtype=float), strict=True):
            alone = replace(full.only(force > 0), B=full.B * read, D=full.D * np.outer(force, read))
            each.append([self.filled(replace(structure, rows=None), law)[0] for law in reduce(alone, structure.order)])
        return [_sum(laws) for laws in zip(*each, strict=False)]

    def filled(self, structure: LawStructure, law: LinearLaw) -> list[LinearLaw]:
        """Returns laws with as many states as a structure requires, made from a law that may have fewer states than required.

        Even a full-order law may have fewer states than the plant.
        """
        return [law] if law.states == structure.states(len(law.D)) else self.appended(structure, law)

    def appended(self, structure: LawStructure, law: LinearLaw) -> list[LinearLaw]:
        """Returns laws that have additional states but give the same closed loop.

        The additional states receive the measurements, but have no effect.
        """
        (m, q), rows, dt = law.D.shape, structure.rows, self.plant.dt
        count = m if rows is not None else 1
        size = law.states // count
        sizes = np.maximum(np.linalg.norm(self.plant.Cy, axis=1), 1e-300)
        read = READS * self.fastest * np.random.default_rng(SEED).standard_normal((count, q)) / sizes
        read = read * (np.array(rows, dtype=float) if rows is not None else 1.0)
        more, laws = structure.order - size, list[LinearLaw]()
        for rate in self.fastest * np.array(POLES):
            pole, into = (-rate, read) if dt is None else (np.exp(-rate * dt), dt * read)
            each = list[LinearLaw]()
            for i in range(count):
                own = slice(i * size, (i + 1) * size)
                A = np.asarray(linalg.block_diag(law.A[own, own], pole * np.eye(more)))
                B, C = np.vstack([law.B[own], np.tile(into[i], (more, 1))]), np.hstack([law.C[:, own], np.zeros((m, more))])
                each.append(LinearLaw(A, B, C, law.D * (i == 0), dt))
            laws.append(_sum(each))
        return laws

    def of(self, problem: StructuredGain, states: int, limit: float) -> GainSearch:
        """Returns the search for a static gain that represents a law with a given number of states."""
        alike = partial(in_equal_units, states=states)
        search = GainSearch(problem.plant, 1.0, self.below.gamma, problem.free, alike, WITHIN, work=self.work)
        search.limit, self.enough = np.full(len(search.limit), limit), search.enough
        return search

    def ended(
        self,
        structure: LawStructure,
        starts: Sequence[tuple[LinearLaw, str]],
        origin: str = "",
        whole: bool = True,
        sought: int = 0,
    ) -> End:
        """Returns the law with the smallest norm that the search finds; if possible, with poles slow enough for an actuator.

        Args:
            starts: laws of the required structure, possibly with fewer states, each with a name. If no law in `starts` makes
                the loop stable, other starting points are used.
            origin: name of the starting point in the result. Default: the name of the best entry of `starts`.
            whole: True to run the search to its end; False to run only its first descents.
            sought: number of stabilising starting points to find if no law in `starts` is stabilising.

        Raises:
            DesignError: no starting point makes the loop stable.
        """
        problem = structured_gain(structure, self.plant)
        states = len(problem.plant.A) - len(self.plant.A) if problem.filters is None else 0
        starts = [(each, name) for law, name in starts for each in self.filled(structure, law)]
        slowest: End | None = None
        for limit in LIMITS:
            search = self.of(problem, states, limit)
            points = [(search.landscape.point(problem.gain(law)), name) for law, name in starts]
            stable = sorted((each for point in points for each in search.feasible_candidates(*point)), key=lambda each: each.norm)
            names = dict.fromkeys(name for _, name in starts)
            candidates = [each for name in names for each in [one for one in stable if one.origin == name][:STARTS_OF_A_KIND]]
            candidates = candidates or (search.starts(sought) if sought else [])
            if not candidates:
                continue
            best = search.best(candidates) if whole else search.successive_halving(candidates)
            law = problem.law(search.landscape.gain(best.x))
            if self.stable:
                law = self.made_stable(problem, [law, *(problem.law(search.landscape.gain(each.x)) for each in candidates)])
                if law is None:
                    continue
            end = self.beyond_rounding(law, origin or best.origin)
            if end.certificate.failures:
                continue
            if end.certificate.speed_up <= self.most:
                at_limit = whole and not search.reached(best) and bool(np.any(np.abs(best.x) >= AT_LIMIT * limit))
                return self.further(problem, states, best, limit, end) if at_limit else end
            slowest = end if slowest is None else min(slowest, end, key=lambda each: each.certificate.speed_up)
        if slowest is None:
            raise DesignError(self.no_law)
        return slowest

    def further(self, problem: StructuredGain, states: int, best: Candidate, limit: float, end: End) -> End:
        """Continues a descent that stopped because gain entries reached their limit.

        Returns the new law if it gives a lower norm and slow enough poles. In a chain of integrators, a pole is
        proportional to a root of the gain entry, so a larger entry need not make the pole too fast.
        """
        for wider in WIDER:
            search = self.of(problem, states, wider * limit)
            moved = search.step(best, LAST_ROUNDS)
            wide = self.beyond_rounding(problem.law(search.landscape.gain(moved.x)), end.origin)
            lower = moved.norm < best.norm * (1 - WITHIN) and not wide.certificate.failures
            if lower and wide.certificate.speed_up <= self.most and not (self.stable and self.as_run(wide.law).growth):
                self.capped = bool(np.any(np.abs(moved.x) >= AT_LIMIT * wider * limit))
                return wide
        self.capped = True
        return end

    def beyond_rounding(self, law: LinearLaw, origin: str) -> End:
        """Returns a law with its certificate.

        If the loop contains a pole at 0 that has no effect, the poles of the law are shifted slightly to the left.
        """
        end = End(law, origin, self.certified(law))
        for shift in SHIFTS * bool(law.states and np.any(end.certificate.stability.on_axis)):
            rate, dt = shift * self.fastest, self.plant.dt
            moved = replace(law, A=law.A - rate * np.eye(law.states) if dt is None else np.exp(-rate * dt) * law.A)
            there = self.certified(moved)
            if not there.failures and there.norm.value <= end.certificate.norm.value * (1 + WITHIN):
                return End(moved, origin, there)
        return end

    def made_stable(self, problem: StructuredGain, laws: Sequence[LinearLaw]) -> LinearLaw | None:
        """Returns the best law that is itself stable, found by descent from stable laws in `laws`; None if no law is stable."""
        fits = [law for law in laws if not self.as_run(law).growth]
        if laws[0] in fits[:1]:
            return laws[0]
        ends = list[tuple[float, LinearLaw]]()
        for law in fits[:2]:
            ends.append((self.certified(law).norm.value, law))
            with contextlib.suppress(InputError, np.linalg.LinAlgError):
                light = LIGHTLY * ends[-1][0] * self.fastest
                lower = problem.law(descend_stable(problem.plant, problem.gain(law), law.states, light, problem.free))
                if not self.as_run(lower).growth:
                    ends.append((self.certified(lower).norm.value, lower))
        return min(ends, key=lambda each: each[0])[1] if ends else None


def _sum(laws: Sequence[LinearLaw]) -> LinearLaw:
    """Returns the law whose output is the sum of the outputs of several laws. The resulting law contains the states of all
    added laws.
    """
    A, D = np.asarray(linalg.block_diag(*(law.A for law in laws))), np.sum([law.D for law in laws], axis=0)
    return LinearLaw(A, np.vstack([law.B for law in laws]), np.hstack([law.C for law in laws]), D, laws[0].sample_period)
