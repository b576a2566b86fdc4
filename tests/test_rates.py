"""`python -m synth --rates`: what slower computers cost a controller, and where its loop is lost."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

import synth.vehicle.sample_rate.cost
import synth.vehicle.sample_rate.report
from models.laws.linear import LinearLaw
from models.vehicle.limits_and_implementation import LONGEST_PERIOD, Implementation, delay_text
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from synth.__main__ import main
from synth.analysis.specification import SampledNorm
from synth.analysis.stability import sampled_growth
from synth.controller.controller import Controller
from synth.controller.implementation_norm import norm_as_implemented
from synth.controller.loop_transfer import loop_transfer
from synth.controller.stability_margins import largest_sample_period
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer, design
from synth.vehicle.sample_rate.cost import Cost, cost, norm_at, smallest_unstable_period
from synth.vehicle.sample_rate.report import LITTLE, cost_lines, drawn_periods, rates_figure, short_lines
from tests.analysed import implemented_loop
from tests.commands import attacks, once, prose
from tests.shared import made

RATES = ("10", "100")  # ms; II is lost before the last where forces are late


@pytest.fixture(autouse=True)
def found_once(monkeypatch):
    """One loop is lost in many tests: what is found is shared by those that only tell it."""
    monkeypatch.setattr(
        synth.vehicle.sample_rate.cost, "smallest_unstable_period", lambda *arguments: made(lost_anew, *arguments)
    )


def lost_anew(vehicle: Vehicle, controller: Controller, delay: float) -> float:
    return smallest_unstable_period(vehicle, controller, delay)


@pytest.fixture
def never_lost(found_once, monkeypatch):
    """Leaves out the search for a lost loop: that takes longer than all the rest."""
    monkeypatch.setattr(synth.vehicle.sample_rate.cost, "smallest_unstable_period", lambda *arguments: math.inf)


@pytest.fixture
def norms_once(monkeypatch):
    """Words and `--json` are of one norm to a rate."""
    monkeypatch.setattr(synth.vehicle.sample_rate.cost, "norm_at", lambda *arguments: made(norm_at_anew, *arguments))


def norm_at_anew(vehicle: Vehicle, controller: Controller, period: float, delay: float, near: float) -> SampledNorm:
    return norm_at(vehicle, controller, period, delay, near)


def asked(capsys, *arguments: str) -> tuple[int, dict]:
    code = main(["--rates", *arguments, "--json"])
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("car", "name"),
    [
        ("quarter_car", "II"),
        ("half_car", "I"),
        *(
            pytest.param(*one, marks=pytest.mark.attack)
            for one in (*(("quarter_car", name) for name in ("state", "I")), ("half_car", "II"), ("full_car", "I"))
        ),
    ],
)
def test_it_is_lost_where_the_margins_say(car, name):
    """The rate at which a loop is lost is the margin of its sample period, which another way finds."""
    vehicle = read_vehicle(car)
    controller = design(vehicle, name)
    margin = largest_sample_period(loop_transfer(vehicle, controller, range(len(vehicle.linear_model.inputs))))
    # Either is found to 1e-12 of it, or there is none up to a second.
    assert made(lost_anew, vehicle, controller, 0) == pytest.approx(margin if margin < LONGEST_PERIOD else math.inf, rel=1e-9)


@pytest.mark.parametrize(("car", "delay"), [("quarter_car", 0), *attacks((("quarter_car", 3), ("half_car", 0), ("half_car", 1)))])
def test_it_is_lost_there_and_not_before(car, delay):
    """The loop that is driven grows just beyond the period at which it is lost, and at none of many before."""
    vehicle = read_vehicle(car)
    controller = design(vehicle, "II")

    def growth(period: float) -> float:
        built = replace(vehicle, implementation=Implementation(delay=delay))
        return sampled_growth(implemented_loop(built, controller, period).transition)

    lost = made(lost_anew, vehicle, controller, delay)
    assert growth(lost * (1 + 1e-6)) > 1
    assert max(growth(share * lost) for share in (*np.linspace(0.01, 0.99, 100), 1 - 1e-6)) < 1


def test_no_rate_keeps_what_no_computer_runs():
    """A loop that is unstable at 100 kHz is lost at once, and the text says so."""
    vehicle = parse_vehicle(
        read_vehicle("quarter_car").text + '\n[controllers.mad]\nmeasured = ["sprung_velocity"]\ngain = [[2e4]]\n'
    )
    assert smallest_unstable_period(vehicle, design(vehicle, "mad"), 0) == 0


@pytest.mark.parametrize("car", ["quarter_car", "half_car"])
def test_every_norm_is_that_of_the_loop_as_built(car, never_lost):
    """Each norm is that of a vehicle file with this sample period and delay, whichever rates are asked for beside it."""
    vehicle = replace(read_vehicle(car), implementation=Implementation(delay=2))
    controller = design(vehicle, "I")
    found = cost(vehicle, controller, [1e-3, 2e-2])
    assert found.delay == 2
    for at in found.rates:
        for norm, delay in ((at.undelayed_norm, 0), (at.late, 2)):
            own = norm_as_implemented(replace(vehicle, implementation=Implementation(at.period, delay)), controller)
            assert norm.value == pytest.approx(own.value, rel=2e-8)  # each lies within 1.1e-8 of its levels


@pytest.mark.parametrize("name", ["quiet", pytest.param("I", marks=pytest.mark.attack)])
def test_the_continuous_norm_is_what_fast_rates_tend_to(name, never_lost):
    """With a lag, and of a design that knows the noise of its sensors, it is the norm of the road alone, with the lag."""
    text = read_vehicle("quarter_car").text + (
        '\n[controllers.quiet]\nmeasured = ["suspension_deflection", "sprung_velocity"]\nnoise = true\n'
        "[limits]\nactuator_bandwidth = 100.0\n[implementation]\nnoise = { sprung_velocity = 0.01 }\nsample_period = 0.01\n"
    )
    vehicle = parse_vehicle(text)
    found = cost(vehicle, design(vehicle, name), [1e-5, 2e-5])
    said = f"controller {name}: in continuous time, with lag: norm {found.ideal:.7g}"
    assert prose(" ".join(cost_lines(found, "lag"))).startswith(said)
    off = [found.loss(at.undelayed_norm) for at in found.rates]
    assert 0 < abs(off[0]) < 6e-4  # rad, what 63 rad/s turns by in 10 us
    assert off[1] / off[0] == pytest.approx(2, rel=1e-2)  # the first power of the period
    assert found.lower_bound is not None
    assert found.lower_bound <= min(at.undelayed_norm.value for at in found.rates)


@pytest.mark.parametrize(
    ("rates", "names"),
    [
        (RATES, ("II", "I_printed")),
        *attacks((rates, ("state", "I", "II", "state_printed", "I_printed", "II_printed")) for rates in (RATES, ("1", "50"))),
    ],
)
def test_table(capsys, never_lost, norms_once, rates, names):
    """The table of every controller and rate has JSON's numbers, and no controller beats the lower bound."""
    some = [part for name in names for part in ("--controller", name)] if len(names) < 6 else []
    code, found = asked(capsys, *rates, *some)
    assert code == 0
    assert main(["--rates", *reversed(rates), *some, "-v"]) == 0
    printed = capsys.readouterr().out
    rows = {row["name"]: row for row in found["controllers"]}
    assert set(rows) == {*names}  # but passive, which no rate changes
    for name, row in rows.items():
        (block,) = re.findall(rf"^controller {name}: (.*?)\n\n", printed, re.M | re.S)
        assert block.startswith(f"in continuous time norm {row['norm']:.7g}, lower bound {row['lower_bound']:.7g}\n")
        lines = re.findall(r"^  (\S+) ms +(\S+) Hz +(.*)$", block, re.M)
        assert [line[0] for line in lines] == list(rates)
        for (_, rate, rest), at in zip(lines, row["rates"], strict=True):
            assert float(rate) == pytest.approx(1 / at["sample_period"], rel=1e-3)
            cells = re.findall(r"UNSTABLE|(\S+) +(0|[+-]\S+) %", rest)
            norms = [at["sampled_norm"], at["late_norm"], *([at["designed_norm"]] if name in ("state", "I", "II") else [])]
            for cell, norm in zip(cells, norms, strict=True):
                if norm is None:
                    assert cell == ("", "")
                    continue
                assert float(cell[0]) == pytest.approx(norm["value"], rel=1e-6)  # seven digits
                assert float(cell[1]) / 100 == pytest.approx(norm["loss"], rel=0.05, abs=1e-8)  # two digits
                assert norm["loss"] == pytest.approx(norm["value"] / row["norm"] - 1, abs=1e-12)
                assert row["lower_bound"] < norm["above"] < norm["value"] < norm["below"]
    lost = {name for name, row in rows.items() if row["rates"][-1]["late_norm"] is None}
    assert ("II" in lost) == (rates[-1] == "100")  # 1 sample late it is lost at 18 Hz
    assert ("UNSTABLE" in printed) == bool(lost)


