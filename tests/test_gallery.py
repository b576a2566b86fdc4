"""The gallery: numbers that others printed come out here, or differ for a reason that is small enough."""

import csv
import html
import json
import math
import re
from urllib.parse import unquote

import numpy as np
import pytest

from models.common.errors import InputError
from models.figures.reading import notation
from sim.gallery import main
from sim.report.__main__ import main as report
from sim.studies.gallery import entries
from sim.studies.gallery.entries import names
from tests.commands import prose
from tests.test_page import Elements

ENTRY = """
title = "a title"
source = "a source"
licence = "none"
[[printed]]
what = "zero"
vehicle = "VEHICLE"
signal = "sprung_acceleration"
value = VALUE
digits = 2
where = "here"
"""


PICTURED = ("peak", "rms", "ratio", "norm")  # kinds of numbers that are of a response


@pytest.fixture(scope="module")
def printed():
    """Returns what the command says of all entries: its text and its JSON."""
    import contextlib
    import io

    said = []
    for options in ([], ["--json"]):
        with contextlib.redirect_stdout(io.StringIO()) as out:
            assert main(options) == 0
        said.append(out.getvalue())
    return said[0], {one["name"]: one for one in json.loads(said[1])["entries"]}


def test_every_number_is_reproduced_or_differs_for_a_reason(printed):
    """Ours rounds to the printed digits, or is as near as the reason explains; the text has every number of the JSON."""
    text, found = printed
    assert [*found] == names()
    for one in found.values():
        for number in one["numbers"]:
            near = abs(number["exact"] - number["printed"]) <= 0.5 * 10.0 ** -number["digits"] * (1 + 1e-9)
            assert number["verdict"] == ("reproduced" if near else "differs")
            assert bool(number["reason"]) or near
            assert f"{number['exact']:.{17 if number['digits'] > 12 else 9}g}" in text
        assert prose(text).count(one["source"]) == 1
        assert all(missing["why"] in prose(text) for missing in one["missing"])


def test_by_formulas(printed):
    """Numbers of linear analysis are those of formulas: zeros of (33), a transfer function, rms over a white road."""
    _, found = printed
    k, c, kt, ms, mu = 16000.0, 1000.0, 190000.0, 300.0, 60.0
    formulas = {
        "zero sprung_acceleration": math.sqrt(kt / mu),
        "zero suspension_deflection": math.sqrt(kt / (ms + mu)),
        "white sprung_acceleration": math.sqrt(0.5 * (kt * c / ms**2 + (ms + mu) * k**2 / (ms**2 * c))),
        "white suspension_deflection": math.sqrt((ms + mu) / (2 * c)),
    }
    ours = {number["number"]: number["exact"] for number in found["textbook"]["numbers"]}
    assert ours == pytest.approx(formulas, rel=1e-9)  # zeros and Lyapunov equations to rounding
    s, (k, c, ms, mu) = 2j * np.pi * 0.5, (16812.0, 1000.0, 290.0, 59.0)
    strut = k + c * s
    ratio = kt * strut / ((ms * s**2 + strut) * (mu * s**2 + strut + kt) - strut**2)
    (first, *peaks) = found["afc_replication"]["numbers"]
    assert first["exact"] == pytest.approx(abs(ratio), rel=1e-9)
    for peak in peaks:
        assert peak["mujoco"] == pytest.approx(peak["exact"], rel=2e-4)  # a car of 1 ms, against the continuous loop


