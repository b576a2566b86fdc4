"""Vehicle files: the one that ships is the paper's, and every mistake in one is named in one line."""

import json
import re
import subprocess
import sys
from functools import reduce

import numpy as np
import pytest

import models
import sim
from models.common.errors import InputError
from models.kinds.kind import MOST_SQUEEZE
from models.vehicle.vehicle import parse_vehicle, read_vehicle, shipped_vehicles
from tests.support.commands import ROOT, attacks, main_of, prose, refused

MEASURABLE = "suspension_deflection, suspension_velocity, tyre_deflection, unsprung_acceleration, unsprung_velocity"
MASS = "sprung_mass = 504.5"
WEIGHT = "sprung_acceleration = 1.0"
LAW = "A = [[-1.0]]\nB = [[1.0, 1.0]]\nC = [[1.0]]\nD = [[1.0, 1.0]]"
MINE = 'measured = ["suspension_deflection", "sprung_velocity"]'

# (what is wrong, replaced in the file that ships, by this, what the message says: the key, what is allowed)
CHANGES = [
    ("a key twice", MASS, f"{MASS}\n{MASS}", ["not valid TOML", "line 6"]),
    ("missing parameter", MASS, "", ["'sprung_mass' [kg]", "missing"]),
    ("a tyre that is flat at rest", "= 252000.0", "= 1e3", ["tyre_deflection", "5.56 m", f"at most {MOST_SQUEEZE} m"]),
    ("unknown weight", WEIGHT, f"{WEIGHT}\njerk = 1.0", ["[performance]", "'jerk'", "sprung_acceleration"]),
    ("weight of the road", WEIGHT, f"{WEIGHT}\nroad_velocity = 1.0", ["[performance]", "'road_velocity'"]),
    ("weight in words", WEIGHT, 'sprung_acceleration = "much"', ["sprung_acceleration = 'much'", "1e-12 to 1e+12"]),
    ("half a law", MINE, f"{MINE}\nA = [[1.0]]", ["[controllers.I] B, C, D is missing", "x_c' = A x_c + B y"]),
    (
        "a law that does not fit",
        MINE,
        f"{MINE}\n{LAW}".replace("C = [[1.0]]", "C = [[1.0, 2.0]]"),
        ["C has 1 row(s) of 2 number(s); give 1 row(s) of 1"],
    ),
    ("a law of its own rate", MINE, f"{MINE}\n{LAW}\nsample_period = 0.01", ["give [implementation] sample_period = 0.01"]),
    ("nothing measured", MINE, "", ["[controllers.I] measured is missing", MEASURABLE]),
    ("brackets of a list", "[controllers.I]", "[[controllers.I]]", ["is not a section", "write [controllers.I] once"]),
    ("unknown signal", MINE, 'measured = ["jerk"]', ["[controllers.I]", "'jerk'", MEASURABLE]),
    ("its own force", MINE, 'measured = ["control_force"]', ["'control_force'", "contains no information about the state"]),
    ("measured twice", MINE, 'measured = ["sprung_velocity", "sprung_velocity"]', ["'sprung_velocity' twice"]),
    ("gain is a list", MINE, f"{MINE}\ngain = [1.0, 2.0]", ["gain = [1.0, 2.0]", "gain = [[1.0, 1.0]]"]),
    ("gain of two rows", MINE, f"{MINE}\ngain = [[1.0, 2.0], [3.0]]", ["2 row(s) of 1 or 2 number(s)", "1 row(s)"]),
    ("gain that overflows", MINE, f"{MINE}\ngain = [[1e300, 1.0]]", ["gain = [[1e+300, 1.0]]", "at most 1e+12"]),
    ("a taken name", "[controllers.I]", "[controllers.passive]", ["[controllers.passive]", "rename"]),
    ("a name too long for a file", "[controllers.I]", f"[controllers.{'I' * 70}]", ["at most 60"]),
]

