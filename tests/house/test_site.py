"""Tests of the site: pages are found, the reference has every command and key, and examples run. Sphinx is not needed."""

import argparse
import contextlib
import io
import json
import posixpath
import re
import shlex
import tomllib
from pathlib import Path

import numpy as np
import pytest

from docs import generate, pictures
from models.common.errors import InputError
from models.common.schema import keys
from models.vehicle.controller_section import ControllerSection
from models.vehicle.limits_and_implementation import ImplementationSection
from models.vehicle.vehicle import SECTIONS
from sim.__main__ import COMMANDS, VERBS
from tests.support.commands import main_of
from tests.support.pages import GENERATED, PAGES, PICTURES, ROOT, SITE, page

DOCS = ROOT / "docs"
NOTEBOOK = DOCS / "tutorials" / "notebook.ipynb"
FIRST_ADDRESSES = """
index questions which-command glossary gallery reference
tutorials/index tutorials/first-bump tutorials/your-own-car tutorials/semi-active-damper tutorials/reading-a-report
tutorials/notebook explanation/index explanation/control-problem explanation/bound-norm-lower-bound
explanation/agrees-and-ended explanation/energy-balance explanation/sampled-and-continuous explanation/not-modelled
how-to/index how-to/a-discrete-plant how-to/a-law-from-matlab how-to/a-law-in-python how-to/a-road-in-python
how-to/a-template-for-comfort how-to/adjustable-dampers how-to/any-controller how-to/any-plant how-to/bands-and-families
how-to/bump how-to/campaign how-to/controllers-with-states how-to/curves how-to/designs-with-filters how-to/drive
how-to/envelope how-to/errors-by-frequency how-to/export how-to/gallery how-to/goals how-to/inspect
how-to/limits-and-implementation how-to/many-vehicles how-to/margins how-to/new how-to/preview how-to/proofs-of-goals
how-to/python-control how-to/record-and-open how-to/report how-to/roll-centres how-to/semi-active-laws how-to/sweep
how-to/synth how-to/the-sampled-loop how-to/trade-off how-to/tune-a-law how-to/vehicles-that-ship
how-to/weights-by-frequency how-to/what-is-in-a-log how-to/your-own-kind how-to/your-own-vehicle
reference/commands reference/vehicle-file reference/what-goes-together reference/signals reference/roads reference/metrics
reference/messages reference/logs reference/models reference/synth reference/sim
"""  # of the first site, to which other sites may link


@pytest.fixture(scope="module")
def made():
    """The generated pages, by path below `docs/`."""
    return generate.pages()


def test_every_page_is_in_a_table_of_contents(made):
    """No page is lost: each is an entry of one table of contents, and each entry is a page. A search finds the messages."""
    entries = []
    for name in SITE:
        for block in re.findall(r"^```\{toctree\}\n(.*?)^```", page(name), re.M | re.S):
            folder = (ROOT / name).parent
            named = [line for line in block.splitlines() if line and not line.startswith(":")]
            entries += [posixpath.normpath((folder / line).relative_to(DOCS).as_posix()) for line in named]
    assert sorted(entries) == sorted(addresses(made) - {"index", "reference/messages"})
    assert "orphan: true" in made["reference/messages"]
    assert all(f"docs/{name}.md".startswith(GENERATED) for name in (*made, "reference/logs"))
    assert all(f"docs/{name}".startswith(GENERATED) for name in generate.drawings())


