"""Summary of a campaign: tables by controller and road with linear predictions, and a figure of ride against road holding.

For a vehicle with semi-active dampers, a line in the figure shows the expected results on the same roads with constant damping.
The line for constant dampers begins at the softest damper. A controller below and to the left of the line for constant dampers
is better than every constant damper.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.extensions import METRICS
from models.common.printed import as_name, percent, three_digits
from models.document.document import Block, Document, Table, notes
from models.document.field import Field
from models.document.figure import OTHERS, Curve, Figure, Panel, styles
from models.laws.python_law import PythonLaw
from models.vehicle.names import PASSIVE
from models.vehicle.vehicle import Vehicle
from sim.campaign.batch import FAILED_LAW
from sim.campaign.columns import EXPECTED, LINEAR
from sim.campaign.file import Campaign
from sim.campaign.plan import Candidate, Plan
from sim.campaign.store import Store
from sim.studies.ride.expected import expect
from sim.studies.ride.metrics import ROOT_MEAN_SQUARE, Metric, over_runs
from sim.studies.ride.score_table import headline, score_lines
from sim.studies.ride.scores import FIELDS, FORCES, Score, columns_of, score_over_runs
from synth.controller.controller import AnyController
from synth.controller.law_margins import law_fault
from synth.vehicle.designer import Designer

HEADLINES: tuple[type[Metric], ...] = tuple(one for one in METRICS.load_all().values() if one.headline and not one.effort)
LINES = {one.headline: f"{one.headline} [{one.unit.replace('s2', 's²')}]" for one in HEADLINES}


def headlines(vehicle: Vehicle) -> dict[str, tuple[Metric, ...]]:
    """Returns the metrics that the table shows, by name: ride, travel and dynamic load. If a metric has several columns, the
    table shows the column with the largest value.
    """
    headlines: dict[str, tuple[Metric, ...]] = {one.headline: tuple(map(one, one.compared(vehicle))) for one in HEADLINES}
    return headlines | {name: () for name in (ACROSS, UP) if name not in headlines}


def compare(plan: Plan, store: Store) -> dict[str, dict[Candidate, Score]]:
    """Returns the score of each candidate over all runs of this candidate, by vehicle. The scores of the passive vehicle come
    first.
    """
    scores: dict[str, dict[Candidate, Score]] = {}
    for name, vehicle in plan.campaign.vehicles.items():
        metrics = list(dict.fromkeys(metric for some in columns_of(vehicle).values() for metric in some))
        table = store.read(metrics)
        values = {metric: table[metric].to_numpy().astype(float) for metric in metrics}
        scores[name] = {}
        for candidate, runs in sorted(plan.candidates(name).items(), key=lambda item: item[0].controller != PASSIVE):
            one = score_over_runs(
                vehicle, candidate.name, {metric: each[runs] for metric, each in values.items()}, plan.distances[runs]
            )
            scores[name][candidate] = replace(one, fault=law_fault(vehicle, plan.driver(name, candidate)))
    return scores


Scores = Mapping[str, Mapping[Candidate, Score]]  # score of each candidate for each vehicle


def compared_lines(campaign: Campaign, scores: Scores, chosen: Mapping[str, Candidate | None]) -> list[str]:
    """Returns the printed lines of a table of scores for each vehicle. A variant of a control law appears in the table only if
    it is best in at least one column.

    Args:
        campaign: the campaign. Runs over random roads are measured after the `settle` time of the campaign.
        scores: scores over all runs, see `compare`.
        chosen: candidate that the table of a vehicle always contains, by vehicle; None if no candidate was selected.
    """
    lines, settles = [], any(road.stationary for road in campaign.roads)
    begins = f"; on random roads, metrics omit the first {campaign.settle:g} s (settle)" if settles else ""
    for vehicle, every in scores.items():
        shown = {chosen.get(vehicle)}
        for one in FIELDS:
            counted = {who: one.value(each) for who, each in every.items() if one not in FORCES or who.controller != PASSIVE}
            shown.add(min((who for who in counted if counted[who] is not None), key=counted.__getitem__, default=None))
        there = {who.controller for who, each in every.items() if any(value is not None for value in each.values.values())}
        # If runs were aborted for all variants of a law, the first variant is shown.
        shown |= {who for who in every if who.variant == 0 and who.controller not in there}
        some = [each for who, each in every.items() if who.variant is None or who in shown]
        absent = (
            "; -: some runs of this controller have no metrics" if any(not any(each.values.values()) for each in some) else ""
        )
        left = f"; {len(every) - len(some)} variants that are best in no column are omitted" if len(every) > len(some) else ""
        lines += [
            "",
            vehicle,
            *score_lines(some, f"MuJoCo over all runs, with the largest peak that each controller reached{begins}{absent}{left}"),
        ]
    return lines


def summarise(plan: Plan, store: Store) -> list[dict[str, Any]]:
    """Returns one entry per vehicle, road, speed and controller, over all variants, samples and seeds.

    For each metric of `headlines`, the entry contains the name of the worst column. The entry then contains the root mean
    square and the 95th percentile of the worst column over all runs. The entry also contains the root mean square of the
    metric's linear prediction for the same runs. The prediction is the expected value for random roads, and the linear response
    for other roads. There is no linear prediction for control laws written in Python.

    A run has left the linear regime if a tyre lifted off, an end stop was reached, an actuator saturated, or the run was
    aborted. Aborted runs have no metrics, so the root mean squares of the results and of the predictions do not include these
    runs. Runs in which the control law failed have no metrics either. For a control law with sampled parameters, the entry also
    contains the root mean squares of each variant.
    """
    lines = {name: headlines(vehicle) for name, vehicle in plan.campaign.vehicles.items()}
    metrics = list(dict.fromkeys(one.name for kinds in lines.values() for some in kinds.values() for one in some))
    names = [*metrics, *(f"{prefix}{name}" for name in metrics for prefix in (EXPECTED, LINEAR))]
    table = store.read(["ended_by", "reason", *names])
    columns = {name: table[name].to_numpy() for name in names}
    ended, reasons = ~table["ended_by"].is_null().to_numpy(), np.array(table["reason"].to_pylist(), dtype=object)

    summaries = []
    for block in plan.blocks:
        runs = slice(block.start, block.stop)
        why = [reason for reason in reasons[runs] if reason is not None]
        failures = [reason.removeprefix(FAILED_LAW) for reason in why if reason.startswith(FAILED_LAW)]
        broke = [reason for reason in why if not reason.startswith(FAILED_LAW)]
        entry: dict[str, Any] = {"vehicle": block.vehicle, "controller": block.controller, "road": block.road.text}
        entry |= {"speed": block.speed, "runs": block.stop - block.start, "left": int(ended[runs].sum())}
        entry |= {"broke_off": len(broke), "first_reason": next(iter(broke), None)}
        if (controller := plan.controllers[block.vehicle][block.controller]).user_code is True:
            entry |= {"law": controller.law.law, "failed": len(failures), "first_failure": next(iter(failures), None)}
        of_vehicle = lines[block.vehicle].items()
        every = np.arange(block.start, block.stop)
        entry |= {line: _statistics(columns, some, every, plan.distances) for line, some in of_vehicle}
        if block.variants:
            own = block.candidates.values()
            entry["variants"] = [
                {line: _statistics(columns, some, one, plan.distances)["rms"] for line, some in of_vehicle} for one in own
            ]
        summaries.append(entry)
    vehicles, controllers = list(plan.campaign.vehicles), plan.campaign.controllers
    roads = [road.text for road in plan.campaign.roads]
    return sorted(
        summaries,
        key=lambda e: (vehicles.index(e["vehicle"]), roads.index(e["road"]), e["speed"], controllers.index(e["controller"])),
    )


def _statistics(columns: Mapping[str, Array], metrics: Sequence[Metric], some: Array, distances: Array) -> dict[str, Any]:
    """Returns statistics of the worst metric: root mean square over all runs, its standard error, 95th percentile and linear
    prediction.

    Runs without metrics are ignored. All statistics are None if the vehicle type does not have the requested metrics. For
    example, a vehicle without a suspension has no travel.

    Args:
        columns: columns of the results by name, shape (count,) each.
        metrics: metrics among which the worst is selected.
        some: numbers of the runs to which the statistics refer, shape (n,).
        distances: distance that the vehicle drives in the measured part of each run [m], shape (count,).
    """
    there = some[np.all([np.isfinite(columns[one.name][some]) for one in metrics], axis=0)] if metrics else some[:0]
    if not len(there):
        return {"column": None, "rms": None, "standard_error": None, "p95": None, "predicted": None}
    over = {one: over_runs(one, columns[one.name][there], distances[there]) for one in metrics}
    worst = max(metrics, key=lambda one: over[one])
    # The predicted value is the expected value for a random road, and the value in the linear response for any other road.
    predicted = [columns[f"{prefix}{worst.name}"][there] for prefix in (EXPECTED, LINEAR)]
    known = next((values for values in predicted if np.isfinite(values).all()), None)
    return {
        "column": worst.name,
        "rms": over[worst],
        "standard_error": _standard_error(columns[worst.name][there]) if worst.over_runs is ROOT_MEAN_SQUARE else None,
        "p95": float(np.percentile(columns[worst.name][there], 95)),
        "predicted": None if known is None else over_runs(worst, known, distances[there]),
    }


def _standard_error(values: Array) -> float | None:
    """Returns the standard error of a root mean square over runs, computed from the variance of the squared values; None for a
    single run.
    """
    rms = float(np.sqrt(np.mean(values**2)))
    return float(np.std(values**2, ddof=1) / np.sqrt(len(values)) / (2 * rms)) if len(values) > 1 and rms else None


# text that names the road and the speed, and the ride of each controller over this road
Rides = tuple[str, Mapping[str, float | None]]
Line = tuple[str, Mapping[str, Any]]  # key of `LINES` that selects the metric, and the entry of `summarise`
STATISTICS = tuple(
    Field[Line](label, lambda row, key=key: row[1][row[0]][key], ".4g")
    for label, key in (("rms", "rms"), ("95 %", "p95"), ("predicted", "predicted"))
)
COUNTS = tuple(
    Field[Line](label, lambda row, key=key: row[1].get(key, 0), ".0f", key=key)
    for label, key in (("runs", "runs"), ("left linear", "left"), ("ended early", "broke_off"), ("failed", "failed"))
)
FEW = 3  # largest number of controllers for which a sentence always lists every controller's number of runs
SEEN = 6  # largest number of rows, and of columns, in the table of the ride


def describe(entries: Sequence[Mapping[str, Any]]) -> Document:
    """Returns the printed results: ride on each road (if the campaign has few roads), runs that left the linear regime, and
    details.

    The details, one table for each road and speed, are printed only with `-v`.

    Args:
        entries: results of the campaign, as `summarise` returns them.
    """
    vehicles = [(vehicle, [*some]) for vehicle, some in itertools.groupby(entries, lambda entry: entry["vehicle"])]
    blocks: list[Block] = [] if len(vehicles) > 1 else _ride_table(entries)
    for vehicle, some in vehicles:
        by_controller: dict[str, list[Mapping[str, Any]]] = {}
        for entry in some:
            by_controller.setdefault(entry["controller"], []).append(entry)
        whole = [_all_roads(own) for own in by_controller.values()]
        order = sorted(whole, key=lambda one: one["left"] / one["runs"])
        left = [f"{one['left']} of {one['runs']} with {as_name(one['controller'])}" for one in order if one["left"]]
        told = f"{left[0]} to {left[-1]}" if len(left) > FEW and len(left) == len(whole) else ", ".join(left) or "none"
        of = f"{vehicle}: " if len(vehicles) > 1 else ""
        said = [f"{of}Runs that left the linear regime: {told}."]
        kept = [entry["ride"] for entry in some if not entry["left"] and entry["ride"]["predicted"]]
        if kept:
            off = max(abs(ride["rms"] / ride["predicted"] - 1) for ride in kept)
            where = "On roads without such runs, the rms ride" if left else "The rms ride"
            said.append(f"{of}{where} is within {percent(off)} of its predicted value, which is a mean over random roads.")
        blocks += notes(*said, *_remarks(whole))
    places = itertools.groupby(entries, lambda entry: (entry["vehicle"], entry["road"], entry["speed"]))
    return Document("", (*blocks, *(_place(*place, [*here]) for place, here in places)))


def _place(vehicle: str, road: str, speed: float, entries: Sequence[Mapping[str, Any]]) -> Document:
    """Returns a table of all controllers on one road at one speed [m/s]."""
    title = f"{vehicle} over {road} at {speed:g} m/s"
    columns: tuple[Field[Line], ...] = (
        Field("metric", lambda row: LINES[row[0]]),
        Field("controller", lambda row: row[1]["controller"]),
        *STATISTICS,
        *(one for i, one in enumerate(COUNTS) if i < 2 or any(entry.get(one.key) for entry in entries)),
    )
    table = Table.of("place", title, columns, [(line, entry) for line in LINES for entry in entries], words=2)
    return Document(title, (table, *notes(*_remarks(entries))), "full")


def _ride_table(entries: Sequence[Mapping[str, Any]]) -> list[Block]:
    """Returns a table of the ride metric of a vehicle, with a row for each road and speed and a column for each controller.

    No table is returned for a single road, or if the table would have more than `SEEN` rows or columns.
    """
    by_place: dict[str, dict[str, float | None]] = {}
    for entry in entries:
        by_place.setdefault(f"{entry['road']} at {entry['speed']:g} m/s", {})[entry["controller"]] = entry["ride"]["rms"]
    names = dict.fromkeys(entry["controller"] for entry in entries)
    if not (1 < len(by_place) <= SEEN and len(names) <= SEEN):
        return []
    place = Field[Rides]("ride, rms [m/s²]", lambda row: row[0])
    columns = (place, *(Field[Rides](name, lambda row, name=name: row[1].get(name), three_digits) for name in names))
    return [Table.of("ride", "Ride on each road.", columns, by_place.items())]


def _all_roads(entries: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Adds up the counts of runs in a controller's entries for all roads.

    The result also contains the first reason for an aborted run, and the first error of a control law.
    """
    whole: dict[str, Any] = dict(entries[0])
    whole |= {one.key: sum(entry[one.key] for entry in entries) for one in COUNTS if one.key in whole}
    reasons = {key: [entry[key] for entry in entries if entry.get(key)] for key in ("first_reason", "first_failure")}
    return whole | {key: next(iter(some), None) for key, some in reasons.items()}


