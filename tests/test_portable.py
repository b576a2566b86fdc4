"""Python is all that it needs: no source counts on what only one system has, on its paths, or on its encoding."""

import ast
import json
import os
import subprocess
import sys

import pytest

from tests.commands import ROOT
from tests.sources import of_one_system, sources

# The one path of POSIX, which is only ever compared with what the user gave.
KNOWN = {
    ("models/common/files.py", "/dev/stdout"),
}


def test_no_source_counts_on_a_system():
    """No module, function, signal or path that Linux, macOS or Windows lacks; no text in the system's own encoding."""
    assert {(own, one) for own, source in sources().items() for one in source.of_one_system} - KNOWN == set()


@pytest.mark.parametrize(
    "source",
    [
        "import fcntl",
        "def f():\n    from resource import getrusage",
        "import os\nos.killpg(1, 2)",
        "from os import fork",
        "import signal\nsignal.SIGKILL",
        "open('/proc/self/status')",
        "path.write_text('x')",
        "open(path, 'w')",
        "path.open('w', encoding='utf-8')",
    ],
)
def test_the_walk_sees_it(source):
    """The walk finds what it is for."""
    assert [*of_one_system([*ast.walk(ast.parse(source))])]


# Runs commands as if an extra's package were not installed, each with our own modules imported anew.
WITHOUT = """
import contextlib, io, json, runpy, sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == package:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Missing())
found = []
for package, module, *rest in json.loads(sys.argv[1]):
    for name in [name for name in sys.modules if name.split(".")[0] in (package, "models", "synth", "sim")]:
        del sys.modules[name]
    sys.argv = [module, *rest]
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        try:
            runpy.run_module(module, run_name="__main__")
        except SystemExit as exit:
            found.append((exit.code, out.getvalue(), err.getvalue()))
print(json.dumps(found))
"""
MAP = ["--vary", "height:0.1:0.2:2", "--vary", "speed:5:9:2"]
EXTRAS = [  # a package, its extra, and a command that needs it
    ("matplotlib", "report", ["sim.sweep", "--controller", "passive", "--picture", "x.png"]),
    ("contourpy", "report", ["sim.report"]),
    ("ray", "cluster", ["sim.campaign", "campaign.toml", "--ray", "auto"]),
    ("pyopencrg", "opencrg", ["sim.drive", "--controller", "passive", "--road", "road.crg"]),
]
MORE_EXTRAS = [  # asked for in the same way
    ("matplotlib", "report", ["sim.envelope", "--controller", "passive", *MAP, "--picture", "x.png"]),
    ("matplotlib", "report", ["sim.margins", "--controller", "I", "--picture", "x.svg"]),
    ("jinja2", "report", ["sim.report"]),
]


@pytest.mark.parametrize("extras", [EXTRAS, pytest.param(MORE_EXTRAS, marks=pytest.mark.attack)], ids=["some", "others"])
def test_an_extra_is_asked_for_by_name(tmp_path, extras):
    """Without an extra's packages a command that needs them says in one line how to install them, before any work."""
    (tmp_path / "road.crg").touch()
    (tmp_path / "campaign.toml").write_text(
        'vehicles = ["quarter_car"]\ncontrollers = ["passive"]\nroads = ["bump"]\nspeeds = [10.0]\nduration = 1.0\nsettle = 0.0\n'
    )
    cases = json.dumps([[package, *arguments] for package, _, arguments in extras])
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", WITHOUT, cases]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert len(found) == len(extras)
    for (code, out, err), (package, extra, arguments) in zip(found, extras, strict=True):
        assert (code, out) == (2, ""), (package, arguments, err)
        assert err.count("\n") == 1, (package, arguments, err)
        assert f"[{extra}]" in err, (package, arguments)


@pytest.mark.attack
def test_no_graphics_are_needed(tmp_path):
    """Whatever the environment says of MuJoCo's graphics, a command runs: it draws nothing by them."""
    arguments = [sys.executable, "-m", "sim.bump", "--controller", "passive", "--duration", "0.1", "--no-logs"]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MUJOCO_GL": "none that there is"}
    done = subprocess.run(arguments, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


BLAS = """
import sys
sys.argv = ["-m"]  # as Python's own start says while it imports a command's package
import {package}, numpy, scipy.linalg, threadpoolctl
print({{one["num_threads"] for one in threadpoolctl.threadpool_info() if one["user_api"] == "blas"}})
"""


@pytest.mark.parametrize("package", ["sim", pytest.param("synth", marks=pytest.mark.attack)])
def test_a_command_has_one_thread_of_blas(package):
    """All its libraries have, whichever is loaded when: more only wait for each other."""
    environment = {key: value for key, value in os.environ.items() if "NUM_THREADS" not in key}
    environment |= {"PYTHONPATH": str(ROOT), "PYTHONUTF8": "1"}
    done = subprocess.run([sys.executable, "-c", BLAS.format(package=package)], env=environment, capture_output=True, text=True)
    assert (done.stdout, done.stderr) in (("{1}\n", ""), ("set()\n", ""))  # macOS's own library tells nobody how many
