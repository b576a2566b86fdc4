"""The first sentences of a report: which controller is best for what, by how much against passive, and what that costs."""

import math
from collections.abc import Mapping, Sequence

from models.common.printed import as_name
from models.document.document import Statement, notes
from models.document.field import Field
from models.document.text import joined
from models.roads.load_choice import choose_load
from models.roads.road import RoadInput
from models.vehicle.names import PASSIVE
from models.vehicle.vehicle import Vehicle
from sim.physics.simulate import simulate
from sim.report.loads import loaded_road
from sim.report.scope import Scope, change
from sim.runs.run import sample_times
from sim.studies.ride.metrics import PITCH, angles_of, measure
from sim.studies.ride.standing import CHANGES, FORCE, LOAD, RIDE, TRAVEL, Standing, best, some_names
from synth.controller.controller import AnyController

BRAKE = "brake:g=0.5"
BRAKED = 3.0  # s, in which a car has long begun to rest on its springs
DIVE = Field[float | None]("dive under 0.5 g", lambda angle: angle, ".2g", unit="deg")
NORM = Field[float | None]("H-infinity norm", lambda norm: norm, ".4g")
VERBS = {RIDE.key: "rides best", LOAD.key: "holds the road best", TRAVEL.key: "travels least", "norm": "has the least norm"}


def dives(scope: Scope) -> dict[str, float]:
    """Returns the largest dive of every controller in MuJoCo under braking [deg]; empty for a vehicle that cannot pitch.

    A run that breaks off has none.
    """
    vehicle, controllers = scope.vehicle, [*scope.stable, *scope.laws]
    if PITCH not in angles_of(vehicle) or not controllers:
        return {}
    given = RoadInput(vehicle, loaded_road((choose_load(BRAKE),)), sample_times(vehicle, BRAKED, scope.map_timestep))
    physics = simulate(controllers, [given] * len(controllers), threads=0)
    whole = [i for i in range(len(controllers)) if math.isinf(physics.diverged[i])]
    return {controllers[i].name: measure(vehicle, physics.response.run(i), 0, loaded=True)[f"{PITCH}_dive"] for i in whole}


def lead(
    standings: Sequence[Standing], dive: Mapping[str, float], norms: Mapping[str, float], where: str
) -> tuple[Statement, ...]:
    """Returns a statement for each controller that is best at something: its size, the change from passive, and what it costs.

    Args:
        dive: dive angle under braking, by controller [deg]; empty for a vehicle that cannot pitch.
        norms: H-infinity norms of the stable ideal loops.
        where: roads of the standings, in words.
    """
    rows = {one.controller: one for one in standings}
    passive = rows.get(PASSIVE)
    if passive is None or len(rows) < 2:
        return ()

    def size(name: str, key: str) -> str:
        of = next((one for one in CHANGES if one.key == key), None)
        text, values = (NORM, norms) if of is None else (of, {who: of.value(one) for who, one in rows.items()})
        return ", ".join(filter(None, [text.text(values[name]), change(values[name], values.get(PASSIVE))]))

    leaders = {**best(standings), "norm": [min(norms, key=norms.__getitem__)] if len(norms) > 1 else []}
    alone = {names[0] for key, names in leaders.items() if key in VERBS and len(names) == 1}
    merits: dict[str, dict[str, str]] = {}
    for key, verb in VERBS.items():
        for name in leaders[key]:
            merits.setdefault(name, {})[key] = f"{verb} ({size(name, key)})"
    said = []
    for name, won in sorted(merits.items(), key=lambda one: one[0] not in alone):
        row, costs = rows.get(name, passive), []
        if row is not passive:
            changes = {what: change(one.value(row), one.value(passive)) for one, what in CHANGES.items() if one.key not in won}
            costs = [f"{what} {text}" for what, text in changes.items() if text]
            costs += [f"peak force {FORCE.text(force)}"] if (force := FORCE.value(row)) else []
            usual = f" ({as_name(PASSIVE)}: {DIVE.text(dive[PASSIVE])})" if PASSIVE in dive else ""
            costs += [f"dive {DIVE.text(dive[name])} under 0.5 g{usual}"] if name in dive else []
        merit = joined([*won.values(), *["needs no force"] * (name == PASSIVE)])
        said.append(f"{as_name(name)} {merit}{': ' if costs else ''}{', '.join(costs)}.")
    about = f"Percentages are changes from {as_name(PASSIVE)}; ride, travel, tyre load and force are of {where}."
    return notes(*said, *([about] if said else []))


def titled(vehicle: Vehicle, stem: str, drivers: Sequence[AnyController]) -> str:
    """Returns the title of a page: vehicle file, kind, and controllers."""
    kind = vehicle.kind.name.replace("_", " ")
    return f"{stem}: {some_names([one.name for one in drivers])} on a {kind}, from linear analysis to MuJoCo"
