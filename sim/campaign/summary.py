"""Results of a campaign, controllers against roads, with the linear prediction; and ride against road holding, drawn.

With adjustable dampers a line shows what no damper that stays as it is can leave: all constant ones between their limits, as
they are expected to do over the same roads. What lies below it on the left is worth its control.
"""

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.printed import WIDTH, cell, percent, table, wrapped
from models.figures.figure import OTHERS, Curve, Figure, Panel, styles
from models.laws.python_law import Programmed, PythonLaw
from models.roads.spectrum import Spectrum
from models.vehicle.names import PASSIVE
from models.vehicle.vehicle import Vehicle
from sim.campaign.batch import FAILED
from sim.campaign.columns import EXPECTED, LINEAR
from sim.campaign.plan import Candidate, Plan
from sim.campaign.store import Store
from sim.studies.ride.expected import expect
from sim.studies.ride.metrics import dynamic_load, points
from sim.studies.ride.standing import MEASURES, Standing, columns_of, standing_lines, standing_over_runs, standings_object
from synth.controller.controller import Controller
from synth.controller.law_margins import unstable_by_itself
from synth.vehicle.designer import Designer

INPUTS = ("vehicle", "controller", "road", "speed")


def headlines(plan: Plan, vehicle: str) -> dict[str, tuple[str, ...]]:
    """The metrics of the table, each the worst of some columns: ride, travel, and dynamic load."""
    where = points(plan.campaign.vehicles[vehicle])
    return {
        "ride": tuple(f"{name}_weighted" for name in where.accelerations),
        "travel": tuple(f"{name}_rms" for name in where.suspensions),
        "load": tuple(dynamic_load(name) for name in where.tyres),
    }


def compare(plan: Plan, store: Store) -> dict[str, dict[Candidate, Standing]]:
    """Returns the standings of all controllers and variants by vehicle, over all other inputs of its runs, passive first."""
    names = {name: columns_of(vehicle) for name, vehicle in plan.campaign.vehicles.items()}
    metrics = dict.fromkeys(metric for columns in names.values() for some in columns.values() for metric in some)
    table = store.read([*metrics])
    standings = {}
    for vehicle, columns in names.items():
        values = {metric: table[metric].to_numpy().astype(float) for some in columns.values() for metric in some}
        standings[vehicle] = {}
        for candidate, runs in sorted(plan.candidates(vehicle).items(), key=lambda item: item[0].controller != PASSIVE):
            here = {metric: each[runs] for metric, each in values.items()}
            one = standing_over_runs(plan.campaign.vehicles[vehicle], candidate.name, here)
            sound = not unstable_by_itself(plan.driver(plan.key(int(runs[0]))))
            standings[vehicle][candidate] = replace(one, sound=sound)
    return standings


Standings = Mapping[str, Mapping[Candidate, Standing]]  # by vehicle


def compared_object(standings: Standings) -> list[dict[str, Any]]:
    """Returns the standings by vehicle as in JSON."""
    return [{"vehicle": vehicle, **standings_object([*some.values()])} for vehicle, some in standings.items()]


def compared_lines(standings: Standings, chosen: Mapping[str, Candidate | None]) -> list[str]:
    """Returns a table of standings for each vehicle; of variants only those that have the least of something.

    Args:
        chosen: a candidate of each vehicle that its table contains in any case.
    """
    lines = []
    for vehicle, every in standings.items():
        shown = {chosen.get(vehicle)}
        for one in MEASURES:
            counted = {who: each for who, each in every.items() if not (one.effort and who.controller == PASSIVE)}
            numbers = {who: value for who, each in counted.items() if (value := each.values[one.key]) is not None}
            shown.add(min(numbers, key=numbers.__getitem__, default=None))
        there = {who.controller for who, each in every.items() if any(value is not None for value in each.values.values())}
        shown |= {who for who in every if who.variant == 0 and who.controller not in there}  # all have broken off
        some = [each for who, each in every.items() if who.variant is None or who in shown]
        absent = "; -: not all runs have metrics" if any(not any(each.values.values()) for each in some) else ""
        left = f"; {len(every) - len(some)} variants that are best at nothing are left out" if len(every) > len(some) else ""
        lines += ["", vehicle, *standing_lines(some, f"MuJoCo, all runs, their largest peaks{absent}{left}")]
    return lines


UNITS = {"ride": "m/s2", "travel": "m", "load": "-"}