@pytest.mark.attack
def test_designed_for_the_rate(never_lost):
    """At 10 ms a design for the sampled loop has at most the norm that was found before, and below that of the other."""
    vehicle = read_vehicle("quarter_car")
    (at,) = cost(vehicle, design(vehicle, "II"), [1e-2], [1e-2]).rates  # others are in test_sampled_designs.py
    assert at.designed is not None
    assert at.designed.value <= 7.881
    assert at.designed.value < at.undelayed_norm.value
    given = cost(vehicle, design(vehicle, "I_printed"), [1e-2], [1e-2])
    assert given.rates[0].designed is None  # its gain is given, and not designed


@pytest.mark.attack
def test_what_is_designed_for_a_rate_is_never_worse():
    """At every rate the norm of the design for it is at most that of the continuous design there."""
    vehicle, periods = read_vehicle("half_car"), [1e-3, 0.1, 0.5]
    for at in cost(vehicle, design(vehicle, "II"), periods, periods).rates:
        assert at.designed is not None
        # What counts as reached, and the rounding of two norms.
        assert at.designed.value <= at.undelayed_norm.value * (1 + 2e-7)


@pytest.mark.attack
def test_why_none_is_designed(monkeypatch, capsys):
    """A rate that no design is found for has a dash, and its reason below the table without what to do; in JSON all of it."""
    true = once(synth.vehicle.sample_rate.cost.held_design)

    def fails_at_50_ms(problem, near, known):
        if problem.period == 0.05:
            raise DesignError("nothing was found: it is probably too slow")
        return true(problem, near, known)

    monkeypatch.setattr(synth.vehicle.sample_rate.cost, "held_design", fails_at_50_ms)
    code, found = asked(capsys, "10", "50", "--controller", "I")
    assert code == 0
    assert found["controllers"][0]["rates"][-1]["designed_norm"] is None
    assert found["controllers"][0]["rates"][-1]["not_designed"] == "nothing was found: it is probably too slow"
    main(["--rates", "10", "50", "--controller", "I"])
    said = capsys.readouterr().out
    (line,) = [line for line in said.splitlines() if line.startswith("  50 ms")]
    assert line.split()[-1] == "-"
    assert "\n  not designed for 50 ms: nothing was found\n" in said


