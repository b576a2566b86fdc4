"""Identification of a vehicle from logs: free parameters, estimate, confidence intervals, checks, and the resulting vehicle."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, alike, short_repr
from models.common.printed import rough
from models.common.schema import SI
from models.vehicle.vehicle import Vehicle
from sim.runs.sampled_vehicle import with_sample
from sim.studies.identification.diagnosis import (
    SCALED,
    Cause,
    airborne,
    causes,
    check_columns,
    check_forces,
    contradictions,
    resonances,
)
from sim.studies.identification.estimation.estimate import Estimate, estimate, nearby
from sim.studies.identification.estimation.problem import IdentificationProblem
from sim.studies.identification.estimation.profile import profile
from sim.studies.identification.estimation.residuals import Residuals
from sim.studies.identification.estimation.search import CHI2, NORMAL, first_unknowns
from sim.studies.identification.experiment import Experiment
from sim.studies.identification.in_mujoco import difference_in_mujoco
from sim.studies.identification.log_map import LogMap, read_map
from sim.studies.identification.reading import LEAST, LogStretches, read_experiments, runs
from sim.studies.identification.spectra.random_road import ROAD_UNITS, free_road
from sim.studies.identification.spectra.spectral_estimate import estimate_spectra, fits_elsewhere, nearby_spectra, unsteady

if TYPE_CHECKING:
    from sim.studies.identification.allowed_result import AllowedResult

LOWEST = 1e-6  # if the smallest allowed value of a number exceeds this, the search never goes below that value
SMALL_START = 0.02  # initial value of a damping that is 0 in the file, relative to critical damping
# if the standard deviation of a parameter's logarithm is larger than this, the confidence interval is computed from the profile
# likelihood
SKEWED = 0.2
AFTER = 0.5  # s; samples within this time after a landing are not used, because the tyre is not linear there
# if the reported causes explain a larger share of the residuals' sum of squares than this, resonances are not searched for
NAMED = 0.5
ANOTHER = 0.1  # two solutions count as different if the logarithm of a parameter differs by more than this


@dataclass(frozen=True, eq=False)
class Interval:
    """95 % interval of a parameter.

    Attributes:
        low, high: ends of the confidence interval; None for an open end.
        method: method of computation: "covariance", "robust" (covariance for coloured residuals) or "profile" (profile
            likelihood).
    """

    low: float | None
    high: float | None
    method: str


@dataclass(frozen=True, eq=False)
class Identification:
    """Result of the identification of a vehicle.

    Attributes:
        estimate: estimated parameters with their covariance.
        intervals: 95 % confidence interval of each free parameter that the logs determine individually (not only in a product),
            by name.
        causes: causes of a misfit that were found in the residuals.
        remarks: remarks on the logs and on the columns of the logs.
        mirror: parameter values of a second solution that fits equally well, by name; empty if no second solution is known.
        held_out: fit of each signal in the logs that were not used for the estimate, by experiment.
        in_mujoco: largest difference between MuJoCo and the prediction for each signal, relative to the signal's peak; empty if
            nothing was simulated.
        allowed: results of controllers over all vehicles that are consistent with the logs, if they were requested.
    """

    estimate: Estimate
    intervals: Mapping[str, Interval]
    causes: tuple[Cause, ...]
    remarks: tuple[str, ...]
    mirror: Mapping[str, float]
    held_out: tuple[tuple[str, Mapping[str, float]], ...]
    in_mujoco: Mapping[str, float]
    allowed: "tuple[AllowedResult, ...]" = ()

    @cached_property
    def vehicle(self) -> Vehicle:
        """The vehicle with the identified parameter values."""
        return changed(self.estimate.problem.vehicle, self.estimate.values)

    @property
    def determined(self) -> tuple[str, ...]:
        """Free parameters that the logs determine individually, and not only in a product."""
        return tuple(self.intervals)


def changed(vehicle: Vehicle, values: Mapping[str, float]) -> Vehicle:
    """Returns the vehicle after some parameter values were changed. If the vehicle file replaces a parameter by a table, the
    table is scaled to the new value.

    Changes to parameters of a random road are ignored.
    """
    values = {name: value for name, value in values.items() if name not in ROAD_UNITS}
    optional = {one.name for one in vehicle.kind.parameters} - vehicle.parameters.keys()
    if missing := {name: value for name, value in values.items() if name in optional}:
        vehicle = vehicle.altered(missing)
    curves = {
        name: curve.scaled(values[name] / vehicle.parameters[name]) if name in values else curve
        for name, curve in vehicle.curves.items()
    }
    return with_sample(replace(vehicle, curves=curves) if vehicle.curves else vehicle, values)


def free_parameters(
    vehicle: Vehicle, fix: Sequence[str] = (), free: Sequence[str] = (), parts: Collection[str] = ("",)
) -> dict[str, float]:
    """Returns the initial values of the free parameters: masses, inertias, stiffnesses and dampings that are above zero in the
    vehicle file.

    Args:
        fix: names of parameters that keep their initial values.
        free: names of additional free parameters; a damping that is zero in the file starts at a small value.
        parts: names of the parts to which the logs belong; the empty name stands for logs of the whole vehicle. For a part on a
            dyno, all numerical parameters of the part are estimated, except voltages and bandwidths. If every log belongs to a
            part, no parameters of the vehicle are estimated.

    Raises:
        InputError: a name is not a parameter of the vehicle, or cannot be estimated.
    """
    units = {one.name: one.unit for one in vehicle.kind.parameters}
    numbers = {name: value for name, (value, _) in element_numbers(vehicle).items()}
    given = {**{one.name: one.usual or 0.0 for one in vehicle.kind.parameters}, **vehicle.parameters, **numbers}
    for name in (*fix, *free):
        if name not in given:
            raise InputError(f"{short_repr(name)} is not a parameter; give one of {alike(name, given)}")
    for name in fix:
        if name in free:
            raise InputError(f"{name} is given both as fixed and as free; give it only once")
    first = {name: value for name, value in vehicle.parameters.items() if "" in parts and units.get(name) in SCALED and value > 0}
    own = {name: value for name, value in numbers.items() if name.split(".")[0] in parts and value > 0}
    first |= {name: value for name, value in own.items() if "volt" not in name and not name.endswith(".bandwidth")}
    first |= {name: given[name] for name in free}
    for name in free:
        if first[name] < 0:
            raise InputError(
                f"{name} = {first[name]:g} cannot be estimated, because only parameters above 0 can be estimated; fix "
                "this parameter"
            )
        if first[name] == 0:
            first[name] = _small(vehicle, name, units)
    return {name: value for name, value in first.items() if name not in fix}


def element_numbers(vehicle: Vehicle) -> dict[str, tuple[float, SI]]:
    """Returns the numerical parameters of the force elements, each with its unit and range; their names have the form
    NAME.key.
    """
    return {key: one for element in vehicle.elements for key, one in element.numbers.items()}


def _small(vehicle: Vehicle, name: str, units: Mapping[str, str]) -> float:
    p, ending = vehicle.parameters, name.removeprefix("tyre_damping")
    kind = vehicle.kind
    stiffness, mass = (p.get(kind.of_corner(one, ending), 0.0) for one in ("tyre_stiffness", "unsprung_mass"))
    if units.get(name) != "N s/m" or not stiffness or not mass:
        raise InputError(
            f"{name} is 0 in the vehicle file, but an estimate must start above 0; give {name} a value above 0 in the file"
        )
    return 2 * SMALL_START * float(np.sqrt(stiffness * mass))


def identify(
    logs: Sequence[Path],
    vehicle: Vehicle,
    log_map: Path | LogMap | None = None,
    fix: Sequence[str] = (),
    free: Sequence[str] = (),
    hold_out: Sequence[Path] = (),
    seed: int = 0,
) -> Identification:
    """Identifies the parameters of a vehicle from logs.

    Args:
        logs: paths of the log files; see `sim.studies.identification.reading` for their formats.
        vehicle: vehicle with the initial parameter values. Parameters that are not free keep their initial values.
        log_map: map from columns to signals; None for logs whose column headings are names of signals.
        fix: names of parameters that keep their initial values.
        free: names of additional parameters to estimate, such as tyre_damping, or numbers of force elements as NAME.key.
        hold_out: logs that are compared with their prediction, but not used for the estimate.
        seed: random seed from which further starting points are drawn.

    Raises:
        InputError: a file is invalid, a column seems to have the wrong unit or sign, or the logs determine no parameter.
    """
    own = log_map if isinstance(log_map, LogMap) else read_map(log_map, vehicle)
    named = replace(vehicle, kind=vehicle.kind.naming({*vehicle.kind.possible}))
    read = [read_experiments(path, named, own) for path in logs]
    return identify_experiments(read, named, own, fix, free, [read_experiments(path, named, own) for path in hold_out], seed)


def identify_experiments(
    logs: Sequence[LogStretches],
    vehicle: Vehicle,
    log_map: LogMap,
    fix: Sequence[str] = (),
    free: Sequence[str] = (),
    hold_out: Sequence[LogStretches] = (),
    seed: int = 0,
) -> Identification:
    """Identifies the parameters of a vehicle from experiments; the arguments and errors are those of `identify`."""
    experiments = tuple(one for log in logs for one in log.experiments)
    road = free_road(experiments, fix, free)
    fix, free = ([name for name in names if road is None or name not in ROAD_UNITS] for names in (fix, free))
    first = free_parameters(vehicle, fix, free, {one.part for one in experiments}) | (road or {})
    numbers = element_numbers(vehicle)
    zero = frozenset(name for name in free if not vehicle.parameters.get(name) and not numbers.get(name, (0.0,))[0])
    lowest = {name: numbers[name][1].low for name in first if name in numbers and numbers[name][1].low > LOWEST}
    problem = IdentificationProblem(vehicle, changed, first, experiments, log_map.known, zero, lowest)
    remarks = [one for log in logs for one in log.remarks]
    if road is not None:
        return _identify_spectra(problem, hold_out, remarks, seed)
    remarks += check_columns(problem)
    result = estimate(problem, tuple(first), seed)
    if air := airborne(result):
        problem, more = _on_the_ground(problem, air)
        remarks += more
        result = estimate(problem, tuple(first), seed)
    remarks += [*check_forces(result), *contradictions(result)]
    mirror = _mirror(result, nearby)
    intervals = dict[str, Interval]()
    for name in result.free:
        if result.ratios and set(result.ratios[name]) != {name}:
            continue
        if result.deviations[name] < SKEWED and name not in zero:
            low, high = result.interval(name)
            method = "robust" if result.coloured else "covariance"
            intervals[name] = Interval(max(low, lowest.get(name, low)), high, method)
        else:
            intervals[name] = Interval(*profile(result, name), "profile")
    ended = tuple((one.name, fit) for log in hold_out for one, fit in _held_out(result, log))
    named = causes(result)
    if not result.white and sum(one.share for one in named) < NAMED:
        remarks += resonances(result)
    return Identification(result, intervals, named, tuple(remarks), mirror, ended, difference_in_mujoco(result))


def _identify_spectra(
    problem: IdentificationProblem, hold_out: Sequence[LogStretches], remarks: Sequence[str], seed: int
) -> Identification:
    """Returns the identification from logs of a random road; the arguments are those of `identify_experiments`."""
    result = estimate_spectra(problem, tuple(problem.first), seed)
    intervals = dict[str, Interval]()
    for name in result.free:
        if not result.ratios or set(result.ratios[name]) == {name}:
            value, width = result.values[name], NORMAL * result.values[name] * result.deviations[name]
            around = (value - width if value > width else None, value + width)
            low, high = around if name in problem.from_zero else result.interval(name)
            intervals[name] = Interval(low, high, "robust" if result.coloured else "covariance")
    ended = tuple((one.name, fit) for log in hold_out for one, fit in fits_elsewhere(result, log.experiments))
    remarks = (*remarks, *unsteady(problem.experiments))
    return Identification(result, intervals, (), remarks, _mirror(result, nearby_spectra), ended, {})


def _on_the_ground(problem: IdentificationProblem, air: Sequence[tuple[int, Array]]) -> tuple[IdentificationProblem, list[str]]:
    """Returns the identification problem without the samples at which a wheel is in the air.

    Each stretch that begins with a landing has a separate starting state.
    """
    experiments, remarks, lifted = list[Experiment](), list[str](), dict(air)
    for i, one in enumerate(problem.experiments):
        if i not in lifted:
            experiments.append(one)
            continue
        out, margin = lifted[i].copy(), round(AFTER / one.step)
        for k in np.flatnonzero(lifted[i]):
            out[max(k - 2, 0) : k + margin] = True
        remarks.append(
            f"{one.name}: a wheel is in the air in {int(lifted[i].sum())} samples; these samples, and {AFTER:g} s after each "
            "of them, are ignored"
        )
        for first, last in runs(~out):
            if last - first >= LEAST:
                channels = tuple(replace(each, values=each.values[first:last]) for each in one.channels)
                channels = tuple(each for each in channels if each.counted.any())
                experiments.append(
                    replace(
                        one, name=f"{one.name}, {rough(one.start + one.step * first)} s", road=one.road[first:last],
                        forces=one.forces[first:last], channels=channels, from_rest=one.from_rest and first == 0,
                        start=one.start + one.step * first,
                    )
                )  # fmt: skip
    if not experiments:
        raise InputError(
            "a wheel is in the air nearly all the time, so the log contains little about the vehicle; drive more "
            "slowly, or on a smoother road"
        )
    return replace(problem, experiments=tuple(experiments)), remarks


def _mirror(
    of: Estimate, nearby: Callable[[IdentificationProblem, Sequence[str], float], dict[str, float] | None]
) -> dict[str, float]:
    """Returns a second solution for a quarter-car that fits equally well, in which suspension and tyre are exchanged.

    Let k_s and c_s be the stiffness and damping of the suspension, k_t and c_t those of the tyre, and m = m_s / (m_s + m_u).
    If the tyre is damped, the body's motion alone cannot distinguish suspension and tyre from a suspension with k_t m, c_t m
    and a tyre with k_s / m, c_s / m.
    """
    names = ("suspension_stiffness", "suspension_damping", "tyre_stiffness", "tyre_damping")
    if any(name not in of.free for name in names) or "sprung_mass" not in of.problem.vehicle.parameters:
        return {}
    values = {**of.problem.vehicle.parameters, **of.values}
    share = values["sprung_mass"] / (values["sprung_mass"] + values["unsprung_mass"])
    k_s, c_s, k_t, c_t = (values[name] for name in names)
    other = dict(zip(names, (k_t * share, c_t * share, k_s / share, c_s / share), strict=True))
    again = nearby(replace(of.problem, first={**of.values, **other}), of.free, of.deviance + CHI2)
    if again is None or not any(abs(np.log(again[name] / of.values[name])) > ANOTHER for name in names if of.values[name]):
        return {}
    return again


def _held_out(of: Estimate, log: LogStretches) -> list[tuple[Experiment, dict[str, float]]]:
    """Returns the fit of each signal in each stretch of a log that was not used for the estimate. For each stretch, only the
    starting state and the offsets are estimated.
    """
    residuals = Residuals(replace(of.problem, first=of.values, experiments=log.experiments, known=()), ())
    return list(zip(log.experiments, residuals.fits(first_unknowns(residuals)), strict=True))
