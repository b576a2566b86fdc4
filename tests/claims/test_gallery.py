"""The gallery: numbers that others printed come out here, or differ for a reason that is small enough."""

import contextlib
import html
import io
import json
import math
import re

import numpy as np
import pytest
from scipy import linalg, optimize

from models.common.errors import InputError
from models.roads.obstacles import Step
from models.roads.road import Bump
from models.vehicle.vehicle import read_vehicle
from sim.gallery import main
from sim.report.__main__ import main as report
from sim.runs.run import run_controllers, sample_times
from sim.studies.gallery import entries, numbers
from sim.studies.gallery.entries import names
from sim.studies.gallery.numbers import OF_A_RUN
from sim.studies.ride.step_response import measure_step
from synth.vehicle.designer import Designer
from tests.commands.test_page import Elements
from tests.support.commands import attacks, prose
from tests.support.shared import share

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


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """Returns a function that writes the gallery's only entry, `mine`, with a car of another entry."""
    cars = entries.FOLDER
    monkeypatch.setattr(entries, "FOLDER", tmp_path)
    monkeypatch.setattr("sim.studies.gallery.entries.names", lambda: ["mine"])

    def write(text: str, value: str, of: str = "textbook"):
        (tmp_path / "mine").mkdir(exist_ok=True)
        (tmp_path / "mine" / "car.toml").write_text((cars / of / "car.toml").read_text())
        (tmp_path / "mine" / "entry.toml").write_text(text.replace("VEHICLE", "car.toml").replace("VALUE", value))

    return write


PICTURED = (*OF_A_RUN, "ratio", "norm")  # kinds of numbers that are of a response
LIGHT = [name for name in names() if name not in ("control_lab", "ctms", "mathworks")]  # without those that take most of the time


def said_of(*some: str):
    """Returns the JSON of some entries, by name."""
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as out:
        share(patch, numbers, "compare_numbers")
        assert main([*some, "--json"]) == 0
    return {one["name"]: one for one in json.loads(out.getvalue())["entries"]}


@pytest.fixture(scope="module")
def printed():
    """Returns the light entries."""
    return said_of(*LIGHT)


@pytest.fixture(scope="module")
def whole():
    """Returns all entries."""
    return said_of()


@pytest.mark.parametrize("which", ["printed", *attacks(["whole"])])
def test_every_number_is_reproduced_or_differs_for_a_reason(which, request):
    """Ours rounds to the published digits, or is as near as the reason explains."""
    found = request.getfixturevalue(which)
    assert [*found] == (LIGHT if which == "printed" else names())
    for number in (number for one in found.values() for number in one["numbers"]):
        half = 0.5 * 10.0 ** -number["digits"] * (1 + 1e-9)
        near = abs(number["exact"] - number["printed"]) <= half
        seen = number["grid"] is not None and not number["reason"] and abs(number["grid"] - number["printed"]) <= half
        assert number["verdict"] == ("reproduced" if near else "reproduced on its grid" if seen else "differs")
        assert bool(number["reason"]) or near or seen


def test_by_formulas(printed):
    """Numbers of linear analysis are those of formulas: zeros of (33), a transfer function, rms over a white road."""
    found = printed
    k, c, kt, ms, mu = 16000.0, 1000.0, 190000.0, 300.0, 60.0
    formulas = {
        "zero sprung_acceleration": math.sqrt(kt / mu),
        "zero suspension_deflection": math.sqrt(kt / (ms + mu)),
        "white sprung_acceleration": math.sqrt(0.5 * (kt * c / ms**2 + (ms + mu) * k**2 / (ms**2 * c))),
        "white suspension_deflection": math.sqrt((ms + mu) / (2 * c)),
    }
    ours = {number["number"]: number["exact"] for number in found["textbook"]["numbers"][:4]}
    assert ours == pytest.approx(formulas, rel=1e-9)  # zeros and Lyapunov equations to rounding
    s, (k, c, ms, mu) = 2j * np.pi * 0.5, (16812.0, 1000.0, 290.0, 59.0)
    strut = k + c * s
    ratio = kt * strut / ((ms * s**2 + strut) * (mu * s**2 + strut + kt) - strut**2)
    (first, *peaks) = found["afc_replication"]["numbers"]
    assert first["exact"] == pytest.approx(abs(ratio), rel=1e-9)
    for peak in peaks:
        assert peak["mujoco"] == pytest.approx(peak["exact"], rel=2e-4)  # a car of 1 ms, against the continuous loop


