"""Wrong inputs of every command, from its options to its files: one line, exit code 2, and nothing is lost."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from models.vehicle.vehicle import read_vehicle
from tests.support.commands import environment
from tests.support.pages import hopper

CAR = "sim.bump --vehicle car.toml --controller mine"
DRIVE = "sim.drive --controller passive"
MAP = "sim.envelope --controller I --vary speed:5:20:2 --vary"
CAMPAIGN = "sim.campaign campaign.toml"
SUITE = [  # command line; what is edited in which file, if anything; a word of the message
    ("sim.bump --controller III", "", "'III'"),
    ('sim.bump --controller I --height "60 kg"', "", "kg"),
    (CAR, "car.toml: 504.5 -> -504.5", "sprung_mass"),
    (CAR, "car.toml: [[1.0]] -> [[1.0, 2.0]]", "gain"),
    (DRIVE + " --road road.csv", "road.csv: 0.01 -> x", "'x'"),
    (DRIVE + " --load load.csv", "load.csv: heave [N] -> heave [kg]", "kg"),
    (DRIVE + " --road rig:file=drive.csv --csv drive.csv", "", "is an input file"),
    (CAMPAIGN, 'campaign.toml: "mine" -> "yours"', "yours"),
    ("sim.inspect empty.mcap", "", "empty.mcap"),
    ("synth --check car.toml --refine", "", "--check"),
    ("sim.report --out page.pdf", "", "page.pdf"),
]
ATTACKS = [
    ("sim.bump --controller I --timestep 1", "", "timestep"), ("sim.bump --controller I --picture out.gif", "", "out.gif"),
    ("sim.bump --vehicle hopper.toml --controller passive", "hopper.xml: <mujoco -> <robot", "hopper.xml"),
    ("sim.bump --vehicle hopper.toml --controller passive", "hopper.py: KIND -> KINDS", "KIND"),
    ("sim.bump --vehicle law.toml --controller mine", "law.py: def step -> def stop", "step"),
    ("sim.bump --controller I --speed -5", "", "speed = -5"), (CAR, 'car.toml: 504.5 -> "504.5 N"', "sprung_mass"),
    (CAR, "car.toml: 504.5 -> nan", "sprung_mass"), (CAR, "car.toml: sprung_mass -> spring_mass", "spring_mass"),
    (CAR, "car.toml: 504.5 -> 504.5 kg", "car.toml"), (CAR, 'car.toml: ["sprung_velocity"] -> ["speed"]', "'speed'"),
    (DRIVE + " --class Q", "", "'Q'"), (DRIVE + " --road bump:high=0.1", "", "high"),
    (DRIVE + " --road nowhere.csv", "", "nowhere.csv"), (DRIVE + " --road road.csv", "road.csv: 2, -> 0.5,", "road.csv"),
    (DRIVE + " --road road.csv", "road.csv: height [m] -> height [furlong]", "furlong"), (DRIVE + " --load push", "", "'push'"),
    (DRIVE + " --load load.csv", "load.csv: time [s] -> time", "unit"), ("sim.sweep --picture nowhere/a.png", "", "nowhere"),
    ("sim.campaign nowhere.toml", "", "nowhere.toml"), (CAMPAIGN, 'campaign.toml: 1.0 -> "long"', "duration"),
    (CAMPAIGN, 'campaign.toml: ["bump"] -> ["mud"]', "mud"), (CAMPAIGN, "campaign.toml: [20.0] -> [-20.0]", "speed"),
    ("sim.gallery moon", "", "'moon'"), ("sim.inspect car.toml", "", "car.toml"), ("sim.new car.toml", "", "car.toml"),
    ("synth --vehicle car.toml --save car.toml", "", "car.toml"),
    ("synth --vehicle car.toml --controller mine", "car.toml: gain = -> gian =", "gian"),
    ("sim.report --controller nobody", "", "'nobody'"), (CAMPAIGN, "campaign.toml: duration -> durations", "durations"),
    ("sim.campaign --verify nowhere", "", "nowhere"), ("sim.inspect nowhere.mcap", "", "nowhere.mcap"),
    (DRIVE + " --road road.csv --csv road.csv", "", "is an input file"), (DRIVE + " --road pothole:depth=60", "", "-10 to 10 m"),
    (DRIVE + " --road 'flat + load.csv' --csv load.csv", "", "is an input file"),
    (MAP + " height:0.1:0.2:2 --load load.csv --csv load.csv", "", "is an input file"),
]  # fmt: skip
FILES = {
    "law.py": "def step(sample, state):\n    return 0.0, state\n",
    "campaign.toml": 'vehicles = ["car.toml"]\ncontrollers = ["mine"]\nroads = ["bump"]\nspeeds = [20.0]\nduration = 1.0\n',
    "road.csv": "distance [m],height [m]\n0,0\n1,0.01\n2,0\n",
    "load.csv": "time [s],heave [N]\n0,0\n1,100\n",
    "drive.csv": "time [s],road_displacement [mm]\n0,0\n1,5\n2,0\n3,1\n",
    "empty.mcap": "",
}
# Every command in a folder of its own, all in one process: their imports take longer than they do.
RUNNER = """
import contextlib, io, json, os, runpy, sys
for folder, command, *sys.argv[1:] in json.load(sys.stdin):
    os.chdir(folder)
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        try:
            code = runpy.run_module(command, None, "__main__", True) and None
        except SystemExit as ended:
            code = ended.code
    print(json.dumps([code, out.getvalue(), err.getvalue()]), file=sys.__stdout__, flush=True)
"""


def files(folder: Path) -> dict[str, bytes]:
    """Everything below a folder."""
    return {str(path): path.read_bytes() if path.is_file() else b"" for path in folder.rglob("*")}


@pytest.mark.parametrize("rows", [SUITE, pytest.param(ATTACKS, marks=pytest.mark.attack)], ids=["some", "more"])
def test_wrong_inputs(rows, tmp_path):
    """A wrong option or file is refused with exit code 2 and one line that names it; nothing is printed, written or lost."""
    calls, before, text = [], {}, read_vehicle("quarter_car").text + '\n[controllers.mine]\nmeasured = ["sprung_velocity"]\n'
    cars = {"car.toml": f"{text}gain = [[1.0]]\n", "law.toml": f'{text}law = "law.py:step"\n'}
    for i, (line, edit, _) in enumerate(rows):
        folder = tmp_path / str(i)
        folder.mkdir()
        for name, content in (cars | FILES).items():
            (folder / name).write_text(content)
        hopper(folder)
        if edit:
            name, old, new = re.split(": | -> ", edit, maxsplit=2)
            content = (folder / name).read_text()
            assert old in content
            (folder / name).write_text(content.replace(old, new, 1))
        before[folder] = files(folder)
        calls.append([str(folder), *shlex.split(line)])
    child = [sys.executable, "-W", "ignore", "-c", RUNNER]
    done = subprocess.run(child, input=json.dumps(calls), capture_output=True, text=True, env=environment(), check=True)
    for (folder, *line), said, (_, edit, word) in zip(calls, done.stdout.splitlines(), rows, strict=True):
        code, out, err = json.loads(said)
        assert (code, out, err.count("\n")) == (2, "", 1), (line, edit, code, out, err)
        assert err.startswith("roadproof: "), (line, edit, err)
        assert word in err, (line, edit, err)
        assert files(Path(folder)) == before[Path(folder)], (line, edit)