OF_CARS = [  # vehicle, replaced in its file, by this, what the message says
    ("half_car", "pitch_inertia = 1222.0", "pitch_inertia = 122200.0", ["pitch_inertia", "a body of 690 kg", "at most"]),
    ("full_car", "roll_inertia = 460.0", "roll_inertia = 46000.0", ["roll_inertia", "track of 1.51 m"]),
    ("half_car", '"pitch_rate"]', '"roll_rate"]', ["'roll_rate'", "pitch_rate"]),
    ("full_car", "track = 1.51", "track_front = 1.51", ["distance between left and right wheels is missing", "or track_rear"]),
    ("full_car", '"roll_rate"]', '"tyre_deflection_front_left"]', ["'tyre_deflection_front_left'", "road's height"]),
    ("half_car", "[performance]", "anti_roll_stiffness_front = 1e4\n[performance]", ["only heaves", "use a full_car"]),
    ("full_car", "[performance]", "anti_roll_stiffness = 1e4\n[performance]", ["unknown parameter", "stiffness_front"]),
    ("half_car_roll", '"roll"', '"yaw"', ["plane = 'yaw'", "'half_car'", "give one of pitch, roll"]),
    ("quarter_car", "[parameters]", 'plane = "roll"\n[parameters]', ["plane = 'roll'", "'quarter_car'", "omit the line"]),
    ("half_car_roll", "[performance]", "pitch_inertia = 9\n[performance]", ["only heaves and rolls", "omit plane"]),
    ("half_car_roll", "[performance]", "centre_offset = 0.8\n[performance]", ["beyond the wheels", "0.755 m"]),
]

VELOCITY = '[controllers.mine]\nmeasured = ["sprung_velocity"]'
SAMPLED = "[implementation]\nsample_period = 0.01"
BOTH = f"[controllers.mine]\n{MINE}"
LINE = "{ velocity = [-1.0, 1.0], force = [-9.0, 9.0] }"
RATIO = "motion_ratio = { deflection = [-0.1, 0.1], ratio = [0.7, 0.5] }"
DAMPER = '[actuators]\nkind = "damper"\nc_min = 1.0\nc_max = 5e3'
OWN = '[controllers.mine]\nmeasured = ["control_force"]\ngain = [[0.1]]'

