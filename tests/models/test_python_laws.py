"""Laws in Python: run as they are built, held against linear laws, logged and proved without being run, ended in one line."""

import hashlib
import io
import json
import os
import random
import signal
import subprocess
import sys
import time
from contextlib import redirect_stdout
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import linalg

import sim
from models.common.errors import InputError
from models.kinds.kind import HERE
from models.laws import python_runtime as running
from models.roads.road import Bump, RoadInput, under_wheels
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.linear.forced_response import forced_response
from sim.linear.sampled_response import sampled_response, taylor4
from sim.runs.run import sample_times
from synth.vehicle.designer import Designer
from tests.support.analysed import Runs, simulate
from tests.support.commands import attacks, environment, in_the_suite, main_of, prose
from tests.support.curved import DIGRESSIVE, with_curves
from tests.support.pages import site

GAIN = """
def step(sample, state):
    return 10825.2 * sample["suspension_deflection"] - 2069.5 * sample["sprung_velocity"], state
"""
MEASURED = ("suspension_deflection", "sprung_velocity")
SWITCHED = """
def step(sample, state):
    count = (state or 0) + 1
    return (400.0 if count % 300 > 150 else -300.0) - 2000.0 * sample["sprung_velocity"], count
"""
REALITIES = {
    "ideal": (Implementation(), Limits()),
    "slow": (Implementation(sample_period=0.004), Limits()),
    "late": (Implementation(sample_period=0.002, delay=3), Limits()),
    "noisy": (Implementation(delay=1, noise={"sprung_velocity": 0.01}, quantisation={"sprung_velocity": 0.001}), Limits()),
    "lagging": (Implementation(delay=1), Limits(actuator_bandwidth=60.0)),
}


def vehicle_of(folder: Path, law: str, kind: str = "quarter_car", measured=MEASURED, more: str = "", add: str = "") -> Path:
    """A vehicle file with a controller `mine` whose law has this text."""
    (folder / "mine.py").write_text(law, encoding="utf-8")
    names = ", ".join(f'"{name}"' for name in measured)
    entry = f'\n[controllers.mine]\nmeasured = [{names}]\nlaw = "mine.py:step"\n{more}\n'
    path = folder / "car.toml"
    path.write_text((HERE / f"{kind}.toml").read_text(encoding="utf-8") + entry + add, encoding="utf-8")
    return path


def driven(path: Path, name: str = "mine", vehicle: Vehicle | None = None, duration: float = 0.3) -> Runs:
    """A run of a vehicle file's controller."""
    vehicle = vehicle or read_vehicle(path)
    time = sample_times(vehicle, duration, 1e-3)
    return simulate(
        [vehicle], [vehicle.controllers[name].driver() if name == "mine" else Designer(vehicle).design(name)], [Bump()], time
    )


def refusal(path: Path, command: str = "sim.bump", *options: str) -> str:
    """Returns what a command says of a vehicle file's controller."""
    more = ["--no-logs", "--duration", "0.3"] if command == "sim.bump" else []
    with pytest.raises(InputError) as caught:
        main_of(command)(["--vehicle", str(path), "--controller", "mine", *more, *options])
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("reality", REALITIES)
def test_a_gain_in_python_is_that_gain(tmp_path, reality):
    """Written in Python, a gain drives as its linear law does, however it is built, to rounding."""
    path = vehicle_of(
        tmp_path,
        GAIN,
        add='[controllers.linear]\nmeasured = ["suspension_deflection", "sprung_velocity"]\ngain = [[10825.2, -2069.5]]\n',
    )
    vehicle = read_vehicle(path)
    how, limits = REALITIES[reality]
    built = replace(vehicle, implementation=how, limits=limits)
    ours, linear = (driven(path, name, built).response.run(0) for name in ("mine", "linear"))
    for name in vehicle.linear_model.outputs:
        # Sums are taken in another order: 1e-16 of the terms, which a loop that is stable does not pile up.
        assert np.abs(ours[name] - linear[name]).max() < 1e-10 * linear.scale(name)


