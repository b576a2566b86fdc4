"""A vehicle and the goals of a controller's section as a problem in the plant's language (`synth.goals`)."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.controllers import ControllerEntry
from models.goals.goals import DecayBound, EnergyBound, GainBound, Goals, NormBound, NormOf, PeakBound
from models.goals.reading import FORCE
from models.roads.choice import choose_road
from models.roads.road import Road, delays, under_wheels
from models.vehicle import Vehicle
from synth.goals.energy_peak import Signal
from synth.goals.problem import Errors, GoalProblem, Member, NormGoal, Posed
from synth.goals.road_response import Drive, Driven
from synth.problem.problem import measurements, problem

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
        InputError: a road that is none or has no end, or a member or a measurement that cannot be. The message names the vehicle
            file, and the bound.
    """
    try:
        return _goal_problem(vehicle, entry, goals)
    except InputError as error:
        raise vehicle.found_wrong(error) from error


def _goal_problem(vehicle: Vehicle, entry: ControllerEntry, goals: Goals) -> GoalProblem:
    through = measurements(vehicle, entry.measured, entry.hardware.bandwidth)[1]
    if np.any(through):
        i = int(np.argmax(np.any(through, axis=1)))
        raise InputError(
            f"[controllers.{entry.name}] measures {entry.measured[i]!r}, in which forces act at once, and has goals, whose "
            "errors and structure are of a gain on the state alone; measure something else, or give lag = true"
        )
    vehicles = family_of(vehicle, entry, goals)
    norms = [goals.minimise, *(bound.norm for bound in goals.bounds if isinstance(bound, NormBound))]
    bounded = [(f"[controllers.{entry.name}] bounds[{i}]", bound) for i, bound in enumerate(goals.bounds)]
    peaks = [(bound, _road(where, vehicle, bound)) for where, bound in bounded if isinstance(bound, PeakBound)]
    energies = [(where, bound) for where, bound in bounded if isinstance(bound, EnergyBound)]
    members = tuple(
        Member(
            tuple(_posed(each, entry, norm) for norm in norms),
            tuple(_driven(each, entry, bound, road) for bound, road in peaks),
            tuple(_signal(where, weighing(each, goals.minimise), entry, bound) for where, bound in energies),
        )
        for each in vehicles
    )
    bounds = [
        NormGoal(i + 1, bound.norm.rates, bound.at_most, f"{bound.norm.text} <= {bound.at_most:g}")
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
        NormGoal(0, goals.minimise.rates),
        errors,
        structure,
        norms=tuple(bounds),
        decay=_strictest([bound.rate for bound in goals.bounds if isinstance(bound, DecayBound)], max),
        peaks=tuple(bound.at_most for bound, _ in peaks),
        gain=_strictest([bound.at_most for bound in goals.bounds if isinstance(bound, GainBound)], min),
    )


def weighing(vehicle: Vehicle, norm: NormOf) -> Vehicle:
    """The vehicle whose z is that of a norm."""
    return vehicle if norm.signals is None else replace(vehicle, performance=dict(norm.signals), filters={})


def _posed(vehicle: Vehicle, entry: ControllerEntry, norm: NormOf) -> Posed:
    """A vehicle with the z of a norm."""
    posed = problem(weighing(vehicle, norm), entry.measured, entry.hardware)
    return Posed(posed.plant, posed.Cy, posed.Dyw)


def _driven(vehicle: Vehicle, entry: ControllerEntry, bound: PeakBound, road: Road) -> Driven:
    """A vehicle on the road of a bound."""
    bandwidth = entry.hardware.bandwidth
    model = vehicle.linear_model if bandwidth is None else vehicle.linear_model.behind_lag(bandwidth)
    (C, D), (Cy, _) = model.rows([bound.signal]), model.rows(entry.measured)
    of_height = model.Cr[model.outputs.index(bound.signal)]

    @cache
    def heights(times: bytes) -> Array:
        return under_wheels(road.displacement, road, vehicle, np.frombuffer(times))

    later = delays(road, vehicle)
    kinks = np.unique([kink + delay for kink in road.kinks for delay in later])
    drive = Drive(
        lambda t: heights(np.ascontiguousarray(t).tobytes()),
        lambda t: under_wheels(road.velocity, road, vehicle, t),
        kinks,
        road.duration + max(later),
    )
    name = f"{bound.signal} over {bound.road} <= {bound.at_most:g}"
    return Driven(model.A, model.B, Cy, model.Bw, model.Br, C[0], D[0], of_height, drive, name)


def _signal(where: str, vehicle: Vehicle, entry: ControllerEntry, bound: EnergyBound) -> Signal:
    """The signal of a bound for roads of given energy, on the states of what is minimised.

    Args:
        where: the bound, for messages.
        vehicle, entry, bound: what it is of.

    Raises:
        InputError: the road's height, which has no energy, or noise reaches it at once.
    """
    model, bandwidth = vehicle.linear_model, entry.hardware.bandwidth
    if np.any(model.Cr[model.outputs.index(bound.signal)]):
        raise InputError(
            f"{where}: {bound.signal!r} has the road's height in it, which no energy of its velocity bounds; give another "
            "signal, or its peak over a road"
        )
    if any(entry.hardware.noise):
        raise InputError(
            f"{where} is an energy_peak, which is of the road alone, and [controllers.{entry.name}] has noise = true; leave "
            "one out"
        )
    c, g = measurements(vehicle, [bound.signal], bandwidth)
    name = f"{bound.signal} for roads of {bound.energy:g} m2/s <= {bound.at_most:g}"
    return Signal(c[0], g[0], bound.at_most, bound.energy**0.5, name)


def _road(where: str, vehicle: Vehicle, bound: PeakBound) -> Road:
    """The road of a bound.

    Args:
        where: the bound, for messages.
        vehicle, bound: what it is of.

    Raises:
        InputError: it is none, or has no end.
    """
    where = f"{where} road = {bound.road!r}"
    try:
        choice = choose_road(bound.road)
        road = choice.build(vehicle, bound.speed or USUAL_SPEED, 0, 0.0)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    if choice.loads:
        raise InputError(f"{where} has loads, and a bound on a peak is over the road alone; leave them out")
    if not np.isfinite(road.duration):
        raise InputError(f"{where} has no end, and so no largest value; give a bump, a step, a hump or a pothole")
    return road


def _strictest(values: Sequence[float], of: Callable[[Sequence[float]], float]) -> float | None:
    return of(values) if values else None
