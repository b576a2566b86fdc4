"""Pages as readers open them: at two widths, by day and by night, and on paper; is all of it accessible?"""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from sim.report.__main__ import main
from tests.commands.test_page import PAGES, everything
from tests.support.npm import installed

pytest.importorskip("jinja2", reason="a report needs the extra [report]")
pytest.importorskip("matplotlib", reason="a report needs the extra [report]")

PACKAGES = ("playwright-core@1.65.1", "axe-core@4.14.1")
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
READER = Path(__file__).with_name("page_in_browser.mjs")


@pytest.fixture(scope="module")
def node_modules(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns what drives a browser, and the checker, from the npm registry."""
    if BROWSER is None:
        pytest.skip("needs a Chromium")
    return installed(PACKAGES, tmp_path_factory.mktemp("node"))


def wrong(pages: list[Path], node_modules: Path) -> list[dict[str, list[str]]]:
    """Returns what is wrong with each page, by how it is read."""
    command = ["node", str(READER), str(node_modules), str(BROWSER), *map(str, pages)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=900)
    return json.loads(done.stdout)


@pytest.mark.attack
def test_pages_can_be_read(node_modules, tmp_path):
    """Nothing is inaccessible, cut off, drawn over something else, or missing on paper."""
    from models.document.page import render

    hard = {name: names for name, names in PAGES.items() if name != "plain"}  # what is read without trouble is the report below
    pages = [tmp_path / f"{name}.html" for name in hard]
    for path, names in zip(pages, hard.values(), strict=True):
        path.write_text(render(everything(names)), encoding="utf-8")
    pages.append(tmp_path / "full_car.html")
    assert main(["--quick", "--timestep", "0.004", "--vehicle", "full_car", "--out", str(pages[-1])]) == 0
    assert all(path.stat().st_size < 1_000_000 for path in pages)  # they are to be mailed
    for path, found in zip(pages, wrong(pages, node_modules), strict=True):
        assert len(found) == 5
        assert not {how: said for how, said in found.items() if said}, path.name