def test_what_is_not_reproduced(tmp_path, monkeypatch, capsys):
    """A number that is off in its last digit is not reproduced, and the exit code says so; a reason explains no more than it
    says."""
    source = entries.FOLDER / "textbook" / "car.toml"
    monkeypatch.setattr(entries, "FOLDER", tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "car.toml").write_text(source.read_text())
    text = ENTRY.replace("VEHICLE", "car.toml")
    for value, more, code, word in (
        ("56.27", "", 0, "1 numbers reproduced"),
        ("56.28", "", 1, "1 NOT REPRODUCED"),
        ("56.28", 'reason = "rounded"\nwithin = 2e-4\n', 0, "1 differ for a reason"),
        ("56.48", 'reason = "rounded"\nwithin = 2e-4\n', 1, "1 NOT REPRODUCED"),
    ):
        (tmp_path / "mine" / "entry.toml").write_text(text.replace("VALUE", value) + more)
        assert main(["mine"]) == code
        assert word in prose(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("where =", "were =", "'were' means nothing"),
        ('what = "zero"', 'what = "root"', "what = 'root' is not allowed"),
        ('what = "zero"', 'what = "pole"', "is no pole; give"),
        ("licence =", 'sources = ["nobody"]\nlicence =', "unknown source 'nobody'"),
        ("sprung_acceleration", "heave", "unknown signal 'heave'"),
        ("licence =", "license =", "license"),
        ("VEHICLE", "none.toml", "none.toml"),
    ],
)
def test_entries_that_are_none(tmp_path, monkeypatch, old, new, said):
    """What an entry says that means nothing is named in one line."""
    source = entries.FOLDER / "textbook" / "car.toml"
    monkeypatch.setattr(entries, "FOLDER", tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "car.toml").write_text(source.read_text())
    text = ENTRY.replace(old, new).replace("VEHICLE", "car.toml").replace("VALUE", "56.27")
    (tmp_path / "mine" / "entry.toml").write_text(text)
    with pytest.raises(InputError, match=said):
        main(["mine"])
    with pytest.raises(InputError, match="unknown entry 'nothing'; the gallery has"):
        main(["nothing"])


def test_page(printed, tmp_path, capsys):
    """The page has every entry with its licence, every number, reason and picture of a response, and loads nothing."""
    pytest.importorskip("jinja2", reason="needs the extra [report]")
    _, found = printed
    path = tmp_path / "gallery.html"
    assert report(["--gallery", "--out", str(path), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert {one["name"]: one["numbers"] for one in result["entries"]} == {name: one["numbers"] for name, one in found.items()}
    text = path.read_text(encoding="utf-8")
    elements = Elements(text)
    assert "default-src 'none'" in text
    assert not [one for one in elements.all if one["tag"] in ("img", "script", "link") and one.get("@src")]
    shown = " ".join(re.sub(r"<[^>]*>", "", html.unescape(text)).split())
    assert sum(one["tag"] == "figure" for one in elements.all) == len(
        {name for name, one in found.items() if any(each["number"].split()[0] in PICTURED for each in one["numbers"])}
    )
    assert "every number is reproduced, or differs for a reason" in shown
    for one in found.values():
        assert f"Source: {one['source']}. Licence: {one['licence']}." in shown
        assert all(missing["why"] in shown for missing in one["missing"])
        assert all(
            re.sub(r"<[^>]*>", "", notation(number["reason"])) in shown
            for number in one["numbers"]
            if number["verdict"] == "differs"
        )
    links = re.findall(r'href="data:text/csv[^,"]*,([^"]*)"', text)
    rows = [row for link in links for row in csv.reader(unquote(link).splitlines())]
    for number in (each for one in found.values() for each in one["numbers"]):
        start = f"{number['exact']:.9g}"[:8]
        assert [
            row for row in rows if row[:2] == [number["number"], number["where"]] and any(cell.startswith(start) for cell in row)
        ]


def test_page_is_of_no_vehicle(tmp_path, monkeypatch):
    """Options of a vehicle's report are refused, and a number that is not reproduced is the page's verdict and exit code."""
    pytest.importorskip("jinja2", reason="needs the extra [report]")
    for options in (["--controller", "I"], ["--quick"], ["--load", "brake:g=0.5"], ["--vehicle", "quarter_car"]):
        with pytest.raises(InputError, match=f"{options[0]} is of a vehicle file's report"):
            report(["--gallery", *options])
    source = entries.FOLDER / "textbook" / "car.toml"
    monkeypatch.setattr(entries, "FOLDER", tmp_path)
    monkeypatch.setattr("sim.studies.gallery.entries.names", lambda: ["mine"])
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "car.toml").write_text(source.read_text())
    (tmp_path / "mine" / "entry.toml").write_text(ENTRY.replace("VEHICLE", "car.toml").replace("VALUE", "56.28"))
    assert report(["--gallery", "--out", str(tmp_path / "wrong.html")]) == 1
    assert "numbers are NOT REPRODUCED" in (tmp_path / "wrong.html").read_text(encoding="utf-8")
