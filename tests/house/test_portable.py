"""Commands run on any machine that has Python: from any folder, with any letters in names, without the packages of extras."""

import json
import subprocess
import sys

from models.kinds.kind import HERE
from tests.support.commands import environment


def test_names_and_folders(tmp_path):
    """A command runs without warnings from any folder, with spaces and letters of other scripts in names, in the C locale."""
    folder = tmp_path / "mein Auto é Ы"
    folder.mkdir()
    text = (HERE / "quarter_car.toml").read_text(encoding="utf-8").partition("[controllers.")[0]
    controller = '[controllers."Жук"]\nmeasured = ["sprung_velocity"]\ngain = [[-8970.3]]\n'
    (folder / "das Auto.toml").write_text(text + controller, encoding="utf-8")
    options = ("--vehicle", "das Auto.toml", "--controller", "Жук", "--duration", "0.1", "--logs", "журнал 1")
    command = [sys.executable, "-W", "error", "-m", "sim.bump", *options]
    kept = {name: value for name, value in environment().items() if not name.startswith(("LC_", "LANG", "PYTHONUTF8"))}
    ran = subprocess.run(command, cwd=folder, env=kept | {"LC_ALL": "C"}, capture_output=True, check=False)
    assert (ran.returncode, ran.stderr.decode()) == (0, "")
    assert "Жук: norm" in ran.stdout.decode()
    assert [path.name for path in (folder / "журнал 1").glob("*Жук*.mcap")]


# Runs commands as if some packages were not installed. Our own modules are imported again when others are missing.
WITHOUT = """
import contextlib, io, json, runpy, sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in missing:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Missing())
found, missing = [], []
for packages, module, *rest in json.loads(sys.argv[1]):
    for name in [n for n in sys.modules if packages != missing and n.split(".")[0] in [*packages, "models", "synth", "sim"]]:
        del sys.modules[name]
    missing = packages
    sys.argv = [module, *rest]
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        try:
            runpy.run_module(module, run_name="__main__")
        except SystemExit as exit:
            found.append((exit.code, out.getvalue(), err.getvalue()))
print(json.dumps(found))
"""
NONE = ("matplotlib", "ray", "python_calamine", "pyopencrg", "asammdf")
EXTRAS = [  # missing packages, the extra, and a command that needs one of them
    (NONE, "report", ["sim.sweep", "--controller", "passive", "--picture", "x.png"]),
    (NONE, "report", ["sim.report"]),
    (NONE, "cluster", ["sim.campaign", "campaign.toml", "--ray", "auto"]),
    (NONE, "excel", ["sim.drive", "--controller", "passive", "--road", "road.xlsx"]),
    (NONE, "opencrg", ["sim.drive", "--controller", "passive", "--road", "road.crg"]),
    (NONE, "mdf", ["sim.identify", "log.mf4", "--columns"]),
    (("jinja2",), "report", ["sim.report"]),
]


def test_an_extra_is_asked_for_by_name(tmp_path):
    """Without an extra's packages a command that needs them says in one line how to install them, before any work."""
    (tmp_path / "road.crg").touch()
    (tmp_path / "campaign.toml").write_text(
        'vehicles = ["quarter_car"]\ncontrollers = ["passive"]\nroads = ["bump"]\nspeeds = [10.0]\nduration = 1.0\nsettle = 0.0\n'
    )
    command = [sys.executable, "-c", WITHOUT, json.dumps([[packages, *arguments] for packages, _, arguments in EXTRAS])]
    done = subprocess.run(command, cwd=tmp_path, env=environment(), capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert len(found) == len(EXTRAS)
    for (code, out, err), (_, extra, arguments) in zip(found, EXTRAS, strict=True):
        assert (code, out, err.count("\n")) == (2, "", 1), (arguments, err)
        assert f"[{extra}]" in err, arguments


BLAS = """
import atexit, runpy, sys

@atexit.register
def count():
    import numpy, scipy.linalg, threadpoolctl
    print("threads", {one["num_threads"] for one in threadpoolctl.threadpool_info() if one["user_api"] == "blas"})

sys.argv = ["-m", "--help"]  # as Python's own start has it while it imports a command's package
runpy.run_module("sim.bump", None, "__main__", True)
"""


def test_a_command_has_one_thread_of_blas():
    """All libraries of a command have one thread of BLAS: more only wait for each other."""
    kept = {key: value for key, value in environment().items() if "NUM_THREADS" not in key}
    done = subprocess.run([sys.executable, "-c", BLAS], env=kept, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] in ("threads {1}", "threads set()")  # macOS's own library does not tell