# By vehicle, and what begins the lines that are added to its file: the rest of them, what the message says.
ADDED = {
    ("quarter_car", VELOCITY): [
        ('order = "half"', "order = 'half' is unknown; give one of full"),
        ('design = "lqr"', 'design = "lqr" uses the full state'),
        ("gain = [[-100.0]]\nanti_windup = 20.0\n[limits]\nactuator_force = 40.0", "static gain has no states that can wind up"),
        (
            'design = "preview"',
            "needs a preview time (the range of the road sensor divided by the speed); give the preview time in seconds",
        ),
        ('design = "preview"\npreview = 0.5', 'design = "preview" uses the full state'),
        ("preview = 1.0", "preview needs a law in Python or design"),
        *((f'law = "{law}"', "is not a law in Python") for law in ("../mine.py:step", "/etc/mine.py:step", "mine.py")),
        *((f'law = "mi{mark}ne.py:step"', "is not a law in Python") for mark in (r"\u0007", r"\n", r"\u2028")),
        *((f'fmu = "{fmu}"', "fmu = ") for fmu in ("../their.fmu", "/tmp/their.fmu", "their.zip")),
        ('fmu = "their.fmu"\npreview = 1.0', "fmu"),
        ('fmu = "their.fmu"\ngain = [[1.0]]', "fmu", "gain"),
        ('law = "~/law.py:step"', "law = '~/law.py:step'", "next to the vehicle file"),
        ("order = 300", "order = 300 is unknown; give one of full, static, or a number of states from 0 to 200"),
        ("order = true", "order = True is unknown"),
        ("pid = { kp = 1.0, kd = 2.0 }", "pid has kd but no filter"),
        ("pid = { kp = 1.0, filter = 2.0 }", "pid has a filter, which acts only on the derivative"),
        ("pid = { kp = 1.0 }\nA = [[1.0]]", "has both pid and A, but a controller can have only one law"),
        ("pid = { kp = [1.0, 2.0] }", "pid] kp = [1.0, 2.0] is not allowed; give a number, or a list of 1"),
        ('structure = "pid"\npid = { kp = 1.0 }', "means that Roadproof designs the gains, but pid already gives kp"),
        ('structure = "pi"\npid = { filter = 1.0 }', 'structure = "pi" has no derivative'),
    ],
    ("quarter_car", f"{VELOCITY}\ngain = [[1.0]]"): [
        ("tolerance = { force = { weight = -0.1 } }", "is not allowed; give"),
        ("tolerance = { force = { weight = { numerator = [1.0, 0.0], denominator = [1.0] } } }", "the gain grows without limit"),
        ("tolerance = { force = { numerator = [1.0], denominator = [1.0, 1.0] } }", "give the largest relative error"),
    ],
    ("half_car", "[controllers.mine]"): [
        ('measured = ["suspension_deflection_front", "heave_velocity"]\nstructure = "corner"', "belongs to no corner")
    ],
    ("quarter_car", ""): [
        *(
            (f'[controllers."{name}"]', "use letters, digits, '_' and '-', without")
            for name in ("--help", "-I", "a b", "it's", "")
        ),
        ("[controllers.my law]", "not valid TOML", "my_law for"),
        ("sprung mass = 500", "not valid TOML", "sprung_mass for"),
        (
            '[controllers.rig]\nmeasured = ["sprung_displacement"]',
            "is an absolute height (above the datum of a flat road), which no sensor on a car",
        ),
    ],
    ("quarter_car", "[controllers.mine]"): [('semi_active = "skyhook"', "but control_force has none; add [actuators]")],
    ("quarter_car", "[payload]"): [
        ("mass = 60.0\nx = 0.5", "[payload]", "does not pitch"),
        ("mass = 60.0\ny = 0.5", "[payload]", "--load payload:y="),
        ("mass = 200.0\n[limits]\nsuspension_stroke = 0.07\nstop_stiffness = 1e5", "[payload]", "beyond the bump stroke"),
    ],
    ("quarter_car", "[actuators]"): [
        ('kind = "damper"\nc_max = 4e3', "c_min is missing; give both c_min and c_max"),
        ('kind = "damper"\nc_min = 4e3\nc_max = 4e3', "c_min = 4000 N s/m is not below c_max = 4000 N s/m; give a smaller"),
        ('kind = "damper"\nc_min = nan\nc_max = 4e3', "c_min = nan is not allowed; give a number from 0 to"),
        (
            'kind = "damper"\nc_min = 500.0\nc_max = 4e3',
            "suspension_damping = 400 N s/m, which applies while the controller gives no command, is not between",
        ),
        ("c_min = 300.0", 'has c_min, which needs kind = "damper"'),
    ],
    ("quarter_car", DAMPER): [
        ("[actuators.front]\nc_min = 1", "is not a suspension of this vehicle"),
        ("[limits]\nactuator_force = 900.0", "[limits] actuator_force applies only to force actuators"),
    ],
    ("quarter_car", "[curves]"): [
        (f"{RATIO}\n{DAMPER}\n{OWN}", "but no sensor measures the force of a damper whose motion ratio changes with travel"),
        (f"{RATIO}\n[payload]\nmass = 5e3", "the static deflection is outside the table"),
        (f"suspension_damping = {LINE}", "suspension_damping is in both [parameters] and [curves]"),
        (f"sprung_mass = {LINE}", "'sprung_mass' is not a stiffness or damping of a suspension; this vehicle has suspension_d"),
        (RATIO.replace("0.7, 0.5", "0.3, 2.9"), "changes so fast with travel that the preload"),
    ],
    ("quarter_car", BOTH): [
        ("minimise = { band = [8.0, 4.0] }", "[controllers.mine.minimise] band = [8.0, 4.0] is not allowed"),
        ("minimise = { band = [4.0, inf] }", "minimise] band = [4.0, inf] is not allowed; give the lowest and highest"),
        ('minimise = { signals = "speed" }', "minimise] signals: unknown signal 'speed'"),
        ('minimise = { over = "regret" }', "which is computed over a family of vehicles, but no family is given"),
        ("bounds = [{ norm = 8.0, decay = 1.0 }]", "is not allowed; give a bound, one of"),
        ("tolerance = { tyre_deflection = 0.1 }", "unknown key 'tyre_deflection'", "force stands for all forces"),
        (
            "tolerance = { force = 0.1, control_force = 0.1 }",
            "which stands for all forces, and a single force; give only one of the two",
        ),
        ("family = [{ sprung_mass = 0 }]", "family[0].sprung_mass = 0 is not allowed"),
        ("family = [{ colour = 2 }]", "family[0]: unknown parameter 'colour'"),
        ("structure = [[0, 0]]", "has only zeros"),
        ("noise = true", "has noise = true, but [implementation] gives no noise of the measured signals"),
        (
            "noise = true\n[implementation]\nnoise = { unsprung_velocity = 0.1, sprung_velocity = 0.0 }",
            "gives no noise of the measured signals",
        ),
        ("lag = true", "has lag = true, but ", "has no actuator_bandwidth"),
        ("pid = { kp = 1.0 }", "needs one measured signal for each force, but measured lists 2 signal(s) for 1 force"),
        (f"{LAW}\nanti_windup = 20.0", "has anti_windup, which acts only when forces are clipped, but no limit clips the forces"),
    ],
    ("quarter_car_semi_active", "[controllers.mine]"): [
        (
            'design = "preview"\npreview = 0.5',
            "applies forces before the wheels reach a bump, but semi-active dampers can only resist motion",
        ),
        ('semi_active = "skyhook"\nmix = 0.5', "'skyhook' has no key 'mix' (this law has no keys)"),
        ('semi_active = "hybrid"\nmeasured = ["sprung_velocity"]', "no key 'measured' (its keys are"),
        ('semi_active = "skyhook_modal"', "needs a body that pitches or rolls"),
    ],
    ("quarter_car", "[implementation]"): [
        ("sampled = true", "[implementation] has sampled = true, but ", "gives no sample period"),
        ("delay = 51", "delay = 51", "from 0 to 50"),
        ('sample_period = 0.005\ndelay = "0.5"', 'unit may be in quotes; add the unit, as in "1.5 s", or omit the quotes'),
    ],
    ("quarter_car_semi_active", VELOCITY): [("mix = 0.5", "mix needs a semi-active law, but the section names none")],
    ("full_car", ""): [
        (
            "[limits.middle]\nsuspension_stroke = 0.1",
            "[limits.middle] is not a suspension",
            "front, front_left, front_right, rear",
        ),
        ("[limits.rear]\nactuator_force = 100.0", "[limits.rear]", "'actuator_force'", "applies to all suspensions"),
        ("[limits.rear]\nsuspension_stroke = { up = 0.1 }\nstop_stiffness = 1e5", "[limits.rear] suspension_stroke", "rebound"),
        ("[[limits.rear]]\nsuspension_stroke = 0.1", "unknown key 'rear'"),
    ],
    ("quarter_car", "[limits]"): [
        ("suspension_stroke = { up = 0.1, down = 0.1 }\nstop_stiffness = 1e5", "'up'", "bump = ..., rebound = ..."),
        ("suspension_stroke = { bump = 0.1, rebound = -0.1 }\nstop_stiffness = 1e5", "[limits.suspension_stroke] rebound = -0.1"),
        ("suspension_stroke = 0.1\nstop_stiffness = [1e5, nan]", "stop_stiffness[1] = nan", "N/m2"),
        ("suspension_stroke = 0.1\nstop_stiffness = [0.0, 1e5]", "stop_stiffness[0] = 0", "from 1e-06"),
        ("suspension_stroke = 0.1\nstop_stiffness = [1.0, 1.0, 1.0, 1.0]", "has 4 coefficients", "k_3 x^3"),
        ("[limits.rear]\nsuspension_stroke = 0.1", "limits.rear", "no sections, because there is only one suspension"),
        ("suspension_stroke = 0.1", "suspension_stroke", "stop_stiffness", "both"),
        (
            "stop = { compression = [0.02, 0.03], force = [0, 500] }\nsuspension_stroke = 0.07",
            "begins with a gap of 0.02 m, but suspension_stroke already gives a gap of 0.07 m; omit one of the two gaps",
        ),
        (
            "stop = { compression = [0, 0.01], force = [0, 500] }",
            "pushes back with 500 N at 0.01 m, but has no point where contact begins",
        ),
        (
            "stop = { compression = [0.01, 0.02, 0.03], force = [0, 500, -1] }",
            "bump: its table gives a pulling force of 1 N at 0.03 m",
        ),
        ("stop = { compression = [0.01, 0.02, 0.03], force = [0, 500, 400] }", "its table ends with a falling force, 400 N"),
        ("stop = { compression = [0.01, 0.02], force = [0, 0] }", "has a table in which every force is 0"),
        (
            "stop = { compression = [10, 20], force = [0, 500] }",
            "at most 5 m is allowed; check that the values are in m, not in mm",
        ),
        ("stop = { compression = [0.01, 0.02], force = [0, 500] }\nstop_stiffness = 3", "two names of the same key; omit one"),
        ("stop = 1e5", "a bump stop needs both"),
        ('actuator_bandwidth = 1.0\nlimit = "command"', "limit = 'command', but no actuator_force; give actuator_force [N]"),
    ],
}