def summarise(plan: Plan, store: Store) -> list[dict[str, Any]]:
    """Returns one entry per vehicle, road, speed and controller, over its variants, samples and seeds.

    Each headline is of the column that is worst, and has its root mean square and 95th percentile over runs, and the root mean
    square of what is predicted of the same runs: expected over random roads, the linear response over others. A run counts as
    having left the linear regime where a tyre lifted, a stop was reached, an actuator saturated, or it broke off, diverged or on
    a flat tyre; one that broke off has no metrics, and neither it nor its prediction counts. A law in Python has no
    prediction; a run whose law failed has no metrics, either. A drawn law has the root mean squares of each variant, too.
    """
    lines = {name: headlines(plan, name) for name in plan.campaign.vehicles}
    metrics = list(dict.fromkeys(name for kinds in lines.values() for names in kinds.values() for name in names))
    predicted = [f"{prefix}{name}" for name in metrics for prefix in (EXPECTED, LINEAR)]
    drawn = ["variant"] if any(plan.campaign.variants.values()) else []
    table = store.read([*INPUTS, *drawn, "ended_by", "reason", *metrics, *predicted])
    # Dictionary-encoded, so that rows are compared by number.
    codes = np.zeros(len(table), dtype=np.int64)
    values: list[list[Any]] = []
    for name in INPUTS:
        column = table[name].combine_chunks().dictionary_encode()
        values.append(column.dictionary.to_pylist())
        codes = codes * max(1, len(values[-1])) + column.indices.to_numpy(zero_copy_only=False)
    ended = ~table["ended_by"].is_null().to_numpy()
    reasons: list[str | None] = table["reason"].to_pylist()
    failed = np.array([reason is not None and reason.startswith(FAILED) for reason in reasons], dtype=bool)
    broken = ~table["reason"].is_null().to_numpy() & ~failed
    columns = {name: table[name].to_numpy() for name in (*metrics, *predicted)}
    order = {road.text: i for i, road in enumerate(plan.campaign.roads)}

    summaries = []
    by_code = np.argsort(codes, kind="stable")
    first = np.flatnonzero(np.diff(codes[by_code], prepend=-1))
    for some in np.split(by_code, first[1:]) if len(first) else []:
        where, rest = [], int(codes[some[0]])
        for names in reversed(values):
            rest, index = divmod(rest, max(1, len(names)))
            where.append(names[index])
        entry: dict[str, Any] = dict(zip(INPUTS, reversed(where), strict=True))
        entry |= {"runs": len(some), "left": int(ended[some].sum()), "broke_off": int(broken[some].sum())}
        entry["first_reason"] = next((reasons[i] for i in some[broken[some]].tolist()), None)
        if isinstance(law := plan.controllers[entry["vehicle"]][entry["controller"]], Programmed):
            why = [reason.removeprefix(FAILED) for i in some[failed[some]].tolist() if (reason := reasons[i])]
            entry |= {"law": law.law.law, "failed": len(why), "first_failure": why[0] if why else None}
        for line, names in lines[entry["vehicle"]].items():
            entry[line] = _statistics(columns, names, some)
        if variants := plan.campaign.variants[entry["vehicle"]].get(entry["controller"]):
            of_law = table["variant"].to_numpy()[some]
            rows = [some[of_law == i] for i in range(len(variants))]
            by_line = lines[entry["vehicle"]].items()
            entry["variants"] = [{line: _statistics(columns, names, own)["rms"] for line, names in by_line} for own in rows]
        summaries.append(entry)
    vehicles, controllers = list(plan.campaign.vehicles), plan.campaign.controllers
    summaries.sort(key=lambda e: (vehicles.index(e["vehicle"]), order[e["road"]], e["speed"], controllers.index(e["controller"])))
    return summaries


def _statistics(columns: Mapping[str, Array], names: Sequence[str], some: Array) -> dict[str, Any]:
    """Returns root mean square, 95th percentile and prediction of the worst of some columns, over the runs that have metrics.

    A kind of vehicle may have no such column, as one without a suspension has no travel.
    """
    there = some[np.all([np.isfinite(columns[name][some]) for name in names], axis=0)] if names else some[:0]
    if not len(there):
        return {"column": None, "rms": None, "standard_error": None, "p95": None, "predicted": None}
    rms = {name: _rms(columns[name][there]) for name in names}
    worst = max(names, key=lambda name: rms[name])
    # A run over a random road has an expectation, one over another road its own linear response.
    predicted = [columns[f"{prefix}{worst}"][there] for prefix in (EXPECTED, LINEAR)]
    known = next((values for values in predicted if np.isfinite(values).all()), None)
    return {
        "column": worst,
        "rms": rms[worst],
        "standard_error": _standard_error(columns[worst][there]),
        "p95": float(np.percentile(columns[worst][there], 95)),
        "predicted": None if known is None else _rms(known),
    }


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _standard_error(values: Array) -> float | None:
    """Returns the standard error of a root mean square over runs, from the spread of their squares; None of a single run."""
    rms = _rms(values)
    return float(np.std(values**2, ddof=1) / np.sqrt(len(values)) / (2 * rms)) if len(values) > 1 and rms else None


