"""The report: one file that needs no network, with every figure drawn and every table filled, in a real browser."""

import csv
import html
import json
import re
from pathlib import Path

import numpy as np
import pytest

from models.common.errors import InputError
from models.document.figure import STYLES, Bars, Classes, Curve, Figure, Panel, styles
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.report.__main__ import main
from sim.report.designs import other_ways
from sim.studies.ride import over_roads as report_ride
from synth.vehicle.designer import Designer
from tests.commands.golden import QUICK, golden
from tests.support.commands import prose
from tests.support.shared import printed

pytest.importorskip("jinja2", reason="a report needs the extra [report]")
pytest.importorskip("matplotlib", reason="a report needs the extra [report]")


@pytest.fixture(scope="module")
def report() -> tuple[Path, dict]:
    """A quick report of the paper's vehicle, and its JSON."""
    done = golden("sim.report", "plain")
    assert done.code == 0
    return done.folder / "report.html", done.json


def test_names_and_sketch(report):
    """A page begins with a sketch of its vehicle; names of controllers are code in its sentences, plain in title and SVG."""
    page, result = report
    text = page.read_text(encoding="utf-8")
    assert result["headline"].startswith("`II` rides and holds the road best")
    assert "<h2><code>II</code> rides and holds the road best" in text
    assert text.index('<figure class="vehicle">') < text.index("<h2>")
    assert "<title>quarter_car: passive, state, I and II on a quarter car" in text
    assert "`" not in html.unescape(text)


def test_page_has_all_figures_and_tables(report):
    """Every figure is drawn once, each table has all its rows, and the page is small, with no script and no network."""
    page, result = report
    text = page.read_text(encoding="utf-8")
    plots = re.findall(r'<svg class="plot[^"]*" id="([^"]+)"', text)
    assert len(plots) == len(set(plots)) == 4 + 8  # ride, travel, load and force; Fig. 3 and Fig. 4, four signals each
    for name, rows in result["tables"].items():
        table = re.search(rf'id="table-{name}".*?</table>', text, re.S)
        assert table
        assert 2 <= table[0].count("<tr>") <= 1 + len(rows)  # a long one is pivoted, and whole below
        whole = re.search(rf'id="table-{name}-whole".*?</table>', text, re.S)
        assert (whole or table)[0].count("<tr>") == 1 + len(rows)
        assert "<td></td>" not in table[0].replace("> <", "><")
    assert set(re.findall(r"(?:src|href)=\"(?!#)[^\"]+", text)) == {'href="data:,'}  # of no icon
    assert "://" not in text
    assert len(text.encode()) < 500_000


def test_numbers_of_the_paper(report):
    """The page has every printed number, and says of each whether ours is the same."""
    _, result = report
    rows = {(row["equation"], row["quantity"]): row for row in result["tables"]["paper"]}
    assert rows["(41)", "gamma_Gs"]["paper"] == "7.8365"
    assert rows["(41)", "gamma_Gs"]["ours"] == "7.836458"
    assert rows["(41)", "gamma_Gs"]["to the digits printed"] == "same"
    assert "solver" in rows["(58)", "K_II[1, 1]"]["to the digits printed"]


@pytest.mark.attack
def test_remarks_of_the_paper(report, designer):
    """The page has what becomes of L = 0; a full one the genetic algorithm beside the two steps: gain, norm, work and time."""
    _, result = report
    without = {row["controller"]: row for row in result["tables"]["without-l"]}
    assert [name for name, row in without.items() if row["gain"] != "none"] == ["I, states [33]"]
    assert without["I, states [33]"]["state feedback"] == "499.632"
    assert without["I, states [33]"]["bound"] == "510.3363"
    table = other_ways(designer)
    ways = {row[0]: dict(zip(table.headings, row, strict=True)) for row in table.rows}
    assert ways["II, two steps"]["gain"] == "[[-8968.54]]"
    assert ways["II, two steps"]["work"] == "2 LMI problems"
    assert float(ways["II, genetic"]["norm"]) < float(ways["II, two steps"]["norm"]) == pytest.approx(7.906842)
    assert ways["I, genetic"]["work"].endswith(" norms")
    assert float(ways["I, genetic"]["processor time [s]"]) > 0
    assert "gain entries from -20000 to 20000, seed 1" in table.caption