COUNTED = "count = 0\ndef step(t, y):\n  global count\n  count += 1\n  return (10825.2 + count) * y[0] - 2069.5 * y[1]\n"


def step(sample, state):
    count = (state or 0) + 1
    return (10825.2 + count) * sample["suspension_deflection"] - 2069.5 * sample["sprung_velocity"], count


class Counting:
    """The same as an object, and as a method that measures every signal."""

    measured, count = MEASURED, 3

    def reset(self):
        self.count = 0

    def __call__(self, t, y):
        self.count += 1
        return (10825.2 + self.count) * y[0] - 2069.5 * y[1]

    def method(self, sample, state):
        return step(sample, state)


def test_a_function_is_the_law_of_its_file(tmp_path):
    """A function, closure, bound method or object that is run is, to the last bit, the same law in a file, in every run anew."""
    vehicle, own = read_vehicle(vehicle_of(tmp_path, COUNTED)), Counting()
    for noise in ({}, {"sprung_velocity": 0.01}):
        counting = Counting()
        counting.reset()  # as nobody does for a closure
        closure: Any = lambda t, y, counting=counting: counting(t, y)  # noqa: E731 - as one writes it in a notebook
        closure.measured = MEASURED
        built = replace(vehicle, implementation=Implementation(noise=noise))
        mine, *ours = sim.run(built, ["mine", own, closure, step, own.method], Bump(height=0.05), duration=0.2)
        assert [one.controller.name for one in ours] == ["Counting", "lambda", "step", "method"]
        assert all(np.array_equal(one.physics.values, mine.physics.values) and one.passed for one in ours)


@pytest.mark.parametrize(
    ("law", "said", "cause"),
    [
        ("law = lambda t, y: 1 / (t < 0.05)", r"'lambda': lambda\(t, y\) fails \(ZeroDivisionError: .*\) at 0.05 s", "Zero"),
        ("def law(time, y): return -3.0 * y", r"law\(sample, state\) fails \(TypeError: .*'NoneType'\) at 0 s", "TypeError"),
        ("def law(t, y): return y", r"the returned force has shape \(6,\); expected \(1,\)", "InputError"),
        ("def law(t, y): exit()", None, ""),
        (
            "def law(t, y): pass\nlaw.measured = ['nothing']",
            r"law.measured: unknown signal 'nothing'; measurable signals "
            "are",
            "",
        ),
    ],
)
def test_a_wrong_function_is_one_line(law, said, cause):
    """Whatever a function does wrong is one line that names it, with its own error as the cause; an exit is an exit."""
    exec(law, names := dict[str, Any]())
    with pytest.raises(InputError if said else SystemExit, match=said) as caught:
        sim.run(read_vehicle("quarter_car"), names["law"], Bump(), duration=0.1)
    assert cause in repr(caught.value.__cause__ or "")


def test_a_law_that_is_not_repeatable_is_no_disagreement(tmp_path):
    """Random numbers answer otherwise each time: that is no failure, but nothing is confirmed, and a warning says why."""
    path = vehicle_of(tmp_path, "import random\ndef step(sample, state): return random.random(), state\n")
    vehicle, noisy = read_vehicle(path), lambda t, y: random.random()
    with pytest.warns(UserWarning, match=r"controller '(mine|lambda)': agrees is None, as no command is compared") as warned:
        runs = sim.run(vehicle, ["mine", noisy], Bump(height=0.05), duration=0.3)
    assert len(warned) == 2
    for run in runs:
        assert run.passed
        assert run.agrees is None
        assert "no command is compared" in str(run)
        assert run.agreement.commands is not None
        assert not run.agreement.commands.repeatable


class Kept:
    """An object without `reset`, whose sum is in a closure in a closure."""

    def __init__(self):
        total = 0.0

        def summed(y):
            nonlocal total
            total += y[1]
            return total

        self.inner = lambda y: -summed(y)

    def __call__(self, t, y):
        return self.inner(y)

    def method(self, t, y):
        return self.inner(y)

    def inner_law(self):
        return lambda t, y: self.inner(y)


