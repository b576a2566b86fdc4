"""The page by itself: what stands in it for readers with eyes, without, at night, on paper; and figures of any kind in it."""

import base64
import csv
import dataclasses
import hashlib
import itertools
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser

import numpy as np
import pytest

from models.document.description import about
from models.document.document import Document, Pivot, Table, notes
from models.document.figure import OTHERS, STYLES, Bars, Classes, Curve, Figure, Panel, axis_ends, drawn_indices, rgb, styles
from models.document.outputs import check_outputs
from models.document.page import Page, render
from models.document.picture import FONT, cells, panel_svg, ticks, write_picture
from models.document.reading import align_numbers, notation, read, short_form, write_rows
from models.laws.linear import static_law
from models.vehicle.vehicle import read_vehicle
from sim.drive.regime import REGIME_ENDS
from sim.report.designs import gain_table
from sim.studies.validity.report import NOTHING
from tests.support.commands import ROOT, attacks, environment
from tests.support.reading import number

pytest.importorskip("jinja2", reason="a report needs the extra [report]")
pytest.importorskip("matplotlib", reason="a report needs the extra [report]")

CSS = (ROOT / "models" / "document" / "page.css").read_text(encoding="utf-8")
VOID = {"meta", "link", "br", "img", "input", "hr"}
HOSTILE = ('<script>alert("1")</script>', "a & b 'quoted' \"twice\"", "Ω" * 40, "n" * 60, "中" * 20, "]]>", "a\tb c", "{{ x }}")
LEFTWARD = ("العربية", "עברית_1-2", "x_שלום")


