"""A kind of vehicle of the user's own: its three files work beside one another, and whatever is wrong with one is one line."""

import copy
import json
import os
import pickle
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from models.common.errors import InputError
from models.common.files import TEXT
from models.kinds.user_kind import wrong_angles, wrong_distance, wrong_linear_model, wrong_parts, wrong_place, wrong_rest
from models.vehicle.vehicle import kinds, read_vehicle
from sim.bump import main
from tests.commands import environment
from tests.damaged_kinds import damages
from tests.pages import hopper

BUILD = "def linear_model(p):"
SENSOR = '<jointvel name="sprung_velocity" joint="sprung" user="1"/>'
ROAD = '<body name="road" mocap="true">'


@pytest.fixture
def folder(tmp_path):
    """The hopper of its page."""
    return hopper(tmp_path).parent


def refusal(folder: Path) -> str:
    """Returns what the command says of the vehicle."""
    with pytest.raises(InputError) as caught:
        main(["--vehicle", str(folder / "hopper.toml"), "--controller", "passive", "--duration", "1", "--no-logs"])
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_it_works(folder):
    """As the page has them, they do."""
    assert main(["--vehicle", str(folder / "hopper.toml"), "--controller", "passive", "--duration", "1", "--no-logs"]) == 0


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
        ("import numpy as np", "1 / 0", r"fails \(ZeroDivisionError: division by zero, line 1\)"),
        ("import numpy as np", "import nothing_of_that_name", r"fails \(ModuleNotFoundError: .*nothing_of_that_name.*line 1\)"),
        ("import numpy as np", "raise SystemExit(3)", r"fails \(SystemExit: 3, line 1\)"),
        ("import numpy as np", "raise ValueError('two\\nlines')", r"ValueError: two lines"),
        (BUILD, "def linear_model(p:", r"is not Python \(.*line AT\)"),
        ("KIND = VehicleKind(", "OTHER = VehicleKind(", r"it has no KIND; end it with KIND = VehicleKind"),
        ("KIND = VehicleKind(", "KIND = dict(", r"its KIND is a dict"),
        ('name="hopper"', 'name="jumper"', r"its KIND is called 'jumper'; call it 'hopper'"),
        (BUILD, f"{BUILD}\n    p['weight']", r"linear_model fails \(KeyError: 'weight', line BELOW\)"),
        (BUILD, f"{BUILD}\n    return None", r"linear_model gives a NoneType, not a LinearModel"),
        ("np.array([[-1], [0]])", "np.array([[-1]])", r"linear_model fails \(Bw has shape \(1, 1\)"),
        ('return {"tyre', 'return 0, {"tyre', r"static_tyre_deflection gives a tuple, not a mapping from each tyre's signal"),
        ('spec.body("sprung")', 'spec.body("nobody")', r"write_mjcf fails \(AttributeError: .*line \d+\)"),
    ],
)
def test_equations_that_do_not_work(folder, old, new, said):
    """Python that fails, at once or later, is no Python, or has no KIND: one line with the file, the reason and its line."""
    path = folder / "hopper.py"
    source = path.read_text()
    assert old in source
    path.write_text(source.replace(old, new, 1))
    found = refusal(folder)
    at = source[: source.index(BUILD)].count("\n") + 1
    assert re.search(said.replace("AT", str(at)).replace("BELOW", str(at + 1)), found), found
    assert str(path) in found


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("</mujoco>", "", r"MuJoCo does not take it \(.*XML"),
        ("<mujoco model", "<mojoco model", r"MuJoCo does not take it"),
        ('site="sprung"', 'site="nowhere"', r"MuJoCo does not take it \(.*nowhere"),
        (SENSOR, "", r"has no sensor 'sprung_velocity', which the equations name"),
        (ROAD, '<body name="road">', r"has no mocap body 'road'"),
        ('<actuator><motor name="control_force" joint="sprung"/></actuator>', "", r"MJCF"),
        ("</actuator>", '<motor joint="sprung"/></actuator>', r"has 2 actuator\(s\), and the equations 1"),
        ("</actuator>", '<motor name="fitted_1" joint="sprung"/></actuator>', r"actuator 'fitted_1'; call it otherwise"),
    ],
)
def test_a_model_that_does_not_work(folder, old, new, said):
    """An MJCF that is none, or lacks what the equations name: one line with the file and the reason."""
    path = folder / "hopper.xml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    found = refusal(folder)
    assert re.search(said, found), found
    assert str(path) in found