@pytest.fixture(scope="module")
def text(paper):
    return paper.text


def test_the_file_that_ships_is_the_papers(paper):
    """`quarter_car` has the parameters (33), the weights (38), what I and II measure, and the printed gains."""
    assert paper.parameters == {
        "sprung_mass": 504.5,
        "unsprung_mass": 62.0,
        "suspension_stiffness": 13100.0,
        "suspension_damping": 400.0,
        "tyre_stiffness": 252000.0,
    }
    assert paper.performance == {
        "sprung_acceleration": 1.0,
        "suspension_deflection": 0.1,
        "tyre_deflection": 0.2,
        "control_force": 1e-4,
    }
    measured = {name: entry.measured for name, entry in paper.controllers.items()}
    assert measured["I"] == measured["I_printed"] == ("suspension_deflection", "sprung_velocity")  # (45)
    assert measured["II"] == measured["II_printed"] == ("sprung_velocity",)  # (54)
    laws = {name: entry.law for name, entry in paper.controllers.items()}
    assert laws["I"] is None
    assert laws["II"] is None
    gains = {name: law.D for name, law in laws.items() if law is not None and not law.states}
    np.testing.assert_array_equal(gains["I_printed"], [[1.0824e4, -0.2071e4]])  # (50)
    np.testing.assert_array_equal(gains["II_printed"], [[-8970.3]])  # (58)
    np.testing.assert_array_equal(gains["state_printed"], [[1.1810e4, 0.2333e4, -0.1096e4, 0.0109e4]])  # (40)


