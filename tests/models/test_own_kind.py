"""A custom vehicle type: its three files work next to one another, and every mistake in one of them is one line."""

import copy
import json
import pickle
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from models.common.errors import InputError
from models.kinds.user_kind import check_equations, check_parts
from models.roads.iso8608 import Iso8608
from models.vehicle.vehicle import kinds, read_vehicle
from sim.bump import main
from sim.drive.__main__ import main as drive
from sim.studies.ride.weighting import wk
from synth.__main__ import main as synth
from tests.support.commands import environment, prose
from tests.support.pages import hopper

BUILD = "def linear_model(p):"
SENSOR = '<jointvel name="sprung_velocity" joint="sprung" user="1"/>'
ROAD = '<body name="road" mocap="true">'
OTHER = "from models import BodyLoad, Invariant, Suspension\nK = dict(KIND.__dict__)\n"


@pytest.fixture
def folder(tmp_path):
    """The folder of the hopper of the page about custom vehicle types."""
    return hopper(tmp_path).parent


def refusal(folder: Path) -> str:
    """Returns the error of a command about the vehicle."""
    with pytest.raises(InputError, match=r"\A.{,499}\Z") as caught:  # one line
        main(["--vehicle", str(folder / "hopper.toml"), "--controller", "passive", "--duration", "1", "--no-logs"])
    return str(caught.value)


def replace(path: Path, *changes: tuple[str, str]) -> None:
    """Replaces texts in a file."""
    text = path.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text)


def test_it_works(folder):
    """The three files of the page run as they are, with their motor; in a fluid that the equations lack the run disagrees."""
    assert main(command := ["--vehicle", str(folder / "hopper.toml"), "--controller", "I", "--duration", "1", "--no-logs"]) == 0
    replace(folder / "hopper.xml", ('integrator="RK4"', 'integrator="RK4" density="2000"'))
    assert main(command) == 1


def test_it_goes_to_other_processes(folder):
    """Pickle writes it with its functions, also into a process that knows no such file; a deep copy is the same kind."""
    vehicle = read_vehicle(folder / "hopper.toml")
    (folder / "hopper.pickle").write_bytes(pickle.dumps(vehicle))
    assert copy.deepcopy(vehicle).kind is vehicle.kind
    (folder / "hopper.py").unlink()
    code = "import pickle; print(pickle.load(open('hopper.pickle', 'rb')).kind.model({'mass': 2.0, 'stiffness': 8.0}).A.tolist())"
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, env=environment(), capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[[0.0, 1.0], [-4.0, 0.0]]"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("import numpy as np", "1 / 0", r"the file fails \(ZeroDivisionError: division by zero, line 1\)"),
        ("import numpy as np", "import nothing_of_that_name", r"fails \(ModuleNotFoundError: .*nothing_of_that_name.*line 1\)"),
        ("import numpy as np", "raise SystemExit(3)", r"fails \(SystemExit: 3, line 1\)"),
        ("import numpy as np", "raise ValueError('two\\nlines')", r"ValueError: two lines"),
        (BUILD, "def linear_model(p:", r"\(.*line AT\)"),
        (
            "KIND = VehicleKind(",
            "OTHER = VehicleKind(",
            r"the file defines no KIND; end the file of the vehicle type with KIND = VehicleKind",
        ),
        ("KIND = VehicleKind(", "KIND = dict(", r"KIND is a dict"),
        ('name="hopper"', 'name="jumper"', r"KIND has the name 'jumper', but the files of this vehicle type are named 'hopper'"),
        (BUILD, f"{BUILD}\n    p['weight']", r"linear_model fails \(KeyError: 'weight', line BELOW\)"),
        (BUILD, f"{BUILD}\n    return None", r"linear_model\(parameters\) = None is not allowed; give a LinearModel"),
        ("np.array([[-1], [0]])", "np.array([[-1]])", r"linear_model fails \(Bw has shape \(1, 1\)"),
        ("return LinearModel(A", "return LinearModel(A * np.inf", r"linear_model fails \(A\[0, 0\] = .* is not finite"),
        ("(signals.ROAD_VELOCITY.name,)", "('w',)", r"the disturbances w; return, in this order, road_velocity"),
        (
            "return LinearModel(A, B, Bw, C, D, STATES",
            "return LinearModel(A, B, Bw, C, D, STATES[::-1]",
            r"differs from the state or input",
        ),
        (
            "signals.CONTROL_FORCE.name)",
            "'force')",
            r"no output 'control_force', which is a signal of the vehicle type; add the output",
        ),
        ("        signals.CONTROL_FORCE,\n", "", r"an output 'control_force', which is not a signal of the vehicle type"),
        ('return {"tyre', 'return 0, {"tyre', r"static_tyre_deflection\(parameters\) = .*give a mapping from a text to a number"),
        ('return {"tyre_deflection"', 'return {"tyre"', r"returns tyre; return one number for each of tyre_deflection"),
        ('return {"tyre_deflection": p', 'return {"tyre_deflection": -p', r"= -0\.01308 is not allowed; give a number above 0"),
        ('spec.body("sprung")', 'spec.body("nobody")', r"write_mjcf fails \(AttributeError: .*line \d+\)"),
        ('mass = p["mass"]', 'mass = float("nan")', r"MuJoCo rejects the MJCF with the changes of write_mjcf"),
    ],
)
def test_equations_that_do_not_work(folder, old, new, said):
    """Python that fails or gives wrong results is one line with the file and the reason, and where it fails with its line."""
    path = folder / "hopper.py"
    source = path.read_text()
    replace(path, (old, new))
    found = refusal(folder)
    at = source[: source.index(BUILD)].count("\n") + 1
    assert re.search(said.replace("AT", str(at)).replace("BELOW", str(at + 1)), found), found
    assert str(path) in found


