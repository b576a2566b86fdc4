"""What a vehicle file can have, feature by feature, and rows of it in which every two features meet, with every command.

Rows are a covering array of strength 2 (Cohen, Dalal, Fredman and Patton 1997, The AETG System). A new line of `FEATURES`
adds its rows by itself.
"""

import itertools
import json
import random
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from models.common.errors import InputError
from models.vehicle.vehicle import parse_vehicle, read_vehicle

Row = Mapping[str, str]  # the level of every feature

CORNERS = {
    "quarter_car": [""],
    "half_car": ["_front", "_rear"],
    "half_car_roll": ["_left", "_right"],
    "full_car": ["_front_left", "_front_right", "_rear_left", "_rear_right"],
}
VELOCITIES = {
    "quarter_car": ["sprung_velocity"],
    "half_car": ["heave_velocity", "pitch_rate"],
    "half_car_roll": ["heave_velocity", "roll_rate"],
    "full_car": ["heave_velocity", "pitch_rate", "roll_rate"],
}
TABLE = "{ velocity = [-1.5, -0.15, 0, 0.15, 1.5], force = [-1350, -262, 0, 262, 1900] }"
SOFT = "{ velocity = [-1.5, -0.6, 0, 0.6, 1.5], force = [-700, -380, 0, 420, 800] }"
FIRM = "{ velocity = [-1.5, -0.6, 0, 0.6, 1.5], force = [-4000, -2400, 0, 2600, 4500] }"
SPRING = "{ deflection = [-0.06, 0, 0.06], force = [-1500, 0, 1200] }"