def test_passive_and_state_always_exist(text):
    """A vehicle file without controllers still has two: no force, and full state feedback. Whole numbers and no damping do."""
    vehicle = parse_vehicle(text.split("[controllers.I]")[0].replace("= 400.0", "= 0").replace("= 504.5", "= 500"))
    assert vehicle.controller_names == ("passive", "state")
    assert (vehicle.parameters["suspension_damping"], vehicle.parameters["sprung_mass"]) == (0.0, 500.0)


@pytest.mark.parametrize(
    ("kind", "old", "new", "said"),
    [*(("quarter_car", *row[1:]) for row in CHANGES), *OF_CARS],
    ids=[*(row[0] for row in CHANGES), *(row[2] for row in OF_CARS)],
)
def test_a_mistake_is_named(kind, old, new, said):
    """One wrong entry is refused in one line that names the key and what is allowed."""
    text = read_vehicle(kind).text
    assert text.count(old) >= 1
    with refused(*said, match=r"\A.{,400}\Z" if kind == "quarter_car" else None):  # not a page: values are shortened
        parse_vehicle(text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("kind", "lines", "said"),
    [(kind, f"{head}\n{row[0]}", row[1:]) for (kind, head), rows in ADDED.items() for row in rows],
    ids=[row[1] for rows in ADDED.values() for row in rows],
)
def test_what_is_added_wrongly_is_named(kind, lines, said):
    """Keys that do not go together, and sections of what a vehicle does not have, are refused in one line that says where."""
    with refused(*said, *(["[controllers.mine"] if "[controllers.mine]" in lines else [])):
        parse_vehicle(f"{read_vehicle(kind).text}\n{lines}\n")


def test_a_design_needs_weights(text):
    """A `[performance]` that is empty or all zero is refused."""
    for weight in ("", "sprung_acceleration = 0.0\n"):
        with refused("has no weight above 0"):
            parse_vehicle(f"{text.split('# Weights')[0]}[performance]\n{weight}")