@pytest.mark.parametrize(
    ("part", "value", "said"),
    [
        ("parameters", "K['parameters'] * 2", "parameter: the name 'mass' is used twice"),
        ("parameters", "(Parameter('a mass', 'kg', 'x'),)", "parameter: 'a mass' is not allowed; use letters"),
        ("parameters", "(Parameter('mass', 1, 'x'),)", "unit = 1 is not allowed; give a text"),
        ("signals", "(*K['signals'], signals.Signal('controller_1', 'x', 'm', 'x'))", "or controller_ at the beginning"),
        ("signals", "()", "signals = .* is not allowed; give a list in which each item is a signal"),
        ("on_demand", "(K['signals'][-1],)", "signal: the name 'control_force' is used twice"),
        ("wheels", "K['wheels'] * 2", "road_body of a wheel: the name 'road' is used twice"),
        (
            "wheels",
            "(Wheel('road', 'x', 'road_velocity', 'tyre_deflection'),)",
            "a wheel's road_displacement is 'x'",
        ),
        ("wheels", "(Wheel(**K['wheels'][0].__dict__ | {'behind': lambda p: -1}),)", "behind of a wheel = -1 is not allowed"),
        (
            "wheels",
            "(Wheel(**K['wheels'][0].__dict__ | {'behind': lambda p: p['l']}),)",
            r"behind of .* fails \(Key",
        ),
        ("combined", "{'x': {'tyre_deflection': 1.0}}", "combined is 'x', which is unknown; give one of control_force, "),
        (
            "people",
            "('tyre_deflection',)",
            "a point in people is 'tyre_deflection', which is unknown; give one of sprung_acceleration",
        ),
        ("suspended", "(Suspension('x', 'tyre'),)", "a suspension's deflection is 'x'"),
        ("suspended", "(Suspension('tyre_deflection', 'tyre', 'x'),)", "no input 'x', which is the force of a suspension"),
        ("suspended", "(Suspension('tyre_deflection', 'tyre', damping='x'),)", "damping is 'x', .* give one of mass, stiffness"),
        ("invariants", "(Invariant('z', ('x',), len, len),)", "a signal of the invariant 'z' is 'x'"),
        ("loads", "(BodyLoad('push', 'mass'),)", "a load is 'push', which is unknown; give one of heave_load, pitch_load"),
        ("loads", "(BodyLoad('heave_load', 'mass'),)", "the loads none; return, in this order, heave_load"),
        ("angles", "lambda p: {'pitch': {}}", "angles returns 'pitch' as a sum of none, which is not allowed"),
        ("linear_model", "None", "linear_model = None is not allowed; give a function"),
        ("check_together", "lambda p: p['x']", r"check_together fails \(KeyError: 'x'"),
    ],
)
def test_parts_that_do_not_fit(folder, part, value, said):
    """A part that is of another type, or refers to a name that the kind does not have, is one line with the file."""
    path = folder / "hopper.py"
    path.write_text(f"{path.read_text()}\n{OTHER}KIND = VehicleKind(**K | dict({part}={value}))\n")
    found = refusal(folder)
    assert re.search(said, found), found
    assert str(path) in found


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("</mujoco>", "", r"MuJoCo rejects this file \(.*XML"),
        ('site="sprung"', 'site="nowhere"', r"MuJoCo rejects this file \(.*nowhere"),
        (SENSOR, "", r"has no sensor 'sprung_velocity', which the equations of motion need"),
        (SENSOR, SENSOR.replace("1", "0"), r"user = \[0.0\] is not a direction"),
        (ROAD, '<body name="road">', r"has no mocap body 'road'"),
        ("</actuator>", '<motor joint="sprung"/></actuator>', r"has 2 actuators, but linear_model has 1 inputs"),
        ("</actuator>", '<motor name="fitted_1" joint="sprung"/></actuator>', r"reserved; rename the actuator 'fitted_1'"),
        ('<joint name="sprung" type="slide" axis="0 0 1"/>', '<freejoint name="sprung"/>', r"MJCF"),
        ('pos="0 0 .3"', 'pos="0 0 .25"', r"if the hub is too low, place the hub at least"),
    ],
)
def test_a_model_that_does_not_work(folder, old, new, said):
    """An MJCF that MuJoCo refuses, or that lacks a name of the equations, is one line with the file and the reason."""
    path = folder / "hopper.xml"
    replace(path, (old, new))
    found = refusal(folder)
    assert re.search(said, found), found
    assert str(path) in found