# By feature, by level: lines of TOML. A line with @c is there for every corner, one with @a for every axle. $gain and so on are
# matrices that fit the vehicle, see `_matrices`. The first level of a feature is the file without it.
FEATURES: dict[str, dict[str, str]] = {
    "type": dict.fromkeys(CORNERS, ""),
    "tyres": {"stiff": "", "damp": "[parameters]\ntyre_damping@a = 150.0"},
    "body": {
        "plain": "",
        "bars": "[parameters]\nanti_roll_stiffness_front = 2e4",
        "roll centres": "[parameters]\nroll_centre_height_front = 0.05\nroll_centre_height_rear = 0.1",
        "anti-dive": "[parameters]\nanti_dive_front = 0.3\nanti_squat_rear = 0.2",
        "tracks": "[parameters]\ntrack_front = 1.387\ntrack_rear = 1.364",
        "bar and roll centre": "[parameters]\nanti_roll_stiffness = 2e4\nroll_centre_height = 0.1",
        "pitch centre": "[parameters]\npitch_centre_height = 0.3",
    },
    "curves": {
        "straight": "",
        "damper": f"[curves]\nsuspension_damping@a = {TABLE}",
        "spring": f"[curves]\nsuspension_stiffness@a = {SPRING}",
        "both": f"[curves]\nsuspension_damping@a = {TABLE}\nsuspension_stiffness@a = {SPRING}",
        "friction": f"[curves]\nsuspension_damping@a = {TABLE[:-2]}, friction = 20.0, friction_velocity = 0.05 }}",
    },
    "stops": {
        "none": "",
        "both": "[limits]\nsuspension_stroke = 0.01\nstop_stiffness = 5e4",
        "bump": "[limits]\nsuspension_stroke = { bump = 0.01 }\nstop_stiffness = 5e4",
        "rebound": "[limits]\nsuspension_stroke = { rebound = 0.01 }\nstop_stiffness = 5e4",
        "progressive": "[limits]\nsuspension_stroke = { bump = 0.01, rebound = 0.02 }\nstop_stiffness = [1e4, 0, 4e8]",
        "rear": "[limits.rear]\nsuspension_stroke = 0.01\nstop_stiffness = 5e4",
    },
    "force": {
        "any": "",
        "limited": "[limits]\nactuator_force = 100.0",
        "command": '[limits]\nactuator_force = 100.0\nlimit = "command"',
    },
    "lag": {"none": "", "lags": "[limits]\nactuator_bandwidth = 60.0"},
    "actuators": {
        "push": "",
        "damp": '[actuators]\nkind = "damper"\nc_min = 200.0\nc_max = 4000.0',
        "valve": '[actuators]\nkind = "damper"\nc_min = 200.0\nc_max = 4000.0\nbandwidth = 100.0',
        "measured": f'[parameters]\nsuspension_damping@a = 1200.0\n[actuators]\nkind = "damper"\nc_min = {SOFT}\nc_max = {FIRM}',
        "rear": '[actuators.rear]\nkind = "damper"\nc_min = 200.0\nc_max = 4000.0',
    },
    "sampling": {
        "at once": "",
        "held": "[implementation]\nsample_period = 0.004",
        "late": "[implementation]\nsample_period = 0.004\ndelay = 1",
        "between": "[implementation]\nsample_period = 0.004\ndelay = 1.5",
        "late alone": "[implementation]\ndelay = 2",
    },
    "readings": {
        "exact": "",
        "noise": "[implementation.noise]\n$first = 1e-4",
        "quantised": "[implementation.quantisation]\n$first = 1e-4",
        "of others": "[implementation.noise]\nunsprung_velocity@c = 1e-3",
        "unnamed": "[implementation.noise]\nunsprung_acceleration@c = 1e-2",
    },
    "weights": {
        "numbers": "",
        "filter": '[performance]\n$ride = { filter = "iso2631_wk" }',
        "road": "[performance.road]\nnumerator = [1.0]\ndenominator = [0.005, 1.0]",
        "integral": "[performance]\nsuspension_deflection@c = { numerator = [0.1, 0.3], denominator = [1.0, 0.0] }",
        "sum": "[performance]\nheight = { weight = 0.5, sum = { $first = 1.0, $velocity = -0.1 } }",
    },
    "law": {
        "passive": "",
        "state": "",
        "steps": "[controllers.mine]\nmeasured = $measured",
        "gain": "[controllers.mine]\nmeasured = $measured\ngain = $gain",
        "states": "[controllers.mine]\nmeasured = $measured\nA = [[-2.0]]\nB = $B\nC = $C\nD = $gain",
        "discrete": "[controllers.mine]\nmeasured = $measured\nsample_period = 0.004\nA = [[0.9]]\nB = $B\nC = $C\nD = $gain",
        "accelerometer": "[controllers.mine]\nmeasured = $accelerations\nA = [[-2.0]]\nB = $Ba\nC = $C\nD = $small",
        "pid": "[controllers.mine]\nmeasured = $deflections\npid = { kp = -500.0, ki = -50.0, kd = -50.0, filter = 0.02 }",
        "full": '[controllers.mine]\nmeasured = $measured\norder = "full"',
        "order": "[controllers.mine]\nmeasured = $velocities\norder = 1",
        "pi": '[controllers.mine]\nmeasured = $deflections\nstructure = "pi"',
        "lqr": '[controllers.mine]\ndesign = "lqr"',
        "lqg": '[controllers.mine]\nmeasured = $measured\ndesign = "lqg"',
        "h2": '[controllers.mine]\nmeasured = $measured\ndesign = "h2"',
        "preview": '[controllers.mine]\ndesign = "preview"\npreview = 0.1',
        "python": '[controllers.mine]\nmeasured = $measured\nlaw = "law.py:step"',
        "skyhook": '[controllers.mine]\nsemi_active = "skyhook"',
        "linear skyhook": '[controllers.mine]\nsemi_active = "skyhook_linear"',
        "hybrid": '[controllers.mine]\nsemi_active = "hybrid"',
        "add": '[controllers.mine]\nsemi_active = "add"',
        "band": "[controllers.mine]\nmeasured = $measured\nminimise = { band = [4.0, 8.0] }",
        "bounds": "[controllers.mine]\nmeasured = $measured\nbounds = [{ gain = 1e5 }, { decay = 0.1 }]",
    },
    "demand": {
        "none": "",
        "noise": "[controllers.mine]\nnoise = true",
        "lag": "[controllers.mine]\nlag = true",
        "sampled": "[controllers.mine]\nsampled = true",
        "stable": "[controllers.mine]\nstable = true",
        "anti-windup": "[controllers.mine]\nanti_windup = 20.0",
        "loads": "[controllers.mine]\nloads = { heave_load = 1000.0 }",
        "tolerance": "[controllers.mine.tolerance]\n$first = 0.1",
        "weighted": "[controllers.mine.tolerance]\nforce = { weight = 0.05 }",
        "family": "[controllers.mine]\nfamily = [{ sprung_mass = 0.8 }, {}]",
    },
    # Of the run. Where a command takes no road or no load, neither is there.
    "road": {
        "flat": "",
        "bump": "bump:height=0.03",
        "edge": "step:height=0.005:edge=0:start=0.1",
        "class": "iso8608:class=C",
        "sweep": "sweep",
        "sine": "sine:frequency=2:phase=90",
        "pothole": "pothole:depth=0.02:length=1",
        "measured": "road.csv",
        "rig": "rig:file=rig.csv",
    },
    "load": {
        "none": "",
        "brake": "brake:g=0.2:start=0.05:rise=0.1",
        "corner": "corner:g=0.2:start=0.05:rise=0.1",
        "payload": "payload:mass=50:start=0.05:rise=0.1",
        "gust": "gust:force=300:start=0.05:rise=0.1:hold=0.1",
        "file": "push.csv",
    },
    "command": dict.fromkeys(
        ["synth", "export", "bump", "drive", "sweep", "margins", "envelope", "report", "inspect", "campaign"], ""
    ),
}
LEFT_OUT = {  # levels that a type of vehicle does not have: loads that it does not feel, and designs that take minutes
    "quarter_car": {"brake", "corner", "gust"},
    "half_car": {"corner", "gust"},
    "half_car_roll": {"brake"},
    "full_car": {"family", "sampled"},
}
EITHER = ("type", "law", "command")
CHEAP = {  # levels that the suite has, of features with others that take long
    "type": ("quarter_car", "half_car", "half_car_roll"),
    "law": tuple(
        law for law in FEATURES["law"] if law not in ("state", "steps", "full", "order", "pi", "lqg", "h2", "band", "bounds")
    ),
    "command": ("synth", "export", "bump", "drive", "inspect", "campaign"),
}
REFUSALS = (  # what is no fault of a file, and which command it does not go with
    "no linear loop",
    "so its code needs a sample period",
    "an export can contain only feedback of measured signals",
    "is a law in Python, which is already code",
    "states of filters in [performance] never are",
    "no sensor measures the states of filters in [performance]",
    "is not an integer, but exported code can change forces only at samples",
    "semi-active dampers with curves c_min and c_max cannot be exported",
    "is not stable because of the timestep of",
    "unknown controller 'passive'; give --controller with one of",
    "requests no force, so it closes no loop",
    "cannot be stabilised with these measurements",
    "semi-active dampers and force actuators cannot be exported together",
    "has noise without sample_period",
    "has no frequency response, because its motion does not decay",
    "has an entry with a magnitude above 1e+15; use units",
    "has an entry that is not finite",
)
IN_FILE = [name for name in FEATURES if name not in ("road", "load", "command")]


