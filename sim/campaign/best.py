"""Selects the best controller of a campaign by one metric, within limits on other metrics, and writes this controller to a
vehicle file.

All controllers of the campaign are candidates. If parameters of a control law are sampled, each variant is a candidate. All
candidates are simulated over the same roads.
"""

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from models.common.errors import InputError, list_names
from models.common.files import whole_file
from models.common.printed import as_name, percent, shell_line
from models.common.toml_edit import section_lines
from models.common.units import setting
from models.document.document import Statement
from models.document.field import Field
from models.document.outputs import CAMPAIGN_SUM
from models.vehicle.in_place import with_sections
from models.vehicle.names import check_name
from models.vehicle.vehicle import Vehicle, parse_vehicle
from sim.campaign.file import Campaign
from sim.campaign.law_keys import record_of
from sim.campaign.plan import Candidate, Plan
from sim.campaign.store import Store
from sim.studies.ride.metrics import Metric, compared_metrics, metrics_of, over_runs

SUFFIX = "_tuned"
GIVE = "give METRIC:LIMIT in SI units, for example peak_travel:0.08"
VALUE, MISS = Field[float]("value", float, ".4g"), Field[float]("miss", float, ".3g")
DRAWN_KEY = Field[float]("drawn key", float, ".6g")


@dataclass(frozen=True)
class Request:
    """The metric that `--best` minimises, and the limits on other metrics that `--subject-to` sets.

    Attributes:
        metric: name of the metric that is minimised.
        limits: upper limits on other metrics, by name of the metric, in SI units.
        units: units of the limits; empty for a limit without a unit.
    """

    metric: str
    limits: Mapping[str, float]
    units: Mapping[str, str]

    @property
    def words(self) -> str:
        """Text that lists the limits on metrics, such as "peak_travel <= 0.08 m"; empty if there are no limits."""
        return " and ".join(f"{name} <= {limit:g} {self.units[name]}".rstrip() for name, limit in self.limits.items())


@dataclass(frozen=True)
class Choice:
    """Result of the selection for one vehicle: the best candidate, or the candidate nearest to the limits.

    Attributes:
        vehicle: name of the vehicle in the campaign file.
        request: metric to minimise and limits on other metrics, as the user requested them.
        candidate: selected candidate; None if no candidate has values for all requested metrics.
        values: sampled values of the parameters of the selected candidate's control law, by key; empty if no parameters are
            sampled.
        numbers: values of the requested metrics for the selected candidate, by name of the metric, in SI units.
        within: number of candidates that satisfy all limits; if no candidate does, `candidate` is the candidate nearest to the
            limits.
        count: number of candidates that were compared.
    """

    vehicle: str
    request: Request
    candidate: Candidate | None
    values: Mapping[str, float]
    numbers: Mapping[str, float]
    within: int
    count: int

    @property
    def misses(self) -> dict[str, float]:
        """For each limit that the selected candidate exceeds: the metric's value minus the limit, by name of the metric, in SI
        units.
        """
        limits = self.request.limits.items() if self.candidate is not None else ()
        return {name: self.numbers[name] - limit for name, limit in limits if self.numbers[name] > limit}

    @property
    def record(self) -> dict[str, Any]:
        """The selected candidate and its metrics as a JSON object. The key `nearest` replaces the key `best` if no candidate
        satisfies all limits.
        """
        candidate, request = self.candidate, self.request
        about = {"vehicle": self.vehicle, "metric": request.metric, "limits": dict(request.limits)}
        about |= {"within": self.within, "of": self.count, "best": None, "nearest": None}
        if candidate is None:
            return about
        controller = {"controller": candidate.controller, "variant": candidate.variant}
        described = {**controller, "values": dict(self.values), "numbers": dict(self.numbers)}
        return {**about, "best": described} if self.within else {**about, "nearest": {**described, "misses": self.misses}}

    @property
    def statement(self) -> Statement:
        """A sentence for the printed output that states the selected candidate and its metrics."""
        request, candidate = self.request, self.candidate
        if candidate is None:
            absent = list_names([request.metric, *request.limits])
            return Statement(
                f"{self.vehicle}: each of the {self.count} candidates has runs that ended early, so no candidate has a {absent}.",
                "fails",
            )
        drawn = "".join(f", {key} {DRAWN_KEY.digits(value)}" for key, value in self.values.items())
        who = f"{self.vehicle}: {as_name(candidate.name)}{drawn and f'{drawn},'}"
        if self.within:
            numbers = ", ".join(f"{name} {VALUE.digits(value)}" for name, value in self.numbers.items())
            count = f"{self.within} of {self.count} satisfy the limits" if request.limits else f"{self.count} were compared"
            return Statement(f"{who} has the best {request.metric}{self.limits}: {numbers}. {count}.", "holds")
        missed = []
        for name, by in self.misses.items():
            share = f" ({percent(by / abs(request.limits[name]))})" if request.limits[name] else ""
            missed.append(f"{name} by {MISS.digits(by)} {request.units[name]}".rstrip() + share)
        text = (
            f"None of the {self.count} candidates satisfies {request.words}. {who} comes closest, but exceeds "
            f"{' and '.join(missed)}."
        )
        return Statement(text, "fails")

    @property
    def limits(self) -> str:
        """Text " within" followed by the limits of the request; empty if there are no limits."""
        return f" within {self.request.words}" if self.request.limits else ""


