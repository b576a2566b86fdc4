"""Every command of the pages runs as it stands there, prints what stands beside it, and draws the picture above it."""

import re

import pytest

from sim.studies.gallery import numbers
from tests.support.commands import in_the_suite
from tests.support.pages import (
    GENERATED,
    LIGHTER,
    PAGES,
    PICTURES,
    ROOT,
    THINNER,
    Section,
    missing,
    page,
    run,
    same_picture,
    sections,
)
from tests.support.shared import share

SECTIONS = [each for name in PAGES for each in sections(name) if each.commands]
# Each some seconds or more: after the suite.
SLOW = (
    *("sim.sweep", "sim.margins", "sim.envelope", "sim.report", "sim.gallery", "sim recommend"),
    *("synth --vehicle quarter_car_goals", "synth --front"),
    *("synth --vehicle models/gallery/mathworks/robust.toml", "sim.campaign campaign.toml", "sim.campaign --verify"),
    *("sim.drive --controller I --class C", "sim.bump --controller all --serve", "synth --part loop"),
    "sim.drive --controller skyhook",
)
# Sections of a second or more whose commands others have, too, with other options.
ALIKE = (
    *("bump.md: Drive over one bump", "bump.md: Lift-off", "bump.md: Compare vehicles"),
    *("first-bump.md: Drive your own car", "semi-active-dampers.md: Set the voltage", "synth.md: Design controllers"),
    "export.md: Simulate the exported code",
    *(
        "README.md: Export",
        "README.md: Read the output",
        "first-bump.md: First bump",
        "semi-active-dampers.md: Semi-active dampers",
    ),
    *("inspect.md: Recompute a logged run", "first-bump.md: Look at every signal", "built-in-vehicles.md: Built-in vehicles"),
)


def slow(one: Section) -> bool:
    """Returns True if a section is for the attacks."""
    named = f"{one}".rpartition("/")[2] if "`" not in f"{one}" else f"{one}".partition("`")[0].rpartition("/")[2]
    return named.startswith(ALIKE) or any(f"-m {command} " in f"{line} " for command in SLOW for line in one.commands)


@pytest.mark.parametrize("one", in_the_suite([each for each in SECTIONS if not slow(each)], SECTIONS), ids=str)
def test_commands(one, tmp_path, monkeypatch, capsys):
    """Every command exits with 0, prints the lines that stand beside it, and draws a picture: the one that is shown, if any."""
    share(monkeypatch, numbers, "compare_numbers")  # three pages show numbers of the gallery, which `test_gallery.py` holds
    if any("--picture" in line or "sim.report" in line for line in one.commands):
        pytest.importorskip("matplotlib", reason="needs the extra [report]")
        pytest.importorskip("jinja2", reason="needs the extra [report]")
    monkeypatch.chdir(tmp_path)
    run(one, tmp_path)
    printed = capsys.readouterr().out
    for text in one.blocks("text"):
        assert missing(text, printed) is None
    lines = "\n".join(one.commands)
    for name in re.findall(r"--picture (\S+)", lines):
        shown = f"/pictures/{name})" in page(one.page)
        assert same_picture(tmp_path / name, PICTURES / name) if shown else (tmp_path / name).stat().st_size > 10_000
    for figures in re.findall(r"--figures (\S+)", lines):
        for name in re.findall(r"!\[.*/pictures/(\S+)\)", one.text):
            assert same_picture(tmp_path / figures / name, PICTURES / name)


def test_what_is_made_lighter_is_there():
    """Every line and every setting that is given less to do stands on a page."""
    lines = [line for one in SECTIONS for line in one.commands]
    assert all(any(line.startswith(f"python -m {start}") for line in lines) for start in LIGHTER)
    assert all(much in page("docs/how-to/campaign.md") for much in THINNER)


def test_a_stale_line_is_found():
    """A line that is not printed, or not in its place, is named; dots stand for anything in between."""
    printed = "first\nthe norm is 7.84, at 63\nlast\n"
    assert missing("first\n...\nlast\n", printed) is None
    assert missing("the norm ... at 63\n", printed) is None
    assert missing("the norm is 7.84, ...\n", printed) is None
    assert missing("the norm is 7.84\n", printed) == "the norm is 7.84"
    assert missing("last\nfirst\n", printed) == "first"


@pytest.mark.parametrize("name", [*PAGES, ".github/CONTRIBUTING.md"])
def test_links_and_tables(name):
    """The targets of a page's links are there, headings included, and its tables are at most 100 columns wide."""
    text, folder = page(name), (PICTURES.parent.parent / name).parent
    for path, _, heading in (link.partition("#") for link in re.findall(r"\]\((?!https?:)([^)]+)\)", text)):
        there = folder / path if path else PICTURES.parent.parent / name  # a link within the page names its heading alone
        if there.resolve().relative_to(ROOT.resolve()).as_posix().startswith(GENERATED):
            continue  # Sphinx says whether it is there, and test_site.py what there is
        assert there.exists(), path
        headings = re.findall(r"^#+ (.*)$", there.read_text(encoding="utf-8"), re.M) if heading else []
        assert not heading or heading in [re.sub(r"[^\w -]", "", each.lower()).replace(" ", "-") for each in headings]
    assert all(len(line) <= 100 for line in text.splitlines() if line.startswith("|"))