def test_a_part_of_the_gallery_counts_no_sources(capsys):
    """The number of all sources, and those without numbers, are printed for the whole gallery alone."""
    assert main(["paper", "textbook", "--brief"]) == 0
    said = prose(capsys.readouterr().out)
    assert "published sources" not in said
    assert "have no numbers" not in said


def test_what_is_not_reproduced(mine, capsys):
    """A number that is off in its last digit is not reproduced, and the exit code says so; a reason explains no more than it
    says."""
    for value, more, code, word in (
        ("56.27", "", 0, "1 number is reproduced to all digits."),
        ("56.28", "", 1, "zero sprung_acceleration is NOT REPRODUCED: 56.2731434, not 56.28."),
        ("56.28", 'reason = "rounded"\nwithin = 2e-4\n', 0, "and 1 differs for a known reason."),
        ("56.48", 'reason = "rounded"\nwithin = 2e-4\n', 1, "1 number is NOT REPRODUCED."),
    ):
        mine(ENTRY + more, value)
        assert main(["mine"]) == code
        said = prose(capsys.readouterr().out)
        assert word in said
        assert "in brackets" not in said  # nothing is derived


def test_a_source_with_a_grid(tmp_path, mine, capsys):
    """A peak that a source sees at the samples of a plot is what the exact response is there, and no more than its peak."""
    pytest.importorskip("jinja2", reason="needs the extra [report]")
    text = ENTRY.replace('"zero"', '"peak"')
    mine(f"{text}grid = 0.0405\n", "7.09", "afc_replication")
    assert main(["mine", "--json"]) == 0
    ((peak,),) = (each["numbers"] for each in json.loads(capsys.readouterr().out)["entries"])
    assert report(["--gallery", "--out", str(tmp_path / "mine.html")]) == 0
    assert "the source's grid" in html.unescape((tmp_path / "mine.html").read_text(encoding="utf-8"))
    mine(f"{text}grid = 0.0405\n".replace('"peak"', '"rms"'), "7.09", "afc_replication")
    capsys.readouterr()
    main(["mine", "--json"])
    ((rms,),) = (each["numbers"] for each in json.loads(capsys.readouterr().out)["entries"])
    vehicle = read_vehicle(tmp_path / "mine" / "car.toml")
    passive = Designer(vehicle).design("passive")
    (run,) = run_controllers(vehicle, [passive], Bump(), sample_times(vehicle, 3.0, 5e-4))
    seen = run.continuous["sprung_acceleration"][::81]
    assert peak["exact"] > peak["grid"] == pytest.approx(np.abs(seen).max(), rel=1e-9)
    assert rms["grid"] == pytest.approx(np.sqrt(np.mean(seen**2)), rel=1e-9)
    mine(f"{text}grid = 1e-6\n", "7.09", "afc_replication")
    with pytest.raises(InputError, match="grid = 1e-06 s is not allowed for what = peak"):
        main(["mine"])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('what = "zero"', 'what = "root"', "what = 'root' is not allowed"),
        ("where =", "page = 1\nwhere =", r"entry.toml of mine: printed\[0\] unknown key 'page'; known keys: "),
        ("sprung_acceleration", "heave", "unknown signal 'heave'"),
        ("VEHICLE", "none.toml", "none.toml"),
    ],
)
def test_entries_that_are_none(mine, old, new, said):
    """A word of an entry that means nothing is named in one line."""
    mine(ENTRY.replace(old, new), "56.27")
    with pytest.raises(InputError, match=said):
        main(["mine"])
    with pytest.raises(InputError, match="unknown entry 'nothing'; the gallery has"):
        main(["nothing"])