def test_kept_files_are_fresh(made):
    """Generated files in the repository are what the code generates; the notebooks have the code of the scripts."""
    old = [name for name, text in generate.kept_files(made).items() if (DOCS / name).read_text(encoding="utf-8") != text]
    assert old == [], "run python -m docs.generate"
    for name in generate.EXAMPLES:
        cells = json.loads((DOCS / "examples" / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
        assert "".join(cells[1]["source"]) == generate.example(name)[2].rstrip()


def addresses(made) -> set[str]:
    """The addresses of all pages, below `docs/` without suffix."""
    return {Path(name).relative_to("docs").with_suffix("").as_posix() for name in SITE} | {*made, "reference/logs"}


def test_old_addresses_lead_somewhere(made):
    """Every address that the site ever had is a page, or has moved to one."""
    there = addresses(made)
    assert {one for one in FIRST_ADDRESSES.split() if generate.MOVED.get(one, one) not in there} == set()
    assert {new for new in generate.MOVED.values() if new not in there} == set()
    assert {old for old in generate.MOVED if old in there} == set()
    for file, text in generate.redirects().items():
        (to,) = re.findall(r'<a href="([^"]+)">', text)
        assert f'content="0; url={to}"' in text
        assert posixpath.normpath(posixpath.join(posixpath.dirname(file), to)).removesuffix(".html") in there


def test_pages_named_in_the_code_are_there():
    """Every page that help, messages and vehicle files name is a file."""
    files = [
        path for folder in ("models", "synth", "sim") for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".toml")
    ]
    named = {one for path in files for one in re.findall(r"\bdocs/[\w/-]+\.md\b", path.read_text(encoding="utf-8"))}
    assert len(named) > 3
    assert {one for one in named if not (ROOT / one).exists()} == set()


def test_the_table_of_extras_is_complete():
    """The page on installation lists the extras of `pyproject.toml`, each once."""
    there = tomllib.loads(page("pyproject.toml"))["project"]["optional-dependencies"]
    rows = re.findall(r"^\| (`.*?) \|", page("docs/start/installation.md"), re.M)
    assert sorted(re.findall(r"`([\w-]+)`", " ".join(rows))) == sorted(there)


def test_the_quick_start_prints_what_it_shows(capsys):
    """The snippets of the quick start run one after the other, and print the text below each."""
    names: dict[str, object] = {"__name__": "page"}
    blocks = re.findall(r"^```python\n(.*?)^```\n```text\n(.*?)^```", page("docs/start/python-quick-start.md"), re.M | re.S)
    assert len(blocks) == 5
    for snippet, text in blocks:
        exec(compile(snippet, "page", "exec"), names)
        assert capsys.readouterr().out == text


def test_every_command_and_option_has_an_entry(made):
    """The page of commands has each command's every option, as its parser knows them, except hidden ones."""
    text = made["reference/commands"]
    for verb, (name, purpose, _) in zip(VERBS, COMMANDS, strict=True):
        part = text.partition(f"\n## roadproof {verb}\n")[2].partition("\n## ")[0]
        assert purpose in part
        shown = [action for action in generate.parser_of(name)._actions if action.help != argparse.SUPPRESS]
        options = [each for action in shown for each in action.option_strings]
        assert {"--help", "--json"} <= {*options}
        assert all(re.search(rf"`{option}[ `]", part) for option in options)


def test_every_key_has_an_entry_and_a_page(made):
    """The page of keys has every section and every key, with a page that uses the key or a sentence on it."""
    text = made["reference/vehicle-file"]
    sections = generate.key_sections()
    assert all(any(name in heading for heading in sections) for name in SECTIONS if name not in ("type", "plane"))
    assert {*keys(ControllerSection)} == {key for key, *_ in sections["[controllers.NAME]"]}
    assert {*keys(ImplementationSection)} == {key for key, *_ in sections["[implementation]"]}
    bare = [key for keys in sections.values() for key, _, meaning in keys if not meaning and not generate.shown_in(key)]
    assert bare == []
    assert "../how-to/seat.md" in text.partition("\n## [seat]\n")[2].partition("\n|")[0]
    assert all(f"`{key}`" in text for keys in sections.values() for key, *_ in keys)


def test_every_message_has_an_entry(made):
    """The page of messages has what a command says of wrong input, with what to do: four are provoked, one of each package and
    one of many rooms, and found there word by word."""
    text = made["reference/messages"]
    rows = [re.split(r"(?<!\\) \| ", line.strip("| ")) for line in text.splitlines() if line.startswith("| ")]
    shown = [re.sub(r"[\\`]", "", "; ".join(filter(None, row[:2]))) for row in rows]
    for command, arguments in (
        ("synth", ["--rates", "5", "5"]),
        ("sim.margins", ["--controller", "passive"]),
        ("sim.bump", ["--controller", "I", "--duration", "1e9"]),
        ("sim.drive", ["--controller", "I", "--road", "pothole:depth=0.1:depth=0.2"]),
    ):
        with pytest.raises(InputError) as error:
            main_of(command)([*arguments, "--no-logs"] if command in ("sim.bump", "sim.drive") else arguments)
        patterns = (".*".join(map(re.escape, re.split(r"<\w+>|\.\.\.", one))) for one in shown)
        assert any(len(one) > 12 and re.fullmatch(one, str(error.value).replace("`", "")) for one in patterns), str(error.value)
    assert len(rows) > 500


def test_tables_have_whole_rows(made):
    """Every row of a generated table has as many cells as its heading."""
    for name, text in made.items():
        for block in re.findall(r"(?:^\|.*\n)+", text, re.M):
            widths = {len(re.findall(r"(?<!\\)\|", line)) for line in block.splitlines()}
            assert len(widths) == 1, name


def test_every_picture_drawn_by_a_command_is_in_the_gallery(made):
    """Each picture that a command on a page draws stands in the gallery, above that command, and pages show no other.

    `test_pages.py` runs the command, and holds what it draws against the picture.
    """
    drawn, others = generate.drawn(), {"car.svg", pictures.ANIMATION.name, pictures.REPORT.name}
    assert {*(name for name, *_ in drawn), *others} == {path.name for path in PICTURES.iterdir()}
    shown = {name for each in PAGES for name in re.findall(r"!\[[^\]]*\]\([^)]*/([^/)]+)\)", page(each))}
    assert shown == {*(name for name, *_ in drawn), *others}
    for name, alt, line, _ in drawn:
        assert (PICTURES / name).exists()
        assert re.search(rf"!\[{re.escape(alt)}\]\([^)]*{name}\).*?{re.escape(line)}", made["gallery"], re.S)


def test_the_home_page_begins_with_a_car_over_a_bump():
    """The picture at the top of the home page is what `docs.generate.car` draws."""
    first = re.findall(r"!\[.*/([^/)]+)\)", page("docs/index.md"))[0]
    assert first == "car.svg"
    assert (PICTURES / first).read_text(encoding="utf-8") == generate.car()


@pytest.mark.attack
def test_the_animation_is_drawn_from_a_log(tmp_path):
    """Frames of README's animation are what `docs/pictures.py` draws from a log that is written now; the file is below 1 MB."""
    pytest.importorskip("matplotlib", reason="needs the extra [report]")
    image = pytest.importorskip("PIL.Image", reason="needs the extra [report]")
    motions = pictures.simulate(tmp_path)
    drawing, passive = pictures.Drawing(motions), motions["passive"]
    with image.open(pictures.ANIMATION) as film:
        assert film.n_frames == pictures.FRAMES
        for frame in (6, 40):
            film.seek(frame)
            shown, drawn = (
                np.asarray(each, float) for each in (film.convert("RGB"), drawing.at(pictures.frame_time(frame, passive)))
            )
            assert (abs(shown - drawn).max(axis=-1) > 64).mean() < 0.01  # letters move with fonts, and WebP blurs edges
    assert pictures.ANIMATION.stat().st_size < 1_000_000


def test_every_command_of_the_questions_is_one():
    """Each command in the sentences of the questions is accepted by its parser."""
    commands = re.findall(r"`roadproof ([^`]+)`", page("docs/questions.md").replace("\n", " "))
    assert len(commands) > 8
    for verb, *arguments in map(shlex.split, commands):
        generate.parser_of(VERBS[verb]).parse_args(arguments)


def test_the_notebook_runs(tmp_path, monkeypatch, made):
    """Its cells run one after the other, print what is stored below each, and stand on the page."""
    pytest.importorskip("pandas", reason="needs the extra [report]")
    pytest.importorskip("matplotlib", reason="needs the extra [report]")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    names: dict[str, object] = {}
    for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        assert source in made["tutorials/notebook"]
        if cell["cell_type"] == "code":
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                exec(compile(source, "notebook", "exec"), names)
            assert printed.getvalue() == "".join("".join(output["text"]) for output in cell["outputs"])
    assert (tmp_path / "bump.png").stat().st_size > 10_000
