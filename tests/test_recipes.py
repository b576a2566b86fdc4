"""What .github/CONTRIBUTING.md says about adding to the project, done in a copy of it."""

import os
import re
import shutil
import subprocess
import sys

import pytest

from tests.pages import ROOT, page, sections

MARK = "\n\n# By their names on a command line"


@pytest.mark.attack  # four processes in a copy that has to be compiled
def test_add_a_road(tmp_path):
    """The road of the recipe, in its two files, is driven, logged and inspected, and holds in every test of roads."""
    (recipe,) = [one for one in sections(".github/CONTRIBUTING.md") if one.heading == "Add a road"]
    (road,) = recipe.blocks("python")
    for folder in ("models", "synth", "sim", "tests", ".github"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for file in ("README.md", "pyproject.toml"):
        shutil.copy(ROOT / file, tmp_path)
    path = tmp_path / "models" / "roads" / "obstacles.py"
    source = path.read_text(encoding="utf-8")
    assert source.count(MARK) == 1
    changed = source.replace(MARK, f"\n\n{road}\n{MARK}").replace('"step": Step,', '"step": Step, "ramp": Ramp,')
    path.write_text(changed, encoding="utf-8", newline="\n")
    names = tmp_path / "models" / "vehicle" / "names.py"
    named = names.read_text(encoding="utf-8").replace('"step", ', '"step", "ramp", ')
    names.write_text(named, encoding="utf-8", newline="\n")

    def run(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", *arguments],
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(tmp_path)},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    driven = run("sim.drive", "--road", "ramp:height=0.05", "--duration", "2", "--controller", "I", "--logs", "logs")
    assert "type ramp, height 0.05" in driven
    (log,) = (tmp_path / "logs").glob("*.mcap")
    assert "the log still proves what it claims" in run("sim.inspect", str(log))
    tested = run("pytest", "-k", "ramp or sizes", "tests/test_roads.py", "tests/test_architecture.py")
    assert int(re.findall(r"(\d+) passed", tested)[0]) >= 3  # its derivative, its description, the size of its file


def test_recipes_name_what_there_is():
    """Every file that a recipe names is there, and every name of code stands in the code."""
    named = set(re.findall(r"`([\w./]+)`", page(".github/CONTRIBUTING.md")))
    files = {name for name in named if "/" in name}
    assert {name for name in files if "NAME" not in name and not (ROOT / name).exists()} == set()
    code = " ".join(path.read_text(encoding="utf-8") for path in ROOT.rglob("*.py") if ".venv" not in path.parts)
    words = set(re.findall(r"\w+", code)) | {"pyright", ".ci/run"}
    assert {part for name in named - files for part in re.findall(r"\w+", name)} - words == set()