@pytest.mark.parametrize("suffix", ["py", "xml"])
@pytest.mark.parametrize(("kind", "said"), [("pipe", "is a pipe"), ("folder", "is a folder"), ("huge", "too large")])
def test_what_is_no_plain_file(folder, suffix, kind, said):
    """A pipe is not waited for, a folder is none, and what is huge is not read."""
    path = folder / f"hopper.{suffix}"
    path.unlink()
    if kind == "pipe":
        if not hasattr(os, "mkfifo"):
            pytest.skip("pipes of POSIX")
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        with path.open("wb") as file:
            file.truncate(TEXT + 1)
    assert said in refusal(folder)


@pytest.mark.parametrize("damage", list(damages()), ids=lambda damage: f"{damage.suffix}: {damage.what}")
def test_damaged_kinds(folder, damage, capfd, monkeypatch):
    """Whatever a kind hands in that is no vehicle's is refused in one line that names the file and the function, before it runs.

    Nothing else is printed or written.
    """
    monkeypatch.chdir(folder)
    path = folder / f"hopper.{damage.suffix}"
    text = path.read_text()
    assert damage.old in text
    path.write_text(text.replace(damage.old, damage.new, 1) if damage.old else f"{text}\n{damage.new}")
    found = refusal(folder)
    assert re.search(damage.said, found), found
    assert str(folder) in found
    assert len(found) < 500
    assert capfd.readouterr() == ("", "")
    assert sorted(one.name for one in folder.iterdir()) == ["hopper.py", "hopper.toml", "hopper.xml"]


def test_actuators_have_their_inputs_names(folder):
    """A motor of another name than the input's would be some other force: it is refused, also where its sensor names it."""
    path = folder / "hopper.xml"
    text = path.read_text().replace('motor name="control_force"', 'motor name="brake"')
    path.write_text(text.replace('actuator="control_force"', 'actuator="brake"'))
    said = "its actuators are 'brake', and the inputs of the equations 'control_force'; name them alike, in the same order"
    assert refusal(folder).endswith(said)


def test_own_refusal(folder):
    """A kind's `check_together` speaks as it is, without a line of Python."""
    path = folder / "hopper.py"
    refuses = "def check_together(p):\n    raise InputError(f\"mass = {p['mass']:g} kg is too much\")\n\n\nKIND ="
    text = (
        path.read_text()
        .replace("KIND =", refuses)
        .replace("write_mjcf=write_mjcf,", "write_mjcf=write_mjcf, check_together=check_together,")
    )
    path.write_text(f"from models.common.errors import InputError\n{text}")
    assert refusal(folder) == f"vehicle file {folder / 'hopper.toml'}: mass = 200 kg is too much"


def test_what_it_prints_is_no_output(folder, capsys):
    """Prints of a kind, when it is read and when it is called, go to stderr: `--json` stays one JSON object."""
    path = folder / "hopper.py"
    path.write_text("print('read')\n" + path.read_text().replace(BUILD, f"{BUILD}\n    print('called')"))
    vehicle = str(folder / "hopper.toml")
    assert main(["--vehicle", vehicle, "--controller", "passive", "--duration", "1", "--no-logs", "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["runs"]
    assert {"read", "called"} <= set(printed.err.splitlines())


def test_parameters_stay(folder):
    """A function of the user's that changes the parameters it is given changes a copy."""
    path = folder / "hopper.py"
    path.write_text(path.read_text().replace(BUILD, f"{BUILD}\n    p['old'], p['mass'] = p.pop('mass'), 200.0"))
    vehicle = read_vehicle(folder / "hopper.toml")
    vehicle.kind.linear_model(vehicle.parameters)
    assert list(vehicle.parameters) == ["mass", "stiffness"]


def test_angles_are_finite_sums_of_signals():
    """An angle of the body is a sum of the kind's signals with finite factors; what is not both is refused."""
    kind = read_vehicle("half_car").kind
    known = kind.signals[0].name
    assert not wrong_angles({"pitch_angle": {known: -0.5}}, kind)
    for angles in ({"pitch_angle": {"nothing": 0.5}}, {"pitch_angle": {known: np.nan}}, {"yaw_angle": {known: 0.5}}):
        assert "give {'pitch_angle': {signal: factor}}" in wrong_angles(angles, kind)


@pytest.mark.parametrize("name", kinds())
def test_those_that_ship_are_sound(name):
    """The kinds that ship pass the door that the user's own go through."""
    vehicle = read_vehicle(name)
    kind = vehicle.kind
    assert not wrong_parts(kind)
    assert not wrong_linear_model(kind.linear_model(vehicle.parameters), kind)
    assert not wrong_rest(kind.static_tyre_deflection(vehicle.parameters), kind)
    assert not any(wrong_distance(wheel.behind(vehicle.parameters)) for wheel in kind.wheels)
    assert not any(wrong_place(wheel.lateral(vehicle.parameters)) for wheel in kind.wheels)