def test_a_law_with_states_is_not_designed_for_a_rate(monkeypatch, never_lost):
    """What is designed for a rate is a gain; no search is made in place of a law with states that stands in no vehicle file."""
    vehicle = read_vehicle("quarter_car")
    monkeypatch.setattr(synth.vehicle.sample_rate.cost, "held_design", _not_asked_for)
    law = LinearLaw(np.array([[-5.0]]), np.array([[0.0, 1.0]]), np.array([[500.0]]), np.array([[0.0, -2000.0]]))
    (at,) = cost(vehicle, replace(design(vehicle, "I"), name="mine", law=law), [1e-2], [1e-2]).rates
    assert (at.designed, at.undesigned) == (None, "")


def test_one_sample_as_it_is_printed():
    """A delay that is printed as 1 is of one sample, not of samples."""
    vehicle = replace(read_vehicle("quarter_car"), implementation=Implementation(delay=0.999999999999))
    assert vehicle.implementation.phrases == ("forces that act 1 sample late",)
    assert delay_text(2) == "2 samples late"
    assert delay_text(0.5) == "0.5 samples late"


def test_sentence(capsys, norms_once):
    """In words stand the slowest rate that costs little, what it costs, late too, and where the loop is lost."""
    code, found = asked(capsys, *RATES, "--controller", "II")
    assert code == 0
    (row,) = found["controllers"]
    main(["--rates", *RATES, "--controller", "II"])
    said = prose(capsys.readouterr().out)
    words = re.search(
        r"at (\S+) Hz controller II gains (\S+) %, 1 sample late loses (\S+) %; designed for it gains (\S+) %; "
        r"at once it loses stability at (\S+) Hz, 1 sample late it loses stability at (\S+) Hz$",
        said,
    )
    assert words
    assert "late: the forces act 1 sample late; designed: anew" in said  # the columns are explained where they stand
    (at,) = [at for at in row["rates"] if at["sample_period"] == 1e-2]
    assert at["sampled_norm"]["loss"] < LITTLE < row["rates"][-1]["sampled_norm"]["loss"]
    numbers = [100, -100 * at["sampled_norm"]["loss"], 100 * at["late_norm"]["loss"], -100 * at["designed_norm"]["loss"]]
    numbers += [1 / row["unstable_from"], 1 / row["late_unstable_from"]]
    assert [float(word) for word in words.groups()] == pytest.approx(numbers, rel=0.05)  # of two digits


