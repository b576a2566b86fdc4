"""Multi-objective design: finds a gain that meets goals and bounds, or reports why no gain does."""

import contextlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from models.common.checks import check_shape
from models.common.errors import InputError
from models.common.printed import percent
from models.laws.linear import static_law
from synth.analysis.stability import is_stable
from synth.design.multi_objective.problem import GainErrors, MultiObjectiveProblem
from synth.design.multi_objective.search import MinimaxSearch
from synth.design.problem import DesignProblem, DesignResult, Progress, quiet
from synth.design.two_step import two_step_design
from synth.design.uncertainty.worst_case import stable_with_errors
from synth.plant.generalized import Feedback, on_all_rows
from synth.plant.numerics import DesignError, numerics, up_to_rounding


@dataclass(frozen=True, eq=False)
class MultiObjectiveDesign:
    """Result of a multi-objective design.

    Attributes:
        gain: gain matrix K that was found, shape (m, q).
        goal: largest norm over all members of the family and all gain errors found, or largest ratio of a member's norm to its
            individual optimum.
        rejected_improvement: relative decrease of the goal that a gain up to twice as large would achieve. The decrease was
            rejected because it was too small for the growth of the gain. None if no decrease was rejected.
        errors: gain errors of sensors and actuators that the search took into account, in addition to the case without errors.
        problem: multi-objective problem that the gain solves.
    """

    gain: Array
    goal: float
    rejected_improvement: float | None
    errors: tuple[GainErrors, ...]
    problem: MultiObjectiveProblem

    @cached_property
    def unproved(self) -> tuple[int, ...]:
        """Indices of the members whose stability is not proved for all errors within the tolerance.

        The indices are computed when they are first used.

        If there are no errors, the poles of a loop prove its stability. None of the errors found in the search makes a loop
        unstable.
        """
        tolerance, members = self.problem.tolerance, []
        for i, member in enumerate(self.problem.members):
            problem = member.plants[self.problem.minimise.which].without_weighting
            if not self.problem.has_errors:
                loop = problem.closed_loop(Feedback(problem.acting(self.gain), problem.Cy))
                members += [] if is_stable(loop.A, loop.dt) else [i]
                continue
            with up_to_rounding():
                if stable_with_errors(problem, self.gain, tolerance.sensors, tolerance.forces) is not None:
                    continue
            members.append(i)
        return tuple(members)


@numerics()
def multi_objective_design(
    problem: MultiObjectiveProblem,
    starts: Iterable[Array],
    on_progress: Progress = quiet,
    otherwise: Callable[[], Iterable[Array]] = tuple,
) -> MultiObjectiveDesign:
    """Searches for the best gain of a multi-objective problem.

    Args:
        problem: goals, bounds and plants.
        starts: gains from which the search starts, each of shape (m, q), in addition to the starting gains that the search
            generates.
        on_progress: function that is called at every new point with the value of the goal, and with True if all bounds are
            fulfilled.
        otherwise: function that returns additional starting gains; it is called only if no other starting gain leads to stable
            loops.

    Returns:
        The gain, the value of the goal, and the gain errors that the search took into account.

    Raises:
        InputError: a decay rate is required for a discrete plant.
        DesignError: no gain was found that makes all loops stable and fulfils all bounds; the message lists the violated
            bounds.
        Interrupted: the user pressed Ctrl-C after a feasible design was found.

    Example:
        >>> import numpy as np
        >>> from synth import FamilyMember, GainErrors, GeneralizedPlant, MeasuredPlant
        >>> from synth import MultiObjectiveProblem, NormSpecification, multi_objective_design
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> member = FamilyMember((MeasuredPlant(oscillator, np.array([[0.0, 1.0]])),))
        >>> none, anywhere = GainErrors(np.zeros(1), np.zeros(1)), np.ones((1, 1), dtype=bool)
        >>> problem = MultiObjectiveProblem((member,), NormSpecification(band=(1.0, 3.0)), none, anywhere, gain=5.0)
        >>> design = multi_objective_design(problem, starts=[[[-1.0]]])
        >>> design.gain.round(2)
        array([[-5.]])
    """
    if (
        any(plant_problem.dt is not None for member in problem.members for plant_problem in member.plants)
        and problem.decay is not None
    ):
        raise InputError("decay [rad/s] applies only to continuous plants; omit decay, and bound a norm instead")
    for i, start in enumerate(starts := list(starts)):
        check_shape(f"starts[{i}]", np.asarray(start), problem.shape, "the shape of the structure")
    search = MinimaxSearch(problem, on_progress)
    x, evaluation, refused = search.result(starts, otherwise)
    return MultiObjectiveDesign(search.full.gain(x), evaluation.goal, refused, tuple(search.active_errors), problem)


@numerics()
def improved_goal(problem: MultiObjectiveProblem, design: MultiObjectiveDesign, on_progress: Progress = quiet) -> float:
    """Returns the value of the goal that a descent from the gain of a design reaches. The gain of the design must fulfil the
    bounds of the problem.

    If no better gain is found, the goal value of the design is returned.

    The better gain comes from a descent with a fixed number of rounds, so it need not be the best gain.

    Args:
        problem: problem of the design, possibly with another structure.
        design: design from whose gain the descent starts.
        on_progress: function that is called at every new point with the value of the goal, and with True if all bounds are
            fulfilled.
    """
    found = MinimaxSearch(problem, on_progress).improvement(design.gain, design.errors)
    return design.goal if found is None else min(design.goal, found[1].goal)


def run_search(problem: MultiObjectiveProblem, on_progress: Progress = quiet) -> MultiObjectiveDesign:
    """Runs the search from the two-step gains of the first, middle and last member, and from starting gains that the search
    generates.
    """
    count, gains = len(problem.members), []
    for i in sorted({0, count // 2, count - 1}):
        plant_problem = problem.members[i].plants[0]
        of_state = np.any(plant_problem.Cy != 0, axis=1)  # the two steps use only measurements that depend on a state
        with contextlib.suppress(InputError):
            gains.append(
                plant_problem.on_readings(
                    on_all_rows(two_step_design(plant_problem.rows(of_state)).gain, of_state, len(of_state))
                )
            )
    return multi_objective_design(problem, gains, on_progress)


def with_individual_optima(problem: MultiObjectiveProblem) -> MultiObjectiveProblem:
    """Returns the problem whose goal is the largest ratio of a member's norm to its individual optimum, with the same bounds.

    Raises:
        DesignError: no gain fulfils the bounds for one of the members, even if the gain is designed for this member only.
    """
    bests = []
    for i in range(len(problem.members)):
        try:
            bests.append(run_search(problem.alone(i)).goal)
        except DesignError as error:
            raise DesignError(f"family[{i}] alone: {error}") from error
    return replace(problem, bests=tuple(bests))


def for_goals(problem: DesignProblem, progress: Progress) -> DesignResult:
    """Designs a static gain for goals, by descent from the two-step gain and from other starting gains."""
    assert problem.goals is not None, "goals"
    found = run_search(problem.goals, progress)
    law, share = static_law(found.gain), found.rejected_improvement
    refused = f"; not accepted: a further decrease by {percent(share)} for up to twice the gain" if share is not None else ""
    remarks = [f"designed for its goals, by descent from the two-step method and other starts{refused}"]
    if problem.thorough and (unproved := found.unproved):
        remarks.append(f"stability with all errors is not proved for member {', '.join(map(str, unproved))}")
    given = law, problem.certified(law), "descent for goals"
    return DesignResult(*given, remarks=tuple(remarks), value=found.goal, criterion="goal", details=found)
