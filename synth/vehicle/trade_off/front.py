"""Trade-off between two or three norms of a vehicle (axes): certified designs, lower bounds, and other controllers."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.combinations import check_command
from models.laws.goals import Goals, PeakBound
from models.laws.linear import static_law
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.analysis.bounding import certify_tightly
from synth.analysis.stability import stability
from synth.controller.controller import Controller
from synth.controller.problem import generalized_plant, problem
from synth.design.multi_objective.peak import peak_over_road
from synth.design.multi_objective.search import MinimaxSearch
from synth.design.problem import quiet
from synth.design.two_step import two_step_design
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError, numerics
from synth.vehicle.designer import Designer
from synth.vehicle.multi_objective import goal_problem, with_outputs_of_norm
from synth.vehicle.trade_off.axes import AxisValue, FrontAxis, landscapes, norm_on
from synth.vehicle.trade_off.continuation import EvaluatedGain, FrontContinuation, rays, undominated_rows
from synth.vehicle.trade_off.lower_bound import LowerBoundCurve, limits
from synth.vehicle.verification import Verification

DESIGNS = 200  # default number of designs in a trade-off
# smallest decay rate of a design if the goals give no bound, relative to the decay rate of the first starting gain
SLOWER = 0.1
MARKED_POINTS = 9  # number of representative points of the trade-off


@dataclass(frozen=True, eq=False)
class Point:
    """Design on the trade-off front, or a different controller for comparison.

    Attributes:
        controller: controller with its certificate for `[performance]`.
        norms: norm that the controller achieves on each axis, with a proved bound.
        travel: largest suspension deflection over the paper's bump [m]; None if it was not computed, or if the vehicle has no
            suspension.
    """

    controller: Controller
    norms: tuple[AxisValue, ...]
    travel: float | None = None

    @property
    def values(self) -> list[float]:
        """Norm of the controller on each axis."""
        return [norm.value for norm in self.norms]


@dataclass(frozen=True, eq=False)
class Front:
    """Trade-off of a vehicle: certified designs on the Pareto front, and lower bounds.

    Attributes:
        vehicle: vehicle of the trade-off.
        name: name of the controller whose measurements, bounds and structure the designs use.
        axes: axes of the trade-off.
        points: designs that no other design dominates, in ascending order of the norm on the first axis.
        others: other controllers of the vehicle file, for comparison.
        missing: reason for each controller of the vehicle file that is not compared, by name of the controller.
        limits: lower-bound curve for each pair of axes.
        design_count: number of designs that were tried.
        unproved: number of designs that are omitted because a norm or another claim could not be proved.
    """

    vehicle: Vehicle
    name: str
    axes: tuple[FrontAxis, ...]
    points: tuple[Point, ...]
    others: tuple[Point, ...]
    missing: dict[str, str]
    limits: tuple[LowerBoundCurve, ...]
    design_count: int
    unproved: int

    @property
    def values(self) -> Array:
        """Norms of the N designs on the K axes, shape (N, K)."""
        return np.array([point.values for point in self.points]).reshape(-1, len(self.axes))

    @property
    def marked(self) -> list[int]:
        """Indices of the designs that represent the front in tables and simulations."""
        return marked_indices(len(self.points))


@numerics()
def front(
    vehicle: Vehicle,
    name: str,
    axes: Sequence[FrontAxis],
    others: Sequence[str],
    count: int = DESIGNS,
    on_progress: Callable[[int], None] = lambda done: None,
) -> Front:
    """Computes the trade-off front of static gains that use the same measurements as a controller of the vehicle.

    Args:
        vehicle: vehicle of the trade-off.
        name: name of the controller whose measurements, bounds and structure the designs use.
        axes: two or three axes of the trade-off.
        others: names of other controllers that are shown for comparison.
        count: approximate number of designs to make.
        on_progress: function that is called with the number of finished designs.

    Raises:
        InputError: designs cannot be based on this controller (see `entry_of`), or it has too many measurements for an axis
            with measurement errors.
        DesignError: no gain satisfies the bounds.
    """
    entry, designer = entry_of(vehicle, name), Designer(vehicle)
    trace = _trace(vehicle, entry, axes)
    goals, plant_problem = entry.goals, problem(vehicle, entry.measured, entry.hardware)
    below = designer.lower_bound(entry.measured, entry.hardware)
    asked, swept = goal_problem(vehicle, entry, goals or Goals()), list[EvaluatedGain]()
    for i, unit in enumerate(rays(trace.ends(), count)):
        swept.append(trace.step_along(unit))
        on_progress(i + 1)
    kept = [each for each in swept if each.excess <= 1e-9]
    kept = [each for each, best in zip(kept, undominated_rows(np.array([each.values for each in kept])), strict=True) if best]
    points: list[Point] = []
    unproved = 0
    for each in kept:
        law = static_law(trace.gain(each))
        certificate = certify_tightly(*plant_problem.closed_loop(law), below, plant_without_law=plant_problem.plant)
        norms = tuple(norm_on(vehicle, axis, entry, law) for axis in axes)
        promises = () if goals is None else Verification(vehicle, entry, goals, asked, law.D).promises()
        controller = Controller.of(entry, law, certificate, specifications=promises)
        if certificate.bound is not None and not controller.failures and all(np.isfinite(norm.proved) for norm in norms):
            points.append(Point(controller, norms))
        else:
            unproved += 1
    best = undominated_rows(np.array([point.values for point in points]))
    first = sorted((point for point, one in zip(points, best, strict=True) if one), key=lambda point: point.values)
    found = dict(_others(designer, axes, others, entry.hardware.loads))
    shown = tuple(one for one in found.values() if isinstance(one, Point))
    missing = {name: why for name, why in found.items() if isinstance(why, str)}
    bounds = tuple(_limits(vehicle, axes, np.array([point.values for point in first]), entry.hardware.loads))
    for i, travel in _over_the_bump(vehicle, entry, first):
        first[i] = replace(first[i], travel=travel)
    return Front(vehicle, name, tuple(axes), tuple(first), shown, missing, bounds, len(swept), unproved)


def entry_of(vehicle: Vehicle, name: str) -> ControllerEntry:
    """Returns the section of the controller on which the designs of a front are based.

    Raises:
        InputError: the designs of a front cannot be based on the controller's section.
    """
    if name == "state":
        return ControllerEntry(name, vehicle.linear_model.states)
    entry = vehicle.controllers.get(name)
    why = ""
    if entry is None:
        why = "the passive vehicle measures nothing" if name == "passive" else "this vehicle has no controller of that name"
    if why or entry is None:
        raise InputError(
            f"--front cannot design static gains from the measurements of {name!r}: {why}; give a different controller with "
            "--controller"
        )
    check_command(f"controller {name!r}", entry.parts, "front")
    if vehicle.integrals:
        raise InputError(
            f"controller {name!r}: --front designs static gains, which cannot contain an integral; omit the integral "
            "in [performance]"
        )
    return entry


def _over_the_bump(vehicle: Vehicle, entry: ControllerEntry, points: Sequence[Point]) -> Iterator[tuple[int, float]]:
    """Yields the index of each representative design, and the largest suspension deflection that this design has over the
    paper's bump [m].
    """
    signals = [name for name in vehicle.linear_model.outputs if name.startswith("suspension_deflection")]
    if not signals:
        return
    bounds = tuple(PeakBound(signal, np.inf) for signal in signals)
    driven = goal_problem(vehicle, entry, Goals(bounds=bounds)).members[0].driven_by
    for i in marked_indices(len(points)):
        yield i, max(peak_over_road(one, points[i].controller.gain).value for one in driven)


def marked_indices(count: int) -> list[int]:
    """Returns the indices of representative designs, evenly spaced from the first design to the last."""
    return sorted({round(i) for i in np.linspace(0, count - 1, MARKED_POINTS)}) if count else []


def _trace(vehicle: Vehicle, entry: ControllerEntry, axes: Sequence[FrontAxis]) -> FrontContinuation:
    """Returns the `FrontContinuation` that searches for the designs on the front."""
    problem = goal_problem(vehicle, entry, entry.goals or Goals())
    plant_problem, starts = problem.members[0].plants[0], []
    if entry.law is not None:
        starts.append(entry.law.D)
    with contextlib.suppress(InputError):  # the class InputError includes DesignError
        starts.append(plant_problem.on_readings(two_step_design(plant_problem).gain))
    if problem.decay is None and starts:
        decay = -float(
            np.real(
                stability(plant_problem.A + plant_problem.B @ plant_problem.acting(starts[-1]) @ plant_problem.Cy).poles
            ).max()
        )
        problem = replace(problem, decay=SLOWER * decay if decay > 0 else None)
    search = MinimaxSearch(problem, quiet)
    return FrontContinuation(search, [landscapes(vehicle, axis, entry, search.full) for axis in axes], starts)


def _others(
    designer: Designer, axes: Sequence[FrontAxis], names: Sequence[str], loads: Sequence[tuple[str, float]]
) -> Iterator[tuple[str, Point | str]]:
    """Yields the name of each controller for comparison, and its values on the axes, computed with the same loads as the
    designs.

    For a controller that is omitted, the reason is yielded instead of the values.
    """
    for name in names:
        try:
            controller = designer.design(name)
        except DesignError as error:
            yield name, str(error)
            continue
        entry = ControllerEntry(name, controller.measured, hardware=replace(controller.hardware, loads=loads))
        norms = tuple(norm_on(designer.vehicle, axis, entry, controller.law) for axis in axes)
        if all(np.isfinite(norm.value) for norm in norms):
            yield name, Point(controller, norms)
        else:
            yield name, "its loop is unstable" if not controller.certificate.stable else "its loop is unstable with errors"


def _limits(
    vehicle: Vehicle, axes: Sequence[FrontAxis], values: Array, loads: Sequence[tuple[str, float]]
) -> Iterator[LowerBoundCurve]:
    """Returns the lower-bound curves for all pairs of axes."""
    plants: list[Plant] = [generalized_plant(with_outputs_of_norm(vehicle, axis.norm), loads=loads) for axis in axes]
    units = np.median(values, axis=0) if len(values) else np.ones(len(axes))
    return limits(plants, [axis.norm.rates for axis in axes], np.where(units > 0, units, 1.0))
