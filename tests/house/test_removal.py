"""Every part and every metric can be removed: without its file or class and its line in the registry, all else works."""

import ast
import re
import shutil
import subprocess
import sys

import pytest

from models.parts.registry import PARTS
from sim.studies.ride.registry import METRICS
from tests.support.commands import ROOT, in_the_suite
from tests.support.sources import sources

CHECK = """
import importlib, pathlib, sys
from models.parts.registry import PARTS
assert sys.argv[1] not in PARTS
for folder in ("models", "synth", "sim"):
    for path in sorted(pathlib.Path(folder).rglob("*.py")):
        if path.name != "__main__.py" and "gallery" not in path.parts[1:2]:
            importlib.import_module(".".join(path.with_suffix("").parts).removesuffix(".__init__"))
from sim.bump import main
sys.exit(main(["--controller", "passive", "--duration", "0.2", "--no-logs"]))
"""


@pytest.mark.parametrize("name", in_the_suite(("stop",), PARTS))
def test_all_else_works_without_a_part(name, tmp_path):
    """In a copy without a part every module is imported, and the paper's quarter-car runs over a bump."""
    for folder in ("models", "synth", "sim"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    module = PARTS[name].partition(":")[0]
    (tmp_path / f"{module.replace('.', '/')}.py").unlink()
    registry = tmp_path / "models" / "parts" / "registry.py"
    text, count = re.subn(rf'(?m)^    "{name}": .*\n', "", registry.read_text(encoding="utf-8"))
    assert count == 1
    registry.write_text(text, encoding="utf-8")
    done = subprocess.run([sys.executable, "-c", CHECK, name], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "agrees" in done.stdout


def test_only_the_registry_names_a_part():
    """No file imports the module of a part, which only the registry names."""
    modules = tuple(f"{one.partition(':')[0]}." for one in PARTS.values())
    assert not [(path, one) for path, source in sources().items() for one in source.imported if f"{one}.".startswith(modules)]


WITHOUT_METRIC = """
import importlib, pathlib, sys
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