FILES = {
    "law.py": "def step(sample, state):\n    return [-800.0 * sample.y[0]] * ((len(sample.y) + 1) // 2), state\n",
    "road.csv": "distance [m],height [m]\n" + "".join(f"{0.25 * i:g},{0.01 * (i % 7 == 3):g}\n" for i in range(80)),
    "push.csv": "time [s],heave [N]\n0,0\n0.1,0\n0.2,300\n",
}


def files(row: Row) -> dict[str, str]:
    """The files of a row, by name."""
    kind = row["type"]
    heads = {"quarter_car": ["road_displacement"], "half_car": ["front", "rear"]}.get(kind, [one[1:] for one in CORNERS[kind]])
    drive = [[0.05 * i, *[i % 3 if i > 2 else 0] * len(heads)] for i in range(12)]
    head = ",".join(["time [s]", *(f"{name} [mm]" for name in heads)])
    rig = "\n".join([head, *(",".join(f"{value:g}" for value in line) for line in drive)])
    return FILES | {"car.toml": vehicle_text(row), "rig.csv": rig, "campaign.toml": _campaign(row)}


def _campaign(row: Row) -> str:
    road = " + ".join(filter(None, (FEATURES["road"][row["road"]], FEATURES["load"][row["load"]]))) or "bump:height=0.02"
    road = f"flat + {road}" if row["road"] == "flat" and row["load"] != "none" else road
    return (
        f'vehicles = ["car.toml"]\ncontrollers = ["{controller(row)}"]\nroads = ["{road}"]\nspeeds = [15.0]\n'
        "duration = 0.3\nsettle = 0.1\nseeds = 1\n"
    )