def _not_asked_for(*given):
    raise DesignError("it does not matter here")


@pytest.mark.parametrize("name", ["I", *attacks(["state"])])
def test_islands(name, capsys, monkeypatch, norms_once):
    """No rate is called unstable that the table has stable: the slower ones that are, beyond the first loss, are named."""
    monkeypatch.setattr(synth.vehicle.sample_rate.cost, "held_design", _not_asked_for)
    rates = [10.0, 200.0, 300.0, 600.0, 1000.0]
    code, found = asked(capsys, *map(str, rates), "--controller", name)
    assert code == 0
    (row,) = found["controllers"]
    main(["--rates", *map(str, rates), "--controller", name])
    said = prose(capsys.readouterr().out)
    words = {"sampled_norm": ("at once", "unstable_from"), "late_norm": ("1 sample late", "late_unstable_from")}
    islands: list[float] = []
    for key, (how, limit) in words.items():
        lost = row[limit] or math.inf
        (text,) = re.findall(rf"{how} it (is stable at every rate|loses stability at \S+ Hz(?: \(.*? again\))?)", said)
        stable = [1e3 * at["sample_period"] for at in row["rates"] if at[key] is not None]
        assert ("every" in text) == (math.isinf(lost))
        assert [rate for rate in rates if rate < 1e3 * lost] == [rate for rate in stable if rate < 1e3 * lost]
        again = [float(rate) for rate in re.findall(r"([\d.]+) ms", text)]
        assert again == [rate for rate in stable if rate > 1e3 * lost]
        islands += again
    assert islands


@pytest.mark.parametrize(
    ("name", "words"),
    [
        *attacks([("state", "at once it is stable at every rate down to 1 Hz, 1 sample late it loses stability at 3.73 Hz")]),
        ("passive", "controller passive asks for no force, so that no rate changes anything"),
        ("mad", "controller mad is unstable even in continuous time"),
    ],
)
def test_other_sentences(name, words, tmp_path, capsys, request):
    """A loop that no rate ends, one without a force, and one that was never stable have words of their own."""
    if name != "state":  # no rate ends it, or it has none
        request.getfixturevalue("never_lost")
    car = tmp_path / "car.toml"
    car.write_text(read_vehicle("quarter_car").text + '\n[controllers.mad]\nmeasured = ["sprung_velocity"]\ngain = [[2e4]]\n')
    assert main(["--vehicle", str(car) if name == "mad" else "quarter_car", "--controller", name, "--rates", "10"]) == 0
    assert prose(capsys.readouterr().out).endswith(words)


def test_what_does_not_hold_is_said(monkeypatch, capsys):
    """If two routes to a norm differ, that is said, and the exit code is 1."""
    true = synth.vehicle.sample_rate.cost.sampled_norm
    monkeypatch.setattr(
        synth.vehicle.sample_rate.cost,
        "sampled_norm",
        lambda *arguments: replace(true(*arguments), reached=0.9 * true(*arguments).value),
    )
    assert main(["--rates", "10", "--controller", "I"]) == 1
    said = prose(capsys.readouterr().out)
    assert "DOES NOT HOLD: controller I at 10 ms, at once: the sampled norm 7.86506444 and what a disturbance" in said


