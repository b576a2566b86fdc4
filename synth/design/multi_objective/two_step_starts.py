"""Starts of multi-objective designs: the two steps of some members."""

from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.printed import percent
from models.laws.linear import static_law
from synth.design.multi_objective.design import MultiObjectiveDesign, multi_objective_design
from synth.design.multi_objective.problem import MultiObjectiveProblem
from synth.design.problem import DesignProblem, DesignResult, Progress, quiet
from synth.design.two_step import two_step_design
from synth.plant.generalized import Plant, on_all_rows
from synth.plant.numerics import DesignError


def with_individual_optima(asked: MultiObjectiveProblem) -> MultiObjectiveProblem:
    """Returns the same problem for the largest ratio to each member's individual optimum, within the same bounds.

    Raises:
        DesignError: a member has no gain within the bounds.
    """
    bests = []
    for i in range(len(asked.members)):
        try:
            bests.append(run_search(asked.alone(i)).goal)
        except DesignError as error:
            raise DesignError(f"family[{i}] alone: {error}") from error
    return replace(asked, bests=tuple(bests))


def run_search(asked: MultiObjectiveProblem, on_progress: Progress = quiet) -> MultiObjectiveDesign:
    """Runs the search, started from two-step designs of some members and from its own starts."""
    return multi_objective_design(asked, two_step_gains(asked), on_progress)


def _of_state(posed: Plant) -> Array:
    """Returns True for the measurements that say something of the state, shape (q,): of forces alone nothing is designed."""
    return np.any(posed.Cy != 0, axis=1)


def two_step_gains(asked: MultiObjectiveProblem) -> list[Array]:
    """The gains of the two steps, of the first, middle and last member."""
    count, gains = len(asked.members), []
    for i in sorted({0, count // 2, count - 1}):
        posed = asked.members[i].posed[0]
        try:
            kept = _of_state(posed)
            few = two_step_design(posed.rows(kept)).gain
            gains.append(posed.on_readings(on_all_rows(few, kept, len(kept))))
        except InputError:
            continue
    return gains


def remarks(design: MultiObjectiveDesign) -> tuple[str, ...]:
    """Returns notes on a search."""
    if design.rejected_improvement is None:
        return ("designed for its goals, by descent from the two-step method and other starts",)
    return (
        "designed for its goals, by descent from the two-step method and other starts; not accepted: "
        f"{percent(design.rejected_improvement)} less for up to twice the gain",
    )


def for_goals(problem: DesignProblem, progress: Progress) -> DesignResult:
    """Designs a gain for goals, by descent from the two steps and from other starts."""
    assert problem.goals is not None, "goals"
    found = run_search(problem.goals, progress)
    law, notes = static_law(found.gain), [*remarks(found)]
    if problem.thorough and (unproved := found.unproved):
        notes.append(f"stability with all errors is not proved for member {', '.join(map(str, unproved))}")
    certificate = problem.certified(law)
    given = law, certificate, "descent for goals"
    return DesignResult(*given, remarks=tuple(notes), value=found.goal, criterion="goal", details=found)