@pytest.mark.attack
def test_figures_and_tables_as_files():
    """Every figure is there as SVG and PNG, every table as CSV with the page's numbers; files of others are named, and stay."""
    done = printed("sim.report", *QUICK, "--json", "--figures", ".", files={"gain-mine.csv": ""})
    folder, result = done.folder, done.json
    for name in ("frequency-responses", "bump"):
        assert (folder / f"{name}.svg").read_text().rstrip().endswith("</svg>")
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    for name, rows in result["tables"].items():
        with (folder / f"{name}.csv").open(newline="", encoding="utf-8") as file:
            assert [list(row) for row in csv.reader(file)][1:] == [list(row.values()) for row in rows]
    assert not list(folder.glob(".*"))
    assert (folder / "gain-I.csv").exists()
    assert result["not_of_this_report"] == ["gain-mine.csv"]
    assert (folder / "gain-mine.csv").exists()


@pytest.mark.attack
def test_every_kind_of_ground_is_drawn(tmp_path):
    """Cells, bars and contours go to the page and to a picture alike; the same figure gives the same bytes."""
    from models.document.document import Document, notes
    from models.document.page import Page, render
    from models.document.picture import level, write_picture

    x, y = np.linspace(0, 1, 5), np.linspace(0, 2, 4)
    z = x + y[:, None]
    line = Curve(*level(x, y, z, 1.5), "level", "#000000")
    np.testing.assert_allclose(line.x[1:-1] + line.y[1:-1], 1.5)  # z is linear, so its contour is exact
    cells = Panel("cells", "x", "y", (line,), Classes(x, y, (z > 1.5).astype(int), ("#ffffff", "#7aa6d8"), ("", "high")))
    bars = Panel("bars", "x", "", (), Bars(("a", "b"), np.array([np.nan, 1.0]), ("none", "1"), ("#000000", "#d62728")))
    figure = Figure("grounds", "two", (cells, bars))
    text = render(Page("t", Document("", notes("a < b")), (Document("s", (figure,)),)))
    assert "a &lt; b" in text
    assert len(re.findall(r'id="plot-grounds-\d(?:-title|-text)?"', text)) == 2 * 3  # each with its title and its text
    for suffix in (".svg", ".pdf", ".png"):
        paths = [tmp_path / f"{name}{suffix}" for name in "ab"]
        write_picture(figure, paths[0])
        write_picture(figure, paths[1])
        assert paths[0].read_bytes() == paths[1].read_bytes()