@pytest.mark.parametrize("law", [Kept(), Kept().inner_law(), *attacks([Kept().method, partial(Kept().method)])])
def test_a_law_starts_anew_in_every_run(law):
    """What a closure or an object keeps belongs to one run: the second run of the same one is the same, to the last bit."""
    vehicle, road = read_vehicle("quarter_car"), Bump(height=0.05)
    runs = [one for _ in range(2) for one in sim.run(vehicle, [law, law], road, duration=0.3)]
    assert all(one.agrees for one in runs)
    assert all(np.array_equal(one.physics.values, runs[0].physics.values) for one in runs)


@pytest.mark.parametrize(
    "vehicle", [read_vehicle("full_car"), with_curves(suspension_damping=DIGRESSIVE)], ids=["twisted", "bent"]
)
def test_the_response_to_the_forces_of_a_loop_is_that_of_the_loop(vehicle):
    """To forces that a linear law asked for, a vehicle responds as in its loop, exactly and as RK4 does."""
    controller = Designer(vehicle).design("I")
    road = RoadInput(vehicle, Bump(track="left"), sample_times(vehicle, 0.2, 2e-3))
    for exponential in (linalg.expm, taylor4):
        loop = sampled_response(controller, road, exponential)
        forces = np.stack([loop[name] for name in vehicle.linear_model.inputs], axis=-1)
        found = forced_response(forces, road, exponential)
        for name in vehicle.linear_model.outputs:
            assert np.abs(found[name] - loop[name]).max() < 1e-9 * loop.scale(name), name


def test_preview_is_the_road_ahead(tmp_path):
    """A law is told the heights under each wheel, now and at the next samples, also beyond the end of the run."""
    law = "def step(sample, state):\n    return sample.preview[:, -1] * 100 + sample.preview[:, 0], state\n"
    velocities = ("heave_velocity",)
    path = vehicle_of(tmp_path, law, "half_car", velocities, "preview = 0.3")
    vehicle = replace(read_vehicle(path), implementation=Implementation(sample_period=0.002))
    made = driven(path, vehicle=vehicle, duration=0.4)
    time, road = made.response.time, Bump()
    held = np.round(time / 0.002 - 0.25) * 0.002
    expected = 100 * under_wheels(road.displacement, road, vehicle, held + 0.3) + under_wheels(
        road.displacement, road, vehicle, held
    )
    np.testing.assert_allclose(made.requested_force[0], expected, atol=1e-9)


def test_vectorised_is_the_same_run_by_run(tmp_path):
    """Called for many runs at once, a law drives each as it would alone."""
    one = "def step(sample, state):\n    s = 0.9 * (0.0 if state is None else state) + sample['sprung_velocity']\n"
    one += "    return -500.0 * s * sample.parameters['sprung_mass'] / 500 - 200 * sample.preview[..., 0, 3], s\n"
    vehicles, roads = [], [Bump(height=0.01 * (i + 1)) for i in range(3)]
    responses = []
    for text in (
        one,
        one.replace("], s\n", "])[:, None], s\n").replace("return -500", "return (-500") + "step.vectorised = True\n",
    ):
        path = vehicle_of(tmp_path, text, more="preview = 0.1")
        vehicle = read_vehicle(path)
        mass = vehicle.parameters["sprung_mass"]
        vehicles = [replace(vehicle, parameters={**vehicle.parameters, "sprung_mass": mass * share}) for share in (1.0, 0.9, 1.2)]
        controller = vehicle.controllers["mine"].driver()
        responses.append(simulate(vehicles, [controller] * 3, roads, sample_times(vehicle, 0.6, 1e-3)).response.values)
    np.testing.assert_allclose(*responses, rtol=1e-12, atol=1e-12)  # numpy sums alike, but for its choice of instructions


