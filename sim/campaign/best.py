"""The best controller of a campaign by one metric, within limits on others; and the vehicle file that has it.

Candidates are all controllers, and every variant of those whose laws are drawn. All have been driven over the same roads.
"""

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, listing, quoted
from models.common.files import whole_file
from models.common.printed import pasted, percent
from models.common.toml_edit import section_lines
from models.figures.outputs import CAMPAIGN_SUM
from models.vehicle.in_place import with_sections
from models.vehicle.names import check_name
from models.vehicle.vehicle import Vehicle, parse_vehicle
from sim.campaign.file import Campaign
from sim.campaign.law_keys import record_of
from sim.campaign.plan import Candidate, Plan
from sim.campaign.store import Store
from sim.campaign.summary import Standings
from sim.studies.ride.metrics import Metric, metrics_of
from sim.studies.ride.standing import KEYS, MEASURES, Standing, columns_of, digits

SUFFIX = "_tuned"
GIVE = "give METRIC:LIMIT, as in peak_travel:0.08, in SI units"
LARGEST_OF = ("peak", "mtvv", "vdv", "crest", "dive", "squat")  # what is largest over the runs; shares and work are means
MEAN_OF = ("at_stops", "off_ground", "power", "energy")  # all else are root mean squares
SIGNED = ("at_end",)
SIGNED_LIMITS = ("power", "energy", "dive", "squat")
UNITS = {"ride": "m/s2", "peak_travel": "m", "force_rms": "N", "force_peak": "N"}  # of `KEYS`; shares have none
NEAREST = 3  # candidates next to the best that are named


@dataclass(frozen=True)
class Request:
    """The metric of `--best` and the limits of `--subject-to`.

    Attributes:
        metric: metric that is minimised.
        limits: the most that other metrics may be, in SI units.
        units: units of the limits; empty for numbers without one.
    """

    metric: str
    limits: Mapping[str, float]
    units: Mapping[str, str]

    @property
    def metrics(self) -> tuple[str, ...]:
        """All metrics that are requested."""
        return tuple(dict.fromkeys((self.metric, *self.limits)))

    @property
    def words(self) -> str:
        """The limits in words, after the metric; empty without them."""
        return " and ".join(f"{name} <= {limit:g} {self.units[name]}".rstrip() for name, limit in self.limits.items())


@dataclass(frozen=True)
class Choice:
    """The best of a vehicle's controllers, or the one nearest to the limits.

    Attributes:
        vehicle: name of the vehicle in the campaign.
        request: request of the user.
        candidate: the controller; None if none has numbers.
        values: keys of the law that were drawn.
        numbers: values of the requested metrics.
        within: number of candidates within the limits; 0 if the candidate is only the nearest.
        count: number of candidates.
        near: relative distances of the candidates that the table's digits do not tell from the best, by name.
    """

    vehicle: str
    request: Request
    candidate: Candidate | None
    values: Mapping[str, float]
    numbers: Mapping[str, float]
    within: int
    count: int
    near: Mapping[str, float] = field(default_factory=dict)

    @property
    def misses(self) -> dict[str, float]:
        """By how much the limits are missed, in SI units."""
        limits = self.request.limits.items() if self.candidate is not None else ()
        return {name: self.numbers[name] - limit for name, limit in limits if self.numbers[name] > limit}

    @property
    def record(self) -> dict[str, Any]:
        """The choice as in JSON: the controller, or the nearest one if none is within the limits."""
        candidate, request = self.candidate, self.request
        about = {"vehicle": self.vehicle, "metric": request.metric, "limits": dict(request.limits)}
        about |= {"within": self.within, "of": self.count, "best": None, "nearest": None}
        if candidate is None:
            return about
        controller = {"controller": candidate.controller, "variant": candidate.variant}
        described = {**controller, "values": dict(self.values), "numbers": dict(self.numbers)}
        return {**about, "best": described} if self.within else {**about, "nearest": {**described, "misses": self.misses}}

    @property
    def line(self) -> str:
        """The choice on one line."""
        request, candidate = self.request, self.candidate
        if candidate is None:
            absent = f"has {listing(request.metrics)} of all runs, as some broke off"
            return f"{self.vehicle}: none of {self.count} {absent}; nothing is best"
        keys = "".join(f", {key} {value:.6g}" for key, value in self.values.items())
        numbers = ", ".join(f"{name} {value:.4g}" for name, value in self.numbers.items())
        if self.within:
            limits = f" within {request.words}" if request.limits else ""
            count = f"; {self.within} of {self.count} are within" if request.limits else f"; of {self.count}"
            near = [f"{name} within {percent(share)}" for name, share in self.near.items()]
            others = f", and {len(near) - NEAREST} more" if len(near) > NEAREST else ""
            tied = f"; and {', '.join(near[:NEAREST])}{others}" if near else ""
            return f"{self.vehicle}: the best {request.metric}{limits} has {candidate.name}{keys}: {numbers}{count}{tied}"
        missed = " and ".join(self._missed(name, by) for name, by in self.misses.items())
        nearest = f"{candidate.name}{keys} is nearest, and misses {missed}"
        return f"{self.vehicle}: none of {self.count} is within {request.words}; {nearest}"

    def _missed(self, name: str, by: float) -> str:
        """A missed limit in words: by how much, in its unit and as its share."""
        limit = self.request.limits[name]
        far = f"{name} by {by:.3g} {self.request.units[name]}".rstrip()
        return f"{far} ({percent(by / abs(limit))})" if limit else far