def requested_best(campaign: Campaign, best: str | None, limits: Sequence[str], save: Path | None) -> Request | None:
    """Returns the request that the options `--best` and `--subject-to` state; None without the option `--best`.

    Raises:
        InputError: a metric is unknown or missing for a vehicle, a limit is not a number, or options cannot be combined.
    """
    if best is None:
        for option, given in (("--subject-to", bool(limits)), ("--save", save is not None)):
            if given:
                raise InputError(f"{option} needs --best; add --best METRIC, or omit {option}")
        return None
    _check_metric("--best", best, campaign)
    read: dict[str, float] = {}
    units: dict[str, str] = {}
    for text in limits:
        metric, colon, number = text.rpartition(":")
        where = f"--subject-to {text}"
        if not colon:
            raise InputError(f"{where} states no limit; {GIVE}")
        _check_metric("--subject-to", metric, campaign)
        unit = next(_known_metrics(vehicle, campaign)[metric][0].unit.removeprefix("-") for vehicle in campaign.vehicles.values())
        if metric in read:
            raise InputError(f"{where}: {metric} already has a limit; give only the smaller limit")
        read[metric], units[metric] = setting(f"--subject-to {metric}", number, unit or "1"), unit
    if save is not None:
        _check_save(campaign, save)
    return Request(best, read, units)


def _check_metric(option: str, name: str, campaign: Campaign) -> None:
    """Raises InputError if a vehicle of the campaign does not have the requested metric."""
    for vehicle, one in campaign.vehicles.items():
        if name not in (there := _known_metrics(one, campaign)):
            raise InputError(f"{option} {name}: vehicle {vehicle!r} has no metric {name}; it has {list_names(there)}")


def _known_metrics(vehicle: Vehicle, campaign: Campaign) -> dict[str, tuple[Metric, ...]]:
    """Returns the metrics that a campaign computes for a vehicle, by name.

    A metric is either a single column of the results, or an entry of the registry `METRICS`, which may combine several columns.
    """
    compared = {name: metrics for name, metrics in compared_metrics(vehicle, campaign.loaded).items() if metrics}
    return {metric.name: (metric,) for metric in metrics_of(vehicle, campaign.loaded)} | compared


def _check_save(campaign: Campaign, path: Path) -> None:
    """Checks that the option `--save` can save a vehicle file with the selected controller.

    Raises:
        InputError: the campaign has several vehicles, the name for the saved controller exists already, or Roadproof could not
            read the saved file.
    """
    if len(campaign.vehicles) > 1:
        raise InputError(
            f"--save needs a campaign with one vehicle, but this campaign has {len(campaign.vehicles)}; omit --save, or "
            "list only one vehicle"
        )
    ((name, vehicle),) = campaign.vehicles.items()
    for controller in campaign.variants[name]:
        check_name("--save:", controller + SUFFIX, ())
        if controller + SUFFIX in vehicle.controllers:
            raise InputError(
                f"--save: {name} already has a controller {controller + SUFFIX!r}, which --save would add; rename or "
                "remove this controller"
            )
    with_sections(vehicle.text_for(path), [])