def controller(row: Row) -> str:
    """The name of the controller that a row is about."""
    return row["law"] if row["law"] in ("passive", "state") else "mine"


def arguments(row: Row) -> tuple[str, list[str]]:
    """The command of a row, and its options."""
    command, short = row["command"], ["--duration", "0.3"]
    mine = ["--vehicle", "car.toml", "--controller", controller(row)]
    road, load = FEATURES["road"][row["road"]], FEATURES["load"][row["load"]]
    pushed = ["--load", load] if load else []
    driven = [*mine, *short, *(["--speed", "15"] if row["road"] != "rig" else []), *(["--road", road] if road else []), *pushed]
    driven += [] if road or load else ["--road", "flat"]
    return {
        "synth": ("synth", mine),
        "export": ("synth", [*mine, "--export", "out"]),
        "bump": ("sim.bump", [*mine, *short, "--height", "0.03", "--length", "3", "--no-logs"]),
        "drive": ("sim.drive", [*driven, "--no-logs"]),
        "sweep": ("sim.sweep", mine),
        "margins": ("sim.margins", mine),
        "envelope": ("sim.envelope", [*mine, "--duration", "0.6", *pushed, "--vary", "height:0.02:0.2:3"]),
        "report": ("sim.report", [*mine, *pushed, "--quick", "--out", "page.html"]),
        "inspect": ("sim.drive", [*driven, "--logs", "logs"]),
        "campaign": ("sim.campaign", ["campaign.toml", "--workers", "1", "--results", "results"]),
    }[command]


@cache
def _shipped(kind: str) -> dict[str, Any]:
    data = tomllib.loads(read_vehicle(kind).text)
    return {key: data[key] for key in ("type", "plane", "parameters", "performance") if key in data}


def _matrices(kind: str) -> dict[str, str]:
    """What stands for each $name in the lines of a vehicle."""
    corners, velocities = CORNERS[kind], VELOCITIES[kind]
    deflections = [f"suspension_deflection{corner}" for corner in corners]
    accelerations = [*deflections, "sprung_acceleration" if kind == "quarter_car" else "heave_acceleration"]
    m, q = len(corners), len(deflections) + len(velocities)
    own = [[500.0 * (i == j) for j in range(m)] for i in range(m)]
    values = {
        "first": deflections[0],
        "velocity": velocities[0],
        "ride": accelerations[-1],
        "measured": [*deflections, *velocities],
        "velocities": velocities,
        "deflections": deflections,
        "accelerations": accelerations,
        "gain": [[*row, -800.0, *[0.0] * (len(velocities) - 1)] for row in own],
        "small": [[*row, -20.0] for row in own],
        "B": [[0.0] * m + [1.0] + [0.0] * (q - m - 1)],
        "Ba": [[0.0] * m + [1.0]],
        "C": [[-200.0]] * m,
    }
    return {name: value if name in ("first", "velocity", "ride") else json.dumps(value) for name, value in values.items()}


