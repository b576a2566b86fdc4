"""What only a registry names can be removed: without its file and its lines in the registry, all else works."""

import ast
import re
import shutil
import subprocess
import sys

import pytest

from models.laws.design_methods import METHODS
from models.parts.registry import PARTS
from sim.drive.drivers.registry import DRIVERS
from sim.observers.registry import OBSERVERS
from sim.studies.registry import STUDIES
from sim.studies.ride.registry import METRICS
from tests.support.commands import ROOT, in_the_suite
from tests.support.sources import sources

REGISTRIES = {
    "models/parts/registry.py": PARTS,
    "sim/drive/drivers/registry.py": DRIVERS,
    "sim/observers/registry.py": OBSERVERS,
    "models/laws/design_methods.py": METHODS,
    "sim/studies/registry.py": {name: where for name, (where, *_) in STUDIES.items()},
}
BUMP = 'from sim.bump import main; sys.exit(main("--controller passive --duration 0.2 --no-logs".split()))', "agrees"
USE = {  # what works without a module, and prints; the passive vehicle, which each command drives, has a linear law
    "models/laws/design_methods.py": ('from synth.__main__ import main; sys.exit(main(["--controller", "I"]))', "7.843188"),
    "sim/studies/registry.py": (
        "from sim.report.__main__ import main; from sim.__main__ import table; print(*table()); "
        "sys.exit(main('--quick --controller passive --timestep 0.005 --out page.html'.split()))",
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


def removable() -> dict[str, tuple[str, list[str]]]:
    """Each module that only a registry names, with the file of its registry and its names there."""
    every = [(file, where.partition(":")[0], name) for file, each in REGISTRIES.items() for name, where in each.items()]
    alone = {module: file for file, module, _ in every if not set(users(module)) - {"synth/__init__.py"}}
    return {module: (file, [name for _, other, name in every if other == module]) for module, file in alone.items()}


SAMPLES = [next(module for module, (of, _) in removable().items() if of == file) for file in REGISTRIES]


@pytest.mark.parametrize("module", in_the_suite(SAMPLES, removable()))
def test_all_else_works_without_it(module, tmp_path):
    """In a copy without a file and its lines every module is imported, and a car runs over a bump, or is designed for."""
    for folder in ("models", "synth", "sim"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    file, names = removable()[module]
    (tmp_path / f"{module.replace('.', '/')}.py").unlink()
    text = (tmp_path / file).read_text(encoding="utf-8")
    for name in names:
        text, count = re.subn(rf'(?m)^    "{name}": .*\n', "", text)
        assert count == 1
    (tmp_path / file).write_text(text, encoding="utf-8")
    code, printed = USE.get(module, USE.get(file, BUMP))
    done = subprocess.run([sys.executable, "-c", CHECK + code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert printed in done.stdout


def test_methods_are_named_by_their_table():
    """At least these methods are named by nothing but the table, and can be taken away."""
    assert {name for _, names in removable().values() for name in names} >= {"descent", "refinement", "mu", "preview"}


@pytest.mark.parametrize("file", [file for file, registry in REGISTRIES.items() if registry is not METHODS])
def test_only_the_registry_names_a_module(file):
    """No file imports a module of a registry, which alone names it."""
    assert not [(path, where) for where in REGISTRIES[file].values() for path in users(where.partition(":")[0])]


WITHOUT_METRIC = """
import importlib, pathlib, sys
from sim.studies.registry import STUDIES
from sim.studies.ride.registry import METRICS
assert sys.argv[1] not in METRICS
for path in sorted(pathlib.Path("sim").rglob("*.py")):
    if path.name != "__main__.py" and "gallery" not in path.parts[1:2]:
        importlib.import_module(".".join(path.with_suffix("").parts).removesuffix(".__init__"))
from sim.campaign.__main__ import main as campaign
from sim.drive.__main__ import main
key = next(name for name in ("ride", "peak_travel") if name in METRICS)
road = ["--road", "iso8608:class=C", "--load", "brake:g=0.3", "--vehicle", "full_car"]
status = main(["--controller", "passive", *road, "--duration", "0.2", "-v", "--no-logs"])
sys.exit(status or campaign(["campaign.toml", "--best", key, "--picture", "ride.svg"]))
"""
RUNS = """
vehicles = ["quarter_car"]
controllers = ["passive", "II_printed"]
roads = ["iso8608:class=C", "bump"]
speeds = [15]
duration = 0.2
"""


@pytest.mark.parametrize("name", in_the_suite(("ride",), METRICS))
def test_all_else_works_without_a_metric(name, tmp_path):
    """In a copy without a metric every module is imported, a full car is driven, and a campaign finds its best controller."""
    for folder in ("models", "synth", "sim"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    registry = tmp_path / "sim" / "studies" / "ride" / "registry.py"
    text, count = re.subn(rf'(?m)^    "{name}": .*\n', "", registry.read_text(encoding="utf-8"))
    assert count == 1
    registry.write_text(text, encoding="utf-8")
    module, _, named = METRICS[name].partition(":")
    file = tmp_path / f"{module.replace('.', '/')}.py"
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
    (of_class,) = (one for one in ast.parse("".join(lines)).body if isinstance(one, ast.ClassDef) and one.name == named)
    del lines[of_class.lineno - 1 : of_class.end_lineno]
    file.write_text("".join(lines), encoding="utf-8")
    (tmp_path / "campaign.toml").write_text(RUNS, encoding="utf-8")
    done = subprocess.run([sys.executable, "-c", WITHOUT_METRIC, name], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