def test_runs_do_not_know_of_one_another(tmp_path):
    """Names of a file's own, and lists that it is given, are one run's: the same alone and beside others, as a linear run is."""
    law = "calls = []\ndef step(sample, state):\n    calls.append(sample.time)\n    sample.y[:] = 7.0\n"
    law += "    sample.parameters.clear()\n    return -float(len(calls)), state\n"
    path = vehicle_of(tmp_path, law)
    vehicle = read_vehicle(path)
    mine, linear, time = vehicle.controllers["mine"].driver(), Designer(vehicle).design("I"), sample_times(vehicle, 0.3, 1e-3)
    together = simulate([vehicle] * 4, [*[mine] * 3, linear], [Bump()] * 4, time)
    alone = driven(path, duration=0.3)
    assert np.array_equal(together.requested_force[2], alone.requested_force[0])
    assert np.array_equal(alone.requested_force[0, :, 0], -np.arange(1.0, 302.0))
    assert np.array_equal(together.qpos[3], simulate([vehicle], [linear], [Bump()], time).qpos[0])


def test_documented_law_is_driven(tmp_path, capsys):
    """The law of its page, as it stands there, is driven and recorded, and agrees."""
    page = site("Write a control law in Python")
    (entry,), (text,) = page.blocks("toml"), page.blocks("python")
    (tmp_path / "skyhook.py").write_text(text, encoding="utf-8")
    car = tmp_path / "car.toml"
    car.write_text((HERE / "quarter_car.toml").read_text(encoding="utf-8") + "\n" + entry, encoding="utf-8")
    assert main_of("sim.bump")(["--vehicle", str(car), "--controller", "skyhook", "--duration", "1", "--no-logs", "-v"]) == 0
    said = prose(capsys.readouterr().out)
    assert "law in Python skyhook.py:step, with 0.5 s of road preview" in said
    assert "linear analysis does not apply (a law in Python)" in said
    assert "the exact linear response to the forces of the law" in said
    assert "every command equals the control law, to 0 of a peak" in said
    assert "norm" not in said


def log_of(folder: Path, law: str = SWITCHED, command: str = "sim.bump", *options: str) -> Path:
    """A log of a run of a law."""
    path = vehicle_of(folder, law, measured=("sprung_velocity",))
    arguments = ["--vehicle", str(path), "--controller", "mine", "--controller", "I", "--logs", str(folder / "logs")]
    with redirect_stdout(io.StringIO()):
        assert main_of(command)([*arguments, "--duration", "0.3", *options]) == 0
    (log,) = (folder / "logs").glob("*.mcap")
    return log


