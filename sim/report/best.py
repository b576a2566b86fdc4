"""The first sentences of a report: which controller is best for what, by how much against passive, and what that costs."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from models.common.printed import as_name
from models.document.document import Table
from models.document.reading import Pivot
from models.roads.load_choice import choose_load
from models.roads.road import RoadInput
from models.vehicle.names import PASSIVE
from models.vehicle.vehicle import Vehicle
from sim.physics.simulate import simulate
from sim.report.loads import loaded_road
from sim.report.scope import LEAST, Scope, joined, names_text, percents
from sim.response.regime import BUMP_STOP, REGIME_ENDS, SATURATION, reached
from sim.runs.run import Run, sample_times
from sim.studies.ride.metrics import DEGREES, angles_of
from sim.studies.ride.standing import LOAD, MEASURES, RIDE, TRAVEL, Standing, best, digits
from synth.controller.controller import AnyController

BRAKE = "brake:g=0.5"
DIVE = "dive under 0.5 g [deg]"
BRAKED = 3.0  # s, in which a car has long begun to rest on its springs
NORM = "norm"
VERBS = {RIDE: "rides best", LOAD: "holds the road best", TRAVEL: "travels least", NORM: "has the least norm"}
MANY = 4  # names in a title


def dives(scope: Scope) -> dict[str, float]:
    """Returns the largest dive of every controller in MuJoCo under braking [deg]; empty for a vehicle that cannot pitch.

    A run that breaks off has none.
    """
    vehicle, controllers = scope.vehicle, [*scope.stable, *scope.laws]
    parts = angles_of(vehicle).get("pitch_angle")
    if parts is None or not controllers:
        return {}
    step = scope.map_timestep
    road = loaded_road((choose_load(BRAKE),))
    given = RoadInput(vehicle, road, sample_times(vehicle, BRAKED, step))
    physics = simulate(controllers, [given] * len(controllers), threads=0)
    found = {}
    for i, one in enumerate(controllers):
        response = physics.response.run(i)
        if math.isinf(physics.diverged[i]):
            pitch = np.sum([share * response[part] for part, share in parts.items()], axis=0) * DEGREES
            found[one.name] = max(float(pitch.max()), 0.0)
    return found


def headline(standings: Sequence[Standing]) -> str:
    """Returns in a line who is best at ride and at road holding."""
    marked = best(standings)
    rides, holds = marked[RIDE], marked[LOAD]
    if not rides and not holds:
        return "No controller can be told from another"
    if rides == holds:
        return (
            f"{_and(rides)} {'rides' if len(rides) == 1 else 'ride'} and {'holds' if len(rides) == 1 else 'hold'} the road best"
        )
    said = [f"{_and(rides)} {'rides' if len(rides) == 1 else 'ride'} best"] if rides else []
    said += [f"{_and(holds)} {'holds' if len(holds) == 1 else 'hold'} the road best"] if holds else []
    return ", ".join(said)


def lead(standings: Sequence[Standing], dive: Mapping[str, float], norms: Mapping[str, float], where: str) -> list[str]:
    """Returns a sentence for each controller that is best at something: by how much against passive, and what it costs.

    Args:
        dive: dive angle under braking, by controller [deg]; empty for a vehicle that cannot pitch.
        norms: H-infinity norms of the stable ideal loops.
        where: roads of the standings, in words.
    """
    rows = {one.controller: one for one in standings}
    passive = rows.get(PASSIVE)
    if passive is None or len(rows) < 2:
        return []
    merits: dict[str, dict[str, str]] = {}
    leaders = {**best(standings), NORM: _least(norms)}
    alone = {names[0] for key, names in leaders.items() if key in VERBS and len(names) == 1}
    for key, names in leaders.items():
        for name in names if key in VERBS else ():
            merits.setdefault(name, {})[key] = f"{VERBS[key]} ({_size(rows, norms, name, key)})"
    sentences = []
    for name, won in sorted(merits.items(), key=lambda one: (one[0] not in alone, list(VERBS).index(next(iter(one[1]))))):
        if name == PASSIVE:
            sentences.append(f"{as_name(PASSIVE)}, without any force, {joined(list(won.values()))}.")
            continue
        row = rows.get(name)
        costs = [text for key in (RIDE, TRAVEL, LOAD) if row and key not in won and (text := _cost(row, passive, key))]
        if row and (force := row.values["force_peak"]):
            costs.append(f"forces of up to {digits(force)} N")
        if name in dive:
            beside = f", {as_name(PASSIVE)} {dive[PASSIVE]:.2g}°" if PASSIVE in dive else ""
            costs.append(f"{dive[name]:.2g}° of dive under 0.5 g{beside}")
        sentences.append(f"{as_name(name)} {joined(list(won.values()))}; with {joined(costs)}.")
    return (
        [*sentences, f"Percentages are against {as_name(PASSIVE)}; ride, travel, load and force are of {where}."]
        if sentences
        else []
    )


def _least(norms: Mapping[str, float]) -> list[str]:
    """Returns the name with the least norm, in a list; empty without a choice."""
    return [min(norms, key=lambda name: norms[name])] if len(norms) > 1 else []


def _size(rows: Mapping[str, Standing], norms: Mapping[str, float], name: str, key: str) -> str:
    """Returns a number with its unit, and how far it is from passive's."""
    if key == NORM:
        share = _share(norms[name], norms.get(PASSIVE))
        return f"{norms[name]:.4g}{'' if share is None or name == PASSIVE else f', {_change(share)}'}"
    measure = next(one for one in MEASURES if one.key == key)
    unit = measure.heading.partition("[")[2].rstrip("]")
    value = rows[name].values[key]
    assert value is not None, "the best has a number"
    share = _share(value, rows[PASSIVE].values[key])
    size = f"{digits(value * measure.scale)}{'' if unit == '-' else f' {unit}'}"
    return f"{size}{'' if share is None or name == PASSIVE else f', {_change(share)}'}"


