"""The examples to copy run and draw their pictures; links lead to tracked files."""

import re
import subprocess
from pathlib import Path

import pytest

from docs import generate
from tests.support.pages import ROOT, same_picture

DOCS = ROOT / "docs"
CHEAP = ("measured_road",)  # about a second of processor time
MOST_BYTES, FEWEST_LINES, MOST_LINES = 60_000, 10, 32


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.attack] * (name not in CHEAP)) for name in generate.EXAMPLES]
)
def test_an_example_draws_its_picture(name, tmp_path):
    """A script runs in a fresh namespace and an empty folder, and draws the picture of the page."""
    pytest.importorskip("matplotlib", reason="needs the extra [report]")
    shown = DOCS / "examples" / f"{name}.png"
    assert same_picture(generate.draw_example(name, tmp_path), shown), f"run python -m docs.generate {name}, and look at it"


@pytest.mark.parametrize("name", generate.EXAMPLES)
def test_an_example_is_short_and_labelled(name):
    """A script has 10 to 30 lines of code, title and axes with units, and a small picture."""
    code = generate.example(name)[2]
    lines = [line for line in code.splitlines() if line.strip() and not line.startswith(("import ", "from "))]
    assert FEWEST_LINES <= len(lines) <= MOST_LINES
    assert "title=" in code
    assert re.search(r"xlabel=\"[^\"]*\[", code)
    assert (DOCS / "examples" / f"{name}.png").stat().st_size < MOST_BYTES


def test_every_example_is_in_the_list():
    """Each script of the folder is an example, with a picture and a notebook, and there is nothing else."""
    found = {path.name for path in (DOCS / "examples").iterdir() if path.is_file()}
    assert found == {f"{name}.{suffix}" for name in generate.EXAMPLES for suffix in ("py", "png", "ipynb")}


@pytest.mark.attack  # a run
def test_the_page_of_logs_is_fresh():
    """The page of logs is that of a run that is recorded now."""
    assert (DOCS / "reference" / "logs.md").read_text(encoding="utf-8") == generate.log_page(), "run python -m docs.generate"


@pytest.mark.attack
def test_a_notebook_runs_in_jupyter(tmp_path):
    """A notebook runs in a kernel of its own."""
    nbformat = pytest.importorskip("nbformat", reason="needs Jupyter")
    client = pytest.importorskip("nbclient", reason="needs Jupyter")
    pytest.importorskip("ipykernel", reason="needs Jupyter")
    book = nbformat.read(DOCS / "examples" / "preview.ipynb", as_version=4)
    client.NotebookClient(book, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert (tmp_path / "preview.png").exists()


def tracked() -> set[Path]:
    """Returns the files that git tracks; skips without git."""
    try:
        done = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("needs git and a clone")
    return {(ROOT / name).resolve() for name in done.stdout.split("\0") if name}


def test_links_lead_to_tracked_files():
    """Every relative link and picture of each page in the repository leads to a tracked file or folder, as GitHub needs it."""
    files = tracked()
    there = files | {folder for path in files for folder in path.parents}
    dead = []
    for page in sorted(path for path in files if path.suffix == ".md" and path.exists()):
        text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
        for link in re.findall(r"\]\((?![a-z]+:)([^)#\s]+)[^)]*\)", text):
            if (page.parent / link).resolve() not in there:
                dead.append(f"{page.relative_to(ROOT)}: {link}")
    assert dead == []