def summary_lines(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """The table."""
    lines: list[str] = []
    places = itertools.groupby(entries, lambda entry: (entry["vehicle"], entry["road"], entry["speed"]))
    for (vehicle, road, speed), here in places:
        every = list(here)
        counted = {"runs": "runs", "left": "left linear"}
        counted |= {"broke_off": "broke off"} if any(entry["broke_off"] for entry in every) else {}
        counted |= {"failed": "failed"} if any(entry.get("failed") for entry in every) else {}
        rows: list[tuple[str, ...] | str] = [("", "rms", "95 %", "predicted", *counted.values())]
        for name, unit in UNITS.items():
            rows.append(f"{name} [{unit}]")
            for entry in every:
                numbers = (cell(entry[name][key], ".4g") for key in ("rms", "p95", "predicted"))
                rows.append((f"  {entry['controller']}", *numbers, *(str(entry.get(key, 0)) for key in counted)))
        lines += ["", f"{vehicle} over {road} at {speed:g} m/s", *table(rows), *_broken_lines(every), *_law_lines(every)]
    return lines


FEW = 3  # controllers whose runs are counted one by one
SEEN = 6  # roads and speeds that a short table has


def short_lines(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """Returns the ride by road where there are few, what left the linear regime, and how far the ride is from its prediction."""
    lines, groups = [""], [list(some) for _, some in itertools.groupby(entries, lambda entry: entry["vehicle"])]
    if len(groups) == 1:
        lines += _ride_table(entries)
    for some in groups:
        of = f"{some[0]['vehicle']}: " if len(groups) > 1 else ""
        whole = [_all_roads([entry for entry in some if entry["controller"] == name]) for name in _controllers(some)]
        left = [f"{one['left']} of {one['runs']} of {one['controller']}" for one in sorted(whole, key=_share_left) if one["left"]]
        told = f"{left[0]} to {left[-1]}" if len(left) > FEW and len(left) == len(whole) else ", ".join(left) or "none"
        lines += wrapped(f"{of}runs that left the linear regime: {told}", "  ", 4)
        kept = [entry["ride"] for entry in some if not entry["left"] and entry["ride"]["predicted"]]
        if kept and left:
            of += "where none has, "
        if kept:
            off = max(abs(ride["rms"] / ride["predicted"] - 1) for ride in kept)
            said = f"{of}the ride is within {percent(off)} of its prediction, over random roads a mean"
            lines += wrapped(said, "  ", 4)
        lines += [*_broken_lines(whole), *_law_lines(whole)]
    return [*lines, "  -v: rms, 95 %, prediction of ride, travel and load, by road and speed"]


def _share_left(one: Mapping[str, Any]) -> float:
    return one["left"] / one["runs"]


def _controllers(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(entry["controller"] for entry in entries))


def _ride_table(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """Returns the ride of every controller on every road of a vehicle; empty for a single road, or what does not fit."""
    by_place: dict[str, dict[str, str]] = {}
    for entry in entries:
        place = by_place.setdefault(f"{entry['road']} at {entry['speed']:g} m/s", {})
        place[entry["controller"]] = cell(entry["ride"]["rms"], ".3g")
    names = _controllers(entries)
    rows = [(place, *(here.get(name, "-") for name in names)) for place, here in by_place.items()]
    lines = table([("ride, rms [m/s2]", *names), *rows])
    return lines if 1 < len(rows) <= SEEN and len(lines) == len(rows) + 1 and max(map(len, lines)) <= WIDTH else []


def _all_roads(entries: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Returns the counts of a controller's entries, summed, with the first reasons."""
    whole: dict[str, Any] = dict(entries[0])
    for key in ("runs", "left", "broke_off", *(["failed"] if "failed" in whole else [])):
        whole[key] = sum(entry[key] for entry in entries)
    for key in ("first_reason", "first_failure"):
        whole[key] = next((entry[key] for entry in entries if entry.get(key)), None)
    return whole


def _broken_lines(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """Returns a sentence on each controller of which runs broke off."""
    return [
        f"  {entry['controller']}: {entry['broke_off']} of {entry['runs']} runs broke off, the first: {entry['first_reason']}"
        for entry in entries
        if entry["broke_off"]
    ]


def _law_lines(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """Returns a sentence on each law in Python or FMU."""
    lines = []
    for entry in entries:
        if "law" in entry:
            what = PythonLaw(entry["law"]).with_article
            said = f"{entry['controller']} is {what}, {entry['law']}: no linear claim, so nothing is predicted of it"
            if entry["failed"]:
                said += f"; {entry['failed']} of {entry['runs']} runs failed, the first: {entry['first_failure']}"
            lines.append(f"  {said}")
    return lines


CONSTANT = 25  # dampers on the line
SOFTEST = 0.02  # of c_max, where c_min is less: next to no damper at all is none that anybody fits
ACROSS, UP = "load", "ride"
ACROSS_LABEL, UP_LABEL = "dynamic tyre load, rms [of the static load]", "weighted acceleration, rms [m/s²]"


def trade_off(plan: Plan, entries: Sequence[Mapping[str, Any]]) -> Figure | None:
    """A panel for every road and speed, a point for every vehicle, controller and variant: their root mean squares in MuJoCo.

    Args:
        entries: results of the campaign, see `summarise`.

    Returns:
        None if no run has both metrics.
    """
    campaign, several = plan.campaign, len(plan.campaign.vehicles) > 1
    own = {vehicle: f", {vehicle}" if several else "" for vehicle in campaign.vehicles}
    looks = styles(tuple(f"{controller}{end}" for end in own.values() for controller in campaign.controllers))
    panels, crossed = [], False
    for road, speed in dict.fromkeys((entry["road"], entry["speed"]) for entry in entries):
        curves, measured = [], False
        for i, (name, vehicle) in enumerate(campaign.vehicles.items()):
            place = RoadAndSpeed(plan, name, vehicle, road, speed)
            line = place.constant_dampers()
            if len(line):
                color = OTHERS[-1 - i % len(OTHERS)]
                curves.append(Curve(line[:, 0], line[:, 1], f"constant dampers, expected{own[name]}", color, width=2.2))
            for controller, (x, y) in place.fully_active().items():
                label = f"{controller}, fully active, expected{own[name]}"
                color = looks[f"{controller}{own[name]}"].color
                curves.append(Curve(np.array([x]), np.array([y]), label, color, "none", "x"))
        for entry in entries:
            ones = entry.get("variants") or [{line: entry[line]["rms"] for line in (ACROSS, UP)}]
            there = [(one[ACROSS], one[UP]) for one in ones if one[ACROSS] is not None and one[UP] is not None]
            if (entry["road"], entry["speed"]) == (road, speed) and there:
                label = f"{entry['controller']}{own[entry['vehicle']]}"
                x, y = np.array(there).T
                curves.append(Curve(x, y, label, looks[label].color, "none", looks[label].marker))
                if "variants" not in entry:
                    curves += _error_bars(entry, looks[label].color)
                measured = True
        crossed = crossed or any(curve.marker == "x" for curve in curves)
        if measured:
            title = f"{road} at {speed:g} m/s"
            panels.append(Panel(title, ACROSS_LABEL, UP_LABEL, tuple(curves)))
    if not panels:
        return None
    drawn = {curve.label for panel in panels for curve in panel.curves}
    absent = [label for label in looks if label not in drawn]
    said = {vehicle: _finding(panels, end) for vehicle, end in own.items()}
    finding = "; ".join(f"{vehicle}: {words}" if several else words for vehicle, words in said.items() if words)
    title = (
        "Ride against road holding: down is more comfortable, left holds the road better. Points: MuJoCo, root mean squares over "
        "runs, of the worst point of the vehicle, with two standard errors."
        + (" Crosses: with force actuators instead of semi-active dampers." if crossed else "")
        + (f" Not drawn, as no run has both numbers: {'; '.join(absent)}." if absent else "")
    )
    return Figure("trade_off", title, tuple(panels), min(2, len(panels)), (6.4, 4.8), finding=finding)


def _error_bars(entry: Mapping[str, Any], color: str) -> list[Curve]:
    """Returns the bars of two standard errors through a controller's point, as one curve; none of a single run."""
    x, y = entry[ACROSS]["rms"], entry[UP]["rms"]
    across, up = entry[ACROSS].get("standard_error"), entry[UP].get("standard_error")
    if across is None or up is None:
        return []
    ends = np.array([[x - 2 * across, y], [x + 2 * across, y], [np.nan, np.nan], [x, y - 2 * up], [x, y + 2 * up]])
    return [Curve(ends[:, 0], ends[:, 1], "", color, width=1.0, name=f"{entry['controller']}, two standard errors")]


def _finding(panels: Sequence[Panel], end: str) -> str:
    """Returns who rides best and who holds the road best, in how many panels; an empty text without a choice.

    Args:
        end: ending of the labels of one vehicle, which is omitted.
    """
    best = [one for panel in panels if (one := _best(panel, end))]
    if not best:
        return ""
    soft, firm = (Counter(names).most_common() for names in zip(*best, strict=True))
    if len(soft) == len(firm) == 1:
        (rides, _), (holds, _) = soft[0], firm[0]
        return f"{rides} rides best{f', {holds} holds' if holds != rides else ' and holds'} the road best"
    words = (", ".join(f"{name} in {count} of {len(best)}" for name, count in some) for some in (soft, firm))
    return "rides best: {}; holds the road best: {}".format(*words)


def _best(panel: Panel, end: str) -> tuple[str, str] | None:
    """Returns who rides best and who holds the road best in a panel; None with less than two controllers."""
    points = [one for one in panel.curves if one.dash == "none" and one.marker != "x" and len(one.x) and one.label.endswith(end)]
    if len(points) < 2:
        return None
    soft, firm = min(points, key=lambda one: one.y.min()), min(points, key=lambda one: one.x.min())
    return soft.label.removesuffix(end), firm.label.removesuffix(end)


@dataclass(frozen=True, eq=False)
class RoadAndSpeed:
    """A vehicle of a campaign on one of its roads at one of its speeds, and what is expected there.

    Nothing is expected over a road that is not random, of a vehicle whose parameters are sampled, and without adjustable dampers.

    Attributes:
        plan: plan of the campaign.
        name: name of the vehicle in the campaign.
        vehicle: itself.
        road, speed: conditions of the runs.
    """

    plan: Plan
    name: str
    vehicle: Vehicle
    road: str
    speed: float

    @cached_property
    def spectrum(self) -> Spectrum | None:
        """Returns the spectrum of the road, or None if no expectation exists."""
        campaign = self.plan.campaign
        choice = next(one for one in campaign.roads if one.text == self.road)
        if not choice.random or not self.vehicle.adjustable or any(campaign.samples[self.name]):
            return None
        return choice.build(self.vehicle, self.speed, campaign.seeds[0], self.speed * campaign.duration).spectrum

    def expected(self, vehicle: Vehicle, controller: Controller) -> list[float] | None:
        """Dynamic load and ride; None of a loop that is not stable."""
        campaign, lines = self.plan.campaign, headlines(self.plan, self.name)
        if self.spectrum is None:
            return None
        prediction = expect(vehicle, controller, self.spectrum, campaign.timestep, campaign.duration - campaign.settle)
        return None if prediction is None else [max(prediction.mean[column] for column in lines[line]) for line in (ACROSS, UP)]

    def constant_dampers(self) -> Array:
        """Dynamic load and ride of adjustable dampers that stay as they are, softest first, shape (k, 2)."""
        if self.spectrum is None:
            return np.zeros((0, 2))
        vehicle, points = self.vehicle, []
        adjustable = {one.force: one.damper for one in vehicle.adjustable}
        dampers = {one.damping: adjustable[one.force] for one in vehicle.kind.suspensions if one.force in adjustable}
        passive = Designer(vehicle).design("passive")
        for share in np.linspace(0.0, 1.0, CONSTANT):
            fixed = {}
            for parameter, damper in dampers.items():
                softest = max(damper.c_min, SOFTEST * damper.c_max)
                fixed[parameter] = float(softest * (damper.c_max / softest) ** share)
            still = replace(vehicle, parameters={**vehicle.parameters, **fixed}).with_ideal_actuators
            points.append(self.expected(still, passive))
        return np.array([one for one in points if one is not None]).reshape(-1, 2)

    def fully_active(self) -> dict[str, list[float]]:
        """Dynamic load and ride of every linear law that is not drawn, by name, were every force given that it asks for."""
        points = {}
        for name, controller in self.plan.controllers[self.name].items():
            drawn = name in self.plan.campaign.variants[self.name]
            if isinstance(controller, Controller) and controller.law.acts and not drawn:
                there = self.expected(self.vehicle.with_ideal_actuators, controller)
                points |= {name: there} if there is not None else {}
        return points
