"""What only a registry names can be removed: without its file and its lines in the registry, all else works."""

import ast
import functools
import re
import shutil
import subprocess
import sys
from importlib.util import cache_from_source
from pathlib import Path

import pytest

from models.common.extensions import EXTENSIONS, METRICS
from tests.house.test_architecture import MODULES, core_modules
from tests.support.commands import ROOT, in_the_suite
from tests.support.pages import copied
from tests.support.sources import sources

TABLE = "models/common/extensions.py"
TOGETHER = {"metric"}  # sorts whose names stand in one module: a class is taken away, not the module
USED = {"design method", "feature", "study"}  # sorts some of whose modules are used by others, too
BUMP = 'from sim.bump import main; assert not main("--controller passive --duration 0.2 --no-logs".split())', "agrees"
USE = {  # what works without a module, and prints; the passive vehicle, which each command drives, has a linear law
    "design method": ('from synth.__main__ import main; assert not main(["--controller", "I"])', "7.843188"),
    "study": (
        "from sim.report.__main__ import main; from sim.__main__ import table; print(*table()); "
        "assert not main('--quick --controller passive --timestep 0.005 --out page.html'.split())",
        "agrees",
    ),
    "sim.drive.drivers.linear": (
        "from models import Bump, read_vehicle\nfrom sim import run\n"
        "print(*run(read_vehicle('quarter_car'), lambda y, state: (-2e3 * y['sprung_velocity'], state), Bump(0.05), 0.2))",
        "agrees",
    ),
}
CHECK = """
import importlib, pathlib, sys
for folder in ("models", "synth", "sim"):
    for path in sorted(pathlib.Path(folder).rglob("*.py")):
        if path.name != "__main__.py" and "gallery" not in path.parts[1:2]:
            importlib.import_module(".".join(path.with_suffix("").parts).removesuffix(".__init__"))
"""


def users(module: str) -> list[str]:
    """The files that import a module."""
    return [path for path, source in sources().items() if any(f"{one}.".startswith(f"{module}.") for one in source.imported)]


def without_row(table: str, sort: str, name: str) -> str:
    """The text of the table of extensions without the row of a name."""
    row = rf'        "{name}": (?:\(\n.*?\n        \),|[^\n]*)\n'
    text, count = re.subn(rf'(?s)(    "{sort}": {{.*?\n){row}', r"\1", table, count=1)
    assert count == 1
    return text


@functools.cache
def removable() -> dict[str, tuple[str, list[str]]]:
    """Each module that only the table of extensions names, with its sort and its names there."""
    every = [(sort, *row) for sort, rows in EXTENSIONS.items() if sort not in TOGETHER for row in rows.items()]
    modules = {where.partition(":")[0]: sort for sort, _, where in every}
    alone = {module: sort for module, sort in modules.items() if not set(users(module)) - {"synth/__init__.py"}}
    return {
        module: (sort, [name for _, name, where in every if where.partition(":")[0] == module]) for module, sort in alone.items()
    }


SAMPLES = (
    "models.parts.stops.part",
    "synth.design.fallback",
    "sim.runs.decay",
    "sim.drive.drivers.linear",
    "sim.observers.energy",
)
SORTS = ("part", "driver", "observer", "recording", "study", "design method", "feature")


@pytest.mark.parametrize("sort", in_the_suite(["samples"], ["samples", *SORTS]))
def test_all_else_works_without_them(sort, tmp_path):
    """In a copy without some files and their lines every module is imported, and a car runs over a bump, or is designed for.

    The other removable modules of a sort are removed together. No module of them needs another one, as `removable` has only
    modules that no file imports.
    """
    others = [module for module, (other, _) in removable().items() if other == sort and module not in SAMPLES]
    modules = others if sort in SORTS else SAMPLES
    assert {*modules} <= removable().keys()
    copied(tmp_path, "models", "synth", "sim")
    uses = {one for module in modules if (one := USE.get(module, USE.get(removable()[module][0])))} or {BUMP}
    text = (tmp_path / TABLE).read_text(encoding="utf-8")
    for module in modules:
        (tmp_path / f"{module.replace('.', '/')}.py").unlink()
        sort, names = removable()[module]
        for name in names:
            text = without_row(text, sort, name)
    (tmp_path / TABLE).write_text(text, encoding="utf-8")
    code = "\n".join([CHECK, *(use for use, _ in uses)])
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert all(printed in done.stdout for _, printed in uses)