def test_a_file_is_read_by_path_and_by_name(paper, tmp_path, monkeypatch):
    """A vehicle that ships is found by name, but a file of that name comes first; a byte order mark is no mistake."""
    monkeypatch.chdir(tmp_path)
    assert read_vehicle("quarter_car").source == paper.source
    (tmp_path / "quarter_car").write_text(paper.text.replace("504.5", "600.0"), encoding="utf-8-sig")
    assert read_vehicle("quarter_car").parameters["sprung_mass"] == 600.0


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "there is no such file"),
        ("", "type is missing"),
        ('type = "x"\n[parameters]', "performance is missing; give performance: weights of signals, as `roadproof new` writes"),
    ],
)
def test_a_file_without_a_vehicle(tmp_path, content, said):
    """A file that is not there or lacks sections is refused by name in one line."""
    path = tmp_path / "mine.toml"
    if content is not None:
        path.write_text(content)
    with refused(str(path), said):
        read_vehicle(path)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("suspension_stiffness", 42.7, "natural frequency is about 0.046 Hz"),  # N/mm
        ("suspension_damping", 1.095e6, "damping ratio is about"),  # kN s/m, times 1000
        ("suspension_damping", 1.095, "damping ratio is about 0.00021; check that the damping is in N s/m"),  # N s/mm
        ("sprung_mass", 0.5045, "natural frequency is about 26 Hz"),  # tonnes
        ("suspension_stroke", 60.0, "suspension_stroke is 60 m"),  # mm
        ("suspension_stroke", "{ bump = 60.0 }", "suspension_stroke.bump is 60 m"),
    ],
)
def test_doubtful_units_are_asked_about(name, value, said, tmp_path, capsys):
    """A number that is probably not in SI units is asked about on stderr, and taken as it is; no vehicle that ships is."""
    file = tmp_path / "car.toml"
    text = (ROOT / "models" / "quarter_car.toml").read_text(encoding="utf-8")
    text = re.sub(rf"^{name} = .*$", f"{name} = {value}", text, flags=re.MULTILINE)
    file.write_text(text if f"{name} = {value}" in text else f"{text}[limits]\n{name} = {value}\nstop_stiffness = 100.0\n")
    assert main_of("synth")(["--vehicle", str(file), "--controller", "passive"]) == 0
    asked = prose(capsys.readouterr().err)
    assert said in asked
    assert ("stop_stiffness is 100 N/m" in asked) == (name == "suspension_stroke")  # N/mm


@pytest.mark.parametrize(("name", "value", "said"), [
    ("suspension_stiffness_front", 18.0, "suspension_stiffness_rear is 1222 times suspension_stiffness_front; are both in N/m?"),
    ("suspension_damping_rear", 1.0, "suspension_damping_front is 1000 times suspension_damping_rear; are both in N s/m?"),
    ("unsprung_mass_front", 0.04, "unsprung_mass_rear is 1125 times unsprung_mass_front; are both in kg?"),
    ("suspension_damping_rear", 0.0, None),  # a damper may be absent
])  # fmt: skip
def test_one_axle_in_another_unit_is_asked_about(name, value, said):
    """A number of one axle in another unit than the other's is asked about, in one question."""
    text = re.sub(rf"^{name} = .*$", f"{name} = {value}", read_vehicle("half_car").text, flags=re.MULTILINE)
    assert parse_vehicle(text).warnings == ([said] if said else [])


def test_a_map_asks_about_units_too(tmp_path, capsys):
    """Commands that run a vehicle ask about its units as `synth` does."""
    file = tmp_path / "car.toml"
    file.write_text(read_vehicle("quarter_car").text + "[limits]\nsuspension_stroke = 80\nstop_stiffness = 1e5\n")
    options = ["--vary", "height:0.02:0.03:2", "--duration", "0.5", "--timestep", "0.005", "--json"]
    assert main_of("sim.envelope")(["--vehicle", str(file), "--controller", "passive", *options]) == 0
    assert "suspension_stroke is 80 m; check that its value is in m" in capsys.readouterr().err