def _remarks(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """Returns sentences about controllers with aborted or failed runs, and about control laws in Python or in FMUs."""
    said = []
    for entry in entries:
        who = as_name(entry["controller"])
        if entry["broke_off"]:
            said.append(
                f"{who}: {entry['broke_off']} of {entry['runs']} runs ended early. First reason: {entry['first_reason']}."
            )
        if "law" in entry:
            what = f"{PythonLaw(entry['law']).with_article}, {entry['law']}"
            said.append(f"{who} is {what}. Linear analysis does not apply to this controller, so nothing is predicted.")
        if entry.get("failed"):
            said.append(f"{who}: {entry['failed']} of {entry['runs']} runs failed. The first error: {entry['first_failure']}.")
    return said


CONSTANT = 25  # number of constant dampers whose points form the line in the figure
# smallest damping coefficient of a constant damper, relative to c_max; a softer damper would not be used in practice
SOFTEST = 0.02
ACROSS, UP = "load", "ride"
ACROSS_LABEL, UP_LABEL = "dynamic tyre load, rms [of the static load]", "weighted acceleration, rms [m/s²]"


def trade_off(plan: Plan, entries: Sequence[Mapping[str, Any]], scores: Scores) -> Figure | None:
    """Returns a figure of ride against dynamic tyre load, both as root mean squares over the MuJoCo runs.

    The figure has a panel for each road and speed, and a point for each vehicle, controller and variant.

    Args:
        plan: runs of the campaign.
        entries: results of the campaign, see `summarise`.
        scores: scores over all runs, see `compare`.

    Returns:
        The figure; None if no run has a ride metric and a load metric.
    """
    campaign, several = plan.campaign, len(plan.campaign.vehicles) > 1
    own = {vehicle: f", {vehicle}" if several else "" for vehicle in campaign.vehicles}
    looks = styles(tuple(f"{controller}{end}" for end in own.values() for controller in campaign.controllers))
    panels = []
    for road, speed in dict.fromkeys((entry["road"], entry["speed"]) for entry in entries):
        expected, measured = list[Curve](), list[Curve]()
        for i, (name, end) in enumerate(own.items()):
            line, crosses = _expected_points(plan, name, road, speed)
            if len(line):
                color = OTHERS[-1 - i % len(OTHERS)]
                expected.append(Curve(line[:, 0], line[:, 1], f"constant dampers, expected{end}", color, width=2.2))
            for controller, point in crosses.items():
                label, color = f"{controller}, fully active, expected{end}", looks[f"{controller}{end}"].color
                x, y = np.array(point)[:, None]
                expected.append(Curve(x, y, label, color, "none", "x"))
        for entry in (one for one in entries if (one["road"], one["speed"]) == (road, speed)):
            if there := _points(entry):
                label = f"{entry['controller']}{own[entry['vehicle']]}"
                x, y = np.array(there).T
                measured.append(Curve(x, y, label, looks[label].color, "none", looks[label].marker))
                measured += _error_bars(entry, looks[label].color) if "variants" not in entry else []
        if measured:
            panels.append(Panel(f"{road} at {speed:g} m/s", ACROSS_LABEL, UP_LABEL, (*expected, *measured)))
    if not panels:
        return None
    drawn = {curve.label: curve for panel in panels for curve in panel.curves}
    absent = [label for label in looks if label not in drawn]
    said = [f"{vehicle}: " * several + headline([*each.values()]) for vehicle, each in scores.items()]
    crossed = any(curve.marker == "x" for curve in drawn.values())
    title = (
        "Ride against road holding. Lower points are more comfortable; points further left hold the road better. Points are root "
        "mean squares over the MuJoCo runs, at the worst point of the vehicle, with two standard errors."
        + (" Crosses show force actuators instead of semi-active dampers." if crossed else "")
        + (f" Controllers without both numbers are not drawn: {'; '.join(absent)}." if absent else "")
    )
    return Figure("trade_off", title, tuple(panels), min(2, len(panels)), finding="; ".join(said))


def _points(entry: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Returns the points (dynamic load, ride) of a controller or of its variants; a point is omitted if its load or its ride is
    unknown.
    """
    ones = entry.get("variants") or [{line: entry[line]["rms"] for line in (ACROSS, UP)}]
    return [(one[ACROSS], one[UP]) for one in ones if one[ACROSS] is not None and one[UP] is not None]


def _error_bars(entry: Mapping[str, Any], color: str) -> list[Curve]:
    """Returns error bars of two standard errors around a controller's point as one curve; empty if the controller has only one
    run.
    """
    x, y = entry[ACROSS]["rms"], entry[UP]["rms"]
    across, up = entry[ACROSS].get("standard_error"), entry[UP].get("standard_error")
    if across is None or up is None:
        return []
    ends = np.array([[x - 2 * across, y], [x + 2 * across, y], [np.nan, np.nan], [x, y - 2 * up], [x, y + 2 * up]])
    return [Curve(ends[:, 0], ends[:, 1], "", color, width=1.0, name=f"{entry['controller']}, two standard errors")]


def _expected_points(plan: Plan, name: str, road: str, speed: float) -> tuple[Array, dict[str, list[float]]]:
    """Returns points with the expected dynamic load and ride of a vehicle on one road at one speed.

    Both sets of points are empty if the road is not random, the campaign samples vehicle parameters, or the vehicle has no
    semi-active dampers.

    Args:
        plan: runs of the campaign.
        name: name of the vehicle.
        road: road in the syntax of `--road`.
        speed: speed of the vehicle [m/s].

    Returns:
        Points (dynamic load, ride) of the vehicle with constant damping, the softest damping first, shape (k, 2). Points
        (dynamic load, ride) of linear controllers by name, computed as if ideal actuators applied every requested force.
        A controller is omitted if the campaign samples parameters of its control law.
    """
    campaign, vehicle, lines = plan.campaign, plan.campaign.vehicles[name], headlines(plan.campaign.vehicles[name])
    choice = next(one for one in campaign.roads if one.text == road)
    own = bool(vehicle.dampers) and all(damper.replaces for damper in vehicle.dampers.values())
    if not choice.random or not own or any(campaign.samples[name]):
        return np.zeros((0, 2)), {}
    spectrum = choice.build(vehicle, speed, campaign.seeds[0], speed * campaign.duration).spectrum
    assert spectrum is not None, "the road is random"

    def expected(car: Vehicle, controller: AnyController) -> list[float] | None:
        found = expect(car.with_ideal_actuators, controller, spectrum, campaign.timestep, campaign.duration - campaign.settle)
        return None if found is None else [max(found.mean[metric.name] for metric in lines[line]) for line in (ACROSS, UP)]

    adjustable = {one.force: one.damper for one in vehicle.parts.adjustable}
    dampers = {one.damping: adjustable[one.force] for one in vehicle.kind.suspensions if one.force in adjustable}
    passive, line = Designer(vehicle).design(PASSIVE), []
    for share in np.linspace(0.0, 1.0, CONSTANT):
        softest = {parameter: max(damper.c_min, SOFTEST * damper.c_max) for parameter, damper in dampers.items()}
        fixed = {key: float(softest[key] * (damper.c_max / softest[key]) ** share) for key, damper in dampers.items()}
        line.append(expected(replace(vehicle, parameters={**vehicle.parameters, **fixed}), passive))
    crosses = {
        one: expected(vehicle, controller)
        for one, controller in plan.controllers[name].items()
        if controller.acts and one not in campaign.variants[name]
    }
    return np.array([one for one in line if one is not None]).reshape(-1, 2), {
        one: point for one, point in crosses.items() if point is not None
    }