BROKEN = '[controllers.mine]\nmeasured = ["sprung_velocity"]\nlaw = "mine.py:step"\n'


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--timestep 0.002 --vehicle car.toml", r"sample_period = 0\.005 s is not a multiple of the timestep 0\.002 s"),
        ("--speed 9", "--speed needs a road; give --road or --class"),
        ("--gallery --as ecu", "--as and --gallery cannot be combined"),
        (
            "--vehicle car.toml --controller mine --timestep 0.005",
            r"^controller 'mine', law mine.py:step: step fails \(ZeroDivision",
        ),
    ],
)
def test_a_report_that_cannot_be_is_refused(options, words, tmp_path, monkeypatch):
    """Options that do not fit, and a law that fails, are one line, and leave no page behind."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("def step(sample, state):\n    return 1 / 0, state\n")
    text = f"{read_vehicle('quarter_car').text}\n[implementation]\nsample_period = 0.005\n{BROKEN}"
    (tmp_path / "car.toml").write_text(text)
    with pytest.raises(InputError, match=words):
        main(["--out", "no.html", *options.split()])
    assert not (tmp_path / "no.html").exists()


def test_names_in_any_script_are_drawn_without_a_word(tmp_path, recwarn):
    """A name that the font of pictures has no letters for is no reason to say anything on the terminal."""
    from models.document.picture import write_picture

    names = ("中文控制器", "n" * 60)
    bars = Panel("bars", "norm", "", (), Bars(names, np.ones(2), ("1", "1"), ("#000000", "#d62728")))
    write_picture(Figure("names", "", (bars,)), tmp_path / "a.png")
    assert not [str(one.message) for one in recwarn]


def test_styles_tell_controllers_apart():
    """The paper's controllers have the paper's dashes, others other ones, each its own; none differ by colour alone."""
    found = styles(("passive", "I", "mine", "yours"))
    assert found["I"].dash == "dashdot"
    assert len(set(found.values())) == 4
    many = styles(tuple(f"mine-{k}" for k in range(30)))
    assert len(set(many.values())) == 30
    assert len({(style.dash, style.marker) for style in [*many.values()][:20]}) == 20
    lines = [(style.color, style.dash) for style in styles((*STYLES, *many)).values()]
    assert len(set(lines)) == len(lines)


@pytest.mark.attack
def test_a_controller_looks_the_same_in_every_figure(tmp_path, capsys):
    """If an unstable loop is left out of some figures, the other controllers keep their colours and dashes in them."""
    path = tmp_path / "three.toml"
    gains = {"bad": 60000.0, "mild": -5000.0, "firm": -9000.0}
    sections = [f'[controllers.{name}]\nmeasured = ["sprung_velocity"]\ngain = [[{gain}]]\n' for name, gain in gains.items()]
    path.write_text("\n".join([read_vehicle("quarter_car").text, *sections]))
    asked = [word for name in gains for word in ("--controller", name)]
    out = tmp_path / "page.html"
    assert main(["--quick", "--timestep", "8e-3", "--vehicle", str(path), *asked, "--out", str(out)]) == 0
    legends = re.findall(r'<ul class="legend.*?</ul>', out.read_text(encoding="utf-8"), re.S)
    entries = [re.findall(r"<li>(.*?)</svg>(\w+)", one, re.S) for one in legends]
    looks = [{name: re.findall('stroke(?:-dasharray)?="([^"]*)"', key)[:2] for key, name in one} for one in entries if one]
    assert [set(one) for one in looks] == [{"mild", "firm"}, {"bad", "mild", "firm"}]  # frequency responses, the bump
    assert all(looks[0][name] == looks[1][name] for name in ("mild", "firm"))


@pytest.mark.attack
def test_ride_is_of_runs_that_came_through(monkeypatch):
    """A loop that diverges over every road has no ride: `test_report_numbers.py` has the numbers of those that do not."""
    monkeypatch.setattr(report_ride, "CLASSES", "B")
    monkeypatch.setattr(report_ride, "WINDOW", 2.0)
    vehicle = parse_vehicle(
        read_vehicle("quarter_car").text + '\n[controllers.wild]\nmeasured = ["sprung_velocity"]\ngain = [[1e6]]\n', source="wild"
    )
    rides = [*report_ride.OverRoads(vehicle, Designer(vehicle).design("wild"), 2e-3).rides()]
    rows = report_ride.ride_section(vehicle, rides, styles(("wild",))).tables[0].rows
    assert {row[4:] for row in rows} == {("-", "-", "-", "4 of 4 flat or diverged")}


OTHERS = """
[controllers.accelerated]
measured = ["suspension_deflection", "sprung_acceleration"]
A = [[-300.0]]
B = [[0.0, 300.0]]
C = [[-50.0]]
D = [[8000.0, 0.0]]
[implementation.noise]
sprung_acceleration = 0.01
"""


@pytest.mark.attack
def test_what_is_left_out_is_said(tmp_path, capsys):
    """All controllers of a file are reported but printed copies, and one line names these and how to have them.

    If neither I nor II is in the file, all that is there is reported.
    """
    text = read_vehicle("quarter_car").text
    for name, content in (("car", text), ("other", text.partition("[controllers")[0])):
        (tmp_path / f"{name}.toml").write_text(content + OTHERS)
    options = ["--quick", "--timestep", "8e-3", "--out", str(tmp_path / "car.html"), "--vehicle"]
    assert main([*options, str(tmp_path / "car.toml"), "--brief"]) == 0, (
        "nor is noise refused that only one of the others measures"
    )
    rest = "state_printed, I_printed, II_printed"
    assert rest in (tmp_path / "car.html").read_text("utf-8")
    said = prose(capsys.readouterr().out)
    assert f"not simulated: {rest}; add one with --controller NAME, or all with --controller all" in said
    assert main([*options, str(tmp_path / "other.toml"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["left_out"] == []
    assert [row["controller"] for row in found["tables"]["designs"]] == ["passive", "state", "accelerated"]