@pytest.mark.parametrize(
    "options", [("sim.bump", "--height", "0.02"), pytest.param(("sim.drive", "--class", "B"), marks=pytest.mark.attack)]
)
def test_log_proves_without_running_the_law(tmp_path, monkeypatch, capsys, options):
    """A log proves its physics, metrics and result from the forces that it has; the law, gone or hostile by now, is not run."""
    log = log_of(tmp_path, SWITCHED, *options)
    checksum = hashlib.sha256((tmp_path / "mine.py").read_bytes()).hexdigest()
    (tmp_path / "mine.py").unlink()
    monkeypatch.setattr(running, "runs_of", lambda *arguments: pytest.fail("it was run"))
    assert main_of("sim.inspect")([str(log), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    mine, linear = found["runs"]
    assert found["proves"]
    assert {"law": "mine.py:step", "norm": None, "bound": None, "stability": None}.items() <= mine["controller"].items()
    assert linear["controller"]["norm"] > 0
    assert any(one["verdict"] == "note" and "was not executed" in one["text"] for one in mine["findings"])
    assert mine["controller"]["sha256"] == checksum


def test_other_forces_or_another_text_in_a_log_are_found(tmp_path, monkeypatch):
    """Forces that were changed in a log, by a ten-millionth of a newton, or another text of the law, fail."""
    from sim.inspect import replay
    from sim.inspect.log import read_log
    from sim.inspect.proof import prove

    log = read_log(log_of(tmp_path, SWITCHED, "sim.bump", "--height", "0.02"))
    assert prove(log).holds
    forces = replay.read_forces
    monkeypatch.setattr(replay, "read_forces", lambda *arguments: forces(*arguments) + 1e-7)
    assert not prove(log).holds
    monkeypatch.undo()
    name = next(name for name in log.attachments if name.startswith("law-"))
    changed = replace(log, attachments={**log.attachments, name: log.attachments[name] + b"#"})
    assert any("sha256" in one.text for one in prove(changed).runs[0].findings if one.verdict == "FAILS")


def test_every_source_makes_its_driver(tmp_path):
    """A linear law, given or designed, is made by the caller's design; a law in Python and a semi-active law by themselves."""
    damped = '[controllers.sky]\nsemi_active = "skyhook"\n[actuators]\nkind = "damper"\nc_min = 300.0\nc_max = 4000.0\n'
    given = '[controllers.given]\nmeasured = ["sprung_velocity"]\ngain = [[-900.0]]\n'
    (tmp_path / "car.toml").write_text(vehicle_of(tmp_path, "raise SystemExit(3)\n").read_text() + given + damped)
    vehicle, made = read_vehicle(tmp_path / "car.toml"), {}
    for name in vehicle.controller_names:
        made[name] = vehicle.driver(name, str.upper, lambda: "text in a log")
    assert {name for name, driver in made.items() if driver == name.upper()} == {*vehicle.linear_names} >= {"state", "I", "given"}
    assert (made["mine"].source, made["mine"].name, made["mine"].linear, made["mine"].user_code) == (
        "text in a log",
        "mine",
        False,
        True,
    )
    assert (made["sky"].record["semi_active"], made["sky"].linear, made["sky"].user_code) == ("skyhook", False, False)
    for name in ("I", "given"):
        with pytest.raises(
            InputError, match=f"^controller '{name}' has a linear law that is not designed yet; design the controller with synth"
        ):
            vehicle.controllers[name].driver()
    entries = vehicle.controllers
    given = entries["given"].law
    assert given is not None
    assert (given.D.tolist(), entries["I"].law, entries["mine"].law) == ([[-900.0]], None, None)
    assert (entries["I"].request.two_steps, entries["given"].source.request, entries["sky"].source.request) == (True, None, None)


def test_text_of_a_vehicle_file_runs_nothing(tmp_path):
    """A vehicle file that is text alone names a law and reads none; nor does reading a file run it."""
    path = vehicle_of(tmp_path, "raise SystemExit(3)\n")
    alone = parse_vehicle(path.read_text(encoding="utf-8"))
    assert not alone.controllers["mine"].linear
    with pytest.raises(InputError, match="read from text"):
        alone.controllers["mine"].driver()
    assert read_vehicle(path).controllers["mine"].driver().name == "mine"
    assert "SystemExit: 3, line 1" in refusal(path)
    (tmp_path / "mine.py").unlink()
    assert "there is no such file" in refusal(path)


@pytest.mark.parametrize(
    ("law", "said"),
    [
        ("", "has no function 'step'"),
        ("step = 3", "has no function 'step'"),
        ("def step(sample:", r"its code is not valid Python \('\(' was never closed, line 1\); correct it"),
        (
            "def step(sample, state):\n  return [1][int(sample.time > 0.1)], state",
            "IndexError: list index out of range, line 2) at 0.101 s",
        ),
        (
            "import numpy as np\n\ndef step(sample, state): return np.ma.array([1.0], mask=True), state",
            "the returned force has masked values",
        ),
        ("def step(sample, state): return float('nan'), state", "not finite; return finite numbers) at 0 s"),
        ("def step(sample, state): return [1.0, 2.0], state", "the returned force has shape (2,); expected (1,)"),
        ("def step(sample, state): return 3.0", "the law returns 3.0, not two values"),
        ("def step(sample, state): return 'three', state", "the returned force is 'three', which is not a real number"),
        ("def step(sample, state): return 3j, state", "the returned force is a complex, which is not a real number"),
        ("def step(sample, state): return None, state", "the returned force is not finite"),
        ("def step(sample, state): return sample['nothing'], state", "not measure 'nothing'; it measures suspen"),
        ("def step(sample, state): raise SystemExit('bye')", "SystemExit: bye, line 1"),
        ("import os\ndef step(sample, state): os._exit(0)", "step ends its process (exit code 0) at 0 s; correct step"),
        ("def step(sample, state): raise KeyboardInterrupt", "step "),
        ("import os\ndef step(sample, state): os.kill(os.getpid(), 15)", "step "),
        ("import os\nos._exit(3)\n", "the file ends its process (exit code 3); correct the file"),
        ("async def step(sample, state): return 0.0, state", "the law returns a coroutine, not two values"),
        ("def step(sample, state): yield 0.0, state", "the law returns a generator, not two values"),
        ("def step(sample, state): return float(input()), state", "step fails (EOFError: EOF when reading a line, line 1)"),
        ("def step(sample, state): return 0.0, state\nstep.vectorised = 'no'", "step.vectorised is neither True nor False"),
        ("def step(sample, state): return 0.0, state\nstep.vectorised = 1", "step.vectorised is neither True nor False"),
        ("def step(sample): return 0.0, None", "TypeError: step() takes 1 positional argument but 2 were given"),
        ("def step(sample, state): raise BaseException('two\\nlines')", "BaseException: two lines, line 1"),
    ],
)
def test_what_is_wrong_with_it_is_one_line(tmp_path, law, said):
    """Whatever a law does is one line that names controller, law, line and time."""
    found = refusal(vehicle_of(tmp_path, law))
    assert found.startswith("controller 'mine', law mine.py:step: ")
    assert said.replace("\\", "") in found


def test_a_run_that_ends_at_once_agrees_with_nothing(tmp_path, capsys):
    """If there is no vehicle any more after one step, no comparison was made, and none is claimed to have come out well."""
    path = vehicle_of(tmp_path, "def step(sample, state):\n    return [1e300], state\n")
    assert main_of("sim.bump")(["--vehicle", str(path), "--controller", "mine", "--no-logs", "--duration", "0.1", "-v"]) == 1
    out = prose(capsys.readouterr().out)
    assert "NOTHING WAS COMPARED" in out
    assert "agrees" not in out.replace("DOES NOT AGREE", "")


def test_its_prints_go_to_stderr(tmp_path):
    """However a law writes to stdout, its output appears on stderr, and `--json` prints one JSON object."""
    law = "import os\ndef step(sample, state):\n  print('there')\n  os.write(1, b'raw\\n')\n  os.system('echo shell')\n"
    done = bump(vehicle_of(tmp_path, f"print('read')\n{law}  return 0.0, state\n"))
    assert done.returncode == 0
    assert json.loads(done.stdout)["runs"][0]["controller"]["norm"] is None
    assert sorted(done.stderr.split()) == sorted(["read", *["there", "raw", "shell"] * 11] * 2)  # again to check its commands


def test_linear_commands_leave_it_out(tmp_path, capsys):
    """Commands that are about linear claims say in one line why they cannot have it, and `all` is the others."""
    path = vehicle_of(tmp_path, GAIN)
    axes = ["--vary", "height:0.02:0.1:3", "--vary", "speed:5:20:3"]
    for command, options in {"synth": [], "sim.margins": [], "sim.envelope": axes}.items():
        said = "controller 'mine' is a law in Python, mine.py:step, which has no linear loop"
        assert refusal(path, command, *options).startswith(said)
    assert main_of("synth")(["--vehicle", str(path), "--controller", "all", "--json"]) == 0
    assert "mine" not in [one["name"] for one in json.loads(capsys.readouterr().out)["controllers"]]


def bump(path: Path, *options: str, **how: Any) -> "subprocess.CompletedProcess[str]":
    """The command that drives the law of a vehicle file for 10 ms, in a process of its own."""
    command = [sys.executable, "-m", "sim.bump", "--vehicle", str(path), "--controller", "mine", "--no-logs", "--json"]
    command += ["--duration", "0.01", *options]
    return subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=60, **how)


ENDLESS = {
    "a loop": "while True: pass",
    "a loop in C": "list(iter(int, 1))",
    "a sleep": "__import__('time').sleep(1000)",
    "a loop that catches all": "while True:\n        try:\n            while True: pass\n        except BaseException: pass",
}


@pytest.mark.parametrize("body", in_the_suite(["a loop in C", "a loop that catches all"], ENDLESS))
def test_a_call_that_takes_too_long(tmp_path, monkeypatch, body):
    """A law that does not return is ended, in Python's code or not. The line says which law, and after how long."""
    monkeypatch.setattr(running, "LONGEST", 0.2)
    found = refusal(vehicle_of(tmp_path, f"def step(sample, state):\n    {ENDLESS[body]}\n"))
    assert found == "controller 'mine', law mine.py:step: step takes longer than 0.2 s at 0 s; correct step"


@pytest.mark.skipif(os.name == "nt", reason="a Ctrl-C of POSIX")
def test_ctrl_c_ends_a_command_within_a_call(tmp_path):
    """Ctrl-C during a call that does not return ends the command immediately, with one line; the law does not receive it."""
    law = "def step(sample, state):\n    print('running')\n    while True:\n        try:\n            while True: pass\n"
    path = vehicle_of(tmp_path, f"{law}        except BaseException: print('caught')\n")
    command = [sys.executable, "-m", "sim.bump", "--vehicle", str(path), "--controller", "mine", "--no-logs"]
    process = subprocess.Popen(command, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    assert process.stderr.readline() == "running\n"
    process.send_signal(signal.SIGINT)
    sent = time.monotonic()
    assert process.communicate(timeout=60) == ("", "roadproof: interrupted\n")
    assert time.monotonic() - sent < 5.0  # the limit of the call is 10 s
    assert process.returncode == 130


SCRIPT = """
import multiprocessing
import models, sim

def forces(height):
    (run,) = sim.run(models.read_vehicle("car.toml"), ["mine"], models.Bump(height=height), duration=0.1)
    return run.physics.values.tolist()

high, low = forces(0.1), forces(0.05)
print("script", high != low)
if "fork" in multiprocessing.get_all_start_methods():
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.map(forces, [0.1, 0.05]) == [high, low]
"""


def test_a_script_needs_no_guard(tmp_path):
    """A script that runs the law of a file is not executed again in the law's process, and may fork. The law imports what the
    script can import.
    """
    (tmp_path / "mine_too.py").write_text("slope = -2069.5\n", encoding="utf-8")
    vehicle_of(tmp_path, "from mine_too import slope\ndef law(t, y): return slope * y[1]\nstep = law\n")
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    how: dict[str, Any] = {"cwd": tmp_path, "env": environment(), "capture_output": True, "text": True, "timeout": 100}
    done = subprocess.run([sys.executable, "script.py"], **how)
    assert (done.stdout, done.stderr) == ("script True\n", "")


def test_a_run_has_a_limit_too(tmp_path, monkeypatch):
    """A law of which every call is within its limit may not take for ever: its run has one, by its time on the road."""
    monkeypatch.setattr(running, "LONGEST", 0.2)
    monkeypatch.setattr(running, "SLOWEST", 5.0)
    slow = "import time\ndef step(sample, state):\n    time.sleep({})\n    return 0.0, state\n"
    found = refusal(vehicle_of(tmp_path, slow.format(0.02)))
    # 0.2 s, and 5 ms a call of which each takes 20 ms or, on a busy machine, more: over at the thirteenth call at the latest.
    assert "more than 10 s plus 100 times the simulated time at 0.0" in found  # the words are those of the limits as they are
    driven(vehicle_of(tmp_path, slow.format(0.001)), duration=0.2)