def test_a_road_that_reaches_more_than_the_norm_is_said(monkeypatch, capsys):
    """A road that reaches more than the norm's upper level fails, however near the two routes are."""
    true = synth.vehicle.sample_rate.cost.sampled_norm
    monkeypatch.setattr(
        synth.vehicle.sample_rate.cost,
        "sampled_norm",
        lambda *arguments: replace(true(*arguments), reached=true(*arguments).upper * (1 + 1e-10)),
    )
    assert main(["--rates", "10", "--controller", "I"]) == 1
    assert "at once: the sampled norm is not less than 7.865064" in prose(capsys.readouterr().out)


def test_what_is_not_designed_is_said(tmp_path, capsys, monkeypatch, never_lost):
    """A controller that cannot be designed has a reason in its place, and the others their rates; the exit code is 1."""
    car = tmp_path / "car.toml"
    hasty = '\n[controllers.blind]\nmeasured = ["suspension_deflection"]\nbounds = [{ norm = 1.0 }]\n'
    design_others = Designer.design

    def refuses(self, name):  # test_goals.py says that there is none; to search takes seconds
        if name == "blind":
            raise DesignError("norm <= 1 is passed by 600 %")
        return design_others(self, name)

    monkeypatch.setattr(Designer, "design", refuses)
    monkeypatch.setattr(synth.vehicle.sample_rate.cost, "held_design", _not_asked_for)
    car.write_text(read_vehicle("quarter_car").text + hasty)
    code, found = asked(capsys, "10", "--vehicle", str(car), "--controller", "blind", "--controller", "II")
    assert code == 1
    rows = {row["name"]: row for row in found["controllers"]}
    assert rows["II"]["rates"]
    assert rows["blind"]["reason"]
    main(["--rates", "10", "--vehicle", str(car), "--controller", "blind", "--controller", "II"])
    assert f"NOT DESIGNED: {rows['blind']['reason']}" in prose(capsys.readouterr().out)


def drawn(one: Cost, label: str) -> tuple[list[float], list[float]]:
    periods = [at.period for at in one.rates]
    (panel,) = rates_figure(read_vehicle("quarter_car"), [one], periods[::2]).panels
    assert panel.title == f"controller {one.controller.name}"
    (curve,) = [curve for curve in panel.curves if curve.label == label]
    return list(curve.x), list(curve.y)


def test_table_of_many(never_lost):
    """A row has the rates at which a loop is lost: 100 kHz, the fastest, for one that no computer keeps, - for one without."""
    vehicle = read_vehicle("quarter_car")
    found = cost(vehicle, design(vehicle, "I"), [1e-2])
    lines = short_lines([replace(found, lost=0.0, lost_late=0.05), replace(found, lost=math.inf, lost_late=0.25)])
    rows = [line.split()[-4:] for line in lines if line.split()[:1] == ["I"]]
    assert [" ".join(row) for row in rows] == ["100 kHz 20 Hz", "% - 4 Hz"]  # % of what is before it
    assert found.lower_bound is not None
    for label, level in (("lower bound of any controller", found.lower_bound), ("in continuous time", found.ideal)):
        assert drawn(found, label) == (pytest.approx([10, 10], rel=1e-12), [level, level])


@pytest.mark.attack
def test_picture(tmp_path, monkeypatch, never_lost):
    """The curves are the norms, which end where the loop is unstable; every rate that was asked for is one of theirs."""
    vehicle = read_vehicle("quarter_car")
    found = cost(vehicle, design(vehicle, "II"), [1e-2, 3e-2, 6e-2, 0.1])
    for label, kind in (("at once", "undelayed_norm"), ("1 sample late", "late")):
        norms = [getattr(at, kind) for at in found.rates]
        x, y = drawn(found, label)
        assert x == pytest.approx([10, 30, 60, 100], rel=1e-12)
        assert [math.isnan(value) for value in y] == [not norm.stable for norm in norms]
        assert [value for value in y if value == value] == [norm.value for norm in norms if norm.stable]
    assert {0.01, 0.02, 0.1} <= set(drawn_periods([0.01, 0.02, 0.1]))
    assert drawn_periods([0.01]) == [0.01]
    assert len(drawn_periods([0.01, 0.02])) > 50  # a curve, not its corners
    monkeypatch.setattr(synth.vehicle.sample_rate.report, "POINTS", 4)
    picture = tmp_path / "rates.png"
    assert main(["--rates", "10", "20", "--controller", "I", "--picture", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