def _and(names: Sequence[str]) -> str:
    return names_text(names) if len(names) <= MANY else f"{len(names)} controllers"


def _share(value: float | None, passive: float | None) -> float | None:
    return value / passive - 1 if value is not None and passive else None


def _change(share: float) -> str:
    return "as" if abs(share) < LEAST else f"{percents(share)} % {'above' if share > 0 else 'below'}"


def _cost(one: Standing, passive: Standing, key: str) -> str:
    share = _share(one.values[key], passive.values[key])
    if share is None:
        return ""
    more = f"{percents(share)} % {'more' if share > 0 else 'less'}" if abs(share) >= LEAST else "the same"
    return {RIDE: f"{more} acceleration", TRAVEL: f"{more} travel", LOAD: f"{more} change of tyre load"}[key]


def titled(vehicle: Vehicle, stem: str, drivers: Sequence[AnyController]) -> str:
    """Returns the title of a page: vehicle file, kind, and controllers."""
    names = [one.name for one in drivers]
    kind = vehicle.kind.name.replace("_", " ")
    which = names_text(names) if len(names) <= MANY else f"{len(names)} controllers"
    return f"{stem}: {which} on a {kind}, from linear analysis to MuJoCo"


def requirements_table(scope: Scope, runs: Sequence[Run]) -> Table | None:
    """Returns the goals and limits of the vehicle file, and who keeps them; None without any.

    Goals are held against what is proved, limits against the run over the road.
    """
    rows = []
    for one in scope.controllers:
        for promise in one.specifications:
            if promise.at_most is not None:
                unit = f" {promise.unit}" if promise.unit else ""
                what = f"{promise.what.replace('_', ' ')}, at most {promise.at_most:.6g}{unit}"
                rows.append((what, one.name, f"{'✓' if promise.holds else '✗'} {promise.value:.4g}{unit}"))
    road = "road" if scope.own_road is not None else "bump"
    limits = {end: end.thresholds(scope.vehicle) for end in (BUMP_STOP, SATURATION)}
    for run in runs:
        ended = reached(scope.vehicle, run.physics)
        for end, thresholds in limits.items():
            if thresholds:
                when = float(ended[REGIME_ENDS.index(end)])
                kept = "✓ not reached" if math.isinf(when) else f"✗ at {when:.3g} s"
                rows.append((f"{end.name}, not over the {road}", run.controller.name, kept))
    if not rows:
        return None
    caption = "What the vehicle file asks for, and who keeps it (✓) or not (✗). Goals are held against what is proved of them."
    pivot = Pivot(("requirement",), "controller", ("result",))
    return Table("requirements", caption, ("requirement", "controller", "result"), tuple(rows), 2, pivot)
