"""The door of goals: a vehicle and a controller's section as a problem in the plant's language (`synth.goals`)."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.numbers import percent
from models.controllers import ControllerEntry
from models.goals.goals import REGRET, DecayBound, GainBound, Goals, NormBound, NormOf, PeakBound
from models.goals.reading import FORCE
from models.law import LinearLaw, static_law
from models.roads.choice import choose_road
from models.roads.road import Road, delays, under_wheels
from models.vehicle import Vehicle
from synth.certificate.bounding import certify_tightly
from synth.certificate.lower_bound import LowerBound
from synth.certificate.promise import Promise
from synth.controller import Controller
from synth.design import two_step_design
from synth.designs.promises import Judged
from synth.errors import DesignError
from synth.family.design import slack_design
from synth.goals.engine import GoalDesign, Interrupted, design_for_goals
from synth.goals.problem import Errors, GoalProblem, Member, NormGoal, Posed
from synth.goals.road_response import Drive, Driven
from synth.goals.search import Told
from synth.problem.problem import Problem, measurements, problem

USUAL_SPEED = 12.5  # m/s, the paper's (62)


def family_of(vehicle: Vehicle, entry: ControllerEntry, goals: Goals) -> list[Vehicle]:
    """The vehicles that a design is for.

    Raises:
        InputError: one cannot be.
    """
    found = []
    for i, member in enumerate(goals.family or ({},)):
        parameters = {name: value * member.get(name, 1.0) for name, value in vehicle.parameters.items()}
        try:
            found.append(replace(vehicle, parameters=parameters).checked())
        except InputError as error:
            raise InputError(f"[controllers.{entry.name}] family[{i}]: {error}") from error
    return found


def goal_problem(vehicle: Vehicle, entry: ControllerEntry, goals: Goals) -> GoalProblem:
    """What a section with goals asks for, its members' own bests left open.

    Raises:
        InputError: a road that is none or has no end, or a member or a measurement that cannot be.
    """
    through = measurements(vehicle, entry.measured, entry.hardware.bandwidth)[1]
    if np.any(through):
        i = int(np.argmax(np.any(through, axis=1)))
        raise InputError(
            f"[controllers.{entry.name}] measures {entry.measured[i]!r}, in which forces act at once, and has goals, whose "
            "errors and structure are of a gain on the state alone; measure something else, or give lag = true"
        )
    vehicles = family_of(vehicle, entry, goals)
    norms = [goals.minimise, *(bound.norm for bound in goals.bounds if isinstance(bound, NormBound))]
    peaks = [(bound, _road(vehicle, entry, bound)) for bound in goals.bounds if isinstance(bound, PeakBound)]
    members = tuple(
        Member(
            tuple(_posed(each, entry, norm) for norm in norms), tuple(_driven(each, entry, bound, road) for bound, road in peaks)
        )
        for each in vehicles
    )
    bounds = [
        NormGoal(i + 1, _band(bound.norm), bound.at_most, f"{bound.norm.text} <= {bound.at_most:g}")
        for i, bound in enumerate(each for each in goals.bounds if isinstance(each, NormBound))
    ]
    m, q = through.shape[1], len(entry.measured)
    inputs, tolerance = vehicle.linear_model.inputs, goals.tolerance
    errors = Errors(
        np.array([tolerance.get(signal, 0.0) for signal in entry.measured]),
        np.array([tolerance.get(force, tolerance.get(FORCE, 0.0)) for force in inputs]),
    )
    structure = np.ones((m, q), dtype=bool) if goals.structure is None else np.array(goals.structure)
    return GoalProblem(
        members,
        NormGoal(0, _band(goals.minimise)),
        errors,
        structure,
        norms=tuple(bounds),
        decay=_strictest([bound.rate for bound in goals.bounds if isinstance(bound, DecayBound)], max),
        peaks=tuple(bound.at_most for bound, _ in peaks),
        gain=_strictest([bound.at_most for bound in goals.bounds if isinstance(bound, GainBound)], min),
    )


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
        Interrupted: by Ctrl-C, with the best so far.
    """
    asked = goal_problem(vehicle, entry, goals)
    bests = with_bests(asked) if goals.family else asked  # said of every family, minimised where that is asked for
    try:
        found = searched(bests if goals.over == REGRET else asked, told)
    except Interrupted as stopped:
        stopped.best = _controller(vehicle, entry, goals, posed, lower_bound, bests, stopped.best)
        raise
    made = _controller(vehicle, entry, goals, posed, lower_bound, bests, found)
    return made if goals.structure is None else replace(made, remarks=(*made.remarks, *price(asked, found)))


def _controller(
    vehicle: Vehicle,
    entry: ControllerEntry,
    goals: Goals,
    posed: Problem,
    lower_bound: LowerBound,
    asked: GoalProblem,
    found: GoalDesign,
) -> Controller:
    """The controller of a gain, certified, with what it keeps."""
    law = static_law(found.gain)
    return Controller(
        entry.name,
        entry.measured,
        law,
        designed=True,
        certificate=certify_tightly(*posed.closed(law), lower_bound, by_itself=posed.plant),
        remarks=remarks(found),
        hardware=entry.hardware,
        promises=Judged(vehicle, entry, goals, asked, found.gain).promises(),
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


def _posed(vehicle: Vehicle, entry: ControllerEntry, norm: NormOf) -> Posed:
    """A vehicle with the z of a norm."""
    if norm.signals is not None:
        vehicle = replace(vehicle, performance=dict(norm.signals), filters={})
    posed = problem(vehicle, entry.measured, entry.hardware)
    return Posed(posed.plant, posed.Cy, posed.Dyw)


def _driven(vehicle: Vehicle, entry: ControllerEntry, bound: PeakBound, road: Road) -> Driven:
    """A vehicle on the road of a bound."""
    bandwidth = entry.hardware.bandwidth
    model = vehicle.linear_model if bandwidth is None else vehicle.linear_model.behind_lag(bandwidth)
    (C, D), (Cy, _) = model.rows([bound.signal]), model.rows(entry.measured)
    of_height = model.Cr[model.outputs.index(bound.signal)]

    @cache
    def heights(times: bytes) -> Array:
        t = np.frombuffer(times)
        return np.hstack([under_wheels(of, road, vehicle, t) for of in (road.velocity, road.displacement)])

    later = delays(road, vehicle)
    kinks = np.unique([kink + delay for kink in road.kinks for delay in later])
    drive = Drive(lambda t: heights(np.ascontiguousarray(t).tobytes()), kinks, road.duration + max(later))
    E, f = np.hstack([model.Bw, model.Br]), np.concatenate([np.zeros(len(of_height)), of_height])
    name = f"{bound.signal} over {bound.road} <= {bound.at_most:g}"
    return Driven(model.A, model.B, Cy, E, C[0], D[0], f, drive, name)


def _road(vehicle: Vehicle, entry: ControllerEntry, bound: PeakBound) -> Road:
    """The road of a bound.

    Raises:
        InputError: it is none, or has no end.
    """
    where = f"[controllers.{entry.name}] bounds: road = {bound.road!r}"
    try:
        choice = choose_road(bound.road)
        road = choice.build(vehicle, bound.speed or USUAL_SPEED, 0, 0.0)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    if not np.isfinite(road.duration):
        raise InputError(f"{where} has no end, and so no largest value; give a bump, a step, a hump or a pothole")
    return road


def _band(norm: NormOf) -> tuple[float, float]:
    low, high = norm.band
    return 2 * np.pi * low, 2 * np.pi * high


def _strictest(values: Sequence[float], of: Callable[[Sequence[float]], float]) -> float | None:
    return of(values) if values else None