def test_actuators_have_their_inputs_names(folder):
    """A motor of another name than the input's would be some other force: it is refused, also where its sensor names it."""
    names = 'name="control_force" joint', 'actuator="control_force"'
    replace(folder / "hopper.xml", *((name, name.replace("control_force", "brake")) for name in names))
    said = "actuators 'brake', but linear_model has the inputs 'control_force'; use the same names in the same order"
    assert refusal(folder).endswith(said)


def test_own_refusal(folder):
    """The message of a kind's `check_together` is printed as it is, without a line of Python."""
    refuses = "def check_together(p):\n    raise InputError(f\"mass = {p['mass']:g} kg is too much\")\n\n\nKIND ="
    replace(
        folder / "hopper.py",
        ("import numpy as np", "from models import InputError"),
        ("KIND =", refuses),
        ("write_mjcf=write_mjcf,", "write_mjcf=write_mjcf, check_together=check_together,"),
    )
    assert refusal(folder) == f"vehicle file {folder / 'hopper.toml'}: mass = 200 kg is too much"


def test_a_late_mistake(folder):
    """Equations that fail or are wrong for other parameters alone are one line when these parameters come."""
    replace(folder / "hopper.py", (BUILD, f"{BUILD}\n    if p['mass'] > 300: return 1 / 0\n    if p['mass'] > 250: return 0"))
    vehicle = read_vehicle(folder / "hopper.toml")
    for mass, said in ((260.0, r"hopper.py: linear_model\(parameters\) = 0"), (310.0, r"linear_model fails \(ZeroDivisionError")):
        with pytest.raises(InputError, match=said):
            vehicle.with_parameters(mass=mass)