def test_methods_are_named_by_their_table():
    """At least these methods are named by nothing but the table, and can be taken away; so can the samples."""
    assert {*SAMPLES} <= removable().keys()
    assert {name for _, names in removable().values() for name in names} >= {"descent", "refinement", "mu", "preview"}


@pytest.mark.parametrize("sort", [sort for sort in EXTENSIONS if sort not in USED])
def test_only_the_table_names_a_module(sort):
    """No file imports a module of an extension, which the table alone names."""
    assert not [(path, where) for where in EXTENSIONS[sort].values() for path in users(where.partition(":")[0])]


def test_the_core_drives_without_any_extension(tmp_path):
    """The files of the core alone design, drive, compare and log the paper's controller of three cars, with their own rows."""
    packages = {path.relative_to(ROOT) for path in MODULES.values() if path.name == "__init__.py"}
    data = {path.relative_to(ROOT) for suffix in ("toml", "xml") for path in (ROOT / "models").glob(f"*.{suffix}")}
    files = {MODULES[name].relative_to(ROOT) for name in core_modules()} | packages
    compiled = {Path(cache_from_source(str(path))) for path in files}  # with its time in it, which a copy keeps
    for path in files | data | {path for path in compiled if (ROOT / path).exists()}:
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / path, tmp_path / path)
    text = (ROOT / TABLE).read_text(encoding="utf-8")
    for sort, rows in EXTENSIONS.items():
        for name in (name for name, where in rows.items() if where.partition(":")[0] not in core_modules()):
            text = without_row(text, sort, name)
    (tmp_path / TABLE).write_text(text, encoding="utf-8")
    code = CHECK + "from sim.bump import main\nfor car in ('quarter_car', 'half_car', 'full_car'):\n"
    code += "    assert not main(['--controller', 'II', '--vehicle', car, '--duration', '0.2', '--timestep', '4e-3'])\n"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert done.stdout.count("MuJoCo agrees") == 3
    assert {path.name.split("-")[1] for path in (tmp_path / "logs").glob("*.mcap")} == {"quarter_car", "half_car", "full_car"}


WITHOUT_METRIC = """
import sys
from models.common.extensions import METRICS
assert not {*sys.argv[1:]} & {*METRICS}
from sim.campaign.__main__ import main as campaign
from sim.drive.__main__ import main
key = next(name for name in ("ride", "peak_travel") if name in METRICS)
road = ["--road", "iso8608:class=C", "--load", "brake:g=0.3", "--vehicle", "half_car"]
status = main(["--controller", "passive", *road, "--duration", "0.2", "-v", "--no-logs"])
sys.exit(status or campaign(["campaign.toml", "--workers", "1", "--best", key, "--picture", "ride.svg"]))
"""
RUNS = """
vehicles = ["quarter_car"]
controllers = ["passive", "II_printed"]
roads = ["iso8608:class=C", "bump"]
speeds = [15]
duration = 0.2
"""


@pytest.mark.parametrize("names", in_the_suite([("ride",)], [("ride",), [name for name in METRICS if name != "ride"]]), ids=len)
def test_all_else_works_without_a_metric(names, tmp_path):
    """In a copy without ride, or with ride alone, a car is driven, and a campaign finds its best one.

    No file imports a metric, as `test_only_the_table_names_a_module` holds.
    """
    copied(tmp_path, "models", "synth", "sim")
    table = tmp_path / TABLE
    for name in names:
        text, count = re.subn(rf'(?m)^        "{name}": f"{{_STANDARD}}.*\n', "", table.read_text(encoding="utf-8"))
        assert count == 1
        table.write_text(text, encoding="utf-8")
        module, _, named = METRICS[name].partition(":")
        file = tmp_path / f"{module.replace('.', '/')}.py"
        lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
        (of_class,) = (one for one in ast.parse("".join(lines)).body if isinstance(one, ast.ClassDef) and one.name == named)
        del lines[of_class.lineno - 1 : of_class.end_lineno]
        file.write_text("".join(lines), encoding="utf-8")
    (tmp_path / "campaign.toml").write_text(RUNS, encoding="utf-8")
    command = [sys.executable, "-c", WITHOUT_METRIC, *names]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