def requested(campaign: Campaign, best: str | None, limits: Sequence[str], save: Path | None) -> Request | None:
    """Returns what the options ask for; None without `--best`.

    Raises:
        InputError: a metric is unknown or missing for a vehicle; a limit is not a number; options cannot be combined.
    """
    if best is None:
        for option, given in (("--subject-to", bool(limits)), ("--save", save is not None)):
            if given:
                raise InputError(f"{option} is for the choice of --best; give it with --best METRIC, or omit it")
        return None
    _check_metric("--best", best, campaign)
    read: dict[str, float] = {}
    for text in limits:
        metric, colon, number = text.rpartition(":")
        where = f"--subject-to {text}"
        if not colon:
            raise InputError(f"{where} has no limit; {GIVE}")
        _check_metric("--subject-to", metric, campaign)
        try:
            limit = float(number)
        except ValueError:
            limit = math.nan
        if not math.isfinite(limit):
            raise InputError(f"{where}: {quoted(number)} is not a finite number; {GIVE}")
        if limit < 0 and not _may_be_negative(metric, campaign):
            raise InputError(f"{where}: {metric} is never below 0; {GIVE}")
        if metric in read:
            raise InputError(f"{where}: {metric} has two limits; give the smaller one")
        read[metric] = limit
    if save is not None:
        _check_save(campaign, save)
    return Request(best, read, {name: _unit(name, campaign) for name in read})


def _may_be_negative(metric: str, campaign: Campaign) -> bool:
    """Returns True for a metric that is a power, an energy, or an angle against level ground."""
    known = [_by_name(vehicle, campaign.loaded).get(metric) for vehicle in campaign.vehicles.values()]
    return any(one is not None and one.what in SIGNED_LIMITS for one in known)


def _unit(metric: str, campaign: Campaign) -> str:
    """Returns the SI unit of a metric; empty for a number without one."""
    if metric in KEYS:
        return UNITS.get(metric, "")
    unit = next(_by_name(vehicle, campaign.loaded)[metric].unit for vehicle in campaign.vehicles.values())
    return "" if unit == "-" else unit


def _check_metric(option: str, name: str, campaign: Campaign) -> None:
    """Refuses a metric that a vehicle lacks."""
    known = {key for vehicle in campaign.vehicles.values() for key in _known(vehicle, campaign.loaded)} | {*KEYS}
    if name not in known:
        meant = [key for key in KEYS if name and name in key]
        unknown = f"{quoted(name)} is not a metric of this campaign{f', and {listing(meant)} is' if meant else ''}"
        raise InputError(
            f"{option} {unknown}; give {listing(KEYS)}, or a metric's column of its results, as sprung_acceleration_weighted"
        )
    for vehicle, one in campaign.vehicles.items():
        if name not in (there := _known(one, campaign.loaded)):
            raise InputError(f"{option} {name}: vehicle {vehicle!r} has no such metric; it has {listing(there)}")


def _known(vehicle: Vehicle, loaded: bool) -> list[str]:
    """Returns the names of all metrics of a vehicle: those of the table of standings, and columns of the results."""
    return [*(key for key, names in columns_of(vehicle).items() if names), *_by_name(vehicle, loaded)]


def _by_name(vehicle: Vehicle, loaded: bool) -> dict[str, Metric]:
    return {metric.name: metric for metric in metrics_of(vehicle, loaded) if metric.what not in SIGNED}


def _check_save(campaign: Campaign, path: Path) -> None:
    """Refuses to save a controller of several vehicles, under a name that is taken, or where the file could not be read."""
    if len(campaign.vehicles) > 1:
        raise InputError(f"--save writes one vehicle file, and the campaign has {len(campaign.vehicles)}; list one vehicle in it")
    ((name, vehicle),) = campaign.vehicles.items()
    for controller in campaign.variants[name]:
        check_name("--save:", controller + SUFFIX, ())
        if controller + SUFFIX in vehicle.controllers:
            raise InputError(f"--save: {name} has a controller {controller + SUFFIX!r} already; rename or remove that one")
    with_sections(vehicle.text_for(path), [])


