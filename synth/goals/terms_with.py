"""The terms of a problem, for some errors: what is minimised and what is bounded, of every member."""

from collections.abc import Sequence

from synth.goals.banded import BandLandscape
from synth.goals.energy_peak import EnergyPeak
from synth.goals.problem import Errors, GoalProblem
from synth.goals.road_peak import RoadPeak
from synth.goals.terms import Decay, Gain, Term

TIGHTER = 1e-7  # relative: bounds are kept by so much, for rounding
AND_FOR_ERRORS = 0.02  # and a decay with errors by so much: on the border itself nothing is proved of a whole box


def terms_with(problem: GoalProblem, full: BandLandscape, errors: Sequence[Errors], rate: float) -> tuple[list[Term], list[Term]]:
    """The goals and the bounds.

    Args:
        problem: what is asked for.
        full: the landscape whose points are those of all terms.
        errors: with each of which norms and decay count; peaks count without.
        rate: the decay that is asked for [rad/s]; 0 for none.
    """
    goals: list[Term] = []
    bounds: list[Term] = []
    which, band = problem.minimise.which, problem.minimise.band
    for i, member in enumerate(problem.members):
        unit = problem.bests[i] if problem.bests is not None else 1.0
        for each in errors:
            goals.append(Gain(problem.landscape(i, which, band, each, full), unit))
            for norm in problem.norms:
                landscape = problem.landscape(i, norm.which, norm.band, each, full)
                bounds.append(Gain(landscape, norm.at_most * (1 - TIGHTER), norm.name))
            if rate:
                bounds.append(decay(problem, problem.landscape(i, which, band, each, full), rate))
        for signal in member.signals:
            landscape = problem.landscape(i, which, band, problem.none, full)
            bounds.append(EnergyPeak(landscape, signal, signal.at_most * (1 - TIGHTER)))
        for driven, most in zip(member.driven, problem.peaks, strict=True):
            bounds.append(RoadPeak(driven, full.scale, most))
    return goals, bounds


def decay(problem: GoalProblem, landscape: BandLandscape, rate: float) -> Decay:
    """The bound on the slowest pole of a loop."""
    return Decay(landscape, rate * (1 + (AND_FOR_ERRORS if problem.errors else TIGHTER)))
