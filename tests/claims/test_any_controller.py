"""Every command takes every kind of controller: it agrees, or says in one line why there is nothing of it to say."""

from pathlib import Path

import pytest

from models.kinds.kind import HERE
from sim.__main__ import COMMANDS
from tests.support.commands import attacks, in_the_suite, main_of, refused
from tests.support.drives import MAP

CAR = """
[controllers.best]
measured = ["suspension_deflection", "sprung_acceleration", "control_force"]
order = "full"

[controllers.lqg]
measured = ["suspension_deflection", "sprung_velocity"]
design = "lqg"

[controllers.told_its_force]
measured = ["sprung_velocity", "control_force"]
gain = [[-4000.0, 0.1]]

[controllers.goals]
measured = ["suspension_deflection", "sprung_velocity"]
minimise = { band = [4.0, 8.0] }
bounds = [{ norm = 8.5 }, { decay = 0.5 }, { gain = 2e4 }]

[controllers.first]
measured = ["sprung_velocity"]
order = 1

[controllers.pi]
measured = ["suspension_deflection"]
structure = "pi"

[controllers.pid]
measured = ["suspension_deflection"]
pid = { kp = -2000.0, ki = -500.0, kd = -200.0, filter = 0.02 }

[controllers.ahead]
design = "preview"
preview = 0.1

[controllers.python]
measured = ["sprung_velocity"]
law = "python.py:step"
"""
PYTHON = """
def step(sample, state):
    return -3000.0 * sample["sprung_velocity"][:, None], state
step.vectorised = True
"""
BUILT = """
[implementation]
sample_period = 0.008
noise = { sprung_velocity = 0.005 }

[controllers.sampled]
measured = ["suspension_deflection", "sprung_velocity"]
sampled = true

[controllers.sampled_full]
measured = ["suspension_deflection", "sprung_velocity"]
order = "full"
noise = true
sampled = true

[controllers.noisy]
measured = ["suspension_deflection", "sprung_velocity"]
order = "full"
noise = true

[controllers.discrete]
measured = ["suspension_deflection", "sprung_velocity"]
sample_period = 0.008
A = [[0.5]]
B = [[0.2, 0.1]]
C = [[100.0]]
D = [[8000.0, -1500.0]]

[controllers.slow]
measured = ["suspension_deflection"]
pid = { kp = -2000.0, ki = -5.0, kd = -200.0, filter = 0.02 }
"""
CONTROLLERS = [
    *(("car", name) for name in ("best", "lqg", "told_its_force", "goals", "pid", "ahead", "python")),
    *(("built", name) for name in ("sampled", "sampled_full", "noisy", "discrete")),
    ("quarter_car_accelerometer", "accelerometer"),
    ("quarter_car_semi_active", "skyhook"),
]
DESIGNED = [("car", "first"), ("car", "pi"), ("built", "slow")]  # a second each; laws with states as others, slow poles
SHORT = ["--no-logs", "--allow-unstable", "--timestep", "4e-3", "--duration"]
QUICK = {"synth": [], "sim.bump": [*SHORT, "0.2"], "sim.drive": [*SHORT, "0.4"], "sim.envelope": MAP}
LONG = {"sim.sweep": [], "sim.margins": [], "sim.report": ["--quick"]}  # at their own timestep, so that all of them agree
COARSE = {  # but some agree at 4 ms, too
    "sim.sweep": ("python", "skyhook", "slow"),
    "sim.margins": ("pid", "first", "sampled", "discrete", "slow", "accelerometer"),
}
CAMPAIGN = 'controllers = ["{}"]\nroads = ["bump"]\nspeeds = [10.0]\nduration = 0.2\nsettle = 0.1\ntimestep = 4e-3\n'
ALIKE_SLOW = ("sim.margins", "pi")  # a law with a slow pole as `slow` has, and as long as it
FED_BACK = ("sim.margins", "ahead")  # the margins of a gain: what is known ahead is taken out
SEEN_ELSEWHERE = {  # laws with states, or a gain that is sampled, as the rest there
    "sim.sweep": ("pid", "pi", "first", "sampled"),
    "sim.report": ("first", "pi", "sampled", "discrete"),
    "sim.margins": ("sampled_full",),
}
ALIKE = ("lqg", "told_its_force", "goals", "noisy")  # to commands that take long: states, or a gain, as others have
DRIVEN_ALIKE = ("sim.bump", "sim.envelope")  # they drive it as `sim.drive` does, which takes every controller
ALIKE_DRIVEN = (*ALIKE, "pid", "sampled", "discrete", "sampled_full")
ALIKE_TO = {each: ALIKE_DRIVEN for each in DRIVEN_ALIKE} | {"synth": ("sampled",), "sim.drive": ("noisy", "lqg")}
NO_CLAIM = {"synth", "sim.envelope", "sim.margins"}  # which have nothing to say of laws in Python and semi-active ones