def vehicle_text(row: Row) -> str:
    """The vehicle file of a row."""
    kind, data = row["type"], json.loads(json.dumps(_shipped(row["type"])))
    axles = list(dict.fromkeys(re.sub("_(left|right)$", "", corner) or corner for corner in CORNERS[kind]))
    for feature in IN_FILE:
        lines = FEATURES[feature][row[feature]].splitlines()
        every = [
            line.replace("@c", place).replace("@a", place)
            for line in lines
            for place in (CORNERS[kind] if "@c" in line else axles if "@a" in line else [""])
        ]
        text = re.sub(r"\$(\w+)", lambda found: _matrices(kind)[found[1]], "\n".join(every))
        _merge(data, tomllib.loads(text))
    for curve in data.get("curves", ()):
        del data["parameters"][curve]
    sections = {f"controllers.{name}": section for name, section in data.pop("controllers", {}).items()}
    head = "".join(f"{key} = {_toml(data.pop(key))}\n" for key in ("type", "plane") if key in data)
    return head + "".join(
        f"\n[{name}]\n" + "".join(f"{key} = {_toml(value)}\n" for key, value in section.items())
        for name, section in (data | sections).items()
    )


def _merge(data: dict[str, Any], more: Mapping[str, Any]) -> None:
    for key, value in more.items():
        if isinstance(value, dict) and isinstance(data.get(key), dict):
            _merge(data[key], value)
        else:
            data[key] = value


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(one)}" for key, one in value.items()) + " }"
    return "[" + ", ".join(map(_toml, value)) + "]" if isinstance(value, list) else json.dumps(value)


def is_file(row: Row, folder: Path) -> bool:
    """True if the vehicle file of a row is one: its features go together. The folder has its law in Python."""
    if row["type"] == "full_car" and row["law"] not in CHEAP["law"]:
        return False  # a design of it takes up to half a minute
    if LEFT_OUT[row["type"]] & set(row.values()):
        return False
    try:
        parse_vehicle(vehicle_text(row), folder=folder)
    except InputError:
        return False
    return True


def rows(
    levels: Mapping[str, Collection[str]], fits: Callable[[Row], bool], seed: int = 0, tries: int = 20, of: str = ""
) -> Iterator[Row]:
    """Rows in which all pairs of levels of different features meet that can.

    Args:
        levels: of every feature; the first is the one without it, which half of a row's features have but `EITHER`.
        fits: True for a row that can be.
        of: feature of which alone the pairs are; empty for all.
        tries: random rows out of which each is the one with most new pairs; a pair that is in none of them three times is left.
    """
    rng, failed = random.Random(seed), Counter[frozenset]()
    pairs = itertools.combinations([(name, level) for name, every in levels.items() for level in every], 2)
    left = {
        frozenset(pair): None for pair in pairs if len(names := {pair[0][0], pair[1][0]}) == 2 and (not of or of in names)
    }  # in a fixed order
    while left:
        pair = next(iter(left))
        some = [
            {
                name: rng.choice(list(every)) if name in EITHER or rng.random() < 0.5 else next(iter(every))
                for name, every in levels.items()
            }
            | dict(pair)
            for _ in range(tries)
        ]
        met = [left.keys() & set(map(frozenset, itertools.combinations(row.items(), 2))) for row in some]
        best = next((i for i in sorted(range(tries), key=lambda i: -len(met[i])) if fits(some[i])), None)
        if best is not None:
            left = {one: None for one in left if one not in met[best]}
            yield some[best]
            continue
        del left[pair]
        failed[pair] += 1
        if failed[pair] < 3:
            left[pair] = None
