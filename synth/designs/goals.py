"""A controller that is designed for the goals of its section, certified, with what it keeps of them."""

from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.numbers import percent
from models.controllers import ControllerEntry
from models.goals.goals import REGRET, Goals, NormBound
from models.law import LinearLaw, static_law
from models.vehicle import Vehicle
from synth.certificate.bounding import certify_tightly
from synth.certificate.certificate import Certificate
from synth.certificate.lower_bound import LowerBound
from synth.certificate.promise import Promise
from synth.controller import Controller
from synth.design import two_step_design
from synth.designs.goal_problem import goal_problem
from synth.designs.promises import Judged
from synth.errors import DesignError
from synth.family.design import slack_design
from synth.goals.engine import GoalDesign, Interrupted, design_for_goals
from synth.goals.problem import GoalProblem
from synth.goals.search import Told
from synth.problem.problem import Problem


class InterruptedDesign(KeyboardInterrupt):
    """Ctrl-C, with a controller that is there all the same.

    Attributes:
        controller: certified.
        said: what of it is not as it would have been.
    """

    def __init__(self, controller: Controller, said: str) -> None:
        super().__init__()
        self.controller, self.said = controller, said


def goals_design(
    vehicle: Vehicle,
    entry: ControllerEntry,
    goals: Goals,
    posed: Problem,
    lower_bound: LowerBound,
    told: Told = lambda goal, within: None,
) -> Controller:
    """The controller of a section with goals.

    Args:
        vehicle: the vehicle.
        entry: its section.
        goals: its goals.
        posed: what its certificate is of: z of `[performance]` at all frequencies.
        lower_bound: of that.
        told: called with what is reached, as it is.

    Raises:
        InputError: see `goal_problem`.
        DesignError: there is none.
        InterruptedDesign: by Ctrl-C, with what was finished until then.
    """
    asked = goal_problem(vehicle, entry, goals)
    bests = with_bests(asked) if goals.family else asked  # said of every family, minimised where that is asked for
    stopped = ""
    try:
        found = searched(bests if goals.over == REGRET else asked, told)
    except Interrupted as error:
        found, stopped = error.best, "interrupted: the best within all bounds until then"
    try:
        made = _controller(vehicle, entry, goals, posed, lower_bound, bests, found)
    except KeyboardInterrupt as error:
        made = _controller(vehicle, entry, goals, posed, lower_bound, bests, found, judged=False)
        raise InterruptedDesign(made, "interrupted: of its promises none is proved") from error
    if stopped:
        raise InterruptedDesign(made, stopped)
    try:
        return made if goals.structure is None else replace(made, remarks=(*made.remarks, *price(asked, found)))
    except KeyboardInterrupt as error:
        raise InterruptedDesign(made, "interrupted: what its structure costs is not known") from error


def _controller(
    vehicle: Vehicle,
    entry: ControllerEntry,
    goals: Goals,
    posed: Problem,
    lower_bound: LowerBound,
    asked: GoalProblem,
    found: GoalDesign,
    judged: bool = True,
) -> Controller:
    """The controller of a gain, certified, with what it keeps where that is judged."""
    law = static_law(found.gain)
    certificate = certify_tightly(*posed.closed(law), lower_bound, by_itself=posed.plant)
    return Controller(
        entry.name,
        entry.measured,
        law,
        designed=True,
        certificate=certificate,
        remarks=(*remarks(found), *_beside(goals, certificate)),
        hardware=entry.hardware,
        promises=Judged(vehicle, entry, goals, asked, found.gain).promises() if judged else (),
    )


def _beside(goals: Goals, certificate: Certificate) -> tuple[str, ...]:
    """What is the case beside a band, where nothing bounds that."""
    if not goals.minimise.narrow or any(isinstance(bound, NormBound) and not bound.norm.narrow for bound in goals.bounds):
        return ()
    return (
        f"nothing bounds what lies beside its band, where the norm is {certificate.norm.value:.7g}; "
        "give bounds = [{ norm = ... }]",
    )


def promises_of(vehicle: Vehicle, entry: ControllerEntry, law: LinearLaw, search: bool = True) -> tuple[Promise, ...]:
    """What a given gain keeps of the goals of its section; nothing where it has none.

    Args:
        vehicle: the vehicle.
        entry: the section.
        law: the gain.
        search: whether the ratio to what each vehicle of a family has at its own best, which takes designs, is asked for.

    Raises:
        InputError: see `goal_problem`.
        DesignError: a vehicle of the family has nothing within the bounds by itself, where the ratio to that is asked for.
    """
    if entry.goals is None:
        return ()
    asked = goal_problem(vehicle, entry, entry.goals)
    if search and entry.goals.over == REGRET:
        asked = with_bests(asked)
    return Judged(vehicle, entry, entry.goals, asked, law.D).promises()


def price(asked: GoalProblem, found: GoalDesign) -> tuple[str, ...]:
    """What a structure costs, against the gain that has every entry, designed likewise; nothing where that is the same gain.

    Args:
        asked: the problem, with the structure.
        found: its design, from which that of the whole gain starts, too.
    """
    whole = replace(asked, structure=np.ones_like(asked.structure))
    if np.all(asked.structure):
        return ()
    goal = min(design_for_goals(whole, [found.gain, *_two_steps(whole)]).goal, found.goal)
    return (f"its structure costs {percent(found.goal / goal - 1)}: a gain with every entry comes to {goal:.7g}",)


def with_bests(asked: GoalProblem) -> GoalProblem:
    """The same, of the largest ratio to what each member has by itself, within the same bounds.

    Raises:
        DesignError: one has nothing within the bounds.
    """
    bests = []
    for i in range(len(asked.members)):
        try:
            bests.append(searched(asked.alone(i)).goal)
        except DesignError as error:
            raise DesignError(f"family[{i}] by itself: {error}") from error
    return replace(asked, bests=tuple(bests))


def searched(asked: GoalProblem, told: Told = lambda goal, within: None) -> GoalDesign:
    """What the engine finds, from the two steps of some members, and what it finds itself."""
    return design_for_goals(asked, _two_steps(asked), told, lambda: _slack(asked))


def _slack(asked: GoalProblem) -> list[Array]:
    """The gain of the two steps with a slack variable, for all members at once."""
    plants = [member.posed[0] for member in asked.members]
    try:
        return [slack_design([each.plant for each in plants], [each.Cy for each in plants], asked.structure).gain]
    except InputError:
        return []


def _two_steps(asked: GoalProblem) -> list[Array]:
    """The gains of the two steps, of the first, middle and last member."""
    count, found = len(asked.members), []
    for i in sorted({0, count // 2, count - 1}):
        posed = asked.members[i].posed[0]
        try:
            found.append(two_step_design(posed.plant, posed.Cy).gain)
        except InputError:
            continue
    return found


def remarks(found: GoalDesign) -> tuple[str, ...]:
    """What there is to say of a search."""
    if found.refused is None:
        return ("designed for its goals, by descent from the two steps and other starts",)
    return (
        f"designed for its goals, by descent from the two steps and other starts; refused: {percent(found.refused)} less for "
        "up to twice the gain",
    )