@pytest.fixture(scope="module")
def vehicles(tmp_path_factory) -> Path:
    """The folder of a file for each vehicle."""
    folder = tmp_path_factory.mktemp("vehicles")
    paper = (HERE / "quarter_car.toml").read_text(encoding="utf-8")
    (folder / "python.py").write_text(PYTHON, encoding="utf-8")
    (folder / "car.toml").write_text(paper + CAR, encoding="utf-8")
    (folder / "built.toml").write_text(paper + BUILT, encoding="utf-8")
    for name in ("quarter_car_accelerometer.toml", "quarter_car_semi_active.toml"):
        (folder / name).write_text((HERE / name).read_text(encoding="utf-8"), encoding="utf-8")
    return folder


def takes(command: str, name: str, arguments: list[str]) -> None:
    """Holds that a command agrees, or refuses a controller of which it has nothing to say."""
    if command in NO_CLAIM and name in ("python", "skyhook"):
        why = r"^controller '\w+' is a .*, which has no linear loop; give a different"
        with refused(match=why):
            main_of(command)(arguments)
    else:
        assert main_of(command)(arguments) == 0


def test_no_command_is_forgotten():
    """All but those that take no controller are held below."""
    assert {*QUICK, *LONG, "sim.campaign", "sim.gallery", "sim.identify", "sim.inspect", "sim.new", "sim recommend"} == {
        name for name, _, _ in COMMANDS
    }


@pytest.mark.parametrize(
    ("command", "vehicle", "name"),
    [
        *((each, *one) for each in QUICK for one in CONTROLLERS if one[1] not in ALIKE_TO.get(each, ())),
        *attacks((each, *one) for each, alike in ALIKE_TO.items() for one in CONTROLLERS if one[1] in alike),
        *attacks(("synth", *one) for one in DESIGNED),
        *(
            pytest.param(each, *one, marks=pytest.mark.attack)
            for each in (*QUICK, *LONG)
            for one in DESIGNED
            if each != "synth" and (each, one[1]) != ALIKE_SLOW and one[1] not in SEEN_ELSEWHERE.get(each, ())
        ),
        *(
            pytest.param(each, *one, marks=pytest.mark.attack)
            for each in LONG
            for one in CONTROLLERS
            if one[1] not in (*ALIKE, *SEEN_ELSEWHERE[each]) and (each, one[1]) != FED_BACK
        ),
    ],
)
def test_every_command_takes_it(vehicles, tmp_path, monkeypatch, command, vehicle, name):
    """A controller that is designed, given, sampled, noisy, with preview, in Python or semi-active is driven and judged by every
    command alike."""
    monkeypatch.chdir(tmp_path)
    step = ["--timestep", "4e-3"] if name in COARSE.get(command, ()) else []
    takes(command, name, ["--vehicle", f"{vehicles / vehicle}.toml", "--controller", name, *(QUICK | LONG)[command], *step])


@pytest.mark.parametrize(
    ("vehicle", "name"),
    in_the_suite([one for one in CONTROLLERS if one[1] not in (*ALIKE_DRIVEN, "python")], [*CONTROLLERS, *DESIGNED]),
)
def test_a_campaign_takes_it(vehicles, tmp_path, vehicle, name):
    """So does a campaign, whose folder holds when it is verified."""
    pytest.importorskip("pyarrow", reason="needs the extra [campaign]")
    file = vehicles / f"{vehicle}_{name}.toml"
    file.write_text(f'vehicles = ["{vehicle}.toml"]\n{CAMPAIGN.format(name)}', encoding="utf-8")
    takes("sim.campaign", name, [str(file), "--results", str(tmp_path / "results"), "--workers", "1"])
    assert main_of("sim.campaign")([str(file), "--verify", str(tmp_path / "results"), "--runs", "1"]) == 0