def test_what_it_prints_is_no_output(folder, capsys):
    """Prints of a kind, when it is read and when it is called, go to stderr: `--json` stays one JSON object."""
    replace(folder / "hopper.py", ("import numpy", "print('read')\nimport numpy"), (BUILD, f"{BUILD}\n    print('called')"))
    vehicle = str(folder / "hopper.toml")
    assert main(["--vehicle", vehicle, "--controller", "passive", "--duration", "1", "--no-logs", "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["runs"]
    assert {"read", "called"} <= set(printed.err.splitlines())


def test_parameters_stay(folder):
    """A function of the user's that changes its parameters changes a copy."""
    replace(folder / "hopper.py", (BUILD, f"{BUILD}\n    p['old'], p['mass'] = p.pop('mass'), 200.0"))
    vehicle = read_vehicle(folder / "hopper.toml")
    vehicle.kind.linear_model(vehicle.parameters)
    assert list(vehicle.parameters) == ["mass", "stiffness"]


@pytest.mark.parametrize("name", kinds())
def test_built_in_kinds_are_sound(name):
    """The built-in kinds pass the checks of custom ones."""
    vehicle = read_vehicle(name)
    check_parts(vehicle.kind)
    check_equations(vehicle.kind, vehicle.parameters)


SEATED = """
import numpy as np
from models import GRAVITY, LinearModel, Parameter, VehicleKind, Wheel, signals
from models.kinds.signals import Signal

OWN = [Signal("seat_travel", "z_p - z", "m", "seat"), Signal("seat_velocity", "z_p'", "m/s", "person")]
OWN.append(Signal("seat_acceleration", "z_p''", "m/s2", "person"))
STATES = ("seat_travel", "tyre_deflection", "seat_velocity", "sprung_velocity")

def linear_model(p):
    seat = np.array([p["k_p"], 0, p["c_p"], -p["c_p"]])
    person, body = -seat / p["m_p"], (seat - [0, p["k"], 0, 0]) / p["m"]
    A = np.vstack([[0, 0, 1, -1], [0, 0, 0, 1], person, body])
    B, Bw = np.array([[0, 0, 0, 1 / p["m"]]]).T, np.array([[0, -1.0, 0, 0]]).T
    C, D = np.vstack([np.eye(4), person, body, np.zeros(4)]), np.array([[0, 0, 0, 0, 0, 1 / p["m"], 1]]).T
    outputs = (*STATES, "seat_acceleration", "sprung_acceleration", "control_force")
    none = np.zeros((4, 1)), np.zeros((7, 1))
    return LinearModel(A, B, Bw, C, D, STATES, ("control_force",), ("road_velocity",), outputs, *none)

def static_tyre_deflection(p):
    return {"tyre_deflection": (p["m_p"] + p["m"]) * GRAVITY / p["k"]}

def write_mjcf(spec, p):
    spec.body("sprung").mass, spec.body("person").mass, seat = p["m"], p["m_p"], spec.tendon("seat")
    spec.tendon("tyre").stiffness[0], seat.stiffness[0], seat.damping[0] = p["k"], p["k_p"], p["c_p"]
    spec.tendon("tyre").springlength[0] = 0.3 + static_tyre_deflection(p)["tyre_deflection"]
    seat.springlength = [0.4 + p["m_p"] * GRAVITY / p["k_p"]] * 2

S = signals
KIND = VehicleKind(
    "hopper", tuple(Parameter(n, "1", n) for n in ("m_p", "m", "k_p", "c_p", "k")),
    (S.ROAD_DISPLACEMENT, S.ROAD_VELOCITY, S.TYRE_DEFLECTION, S.SPRUNG_VELOCITY, S.SPRUNG_ACCELERATION, S.CONTROL_FORCE, *OWN),
    (Wheel("road", "road_displacement", "road_velocity", "tyre_deflection"),), linear_model, static_tyre_deflection, write_mjcf,
)
"""
PERSON = """<body name="person" pos="0 0 .7"><joint name="person" type="slide" axis="0 0 1"/>
<inertial pos="0 0 0" mass="8" diaginertia="1 1 1"/><site name="person"/></body></worldbody>"""
SENSORS = """<tendonpos name="seat_travel" tendon="seat" user="1"/><jointvel name="seat_velocity" joint="person" user="1"/>
<framelinacc name="seat_acceleration" objtype="site" objname="person" user="0 0 1"/></sensor>"""


def test_the_ride_of_a_person_comes_first(folder, capsys):
    """A mass above the body has the ride of the vehicle, as an integral of its own over the road's spectrum has it.

    A line asks for its name, and a named point is used without that line.
    """
    (folder / "hopper.py").write_text(SEATED)
    seat = '<spatial name="seat" stiffness="1" springlength=".4"><site site="sprung"/><site site="person"/></spatial></tendon>'
    replace(folder / "hopper.xml", ("</worldbody>", PERSON), ("</tendon>", seat), ("</sensor>", SENSORS))
    numbers = "m_p = 80.0\nm = 300.0\nk_p = 15000.0\nc_p = 900.0\nk = 20000.0\n[performance]\nseat_acceleration = 1.0\n"
    (folder / "hopper.toml").write_text(f'type = "hopper"\n[parameters]\n{numbers}control_force = 1e-3\n')
    vehicle = ["--vehicle", str(folder / "hopper.toml"), "--controller", "passive"]
    assert synth([*vehicle, "--json"]) == 0
    printed = capsys.readouterr()
    found, road = json.loads(printed.out)["expected_ride"], Iso8608("C", speed=20.0).spectrum
    low, high = (rate / (2 * np.pi) for rate in road.band)
    f = np.linspace(low, high, 400_001)
    s = 2j * np.pi * f
    (m_p, m, k_p, c_p, k) = (80.0, 300.0, 15000.0, 900.0, 20000.0)
    seat = k_p + c_p * s
    over_road = k * seat / ((m_p * s**2 + seat) * (m * s**2 + seat + k) - seat**2)  # z_p / z_r
    weighted = np.abs(wk(2 * np.pi * f) * s * over_road) ** 2  # of the road's velocity, whose spectrum is flat
    assert found["passive"] == pytest.approx(np.sqrt(road.density * np.trapezoid(weighted, f)), rel=1e-6)
    assert list(found["points"]) == ["seat_acceleration", "sprung_acceleration"]
    assert "seat_acceleration is the acceleration of a mass above the body" in printed.err
    replace(folder / "hopper.py", ("write_mjcf,\n)", 'write_mjcf, people=("seat_acceleration",),\n)'))
    assert drive([*vehicle, "--class", "C", "--duration", "2", "--no-logs"]) == 0
    printed = capsys.readouterr()
    assert not printed.err
    assert re.search(r"ride, seat.+ride, sprung", prose(printed.out))