def test_page(tmp_path, capsys, monkeypatch):
    """The page has every entry with its licence and its responses, and loads nothing."""
    pytest.importorskip("jinja2", reason="needs the extra [report]")
    monkeypatch.setattr("sim.studies.gallery.entries.names", lambda: LIGHT)
    path = tmp_path / "gallery.html"
    assert report(["--gallery", "--out", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["entries"]
    text = path.read_text(encoding="utf-8")
    elements = Elements(text)
    assert "default-src 'none'" in text
    assert not [one for one in elements.all if one["tag"] in ("img", "script", "link") and one.get("@src")]
    pictured = {one["name"] for one in found if any(each["number"].split()[0] in PICTURED for each in one["numbers"])}
    assert sum(one["tag"] == "figure" for one in elements.all) == len(pictured)
    shown = " ".join(re.sub(r"<[^>]*>", "", html.unescape(text)).split())
    assert all(f"Licence: {one['licence']}." in shown for one in found)


def test_page_is_of_no_vehicle(tmp_path, mine):
    """Options of a vehicle's report are refused, and a number that is not reproduced is the page's verdict and exit code."""
    pytest.importorskip("jinja2", reason="needs the extra [report]")
    for options in (["--controller", "I"], ["--quick"], ["--load", "brake:g=0.5"], ["--vehicle", "quarter_car"]):
        with pytest.raises(InputError, match=f"{options[0]} and --gallery cannot be combined"):
            report(["--gallery", *options])
    mine(ENTRY, "56.28")
    assert report(["--gallery", "--out", str(tmp_path / "wrong.html")]) == 1
    assert "numbers are NOT REPRODUCED" in (tmp_path / "wrong.html").read_text(encoding="utf-8")


def optimum(ms, mu, ks, cs, kt, weights):
    """Returns the gain of least acc, tyre, stroke and force, with these weights, and the poles, by an own Riccati equation."""
    acc, tyre, stroke, force = weights
    A = np.array([[0, 0, 1, -1], [0, 0, 0, 1], [-ks / ms, 0, -cs / ms, cs / ms], [ks / mu, -kt / mu, cs / mu, -cs / mu]])
    B = np.array([[0.0], [0], [1 / ms], [-1 / mu]])
    Q, N = np.diag([stroke, tyre, 0, 0]) + acc * np.outer(A[2], A[2]), acc * A[2][:, None] / ms
    R = np.array([[force + acc / ms**2]])
    gain = -np.linalg.solve(R, B.T @ linalg.solve_continuous_are(A, B, Q, R, s=N) + N.T)
    return gain[0], upper(A + B @ gain)


def upper(A):
    """Returns real and imaginary parts of the poles that are not below the real axis, by falling sizes."""
    poles = np.linalg.eigvals(A)
    poles = poles[poles.imag >= 0]
    return [part for pole in poles[np.argsort(-np.abs(poles))] for part in (pole.real, pole.imag)]


def test_derived_numbers(printed):
    """Numbers that follow from a source's data are those of an own Riccati equation, polynomial or formula, as printed too."""
    found = printed

    def ours(name, what):
        return [one["exact"] for one in found[name]["numbers"] if one["number"].startswith(f"{what} ")]

    for name, plant, weights in (
        ("ulsoy", (410, 45, 25500, 1840.69458514252, 230000), (1, 4e4, 5e3, 1e-18)),
        ("herber_allison", (325, 65, 1e4, 1e3, 232500), (0.5, 1e5, 0, 1e-5)),
    ):
        gain, poles = optimum(*plant, weights)
        assert ours(name, "gain") == pytest.approx(gain, rel=1e-8)  # 1e-18 against 6e-6 on the diagonal
        assert ours(name, "pole") == pytest.approx(poles, rel=1e-9)
    assert 0.3 * 2 * 410 * math.sqrt(25500 * 230000 / (25500 + 230000) / 410) == pytest.approx(1840.69458514252, rel=1e-14)
    squares = np.sort(np.roots([350 * 50, -(350 * 220000 + 50 * 20000), 20000 * 200000]))
    assert ours("acado", "pole") == pytest.approx([0, math.sqrt(squares[0]), 0, math.sqrt(squares[1])], rel=1e-9)
    r, m, k = 1e4, 300.0, 12000.0
    assert ours("one_mass", "pole") == pytest.approx([-(r**0.25) / math.sqrt(2), r**0.25 / math.sqrt(2)], rel=1e-12)
    assert ours("one_mass", "gain") == pytest.approx([k - m * math.sqrt(r), -m * math.sqrt(2 * math.sqrt(r))], rel=1e-12)
    ms, mu, k, c, kt = 300.0, 60.0, 16000.0, 1000.0, 190000.0
    whole = ms + mu
    tyre = (
        mu / (2 * c)
        + whole**2 * c / (2 * kt * ms**2)
        - whole * k * mu / (kt * c * ms)
        + whole**3 * k**2 / (2 * kt**2 * c * ms**2)
    )
    assert ours("textbook", "white")[2] == pytest.approx(math.sqrt(tyre), rel=1e-9)
    assert ours("textbook", "white")[3] == pytest.approx(
        ours("textbook", "white")[0] * math.sqrt(2 * 0.01 * 256e-6 * 20) * math.pi
    )


def test_half_car_on_the_road(printed):
    """The half-car that stands on the road rests where Simulink's does, to 1e-15; poles and height over a step are an own
    solution's, MuJoCo follows, and energy balances."""
    found = printed
    front, rear, *poles, peak, overshoot, settling = (one["exact"] for one in found["simulink_half_car"]["numbers"])
    at_rest = -1200 * 9.81 / (2 * (28000 + 21000))
    assert front == pytest.approx(at_rest, rel=1e-15)
    assert rear == pytest.approx(at_rest, rel=1e-15)
    ends, mass = np.array([[1, -0.9], [1, 1.2]]), np.diag([1200.0, 2100.0])
    springs, dampers = (ends.T @ np.diag([2 * a, 2 * b]) for a, b in ((28000.0, 21000.0), (2500.0, 2000.0)))
    A = np.block(
        [[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(mass, springs @ ends), -np.linalg.solve(mass, dampers @ ends)]]
    )
    assert poles == pytest.approx(upper(A), rel=1e-9)
    # The step of 20 mm over 10 ms under each axle, the rear one 2.1 m behind: states, and the road's sine and cosine at both.
    omega, edge, late, height = math.pi / 0.01, 0.01, 2.1 / 20, 0.02
    push = np.linalg.solve(mass, springs)

    def step(state, level, moving, duration):
        whole = np.zeros((7, 7))  # the state, the moving road's offset from its middle, its rate, and 1
        whole[:4, :4] = A
        whole[2:4, 6] = push @ level
        if moving is not None:
            whole[2:4, 4] = push[:, moving]
            whole[4, 5], whole[5, 4] = 1.0, -(omega**2)
        return linalg.expm(whole * duration) @ np.concatenate([state, [-height / 2, 0.0, 1.0]])

    now = step(np.zeros(4), np.array([height / 2, 0]), 0, edge)[:4]
    now = step(now, np.array([height, 0]), None, late - edge)[:4]
    now = step(now, np.array([height, height / 2]), 1, edge)[:4]
    heights = [step(now, np.full(2, height), None, t)[0] for t in np.arange(0.3, 0.36, 1e-4)]
    assert peak == pytest.approx(1e3 * max(heights), rel=1e-7)  # 1e-4 s from a flat top
    assert overshoot == pytest.approx(100 * (max(heights) / height - 1), rel=1e-6)

    def outside(t):
        return abs(step(now, np.full(2, height), None, t - late - edge)[0] - height) - 0.02 * height

    grid = np.arange(0.5, 2.0, 2e-3)
    last = grid[[outside(t) > 0 for t in grid]][-1]
    assert settling == pytest.approx(optimize.brentq(outside, last, last + 2e-3, xtol=1e-14), rel=1e-9)

    vehicle = read_vehicle(str(entries.FOLDER / "simulink_half_car" / "car.toml"))
    (run,) = run_controllers(
        vehicle,
        [Designer(vehicle).design("passive")],
        Step(height=height, edge=0.2, speed=20.0),
        sample_times(vehicle, 2.0, 1e-3),
    )
    assert run.passed
    metrics = measure_step(run)["heave_displacement"]
    assert metrics.final == height
    assert metrics.continuous is not None
    assert 100 * metrics.continuous.overshoot == pytest.approx(overshoot, rel=1e-9)


@pytest.mark.attack
def test_sources(whole):
    """The published sources are all here, eight and more with numbers, the others with a reason in a line."""
    found = whole
    with_numbers = {name for one in found.values() for name in one["sources"]}
    without = {lack["source"] for one in found.values() for lack in one["missing"] if lack["source"]}
    assert with_numbers | without == {*entries.SOURCES}
    assert not with_numbers & without
    assert len(with_numbers) >= 8


def test_quansers_gain_is_that_of_its_earlier_rig(printed):
    """By a Riccati equation of matrices written out: the factory gain belongs to the tyre of 2500 N/m, not to that of 1250."""
    found = printed
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