class Elements(HTMLParser):
    """Every element of a page with its attributes, its text, and those around it; raises where elements do not nest."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[dict] = []
        self.all: list[dict] = []
        self.feed(page)
        assert not self.open, f"not closed: {[one['tag'] for one in self.open]}"

    def handle_starttag(self, tag, attrs) -> None:
        assert len(dict(attrs)) == len(attrs), f"an attribute twice in {tag}"
        one = {"tag": tag, "text": "", "around": [each["tag"] for each in self.open], **{f"@{k}": v for k, v in attrs}}
        self.all.append(one)
        if tag not in VOID:
            self.open.append(one)

    def handle_startendtag(self, tag, attrs) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag) -> None:
        assert self.open.pop()["tag"] == tag

    def handle_data(self, data) -> None:
        for one in self.open:
            one["text"] += data

    def some(self, tag: str) -> list[dict]:
        """All elements of a tag."""
        return [one for one in self.all if one["tag"] == tag]


def everything(names: tuple[str, ...]) -> Page:
    """A page with every kind of figure, of controllers of these names."""
    x, y = np.geomspace(0.1, 25, 50), np.linspace(0, 2, 4)
    style = styles(names)
    curves = tuple(Curve(x, (k + 1) / x, name, *style[name]) for k, name in enumerate(names))
    points = tuple(Curve(x[::9], 1 / x[::9], "", "#d62728", "none", marker, name="found") for marker in ("o", "x", "+"))
    z = np.add.outer(y, x)
    ground = Classes(x, y, (z > 9).astype(int), ("#ffffff", "#7aa6d8"), ("nothing & all", "<high>"))
    bars = Bars(
        names, np.arange(1.0, len(names) + 1), ("0.123 m/s² (−78 %)",) * len(names), tuple(style[name][0] for name in names)
    )
    panels = (
        Panel(f"lines\nof {names[0]}", "frequency <& [Hz]", "gain [m]", curves + points, xlog=True, ylog=True),
        Panel("map", "speed [m/s]", "height [m]", points[:1], ground),
        Panel("bars", "norm", "", (), bars),
    )
    tables = tuple(Table(f"t{k}", f"of {name}", ("a", "b"), ((name, "1"), ("x", "2"))) for k, name in enumerate(names))
    figures = tuple(Figure(f"f{k}", f"figure {k}", (panel,), columns=1 + k % 2) for k, panel in enumerate(panels))
    section = Document("A term", (*notes("text"), *figures, *tables))
    return Page("title", Document("", notes(*names)), (section,))


PAGES = {
    "plain": ("passive", "state", "I", "II"),
    "hostile": HOSTILE,
    "many": tuple(f"controller-{k}" for k in range(12)),
    "leftward": LEFTWARD,
}


@pytest.fixture(scope="module", params=PAGES)
def page(request) -> tuple[str, Elements]:
    """A page with every kind of figure, and its elements."""
    text = render(everything(PAGES[request.param]))
    return text, Elements(text)


def test_structure(page):
    """One main, one first heading, contents whose links lead somewhere, no heading skipped, every identifier once."""
    _, found = page
    assert [one["@lang"] for one in found.some("html")] == ["en"]
    assert len(found.some("main")) == len(found.some("h1")) == len(found.some("title")) - len(found.some("desc")) == 1
    assert "header" in found.some("h1")[0]["around"]
    assert found.some("nav")[0]["@aria-label"]
    levels = [int(one["tag"][1]) for one in found.all if re.fullmatch("h[1-6]", one["tag"])]
    assert all(after - before <= 1 for before, after in itertools.pairwise(levels))
    identifiers = [one["@id"] for one in found.all if "@id" in one]
    assert len(set(identifiers)) == len(identifiers)
    assert not any(re.search(r"\s", one) for one in identifiers)
    within = [one["@href"][1:] for one in found.some("a")]
    assert within
    assert {*within} <= set(identifiers)
    order = [one.get("@id", one["tag"]) for one in found.all if one.get("@id") == "answer" or one["tag"] == "nav"]
    assert order == ["answer", "nav"]  # who comes by keyboard, by ear or by phone need not go through the contents


def test_figures_say_what_they_show(page):
    """Every picture is one with a title and a text, in a figure with a caption; what only decorates is passed over."""
    _, found = page
    texts = {one["@id"]: one["text"] for one in found.all if one["tag"] in ("title", "desc") and "@id" in one}
    plots = [one for one in found.some("svg") if one.get("@role") == "img"]
    assert len(plots) == 3
    for one in plots:
        assert "figure" in one["around"]
        assert all(texts[name].strip() for name in one["@aria-labelledby"].split())
    assert all(one["@aria-hidden"] == "true" for one in found.some("svg") if "li" in one["around"])
    captions = found.some("figcaption")
    assert [one["text"].split(".")[0] for one in captions] == [f"Figure {k + 1}" for k in range(len(found.some("figure")))]


def test_tables_say_what_they_are(page):
    """Every table has a caption, names its columns and its rows, and one that is too wide can be scrolled by keyboard."""
    _, found = page
    assert len(found.some("caption")) == len(found.some("table")) > 0
    assert all(one["@scope"] == ("col" if "thead" in one["around"] else "row") for one in found.some("th"))
    assert len([one for one in found.some("th") if one["@scope"] == "row"]) == 2 * len(found.some("table"))
    regions = [one for one in found.some("div") if one.get("@class") == "table"]
    captions = {one["@id"] for one in found.some("caption")}
    assert all((one["@tabindex"], one["@role"], one["@aria-labelledby"] in captions) == ("0", "region", True) for one in regions)


def test_only_its_own_style(page):
    """The page has no script, its policy allows only its own style, by its digest, and nothing is inline."""
    text, found = page
    policy = next(one["@content"] for one in found.some("meta") if one.get("@http-equiv") == "Content-Security-Policy")
    (content,) = re.findall("<style>(.*?)</style>", text, re.S)
    digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
    assert policy == f"default-src 'none'; style-src 'sha256-{digest}'; img-src data:"
    assert not found.some("script")
    assert not [name for one in found.all for name in one if name == "@style" or name.startswith("@on")]


def test_names_are_text(page):
    """Whatever a controller is called stands on the page as it is, and is no markup."""
    text, found = page
    captions = " ".join(" ".join(one["text"] for one in found.some("caption")).split())
    assert any(f"of {name}" in captions for name in (HOSTILE[0], "passive", "controller-0", LEFTWARD[0]))
    assert "alert(" not in re.sub(r"&lt;script&gt;.*?&lt;/script&gt;", "", text)
    assert "\n".join(one["text"] for one in found.some("p")).count("{{ x }}") == text.count("<p>{{ x }}")


def test_names_from_right_to_left_keep_to_themselves():
    """Wherever a page shows such a name in a sentence or a table, it is an element, so that nothing beside it changes sides."""
    text = re.sub(
        r"<style>.*?</style>|<svg.*?</svg>|(?:id|aria-labelledby)=\"[^\"]*\"", "", render(everything(LEFTWARD)), flags=re.S
    )
    for name in LEFTWARD:
        assert text.count(name) == text.count(f"<bdi>{name}</bdi>") >= 4  # a sentence, a caption, a cell, a legend


@pytest.mark.attack
def test_nothing_leaves_a_picture(tmp_path, monkeypatch):
    """With long names, and many, every text of a picture is inside it, and none lies over another one."""
    from matplotlib.figure import Figure as Canvas

    drawn = []
    save = Canvas.savefig
    monkeypatch.setattr(Canvas, "savefig", lambda self, *some, **more: (drawn.append(self), save(self, *some, **more)))
    names = ("passive", "__proto__", "W" * 60, "n" * 60, *(f"controller_of_some_length_{k}" for k in range(6)))
    style, x = styles(names), np.linspace(0, 1, 9)
    curves = tuple(Curve(x, x, name, *style[name]) for name in names)
    bars = Bars(names, np.arange(1.0, 11.0), ("0.269 m/s² (−76 %)",) * 10, tuple(style[name][0] for name in names))
    long = "sprung acceleration weighted, road of class C at 20 m/s: shorter is better"
    lines = Figure("a", f"{long}, {long}, {'W' * 60}", (Panel(long, "x", "y", curves),) * 2)
    for figure in (lines, Figure("b", long, (Panel(f"How?\n{long}", "norm", "", (), bars),) * 2, columns=2)):
        write_picture(figure, tmp_path / "a.png")
        canvas = drawn[-1]
        canvas.draw_without_rendering()  # the file has another resolution
        boxes = [text.get_window_extent() for text in canvas.texts]
        assert "__proto__" in [text.get_text() for text in canvas.texts]
        assert all(canvas.bbox.x0 <= box.x0 < box.x1 <= canvas.bbox.x1 for box in boxes)
        assert all(canvas.bbox.y0 <= box.y0 < box.y1 <= canvas.bbox.y1 for box in boxes)
        assert not [pair for pair in itertools.combinations([box.padded(-1) for box in boxes], 2) if pair[0].overlaps(pair[1])]


@pytest.mark.skipif(os.name == "nt", reason="links of POSIX")
@pytest.mark.parametrize(("name", "begins"), [("l.PNG", b"\x89PNG"), ("l.svg", b"<?xml")])
def test_the_name_that_is_given_says_what_a_picture_is(name, begins, tmp_path):
    """Through a link of that name, whatever the name of what it leads to."""
    link = tmp_path / name
    link.symlink_to("other.txt")
    check_outputs({"picture": link})
    write_picture(Figure("a", "b", (Panel("c", "x", "y", (Curve(np.arange(2.0), np.arange(2.0), "d", "#000000"),)),)), link)
    assert (tmp_path / "other.txt").read_bytes().startswith(begins)
    assert link.is_symlink()


def test_the_picture_is_the_data():
    """Every point of a curve is drawn where the labels of the axes have it, to 0.02 px; gaps are gaps."""
    x = np.geomspace(0.1, 25, 200)
    y = np.exp(np.sin(3 * x))
    y[[50, 51, 120]] = np.nan
    panel = Panel("", "x [Hz]", "y [m]", (Curve(x, y, "I"), Curve(x, y, "", marker="o", dash="none", name="found")), xlog=True)
    element = ElementTree.fromstring(panel_svg(panel, "p"))
    known, points = np.isfinite(y), [(float(one.attrib["x"]), float(one.attrib["y"])) for one in element.iter("use")]
    for values, side, k in ((np.log10(x), "middle", 0), (y, "end", 1)):
        labels = [one for one in element.iter("text") if one.get("text-anchor") == side and one.text not in ("x [Hz]", "y [m]")]
        at = [float(one.attrib["xy"[k]]) for one in labels]
        numbers = [number(one.text or "") for one in labels]
        scale = np.polyfit(np.log10(numbers) if k == 0 else numbers, at, 1)
        shift = 0.36 * FONT * k  # of the middle of a label from its baseline
        np.testing.assert_allclose([point[k] for point in points], np.polyval(scale, values[known]) - shift, atol=0.02)
    (line,) = [one.attrib["d"] for one in element.iter("path") if one.get("stroke") == "#404040" and one.get("fill") == "none"]
    assert line.count("M") == 3


def test_cells_are_where_the_axes_say():
    """The outline of a class contains the centres of its cells, each in its row from below, and no other centre."""
    kind = np.array([[0, 1, 1, 0, 1], [1, 0, 0, 0, 1], [0, 0, 1, 2, 1]])
    x, y = np.arange(5.0), 2 * np.arange(3.0)
    centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    for i in range(3):
        outline = cells(kind == i, x, y)
        parts = [type(outline)(outline.vertices[k : k + 5]) for k in range(0, len(outline.vertices), 5)]
        inside = np.sum([part.contains_points(centres) for part in parts], axis=0)
        assert inside.tolist() == (kind == i).ravel().astype(int).tolist()


def test_every_panel_is_sound_xml():
    """The SVG of any panel is well-formed, with names as they are; also where there is nothing to draw, or no number."""
    none, x = np.zeros(0), np.array([1.0, 2.0])
    odd = [
        Panel("", "x", "y", (), xlog=True, ylog=True),
        Panel("", "x", "y", (Curve(none, none, "MuJoCo"),)),
        Panel("", "x", "y", (Curve(x, np.full(2, np.inf), "up"), Curve(x, np.array([-1.0, 0.0]), "low")), ylog=True),
        Panel("", "x", "y", (Curve(x, np.full(2, 7.0), "flat"),)),
        Panel("", "x", "y", (Curve(x, np.array([1e-300, 1e300]), "wide"),), ylog=True),
        Panel("", "x", "y", (Curve(x, np.array([0.0, 1e300]), "cut"),), ylim=(0.0, 1.0)),
        Panel("", "norm", "", (), Bars(("all", "fail"), np.full(2, np.nan), ("unstable", "unstable"), ("#000000", "#d62728"))),
    ]
    whole = [panel for section in everything(HOSTILE).sections for figure in section.figures for panel in figure.panels]
    for panel in [*odd, *whole]:
        text = panel_svg(panel, "p")
        ElementTree.fromstring(text)
        assert "nan" not in re.sub(r"<(title|desc).*?</\1>", "", text)
        assert "inf" not in re.sub(r"<(title|desc).*?</\1>", "", text)


def test_long_names_are_shortened_beside_their_bar():
    """A name that there is no room for is cut with dots in the picture, and whole in its text; another one is as it is."""
    names = ("passive", "n" * 60, "中" * 20)
    panel = Panel("bars", "norm", "", (), Bars(names, np.ones(3), ("7.843 (−78 %)",) * 3, ("#000000",) * 3))
    element = ElementTree.fromstring(panel_svg(panel, "p"))
    shown = [one.text or "" for one in element.iter("text")][::2][:3]
    assert shown[0] == "passive"
    for text, name in zip(shown[1:], names[1:], strict=True):
        assert text.endswith("…")
        assert name.startswith(text[:-1])
        assert 8 < len(text) < len(name)
    description = element.find("desc")
    assert description is not None
    assert all(name in (description.text or "") for name in names)


@pytest.mark.parametrize("log", [False, True])
def test_ticks(log):
    """Over ranges of every size ticks are on the axis, neither too few nor too many, all different, and have true labels."""
    rng = np.random.default_rng(3)
    for _ in range(300):
        low = float(10 ** rng.uniform(-8, 8)) * (1 if log else rng.choice([-1, 1]))
        high = low * float(10 ** rng.uniform(0.05, 9)) if log else low + float(10 ** rng.uniform(-2, 3)) * abs(low)
        values, labels = ticks((low, high), log)
        assert 2 <= len(values) <= 10
        assert len(set(labels)) == len(labels)
        room = 1e-6 * (high - low)
        for value, label in zip(values, labels, strict=True):
            assert low - room <= value <= high + room
            # To a hundredth of the axis where the step has so many digits that they are cut.
            assert number(label) == pytest.approx(value, rel=1e-5, abs=0 if log else 0.01 * (high - low))


def test_axes_hold_their_numbers():
    """An axis contains every number that is finite, with room, also if it is a single one."""
    low, high = axis_ends([np.array([3.0, np.nan, -2.0]), np.array([np.inf, 5.0])])
    assert (low, high) == pytest.approx((-2.28, 5.28))
    assert axis_ends([np.full(3, 7.0)]) == pytest.approx((6.3, 7.7))
    assert axis_ends([]) == (0, 1)


def variables(block: str) -> dict[str, str]:
    """The colours that a block of the style sheet names."""
    return dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", block))


# Minimum contrasts, success criteria 1.4.3 and 1.4.11 of WCAG; and what `hue-rotate(180deg)` of CSS makes of a colour.
TEXT, GRAPHICS = 4.5, 3.0
TURNED = np.array([[-0.574, 1.430, 0.144], [0.426, 0.430, 0.144], [0.426, 1.430, -0.856]])


def by_night(color: str) -> str:
    """Returns a colour of a drawing as a dark page shows it, inverted with its hue kept."""
    return "#" + "".join(f"{round(255 * part):02x}" for part in np.clip(TURNED @ (1 - np.array(rgb(color)) / 255), 0, 1))


def contrast(color: str, other: str) -> float:
    """Returns the contrast ratio of two colours, from 1 to 21."""
    parts = np.array([rgb(color), rgb(other)]) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    low, high = sorted(linear @ [0.2126, 0.7152, 0.0722])
    return (high + 0.05) / (low + 0.05)


def test_page_can_be_read():
    """By day and by night every colour of text has a contrast of 4.5 against its ground, and each drawn line or marker has 3.

    Lines of figures stand on the page; those on maps are black. The contrast of #767676 on white is the guidelines' example.
    """
    assert contrast("#767676", "#ffffff") == pytest.approx(4.54, abs=0.005)
    by_day = variables(CSS.split("@media", 1)[0])
    night = by_day | variables(re.findall(r"@media screen and \(prefers-color-scheme: dark\) \{(.*?)\n\}", CSS, re.S)[0])
    for colors in (by_day, night):
        for text, ground in itertools.product(("ink", "soft", "link", "holds", "ends", "fails"), ("ground", "band")):
            assert contrast(colors[text], colors[ground]) >= TEXT, (text, ground)
    assert "filter: invert(1) hue-rotate(180deg);" in CSS
    assert contrast(by_night("#e9e7e4"), night["ground"]) < 1.1  # white parts of drawings
    for color in {*(style.color for style in STYLES.values()), *OTHERS}:
        assert contrast(color, by_day["ground"]) >= GRAPHICS
        assert contrast(by_night(color), night["ground"]) >= GRAPHICS
    for ground in (NOTHING, *(end.color for end in REGIME_ENDS)):
        assert min(contrast("#000000", ground), contrast(by_night("#000000"), by_night(ground))) >= GRAPHICS, ground


def test_numbers_of_a_column_are_aligned():
    """Points are below each other, and every number has the digits that it has on a terminal."""
    assert align_numbers(["15.37", "5.564", "0"]) == ["15.37\u2007", "5.564", "0\u2008\u2007\u2007\u2007"]
    assert align_numbers(["0.0481*", "0.565", "0*"]) == ["0.0481*", "0.565\u2004\u2007", "0*\u2008" + 4 * "\u2007"]
    assert align_numbers(["10825.2", "-2069.5", "-1.2e-07", "-"]) == ["10825.2", "−2069.5", "−1.2·10⁻⁷", "-"]
    assert align_numbers(["12", "3.25", "none"]) == ["12", "3.25", "none"]


def test_one_notation():
    """Powers, squares and tolerances are written one way; a name that looks like a number is left alone."""
    assert notation("within 1.4e-03 of 2 m/s2, +-3 rad/s2") == "within 1.4·10⁻³ of 2 m/s², ±3 rad/s²"
    assert notation("controller a1e-05 and v1e5") == "controller a1e-05 and v1e5"


def test_tables_are_for_reading(tmp_path):
    """What is the same in all rows stands below, repeated remarks are footnotes, long tables are pivoted; files have all."""
    remark = "the solver of the paper stops early here"
    rows = tuple((f"row {k}", "N", remark if k else "same", f"{k + 1}.5") for k in range(16))
    shown = read(("what", "unit", "why", "value"), rows, 3)
    assert shown.headings == ("what", "why", "value")
    assert shown.same == ("unit: N",)
    assert [row[1] for row in shown.rows] == ["same", *["(a)"] * 15]
    assert (shown.notes, shown.folded) == ((("a", remark),), True)
    assert read(("what", "why", "value"), [(k, remark, k) for k in "xyz"], 2).notes == ()  # it is below, and no footnote
    rows = tuple((signal, "m/s2", name, f"{k}.25") for k, signal in enumerate("ab") for name in ("I", "II"))
    table = Table(
        "t", "of", ("signal", "unit", "controller", "peak"), rows, 3, Pivot(("signal", "unit"), "controller", ("peak",))
    )
    assert short_form(table).headings == ("signal", "I", "II")
    assert short_form(table).rows == (("a [m/s²]", "0.25", "0.25"), ("b [m/s²]", "1.25", "1.25"))
    write_rows(tmp_path / "t.csv", [table.headings, *table.rows])
    assert [tuple(row) for row in csv.reader((tmp_path / "t.csv").read_text().splitlines())] == [table.headings, *rows]


def test_a_figure_in_words():
    """The text of a figure names every line with its largest value, and every class of a map with its share."""
    x = np.linspace(0, 3, 31)
    panel = Panel("travel\nover a bump", "time [s]", "travel [m]", (Curve(x, -((x - 1) ** 2), "I"), Curve(x, x, "", name="II")))
    title, text = about(panel)
    assert title == "travel; over a bump"
    assert text.startswith("As drawn, I: largest 0 m at 1 s, least -4 at 3 s, at the end -4.")
    assert "II: largest 3 m at 3 s" in text
    ground = Classes(x[:2], x[:2], np.array([[0, 0], [0, 1]]), ("#ffffff", "#000000"), ("fine", "broken"))
    assert "fine, 75 %; broken, 25 %;" in about(Panel("map", "x", "y", (), ground))[1]
    panel = Panel("ride", "class of road", "m/s²", (Curve(np.arange(3.0), np.array([1.0, 3.0, 2.0]), "I"),), None)
    panel = dataclasses.replace(panel, xticks=(0.0, 1.0, 2.0), xnames=("A", "B", "C"))  # classes of roads, by their names
    assert "largest 3 at B, least 1 at A, at the end 2." in about(panel)[1]


@pytest.mark.parametrize("every", [1, 60])
def test_what_is_left_of_a_line_keeps_its_largest_and_least(every):
    """Of a line that is thinned the ends, the largest and the least are the whole line's, and so are the words."""
    y = np.sin(np.linspace(0.3, 30, 501)) * np.linspace(1, 2, 501)
    some = y[kept := drawn_indices(y, every)]
    assert kept[[0, -1]].tolist() == [0, 500]
    assert (some.max(), some.min()) == (y.max(), y.min())
    assert len(some) <= len(y) / every + 4  # two of a block that is not whole, and both ends
    gone = np.where(np.arange(501) < 470, y, np.nan)  # a line that breaks off
    assert np.nanmax(gone[drawn_indices(gone, every)]) == np.nanmax(gone)


