"""Laws of a given order or structure for the least norm, by descent from several starts; the lowest end is taken.

A law of k states is one of k + 1 states, too, so orders are gone through from a static gain up. Each starts from

- laws of full order, reduced (`reduction.py`), those next to the least norm and slower ones;
- the static gain, and the law of one state less, with a state appended that reads and does not act yet;
- samples of every size, where none of these is stable.

The search is that of static gains (`design/static.py`), on the plant with the law's states, within the structure of its gain
(`pattern.py`). An end that needs poles beyond any actuator is sought again within smaller gains. It stops early where an order
comes to what no controller beats: then the law has fewer states than it may.
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
from synth.analysis.lower_bound import LowerBound
from synth.analysis.norm import hinf_norm
from synth.analysis.stability import stabilisability_failures
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

LIMITS = (100.0, 10.0, 3.0)  # on a gain's entries, in units in which 1 moves poles as fast as the plant's: the first not too fast
AT_LIMIT = 0.999  # of a limit; an entry this large is stopped by it
WIDER = (1e4, 100.0, 10.0)  # times a limit that stops a descent: how far it goes on
POLES = (0.1, 1.0, 10.0)  # of an appended state, times the plant's speed
READS = 0.1  # what it reads, in these units
SHARES = (1e-1, 1e-2, 1e-3)  # of noise and cost, with which laws of full order are made,
MARGINS = (1e-2, 1e-1, 1.0)  # and how far above the least gamma, relative
STARTS_OF_A_KIND = 4  # starts of a kind that go down
FEW = 2  # stabilising starts of a static gain, where a law may have states
SHIFTS = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  # of the poles of a law, times the plant's speed
SEED = 20261126
NO_LAW = "no law of this structure with a stable loop was found; measure more signals, or allow more states"
CAPPED_REMARK = "an entry of the law is at the limit of the search: a larger entry may give a lower norm, but faster poles"
ONE_STATE = LawStructure(1)


class End(NamedTuple):
    """A law at the end of a search, the start that led to the law, in words, and the certificate."""

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
    """Returns the law of the least norm that descents find, of a given order or structure, with its certificate.

    Args:
        plant: n states, m inputs and q measurements, continuous or discrete; with Dyu only if it is continuous.
        structure: structure of the law.
        lower_bound: lower bound for any controller from these measurements, if known.
        states: names of the states, for messages.
        stable: True for a law that is stable by itself.
        as_run: returns a law as it is run, as for `full_order_design`.
        known: laws of this structure, also of fewer states, as the only starts.
        on_found: callback that receives the best law of fewer states, each time that a law of more states exists.
        work: counts the norms of the search; where it is over, the best so far is returned. About 14 s of processor time for a
            plant of 8 states if it is not given.

    Raises:
        InputError: a matrix does not fit the plant, or the order is more than the plant's.
        InfeasibleError: no law of this kind stabilises the plant; the message names the mode.
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
    """Returns the gains of a PI or PID law as in `pid` of a vehicle file, a table for each force."""
    filter = {FILTER: structure.filter} if structure.kind == PID else {}
    return pid_tables([dict(zip(GAINS, each, strict=False)) | filter for each in gains_on_filters(structure, law)])


class _Search:
    """The search for one plant."""

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
        """Raises an InfeasibleError if a single mode keeps every law from stabilising, that of an integrator too."""
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
        """Returns the lowest end; see `fixed_order_design` for the arguments.

        The law of each order is a start of the search for the next order.
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
                continue  # what is left is for the order that is asked
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
        """Why there is no law, in words."""
        return f"{NO_LAW}; {self.work.text}" if self.work.over else NO_LAW

    def of_filters(self, structure: LawStructure, known: Sequence[LinearLaw]) -> End:
        """Returns the law of PI or PID at the end of a descent that keeps a tenth of the decay of its start.

        Without that the integral's gain would often tend to zero: a norm at all frequencies does not ask for it.

        Raises:
            DesignError: no gain makes the loop stable.
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
        origin = "many starts, ended before the gain grows too much; the loop keeps a tenth of the decay of its start"
        end = self.beyond_rounding(plant_problem.law(gain), origin)
        if end.certificate.failures:
            raise DesignError(f"its certificate fails: {'; '.join(end.certificate.failures)}")
        return end

    def full_laws(self, states: Sequence[str], best: bool) -> list[LinearLaw]:
        """Returns laws of full order, slow ones and faster ones that come nearer to the bound; none where forces act on readings.

        Args:
            best: True for the design of full order itself, too.
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
        """Returns laws of a structure by reduction of a full-order law, separately for each force with a law of its own."""
        reduce = partial(reductions, self.plant)
        if structure.rows is None:
            return [*reduce(full, structure.order)]
        each = list[list[LinearLaw]]()
        for force, read in zip(np.eye(len(full.D)), np.array(structure.rows, dtype=float), strict=True):
            alone = replace(full.only(force > 0), B=full.B * read, D=full.D * np.outer(force, read))
            each.append([self.filled(replace(structure, rows=None), law)[0] for law in reduce(alone, structure.order)])
        return [_sum(laws) for laws in zip(*each, strict=False)]

    def filled(self, structure: LawStructure, law: LinearLaw) -> list[LinearLaw]:
        """Returns laws of a structure from one of as many states or fewer, as a law of full order that needs none has."""
        return [law] if law.states == structure.states(len(law.D)) else self.appended(structure, law)

    def appended(self, structure: LawStructure, law: LinearLaw) -> list[LinearLaw]:
        """Returns laws of the same loop with further states, which read what is measured and do not act."""
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
        """The search for a static gain that is a law of so many states."""
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
        """Returns the law at the lowest end, not too fast if may be.

        Args:
            starts: laws of this structure, or of fewer states; where none of them is stable, others are sought.
            origin: name of the start, where the search finds its own.
            whole: True for a search to its end, False for its first descents alone.
            sought: number of stabilising starts that are tried where no start is stable.

        Raises:
            DesignError: no start is stable.
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
        """Returns the law of a descent beyond the limit on entries that one stopped at, if it is lower and not too fast.

        A pole of a chain of integrators moves as a root of the entry, so that larger entries need not make it too fast.
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
        """Returns a law with its certificate; where a pole of no effect stays at 0, the law's poles move left a little."""
        end = End(law, origin, self.certified(law))
        for shift in SHIFTS * bool(law.states and np.any(end.certificate.stability.on_axis)):
            rate, dt = shift * self.fastest, self.plant.dt
            moved = replace(law, A=law.A - rate * np.eye(law.states) if dt is None else np.exp(-rate * dt) * law.A)
            there = self.certified(moved)
            if not there.failures and there.norm.value <= end.certificate.norm.value * (1 + WITHIN):
                return End(moved, origin, there)
        return end

    def made_stable(self, problem: StructuredGain, laws: Sequence[LinearLaw]) -> LinearLaw | None:
        """Returns the best law that is stable by itself, by descent from those of these that are; None if none is."""
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
    """Returns the sum of laws, each with states of its own."""
    A, D = np.asarray(linalg.block_diag(*(law.A for law in laws))), np.sum([law.D for law in laws], axis=0)
    return LinearLaw(A, np.vstack([law.B for law in laws]), np.hstack([law.C for law in laws]), D, laws[0].sample_period)