CORNER = ["sprung_mass", "unsprung_mass", "suspension_stiffness", "suspension_damping", "tyre_stiffness", "tyre_damping"]
RIGHT = {  # corners in SI, each with its largest force and its sample period
    "car": ((380, 42, 22e3, 1500, 2e5, 50, 0.9), 2000, 0.005),
    "heavy truck": ((4450, 550, 1e6, 15e3, 1.75e6, 2e3, 1.0), 2e4, 0.01),
    "empty truck": ((1100, 520, 4e5, 12e3, 1.7e6, 2e3, 1.0), 2e4, 0.01),
    "motorcycle": ((95, 17, 1e5, 4e3, 1.3e5, 200, 0.38), 500, 0.002),
    "bicycle": ((38, 2.2, 9e4, 2e3, 9e4, 30, 0.36), 50, 0.002),
    "formula car": ((160, 22, 1.9e5, 6e3, 2.4e5, 400, 1.1), 5000, 0.001),
    "test bench": ((2.45, 1.0, 900, 7.5, 2500, 5, 1.0), 38, 0.002),
    "railway vehicle": ((9e3, 900, 4e5, 3e4, 1e9, 0, 1.0), 2e4, 0.01),
}
MISTAKES = {  # of the car: keys and values, and what the remark or the refusal must say
    "sprung_mass = 0.38": "in kg", "sprung_mass = 380e3": "in kg", "unsprung_mass = 0.042": "in kg",
    "unsprung_mass = 4200": "in kg",
    "sprung_mass = 42|unsprung_mass = 380": r"unsprung_mass \(380 kg\) is heavier than .* not swapped",
    "suspension_stiffness = 22": "stiffness in N/m", "suspension_stiffness = 22e6": "stiffness in N/m",
    "tyre_stiffness = 200": "stiffness in N/m", "tyre_stiffness = 200e6": "stiffness is in N/m",
    "suspension_stiffness = 6e4|tyre_stiffness = 4e4": r"tyre_stiffness \(40000 N/m\) is softer than .* not swapped",
    "suspension_damping = 1.5": "damping is in N s/m", "suspension_damping = 1.5e6": "damping is in N s/m",
    "tyre_damping = 5e4": "the tyre's damping ratio", "motion_ratio = 2.2": "motion_ratio is 2.2; .* over wheel travel",
    "suspension_stroke = { bump = 70, rebound = 0.09 }": "bump is 70 m", "stop_stiffness = 100": "in N/m",
    "suspension_stroke = { bump = 0.09, rebound = 0.7 }": "bump and rebound are not swapped",
    "actuator_force = 2": "actuator_force .* is small .* in N", "actuator_force = 2e6": "is large .* in N",
    "force_rate = 20": r"force_rate \(20 N/s\) is low for the static load .* in N/s", "force_rate = 2e7": "is high .* in N/s",
    "actuator_bandwidth = 10": "1.59155 Hz.* rad/s", "sample_period = 5": "sample_period",
    "sample_period = 0.1|delay = 0": "in s", "delay = 5": "delay times sample_period .0.025 s",
    "noise = { suspension_deflection = 1 }": "noise of .* in m",
    "quantisation = { sprung_acceleration = 50 }": "in m/s2",
}  # fmt: skip


def corner(name: str) -> str:
    """The file of a corner, with limits and an implementation."""
    values, force, period = RIGHT[name]
    given = "".join(f"{key} = {value}\n" for key, value in zip([*CORNER, "motion_ratio"], values, strict=True))
    return f"""type = "quarter_car"\n[parameters]\n{given}[performance]\nsprung_acceleration = 1.0
[limits]\nsuspension_stroke = {{ bump = 0.07, rebound = 0.09 }}\nstop_stiffness = 1e5\nactuator_force = {force}
actuator_bandwidth = 60.0\nforce_rate = {10 * force}\n[implementation]\nsample_period = {period}\ndelay = 1
noise = {{ suspension_deflection = 0.001, sprung_acceleration = 0.05 }}\n"""


def put(text: str, entry: str) -> str:
    """The text with another value of a key."""
    name, _, section = *entry.partition(" = ")[:2], "[implementation]\n"
    line = re.compile(rf"^{name} = .*$", re.MULTILINE)
    return line.sub(entry, text) if line.search(text) else text.replace(section, f"{section}{entry}\n")


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_remarked_once(mistake):
    """An improbable number of a vehicle has one remark, with what to check, or is refused; so has one axle of a car."""
    try:
        (said,) = parse_vehicle(reduce(put, mistake.split("|"), corner("car"))).warnings
    except InputError as error:
        said = str(error)
    assert re.search(MISTAKES[mistake], said)


@pytest.mark.parametrize("name", RIGHT)
def test_right_vehicles_have_no_remark(name):
    """Limits are relative to the vehicle: a truck, a bicycle and a test bench of 2.45 kg are all right."""
    assert parse_vehicle(corner(name)).warnings == []


def test_axles_of_a_car():
    """The front and the rear axle of a car have the same rules, and a remark names the axle, or both."""
    for kind, rear in (("half_car", "rear"), ("full_car", "rear_left")):
        text = read_vehicle(kind).text
        (soft,) = parse_vehicle(put(put(text, "tyre_stiffness_rear = 20e3"), "suspension_stiffness_rear = 30e3")).warnings
        assert soft.startswith("tyre_stiffness_rear (20000 N/m) is softer than suspension_stiffness_rear")
        (apart,) = parse_vehicle(put(put(text, "suspension_stiffness_front = 9e4"), "suspension_stiffness_rear = 15e3")).warnings
        assert re.search(rf"at front.* is far above .* at {rear} .* front and rear are not swapped", apart)


