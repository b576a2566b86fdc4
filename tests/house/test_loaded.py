"""A command loads what it does: each number here is of the command's own process, so what a test has imported does not count."""

import subprocess
import sys

import pytest

from models.roads.loads.load import LOADS
from models.roads.obstacles import OBSTACLES
from models.vehicle.names import LOAD_KINDS, ROAD_KINDS
from sim.__main__ import COMMANDS
from tests.support.commands import in_the_suite
from tests.support.pages import ROOT
from tests.support.sources import sources

# Each takes from a thirtieth of a second to two seconds to import. What a command has to do with it may load, and no other.
MAIN = "sim.bump --controller I --no-logs --json"
HEAVY = {
    *("scipy.fft", "scipy.interpolate", "scipy.optimize", "scipy.signal", "scipy.sparse", "scipy.spatial", "scipy.special"),
    *("scipy.stats", "control", "cvxpy", "google", "matplotlib", "mcap", "mujoco", "pandas", "pyarrow", "ray", "rerun"),
}
# Of each command: how many of our modules it may load, packages among them, and what of the above.
# `sim.observers.steps` compares runs step by step, with equations of `models.kinds.rigid_motion`, for one wheel of `rigid_body`.
LOADED = {
    "synth --json": (112, {"scipy.fft", "scipy.optimize", "scipy.sparse", "scipy.spatial", "scipy.special"}),
    "sim.bump --controller I --duration 0.5 --logs DIR": (151, {"google", "mcap", "mujoco", "pandas", "pyarrow", "rerun"}),
    "sim.bump --controller I --no-logs --json": (127, {"mujoco"}),
    "sim.bump --controller I --vehicle full_car --duration 0.5 --no-logs --json": (129, {"mujoco"}),
    "sim.drive --controller I --duration 1 --no-logs --json": (159, {"mujoco", "scipy.special"}),
    "sim.sweep --controller I --timestep 4e-3 --json": (
        135,
        {"mujoco", "scipy.fft", "scipy.optimize", "scipy.sparse", "scipy.spatial", "scipy.special"},
    ),
}
MOST_LINES = 13_510  # of our code that the main command loads, without docstrings, comments and blank lines
HELP = 36  # of our modules, for all the help pages together, beside one for each command; studies have their options in another


def loaded(code: str) -> set[str]:
    """The modules that a process has loaded in the end."""
    run = subprocess.run(
        [sys.executable, "-c", f"import atexit, sys; atexit.register(lambda: print('\\nloaded', *sys.modules)); {code}"],
        capture_output=True,
        text=True,
        check=True,
    )
    found = set(run.stdout.rsplit("\nloaded ", 1)[1].split())
    assert "argparse" in found
    return found


def lines_of(module: str) -> int:
    """Returns the lines of code of a module of ours, or of the `__init__` of a package."""
    path = module.replace(".", "/")
    return sources()[f"{path}/__init__.py" if (ROOT / path).is_dir() else f"{path}.py"].code_lines


def own(modules: set[str]) -> list[str]:
    """Returns those of ours."""
    return sorted(name for name in modules if name.split(".")[0] in ("models", "synth", "sim"))


@pytest.mark.parametrize("command", in_the_suite([*LOADED][:3:2], LOADED))
def test_a_command_loads_what_it_does(command, tmp_path):
    """No command waits for a package that it has no use for, nor for methods, readers and roads that nobody asked it for."""
    arguments = command.replace("DIR", str(tmp_path)).split()
    found = loaded(f"import runpy; sys.argv = {arguments}; runpy.run_module(sys.argv[0], None, '__main__', True)")
    most, heavy = LOADED[command]
    assert len(own(found)) <= most, own(found)
    if command == MAIN:
        assert sum(lines_of(name) for name in own(found)) <= MOST_LINES
    assert found & HEAVY <= heavy


def test_help_pages_wait_for_nothing():
    """The help pages of all commands load numpy no more than what is heavier, and little of ours."""
    names = [name for name, *_ in COMMANDS]
    names = [f"{name}.__main__" if (ROOT / name.replace(".", "/")).is_dir() else name for name in names]
    code = f"""
import contextlib, importlib, io
for name in {names}:
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()) as page:
        module, _, study = name.partition(" ")
        importlib.import_module("sim.command.study" if study else module).main(*filter(None, [study]), ["--help"])
    assert "exit code" in page.getvalue(), name
"""
    found = loaded(f"exec({code!r})")
    assert not found & (HEAVY | {"numpy", "scipy"})
    assert len(own(found)) <= HELP + len(COMMANDS), own(found)


def test_help_pages_name_every_kind():
    """Help pages name all kinds of roads and loads."""
    assert ("iso8608", *OBSTACLES, "rig") == ROAD_KINDS
    assert tuple(LOADS) == LOAD_KINDS
