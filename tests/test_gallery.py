"""The gallery: numbers that others printed come out here, or differ for a reason that is small enough."""

import json
import math

import numpy as np
import pytest
from scipy import linalg

from models.common.errors import InputError
from sim.gallery import main
from sim.studies.gallery import entries
from sim.studies.gallery.entries import names
from tests.commands import prose

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
            assert f"{number['exact']:.9g}" in text
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


def test_quansers_gain_is_that_of_its_earlier_rig(printed):
    """By a Riccati equation of matrices written out: the factory gain belongs to the tyre of 2500 N/m, not to that of 1250."""
    _, found = printed
    numbers = {one["number"]: one["exact"] for one in found["quanser"]["numbers"]}
    ms, mu, ks, bs, bt = 2.45, 1.0, 900.0, 7.5, 5.0
    for kt, ending in ((2500.0, ""), (1250.0, ", later")):
        A = np.array(
            [[0, 1, 0, -1], [-ks / ms, -bs / ms, 0, bs / ms], [0, 0, 0, 1], [ks / mu, bs / mu, -kt / mu, -(bs + bt) / mu]]
        )
        B = np.array([[0], [1 / ms], [0], [-1 / mu]])
        P = linalg.solve_continuous_are(A, B, np.diag([450.0, 30.0, 5.0, 0.01]), [[0.01]])
        K = (B.T @ P)[0] / 0.01
        ours = {f"gain lqr[0, {i}]{ending}": K[j] for i, j in ((0, 0), (2, 1), (1, 2), (3, 3))}
        for name in ours.keys() & numbers.keys():
            assert numbers[name] == pytest.approx(ours[name], rel=1e-8)