def choose(plan: Plan, store: Store, request: Request, standings: Standings) -> list[Choice]:
    """Returns the choice of every vehicle.

    Args:
        standings: standings of all candidates, by vehicle.
    """
    return [_choice(plan, store, request, vehicle, some) for vehicle, some in standings.items()]


def _choice(plan: Plan, store: Store, request: Request, vehicle: str, standings: Mapping[Candidate, Standing]) -> Choice:
    candidates = plan.candidates(vehicle)
    own = _by_name(plan.campaign.vehicles[vehicle], plan.campaign.loaded)
    columns = [name for name in request.metrics if name not in KEYS]
    table = store.read(["run", *columns])
    values = {name: table[name].to_numpy().astype(float) for name in columns}
    numbers: dict[Candidate, dict[str, float]] = {}
    for candidate, runs in candidates.items():
        here = {name: _over_runs(own[name], values[name][runs]) for name in columns}
        chosen = {name: here.get(name, standings[candidate].values.get(name)) for name in request.metrics}
        if all(value is not None and math.isfinite(value) for value in chosen.values()):
            numbers[candidate] = {name: float(value) for name, value in chosen.items() if value is not None}
    within = [one for one, chosen in numbers.items() if all(chosen[name] <= limit for name, limit in request.limits.items())]
    best = min(within, key=lambda one: numbers[one][request.metric], default=None)
    if best is None:
        best = min(numbers, key=lambda one: _excess(numbers[one], request.limits), default=None)
    of_law = plan.campaign.variants[vehicle].get(best.controller, ()) if best is not None else ()
    drawn = of_law[best.variant] if best is not None and best.variant is not None else {}
    near = _near(request.metric, best, {one: numbers[one][request.metric] for one in within}) if best in within else {}
    return Choice(vehicle, request, best, drawn, numbers[best] if best is not None else {}, len(within), len(candidates), near)


def _near(metric: str, best: Candidate | None, values: Mapping[Candidate, float]) -> dict[str, float]:
    """Returns relative distances from the best, by name, of the candidates with the same digits in the table of standings."""
    if best is None or not values[best]:
        return {}
    scale, least = next((one.scale for one in MEASURES if one.key == metric), 1.0), values[best]
    same = [one for one in values if one != best and digits(scale * values[one]) == digits(scale * least)]
    return {one.name: values[one] / least - 1 for one in sorted(same, key=values.__getitem__)}


def _over_runs(metric: Metric, values: Array) -> float:
    """Returns a metric over all runs: the largest of peaks, the mean of shares and work, the root mean square of all else."""
    if metric.what in LARGEST_OF:
        return float(values.max())
    return float(values.mean()) if metric.what in MEAN_OF else float(np.sqrt(np.mean(values**2)))


def _excess(numbers: Mapping[str, float], limits: Mapping[str, float]) -> float:
    """Returns by which share the limits are missed, the worst of them; of a limit of 0 by how much."""
    return max(((numbers[name] - limit) / (abs(limit) or 1.0) for name, limit in limits.items()), default=0.0)


def save(path: Path, campaign: Campaign, choice: Choice, command: str, identity: str) -> str:
    """Writes the vehicle file with the chosen controller, whole or not at all; returns the controller's name in it.

    A variant becomes a section NAME_tuned; another controller keeps its section. A comment contains the origin.

    Args:
        command: command line that was called.
        identity: checksum of the campaign.

    Raises:
        InputError: the file cannot be written, or would not be read back with the same values.
    """
    candidate, vehicle = choice.candidate, campaign.vehicles[choice.vehicle]
    assert candidate is not None, "there is one"
    name = candidate.controller if candidate.variant is None else candidate.controller + SUFFIX
    request = choice.request
    within = f" within {request.words}" if request.limits else ""
    of_law = "" if candidate.variant is None else f", variant {candidate.variant} of {candidate.controller}"
    numbers = ", ".join(f"{metric} {value!r}" for metric, value in choice.numbers.items())
    drawn = "" if candidate.variant is None else f"; variants by seed {campaign.sample_seed} of [samples]"
    lines = [
        f"# {name}{of_law}: the best {request.metric}{within}, of {choice.count} and in SI units, by:",
        f"# {pasted(shlex.split(command))}",
        f"# {numbers}{drawn}; {len(campaign.seeds)} road seed(s), {min(campaign.seeds)} to {max(campaign.seeds)};",
        f"{CAMPAIGN_SUM}{identity}",
    ]
    if candidate.variant is not None:
        lines += section_lines(("controllers", name), record_of(vehicle, candidate.controller, choice.values))
    text = with_sections(vehicle.text_for(path), lines)
    parse_vehicle(text, folder=path.parent)  # what is written can be read
    with whole_file(path, "save") as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")
    return name