def test_gains_are_matrices(designer):
    """A gain's table has a column for every force, a row for every signal with its unit, and the entries of the gain."""
    vehicle, gain = read_vehicle("full_car"), np.arange(12.0).reshape(4, 3)
    measured = ("heave_velocity", "pitch_rate", "roll_rate")
    table = gain_table(vehicle, dataclasses.replace(designer.design("I"), measured=measured, law=static_law(gain)))
    assert table is not None
    assert table.headings == ("for each", "unit", *(name.replace("_", " ") for name in vehicle.linear_model.inputs))
    assert [row[:2] for row in table.rows] == [("heave velocity", "N·s/m"), ("pitch rate", "N·s/rad"), ("roll rate", "N·s/rad")]
    assert [[float(cell) for cell in row[2:]] for row in table.rows] == gain.T.tolist()
    assert gain_table(vehicle, designer.design("passive")) is None


@pytest.mark.parametrize("backend", ["nonsense", *attacks(["svg", "module://matplotlib_inline.backend_inline"])])
def test_a_backend_of_another_environment(backend, tmp_path):
    """A picture is drawn whatever MPLBACKEND names; a backend that exists stays that of the caller's own figures."""
    code = "import pathlib; from models.document.figure import *; from models.document.picture import write_picture\n"
    code += f"write_picture(Figure('a', 'b', (Panel('c', 'x', 'y', ()),)), pathlib.Path({str(tmp_path / 'a.png')!r}))\n"
    code += "import matplotlib, os; print(os.environ['MPLBACKEND'], matplotlib.rcParams['backend'])"
    words, own = [sys.executable, "-c", code], environment() | {"MPLBACKEND": backend}
    printed = subprocess.run(words, cwd=ROOT, env=own, capture_output=True, text=True, check=True).stdout.split()
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert printed[0] == backend
    assert backend != "svg" or printed[1] == "svg"
