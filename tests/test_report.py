"""The report: one file that needs no network, whose every plot is drawn and every table filled, in a real browser."""

import csv
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from models.common.errors import InputError
from models.vehicle import parse_vehicle, read_vehicle
from sim.figures.figure import Classes, Curve, Figure, Panel, Shades, level, styles
from sim.linear.loop import sampled_response
from sim.report import ride as report_ride
from sim.report.__main__ import main
from sim.ride.expected import settling_time
from sim.ride.metrics import measure
from sim.roads.iso8608 import Iso8608
from sim.runs.run import sample_times
from synth.designer import Designer

pytest.importorskip("plotly", reason="a report needs the extra [report]")
pytest.importorskip("matplotlib", reason="a report needs the extra [report]")

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
in_browser = pytest.mark.skipif(BROWSER is None, reason="needs a Chromium; on Debian: apt install chromium")


@pytest.fixture(scope="module")
def report(tmp_path_factory) -> tuple[Path, Path, dict]:
    """A quick report of the paper's vehicle, its figures, and its JSON."""
    folder = tmp_path_factory.mktemp("report")
    page, figures = folder / "report.html", folder / "figures"
    command = ["--quick", "--timestep", "0.002", "--out", str(page), "--figures", str(figures), "--json"]
    import contextlib
    import io

    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert main(command) == 0
    return page, figures, json.loads(out.getvalue())


