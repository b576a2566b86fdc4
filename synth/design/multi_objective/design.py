"""The door of the engine: from a problem of goals to a gain, or why there is none."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

from models.common.arrays import Array
from models.common.errors import InputError
from synth.design.multi_objective.problem import Errors, GoalProblem
from synth.design.multi_objective.search import Search, Told
from synth.design.uncertainty.parameter_dependent_lyapunov import stable_with_errors
from synth.plant.numerics import numerics, up_to_rounding


@dataclass(frozen=True, eq=False)
class GoalDesign:
    """What the search ended with.

    Attributes:
        gain: K, shape (m, q).
        goal: the largest norm met, or ratio.
        refused: what twice the gain would have bought of it, relative; None where nothing.
        errors: the errors that decided, beside none.
        problem: what was asked for.
    """

    gain: Array
    goal: float
    refused: float | None
    errors: tuple[Errors, ...]
    problem: GoalProblem

    @cached_property
    def unproved(self) -> tuple[int, ...]:
        """The members, by index, of which it is not proved that every loop of the tolerance is stable: proved when first asked.

        No error that was met makes one unstable; where the proof is too large to be tried, as of many errors of a large plant,
        `synth.design.uncertainty.worst_case.worst_norm` may have another.
        """
        tolerance, found = self.problem.tolerance, []
        for i, member in enumerate(self.problem.members):
            posed = member.posed[self.problem.minimise.which].unfiltered
            with up_to_rounding():
                if stable_with_errors(posed.plant, posed.Cy, self.gain, tolerance.sensors, tolerance.forces):
                    continue
            found.append(i)
        return tuple(found)


class Interrupted(KeyboardInterrupt):
    """Ctrl-C, with the best so far within all bounds.

    Attributes:
        best: of what the search had met.
    """

    def __init__(self, best: GoalDesign) -> None:
        super().__init__()
        self.best = best


@numerics()
def design_for_goals(
    problem: GoalProblem,
    starts: Iterable[Array],
    told: Told = lambda goal, within: None,
    otherwise: Callable[[], Iterable[Array]] = lambda: (),
) -> GoalDesign:
    """The best gain that the search finds.

    Args:
        problem: what is asked for.
        starts: gains to start from, shape (m, q) each, beside those that it finds itself.
        told: called with every new point.
        otherwise: gives others, where none of those leads to stable loops; they may take their time.

    Raises:
        InputError: a decay is asked for of a discrete plant.
        DesignError: none makes all loops stable, or none keeps all bounds; the message says which bound is in the way.
        Interrupted: by Ctrl-C, once there is something to keep.

    Example:
        >>> import numpy as np
        >>> from synth import Errors, GeneralizedPlant, GoalProblem, Member, NormGoal, Posed, design_for_goals
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> member = Member((Posed(oscillator, np.array([[0.0, 1.0]])),))
        >>> none, anywhere = Errors(np.zeros(1), np.zeros(1)), np.ones((1, 1), dtype=bool)
        >>> problem = GoalProblem((member,), NormGoal(band=(1.0, 3.0)), none, anywhere, gain=5.0)
        >>> design = design_for_goals(problem, starts=[[[-1.0]]])
        >>> design.gain.round(2)
        array([[-5.]])
    """
    if any(posed.plant.dt is not None for member in problem.members for posed in member.posed) and problem.decay is not None:
        raise InputError("a discrete plant has no decay in rad/s; leave decay out, and bound a norm instead")
    search = Search(problem, told)
    try:
        x, height, refused = search.result(starts, otherwise)
    except KeyboardInterrupt as error:
        kept = search.interrupted()
        if kept is None:
            raise
        x, height = kept
        raise Interrupted(GoalDesign(search.full.gain(x), height.goal, None, tuple(search.met), problem)) from error
    return GoalDesign(search.full.gain(x), height.goal, refused, tuple(search.met), problem)
