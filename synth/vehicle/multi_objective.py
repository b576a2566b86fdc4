"""Design of controllers for the goals that their sections in the vehicle file state: optimisation problem and certified
specifications.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, error_in
from models.common.printed import digits, percent
from models.laws.goals import REGRET, EnergyBound, Goals, NormBound, NormOf, PeakBound
from models.laws.linear import LinearLaw
from models.roads.road import Road, delays, under_wheels
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.analysis.lower_bounds.lower_bound import LowerBound
from synth.analysis.specification import Specification
from synth.controller.controller import Controller
from synth.controller.problem import Problem, measurements, problem
from synth.design.methods import design as design_for
from synth.design.multi_objective.design import improved_goal, with_individual_optima
from synth.design.multi_objective.objectives import BoundedSignal
from synth.design.multi_objective.plant_goals import norms_of, posed_goals
from synth.design.multi_objective.problem import FamilyMember, MultiObjectiveProblem
from synth.design.multi_objective.road_response import RoadExcitation, RoadLoop
from synth.design.problem import DesignProblem, Progress
from synth.plant.generalized import Plant
from synth.vehicle.design_problem import certify_ideal_loop
from synth.vehicle.verification import Verification

USUAL_SPEED = 12.5  # default speed for bounds [m/s], as in equation (62) of the paper


def family_of(vehicle: Vehicle, entry: ControllerEntry, goals: Goals) -> list[Vehicle]:
    """Returns the family of vehicles for which the controller of a section is designed.

    Raises:
        InputError: the parameters of a vehicle in the family are invalid.
    """
    members = []
    for i, member in enumerate(goals.family or ({},)):
        scaled = {name: value * member[name] for name, value in vehicle.parameters.items() if name in member}
        with error_in(f"[controllers.{entry.name}] family[{i}]:"):
            members.append(vehicle.with_parameters(**scaled))
    return members


def goal_problem(vehicle: Vehicle, entry: ControllerEntry, goals: Goals) -> MultiObjectiveProblem:
    """Returns the optimisation problem that the goals in a section define, without the individual optimum of each vehicle.

    Raises:
        InputError: the road of a bound is unknown or has no end, or a vehicle or measurement is invalid. The error message
            names the vehicle file and the bound.
    """
    try:
        return _goal_problem(vehicle, entry, goals)
    except InputError as error:
        raise vehicle.located(error) from error


def _goal_problem(vehicle: Vehicle, entry: ControllerEntry, goals: Goals) -> MultiObjectiveProblem:
    vehicles = family_of(vehicle, entry, goals)
    norms = norms_of(goals)
    bounded = [(f"[controllers.{entry.name}] bounds[{i}]", bound) for i, bound in enumerate(goals.bounds)]
    peaks = [(bound, _road(where, vehicle, bound)) for where, bound in bounded if isinstance(bound, PeakBound)]
    energies = [(where, bound) for where, bound in bounded if isinstance(bound, EnergyBound)]
    members = tuple(
        FamilyMember(
            tuple(_with_norm(each, entry, norm) for norm in norms),
            tuple(_on_road_of_bound(each, entry, bound, road) for bound, road in peaks),
            tuple(_signal(where, with_outputs_of_norm(each, goals.minimise), entry, bound) for where, bound in energies),
        )
        for each in vehicles
    )
    return posed_goals(goals, members, entry.measured, vehicle.linear_model.inputs)


def with_outputs_of_norm(vehicle: Vehicle, norm: NormOf) -> Vehicle:
    """Returns the vehicle with an output z that contains the signals of a norm goal, with the weights of this goal."""
    return vehicle if norm.signals is None else replace(vehicle, performance=dict(norm.signals), filters={}, sums=())


def _with_norm(vehicle: Vehicle, entry: ControllerEntry, norm: NormOf) -> Plant:
    """Returns the plant of a vehicle whose output z contains the signals of a norm goal."""
    return problem(with_outputs_of_norm(vehicle, norm), entry.measured, entry.hardware).plant


def _on_road_of_bound(vehicle: Vehicle, entry: ControllerEntry, bound: PeakBound, road: Road) -> RoadLoop:
    """Returns the loop of a vehicle that drives over the road for which a peak bound is stated."""
    bandwidth = entry.hardware.bandwidth
    model = vehicle.linear_model if bandwidth is None else vehicle.linear_model.behind_lag(bandwidth)
    (C, D), (Cy, Dyu) = model.rows([bound.peak]), model.rows(entry.measured)
    of_height = model.Cr[model.outputs.index(bound.peak)]
    _refuse_pushed(f"[controllers.{entry.name}] over a road", vehicle, (bound.peak, *entry.measured))

    felt, end = road.from_start, road.duration
    displacement, velocity = felt.displacement, felt.velocity
    if felt is not road:  # a road that is given by measured points is level after the last point

        def displacement(t: Array, side: str) -> Array:
            return felt.displacement(np.minimum(t, end), side)

        def velocity(t: Array, side: str) -> Array:
            return np.where(t <= end, felt.velocity(t, side), 0.0)

    @cache
    def heights(times: bytes) -> Array:
        return under_wheels(displacement, road, vehicle, np.frombuffer(times))

    later = delays(road, vehicle)
    kinks = np.unique([kink + delay for kink in road.kinks for delay in later])
    drive = RoadExcitation(
        lambda t: heights(np.ascontiguousarray(t).tobytes()),
        lambda t: under_wheels(velocity, road, vehicle, t),
        kinks,
        road.duration + max(later),
    )
    name = f"{bound.peak} over {bound.road} <= {bound.at_most:g}"
    plant = Plant(model.A, model.B, model.Bw, C, D, np.zeros((1, model.Bw.shape[1])), Cy=Cy, Dyu=Dyu)
    return RoadLoop(plant, model.Br, of_height, drive, name)


def _refuse_pushed(where: str, vehicle: Vehicle, names: Sequence[str]) -> None:
    """Raises an InputError if a signal depends directly on the road velocity, because the signal then jumps when the road
    velocity jumps.
    """
    model = vehicle.linear_model
    if pushed := [name for name in names if np.any(model.Dw[model.outputs.index(name)])]:
        raise InputError(
            f"{where}: {pushed[0]!r} contains the road's velocity because of tyre_damping, so neither the peak nor "
            "the energy of this signal is bounded; omit this signal or tyre_damping"
        )


def _signal(where: str, vehicle: Vehicle, entry: ControllerEntry, bound: EnergyBound) -> BoundedSignal:
    """Returns the signal of an energy bound as a linear combination of states and inputs of the plant whose norm is minimised."""
    model, bandwidth = vehicle.linear_model, entry.hardware.bandwidth
    if np.any(model.Cr[model.outputs.index(bound.energy_peak)]):
        raise InputError(
            f"{where}: {bound.energy_peak!r} contains the road's height. The energy of the road's velocity does not bound "
            "this height; give a different signal, or bound the peak over a road"
        )
    if any(entry.hardware.noise):
        raise InputError(
            f"{where} bounds an energy_peak, for which noise is not allowed, but [controllers.{entry.name}] has noise "
            "= true; omit the bound on the energy_peak, or omit noise"
        )
    _refuse_pushed(where, vehicle, (bound.energy_peak, *entry.measured))
    c, g = measurements(vehicle, [bound.energy_peak], bandwidth)
    name = f"{bound.energy_peak} for roads of {bound.energy:g} m2/s <= {bound.at_most:g}"
    return BoundedSignal(c[0], g[0], bound.at_most, bound.energy**0.5, name)


def _road(where: str, vehicle: Vehicle, bound: PeakBound) -> Road:
    """Returns the road for which a peak bound is stated.

    Raises:
        InputError: the road is unknown, has loads or a vertical edge, or has no end.
    """
    from models.roads.choice import choose_road  # this import loads the code of all roads and loads, and of their files

    where = f"{where} road = {bound.road!r}"
    with error_in(f"{where}:"):
        choice = choose_road(bound.road)
        road = choice.build(vehicle, bound.speed or USUAL_SPEED, 0, 0.0)
    if choice.loads:
        raise InputError(
            f"{where} has loads on the vehicle, but a bound on a peak can account only for the road as input; omit the loads"
        )
    if road.jumps:
        raise InputError(f"{where} has a vertical edge, at which the road's velocity is infinite; give an edge longer than 0")
    if not np.isfinite(road.duration):
        raise InputError(
            f"{where} is a road that does not end, so the peaks over this road have no largest value; give a bump, a "
            "step, a hump or a pothole"
        )
    return road


def goals_design(
    vehicle: Vehicle, entry: ControllerEntry, goals: Goals, plant_problem: Problem, lower_bound: LowerBound, on_progress: Progress
) -> Controller:
    """Designs the controller of a vehicle file's section that contains goals.

    Args:
        vehicle: vehicle whose file contains the section.
        entry: section of the vehicle file that defines the controller.
        goals: goals in the section: norm to minimise, bounds, and tolerance of gain errors.
        plant_problem: control problem for the certificate; z is defined in `[performance]` and weighted at all frequencies.
        lower_bound: lower bound on the norm for any controller with the same measurements.
        on_progress: function that is called with the progress of the search.

    Returns:
        The designed controller with its certificate and verified specifications.

    Raises:
        DesignError: the search found no controller that satisfies the bounds.
    """
    problem = goal_problem(vehicle, entry, goals)
    # For every family, the ratios of the norms to the individual optima are reported. If the goals request it, the ratios are
    # minimised.
    bests = with_individual_optima(problem) if goals.family else problem
    certify = certify_ideal_loop(plant_problem, lower_bound)
    asked = DesignProblem(plant_problem.plant, goals=bests if goals.over == REGRET else problem, thorough=False, certify=certify)
    design = design_for(asked, on_progress)
    law, certificate, said = design.law, design.certificate, [*design.remarks]
    if goals.minimise.narrow and not any(isinstance(bound, NormBound) and not bound.narrow for bound in goals.bounds):
        said.append(
            f"the norm has no bound outside the band of the goal, and is {digits(certificate.norm.value)}; to limit it, give "
            "bounds = [{ norm = ... }]"
        )
    if goals.structure is not None and not np.all(problem.structure):
        assert asked.goals is not None, "goals"
        full = replace(asked.goals, structure=np.ones_like(problem.structure))
        # the search descends from the gain of the design for a limited number of rounds
        goal = improved_goal(full, design.details, on_progress)
        said.append(
            f"the structure costs at least {percent(design.value / goal - 1)}: a gain with every entry reaches {digits(goal)}, "
            "and may reach a lower value"
        )
    promises = Verification(vehicle, entry, goals, bests, design.gain).promises()
    return Controller.of(entry, law, certificate, remarks=tuple(said), specifications=promises)


def verify_specifications(
    vehicle: Vehicle, entry: ControllerEntry, goals: Goals, law: LinearLaw, search: bool
) -> tuple[Specification, ...]:
    """Verifies that the gain in a section of the vehicle file satisfies the goals in this section.

    Args:
        vehicle: vehicle whose file contains the section.
        entry: section of the vehicle file that defines the controller.
        goals: goals in the section: norm to minimise, bounds, and tolerance of gain errors.
        law: static control law that the section contains.
        search: True to include, for a family of vehicles, the ratio of the norm to each vehicle's individual optimum. The ratio
            to the individual optima requires additional designs.

    Raises:
        DesignError: `search` is True, but for one vehicle of the family no gain satisfies the bounds, not even a gain for this
            vehicle only.
    """
    problem = goal_problem(vehicle, entry, goals)
    if search and goals.over == REGRET:
        problem = with_individual_optima(problem)
    return Verification(vehicle, entry, goals, problem, law.D).promises()