def browse(page: Path, width: int, folder: Path, *options: str) -> tuple[str, str]:
    """The page's document as the browser has it after its scripts have run, and what the browser said."""
    assert BROWSER is not None
    done = subprocess.run(
        [
            BROWSER,
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-background-networking",
            "--disable-component-update",
            "--no-first-run",
            f"--user-data-dir={folder / 'profile'}",
            f"--window-size={width},2000",
            "--virtual-time-budget=15000",
            "--enable-logging=stderr",
            "--dump-dom",
            *options,
            page.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return done.stdout, done.stderr


@in_browser
def test_page_in_a_browser(report, tmp_path):
    """Every plot is drawn, every table filled, nothing is complained of, and nothing asked of a network."""
    page, _, result = report
    assert "default-src 'none'" in page.read_text(encoding="utf-8")  # what would go to a network is refused, and complained of
    dom, said = browse(page, 1600, tmp_path)
    assert "CONSOLE" not in said, said
    plots = re.findall(r'<div id="plot-[^"]+"', dom)
    assert len(plots) == len(set(plots)) == 8  # Fig. 3 and Fig. 4, four signals each
    assert dom.count('class="main-svg"') >= len(plots)
    for name, rows in result["tables"].items():
        table = re.search(rf'id="table-{name}".*?</table>', dom, re.S)
        assert table
        assert table[0].count("<tr>") == 1 + len(rows)
        assert rows
        assert "<td></td>" not in table[0].replace("> <", "><")


@in_browser
def test_browser_reports_a_request(report, tmp_path):
    """The test above would notice: a page that asks for a picture on a network is complained of."""
    text = report[0].read_text(encoding="utf-8")
    asking = tmp_path / "asking.html"
    asking.write_text(text.replace("</body>", '<img src="https://example.org/a.png"></body>'), encoding="utf-8")
    assert "CONSOLE" in browse(asking, 1600, tmp_path)[1]


@in_browser
def test_page_fits(report, tmp_path):
    """On a telephone and on a wide screen the page itself does not scroll sideways; wide tables do within it."""
    page, _, _ = report
    probe = tmp_path / "probe.html"
    # A headless window has a least width of its own, so the page is put into frames; each is measured when it is drawn.
    measure = "this.title = this.contentDocument.documentElement.scrollWidth"
    frames = [
        f'<iframe src="{page.as_uri()}" width="{width}" height="2000" onload="{measure}"></iframe>' for width in (400, 1600)
    ]
    probe.write_text("".join(frames))
    dom, _ = browse(probe, 2200, tmp_path, "--allow-file-access-from-files")
    narrow, wide = re.findall(r'<iframe [^>]*title="(\d+)"', dom)
    assert 300 < int(narrow) <= 400
    assert 1000 < int(wide) <= 1600


def test_page_is_self_contained(report):
    """Outside of Plotly's own code nothing in the page names another host."""
    page, _, _ = report
    text = page.read_text(encoding="utf-8")
    own = re.sub(r"<script>.*?</script>", "", text, count=1, flags=re.S)  # the first is Plotly
    assert len(own) < len(text) / 2
    assert not re.findall(r"(?:src|href)=\"(?!data:|#)[^\"]+", own)
    assert "://" not in own


def test_numbers_of_the_paper(report):
    """The page has every printed number, and says of each whether ours is the same."""
    _, _, result = report
    rows = {(row["equation"], row["quantity"]): row for row in result["tables"]["paper"]}
    assert rows["(41)", "gamma_Gs"]["paper"] == "7.8365"
    assert rows["(41)", "gamma_Gs"]["ours"] == "7.836458"
    assert rows["(41)", "gamma_Gs"]["to the digits printed"] == "same"
    assert "solver" in rows["(58)", "K_II[1, 1]"]["to the digits printed"]


def test_figures_and_tables_as_files(report):
    """Every figure is there as SVG and PNG, every table as CSV with the page's numbers."""
    _, folder, result = report
    for name in ("frequency-responses", "bump"):
        assert (folder / f"{name}.svg").read_text().rstrip().endswith("</svg>")
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    for name, rows in result["tables"].items():
        with (folder / f"{name}.csv").open(newline="", encoding="utf-8") as file:
            assert [list(row) for row in csv.reader(file)][1:] == [list(row.values()) for row in rows]
    assert not list(folder.glob(".*"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--out", "report.pdf"], "ends in .html"),
        (["--out", "/nowhere/report.html"], "no folder"),
        (["--controller", "X"], "unknown controller"),
        (["--timestep", "1"], "too large"),
    ],
)
def test_bad_input(arguments, words, tmp_path, monkeypatch):
    """One line, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=words):
        main(arguments)
    assert not list(tmp_path.iterdir())


def test_every_kind_of_ground_is_drawn(tmp_path):
    """Cells, shades and contours go to the page and to a picture alike; the same figure gives the same bytes."""
    from sim.figures.page import Page, Section, render
    from sim.figures.picture import write_picture

    x, y = np.linspace(0, 1, 5), np.linspace(0, 2, 4)
    z = x + y[:, None]
    line = Curve(*level(x, y, z, 1.5), "level", "#000000")
    np.testing.assert_allclose(line.x[1:-1] + line.y[1:-1], 1.5)  # z is linear, so its contour is exact
    cells = Panel("cells", "x", "y", (line,), Classes(x, y, (z > 1.5).astype(int), ("#ffffff", "#7aa6d8")))
    shades = Panel("shades", "x", "y", (), Shades(x, y, np.where(z > 2.9, np.nan, z), "z [m]"))
    figure = Figure("grounds", "two", (cells, shades))
    text = render(Page("t", ("a < b",), (Section("s", figures=(figure,)),)))
    assert "a &lt; b" in text
    assert text.count('id="plot-grounds') == 2
    for name in ("a.svg", "b.svg"):
        write_picture(figure, tmp_path / name)
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_styles_tell_controllers_apart():
    """The paper's controllers have the paper's styles, others other ones, each its own."""
    found = styles(("passive", "I", "mine", "yours"))
    assert found["I"] == ("#d62728", "dashdot")
    assert len(set(found.values())) == 4


def test_ride_is_of_runs_that_came_through(monkeypatch):
    """MuJoCo's numbers are roots of mean squares over the roads, as predicted ones are; a loop that diverges has none."""
    monkeypatch.setattr(report_ride, "CLASSES", "B")
    monkeypatch.setattr(report_ride, "WINDOW", 2.0)
    vehicle = parse_vehicle(
        read_vehicle("quarter_car").text + '\n[controllers.wild]\nmeasured = ["sprung_velocity"]\ngain = [[1e6]]\n', source="wild"
    )
    designed = [Designer(vehicle).design(name) for name in ("I_printed", "wild")]
    section = report_ride.ride_section(vehicle, designed, 2e-3)
    rows = {(row[1], row[2]): row for row in section.tables[0].rows}
    assert all(row[4:] == ("-", "-", "-", "4 of 4 flat or diverged") for (name, _), row in rows.items() if name == "wild")

    start = settling_time(vehicle, designed[0])
    time = sample_times(vehicle, start + 2.0, 2e-3)
    roads = [Iso8608("B", seed, 20.0) for seed in report_ride.SEEDS]
    found = [measure(vehicle, sampled_response(vehicle, designed[0], road, time), round(start / 2e-3)) for road in roads]
    for metric in ("sprung_acceleration_weighted", "suspension_deflection_rms", "control_force_rms"):
        rms = np.sqrt(np.mean([one[metric] ** 2 for one in found]))
        printed = float(rows["I_printed", metric.replace("_", " ")][4])
        assert printed == pytest.approx(rms, rel=2e-3)  # 4 digits, RK4, moments in which the wheel lifts