def choose(plan: Plan, store: Store, request: Request, vehicle: str) -> Choice:
    """Returns the best candidate of a vehicle, or the candidate nearest to the limits if all candidates exceed a limit."""
    candidates, known = plan.candidates(vehicle), _known_metrics(plan.campaign.vehicles[vehicle], plan.campaign)
    asked = {name: known[name] for name in (request.metric, *request.limits)}
    table = store.read(list(dict.fromkeys(metric.name for some in asked.values() for metric in some)))
    values = {name: table[name].to_numpy().astype(float) for name in table.column_names}
    numbers: dict[Candidate, dict[str, float]] = {}
    for candidate, runs in candidates.items():
        of_runs = plan.distances[runs]
        found = {
            name: float(np.max([over_runs(one, values[one.name][runs], of_runs) for one in some])) for name, some in asked.items()
        }
        if all(map(math.isfinite, found.values())):
            numbers[candidate] = found
    within = [one for one, found in numbers.items() if all(found[name] <= limit for name, limit in request.limits.items())]
    best = min(within, key=lambda one: numbers[one][request.metric], default=None)
    # no candidate is within all limits; the nearest one exceeds them least, relative to each limit (absolute if a limit is 0)
    if best is None:

        def excess(one: Candidate) -> float:
            return max((numbers[one][name] - limit) / (abs(limit) or 1.0) for name, limit in request.limits.items())

        best = min(numbers, key=excess, default=None)
    if best is None:
        return Choice(vehicle, request, None, {}, {}, 0, len(candidates))
    of_law = plan.campaign.variants[vehicle].get(best.controller, ())
    drawn = of_law[best.variant] if best.variant is not None else {}
    return Choice(vehicle, request, best, drawn, numbers[best], len(within), len(candidates))


def save(path: Path, campaign: Campaign, choice: Choice, command: str, identity: str) -> str:
    """Writes the vehicle file with the selected controller; returns the name of this controller in the written file.

    A controller with sampled parameters is written as a new section NAME_tuned. A controller without sampled parameters keeps
    its section in the vehicle file. A comment in the written file states the command, the metrics and the checksum of the
    campaign. If writing fails, no incomplete file remains.

    Args:
        path: path of the vehicle file to write.
        campaign: campaign from which the controller was chosen.
        choice: result of the selection, which must contain a candidate.
        command: command line with which the campaign was run.
        identity: checksum that identifies the campaign.

    Raises:
        InputError: the file cannot be written, or is not a valid vehicle file.
    """
    candidate, vehicle = choice.candidate, campaign.vehicles[choice.vehicle]
    assert candidate is not None, "there is one"
    name = candidate.controller if candidate.variant is None else candidate.controller + SUFFIX
    request = choice.request
    of_law = "" if candidate.variant is None else f", variant {candidate.variant} of {candidate.controller}"
    numbers = ", ".join(f"{metric} {value!r}" for metric, value in choice.numbers.items())
    drawn = "" if candidate.variant is None else f"; variants by seed {campaign.sample_seed} of [samples]"
    lines = [
        f"# {name}{of_law}: the best {request.metric}{choice.limits} of {choice.count} candidates, in SI units. Command:",
        f"# {shell_line(shlex.split(command))}",
        f"# {numbers}{drawn}; {len(campaign.seeds)} road seed(s), {min(campaign.seeds)} to {max(campaign.seeds)};",
        f"{CAMPAIGN_SUM}{identity}",
    ]
    if candidate.variant is not None:
        lines += section_lines(("controllers", name), record_of(vehicle, candidate.controller, choice.values))
    text = with_sections(vehicle.text_for(path), lines)
    parse_vehicle(text, folder=path.parent)  # checks that the written file can be read
    with whole_file(path, "save") as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")
    return name