def test_remarks_are_in_json_and_python_warns(tmp_path, capsys):
    """Each remark on vehicle and road is printed once, before any error, is in `--json`, and is a warning in Python."""
    file = tmp_path / "car.toml"
    file.write_text(put(corner("car"), "actuator_force = 2"))
    bump = ["--vehicle", str(file), "--controller", "passive", "--no-logs", "--duration", "0.1", "--timestep", "0.005"]
    main_of("sim.bump")([*bump, "--height", "0.6", "--speed", "90", "--json"])
    printed = capsys.readouterr()
    said = [line.removeprefix("roadproof: ") for line in printed.err.splitlines() if line.startswith("roadproof: ")]
    assert json.loads(printed.out)["remarks"] == said
    assert [one.split(" (")[0] for one in said] == ["actuator_force", "speed", "height"]
    with pytest.warns(UserWarning, match="is small for") as warned:
        vehicle = models.read_vehicle(file)
    assert [str(one.message) for one in warned] == said[:1]
    assert warned[0].filename == __file__
    with pytest.warns(UserWarning, match="is above") as warned:
        sim.run(vehicle, ["passive", "passive"], models.Bump(height=0.6, speed=90.0), duration=0.1)
    assert [str(one.message) for one in warned] == said[1:]
    with pytest.warns(UserWarning, match="heavier than the body"):
        vehicle.with_parameters(unsprung_mass="0.5 t")
    file.write_text(put(corner("car"), "sprung_mass = 0.38"))
    with refused(match=r"timestep = 0.005 s is too large: .*; the body's natural frequency .* sprung_mass is in kg"):
        main_of("sim.bump")(bump)


def test_vehicles_that_ship_raise_no_doubt():
    """Nothing is asked about the vehicles that ship."""
    assert not any(read_vehicle(name).warnings for name in shipped_vehicles())


RICH = """[curves]
suspension_damping_front = { velocity = [-1.0, -0.2, 0.0, 0.2, 1.0], force = [-900, -400, 0, 500, 1500] }
suspension_damping_rear = { velocity = [-1.0, -0.2, 0.0, 0.2, 1.0], force = [-900, -400, 0, 500, 1500] }
[limits]
actuator_force = 3000.0
actuator_bandwidth = "8 Hz"
suspension_stroke = { bump = 0.07, rebound = 0.08 }
stop_stiffness = 1e5
[implementation]
sample_period = 0.005
delay = 1
noise = { sprung_velocity_front_left = 0.01 }
"""
COUNTED = """
import importlib, pathlib, pkgutil, sys
import models
for one in pkgutil.walk_packages(models.__path__, "models."):
    if "gallery" not in one.name:
        importlib.import_module(one.name)
codes, folder = set(), str(pathlib.Path(models.__file__).parent)
def note(frame, event, _):
    if event == "call" and frame.f_code.co_filename.startswith(folder):
        codes.add(frame.f_code)
sys.setprofile(note)
models.vehicle.vehicle.read_vehicle(sys.argv[1]).linear_model
sys.setprofile(None)
print(len(codes), max(len({line for *_, line in one.co_lines() if line}) for one in codes))
"""


@pytest.mark.parametrize(("kind", "more", "most"), [*attacks([("quarter_car", "", 154)]), ("full_car", RICH, 262)])
def test_the_path_to_the_linear_model_is_short(tmp_path, kind, more, most):
    """Between a file and its linear model, a limited number of functions, lambdas and comprehensions run, none of them long."""
    text = read_vehicle(kind).text
    for name in re.findall(r"(?m)^\w+(?= = {)", more):
        text = re.sub(rf"(?m)^{name} = .*\n", "", text)
    (tmp_path / "car.toml").write_text(text + more)
    done = subprocess.run([sys.executable, "-c", COUNTED, tmp_path / "car.toml"], capture_output=True, text=True, check=True)
    count, longest = map(int, done.stdout.split())
    print(f"{kind}: {count} code objects, the longest of {longest} lines")
    assert count <= most
    assert longest <= 73  # lines of code of `rigid_body.linear_model`
