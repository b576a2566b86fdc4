"""The sampled loop in the commands: norms as built in tables, certificates and logs, and what slower computers cost."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import synth.vehicle.sample_rate.cost
import synth.vehicle.sample_rate.report
from models.common.errors import InputError
from models.laws.linear import LinearLaw
from models.vehicle.limits_and_implementation import LONGEST_PERIOD, Implementation
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.bump import main as bump
from sim.inspect.__main__ import main as inspect
from sim.margins import main as margins
from sim.report.__main__ import main as report
from synth.__main__ import main
from synth.analysis.specification import SampledNorm
from synth.analysis.stability import sampled_growth
from synth.controller.controller import Controller
from synth.controller.implementation_norm import norm_as_implemented
from synth.controller.loop_of import loop_of
from synth.controller.sample_period_margin import largest_sample_period
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer, design
from synth.vehicle.sample_rate.cost import Cost, cost, norm_at, smallest_unstable_period
from synth.vehicle.sample_rate.report import describe, drawn_periods, rates_figure
from tests.support.analysed import sampled_radius
from tests.support.commands import attacks, prose
from tests.support.rewriting import contents, written
from tests.support.shared import made

BUILT = "\n[implementation]\nsample_period = 0.01\ndelay = 1\n"


@pytest.fixture
def built(tmp_path, paper) -> Path:
    """The paper's car with a computer."""
    path = tmp_path / "built.toml"
    path.write_text(paper.text + BUILT)
    return path


def said(capsys, *arguments: str) -> tuple[int, dict]:
    """Exit code and JSON object of `python -m synth`."""
    code = main([*arguments, "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_norm_and_proof(built, capsys):
    """A norm is between the levels that prove it; an actual road reaches it."""
    code, found = said(capsys, "--vehicle", str(built))
    assert code == 0
    for one in found["controllers"]:
        proof = one["sampled_norm_proof"]
        assert proof["above"] < one["sampled_norm"] < proof["below"] < one["sampled_norm"] * (1 + 2e-8)  # as they are apart
        assert proof["reached"] == pytest.approx(one["sampled_norm"], rel=1e-9)  # polynomials of degree 3 over 2.5 ms
        assert one["sampled_norm"] > one["lower_bound"]
        assert one["certificate"]["sampled_norm"] == one["sampled_norm"]


def test_nothing_without_a_computer(capsys):
    """A vehicle file without a sample period has no such column."""
    main(["--controller", "I", "-v"])
    assert "sampled" not in capsys.readouterr().out.partition("\n\n")[2]  # behind the file, whose folder may have any name


@pytest.mark.parametrize("asked", ["noise", "lag"])
def test_norms_of_other_goals_are_not_compared(built, asked, capsys):
    """A controller that is designed for its noise or lag has an ideal norm of another w or z: no share of it is printed."""
    plain = 'measured = ["sprung_velocity"]\ngain = [[-8000.0]]\n'
    built.write_text(
        f"{built.read_text()}noise = {{ sprung_velocity = 0.005 }}\n[limits]\nactuator_bandwidth = 60.0\n"
        f"[controllers.plain]\n{plain}[controllers.asked]\n{plain}{asked} = true\n"
    )
    main(["--vehicle", str(built), "--controller", "plain", "--controller", "asked", "-v"])
    norms = capsys.readouterr().out.partition("that is")[2]
    rows = re.findall(r"^(?:plain|asked) +\S+ +(\S+)  +(.*?)  +\S+$", norms, re.MULTILINE)
    (plain, compared), (asked_for, other) = rows[:2]
    plain_norm, asked_norm = float(plain), float(asked_for)
    # With the lag the loops as built are the same; noise of the readings counts where it is asked for, and then it adds.
    assert plain_norm < asked_norm if asked == "noise" else plain_norm == asked_norm
    assert "%" in compared
    assert other == "-"


def test_unstable_as_built(built, capsys):
    """At a rate that the loop does not bear, that is said, and no number stands there."""
    built.write_text(built.read_text().replace("0.01", "0.3"))
    _, found = said(capsys, "--vehicle", str(built), "--controller", "II")
    assert found["controllers"][0]["sampled_norm"] is None
    assert "sampled_norm" not in found["controllers"][0]["certificate"]
    main(["--vehicle", str(built), "--controller", "II", "-v"])
    text = capsys.readouterr().out
    assert "a sample every 300 ms" in prose(text)
    assert re.search(r"^II +\S+ +\S+ +UNSTABLE ", text, re.MULTILINE)


@pytest.mark.parametrize("change", ["digit", *attacks(["period", "none"])])
def test_saved_and_checked(built, tmp_path, capsys, change):
    """A certificate says the norm as built, and is refused where that is another: of another rate, or by a hair, or of none."""
    saved = tmp_path / "saved.toml"
    assert said(capsys, "--vehicle", str(built), "--controller", "I", "--save", str(saved))[0] == 0
    assert said(capsys, "--check", str(saved), "--controller", "I_designed")[0] == 0
    text = saved.read_text()
    (claimed,) = re.findall(r"^sampled_norm = (.*)$", text, re.MULTILINE)
    changed = {
        "period": text.replace("sample_period = 0.01", "sample_period = 0.011"),
        "digit": text.replace(claimed, repr(float(claimed) * (1 - 1e-6))),
        "none": text.replace(BUILT.strip(), ""),
    }[change]
    saved.write_text(changed)
    code, found = said(capsys, "--check", str(saved), "--controller", "I_designed")
    (failure,) = found["controllers"][0]["failures"]
    assert code == 1
    another = "the vehicle is no longer the one that was certified: [implementation] sample_period none instead of 0.01"
    words = another if change == "none" else "the certificate claims that the sampled norm is 7.87"
    assert failure.startswith(words)
    bump(["--vehicle", str(saved), "--controller", "I_designed", "--no-logs", "--duration", "0.1"])
    assert words in prose(capsys.readouterr().err)


def test_inspected(built, tmp_path, capsys):
    """A log claims the norm as built; inspection finds it again, and refuses another."""
    bump(["--vehicle", str(built), "--controller", "I", "--logs", str(tmp_path), "--duration", "0.5", "-v"])
    capsys.readouterr()
    (log,) = tmp_path.glob("*.mcap")
    assert inspect([str(log), "-v"]) == 0
    vehicle = read_vehicle(str(built))
    norm = norm_as_implemented(vehicle, design(vehicle, "I"))
    assert f"sampled norm {norm.value:.7g}" in prose(capsys.readouterr().out)

    def forge(claim: str) -> str:
        record = json.loads(claim)
        return json.dumps(record | {"sampled_norm": record["sampled_norm"] * (1 - 1e-6)})

    forged = tmp_path / "forged.mcap"
    forged.write_bytes(written(contents(log).with_claim("run/I", "certificate", forge)))
    assert inspect([str(forged)]) == 1
    assert "the certificate claims that the sampled norm is 7.87" in prose(capsys.readouterr().out)


# --- loops that are stable only with samples, or without -----------------------------------------------------------------


SLOW = "\n[implementation]\nsample_period = 0.05\n"  # s: at 20 Hz what is best with samples is unstable without
HELD = f"{SLOW}sampled = true\n"
WITHOUT = "without sampling the loop is unstable"


@pytest.fixture
def held(tmp_path, paper):
    """The paper's car, designed for a slow computer."""
    path = tmp_path / "held.toml"
    path.write_text(paper.text + HELD)
    return path


@pytest.mark.attack
def test_a_sampled_design_is_judged_by_its_sampled_loop(held, tmp_path, capsys):
    """Its loop is stable as it runs, by a route of its own, and has a norm: no claim fails, in the table, in JSON, or saved."""
    vehicle = read_vehicle(str(held))
    controller = design(vehicle, "I")
    assert not controller.certificate.stable
    assert sampled_radius(vehicle, controller, 0.05) < 1
    saved = tmp_path / "saved.toml"
    assert main(["--vehicle", str(held), "--controller", "I", "--save", str(saved), "--json"]) == 0
    assert design(read_vehicle(str(saved)), "I_designed").false_claims == ()
    (row,) = json.loads(capsys.readouterr().out)["controllers"]
    assert row["failures"] == []
    assert row["norm"] is None
    assert row["certificate"].keys() & {"norm", "bound", "sampled_norm"} == {"sampled_norm"}
    for arguments in (["--vehicle", str(held), "--controller", "I"], ["--check", str(saved), "--controller", "I_designed"]):
        assert main([*arguments, "-v"]) == 0
        text = capsys.readouterr().out
        assert WITHOUT in prose(text)
        assert "FAILS" not in text
        line, *_ = [each for each in text.splitlines() if each.startswith(("I  ", "I_designed  "))]
        assert re.search(rf"UNSTABLE .*{row['sampled_norm']:.7g}", line)
        assert "every claim holds for 1 controller\n" in text


@pytest.mark.attack
def test_a_run_of_it_holds_in_its_log(held, tmp_path, capsys):
    """MuJoCo drives it as analysis says, and what its log claims is found to hold."""
    where = str(tmp_path / "logs")
    assert bump(["--vehicle", str(held), "--controller", "I", "--logs", where, "--duration", "1", "-v"]) == 0
    assert WITHOUT in prose(capsys.readouterr().out)
    assert inspect([str(next((tmp_path / "logs").glob("*.mcap"))), "-v"]) == 0
    text = prose(capsys.readouterr().out)
    assert WITHOUT in text
    assert "sampled norm 8.32" in text


def test_what_its_computer_loses_is_said_in_the_verdict(tmp_path, paper, capsys):
    """A design for the ideal loop, on a computer that loses it: its claims hold, and the last line names it."""
    path = tmp_path / "lost.toml"
    path.write_text(f"{paper.text}\n[implementation]\nsample_period = 0.15\ndelay = 5\n")
    assert main(["--vehicle", str(path), "--controller", "I", "--controller", "passive", "-v"]) == 0
    assert prose(capsys.readouterr().out).endswith("holds for 2 controllers; UNSTABLE in the sampled-data loop: I")


@pytest.mark.attack
def test_a_report_of_it(held, tmp_path, capsys):
    """A report treats it as stable: its norm as built, its responses and the end of its regime, and no ideal norm."""
    quick = ["--vehicle", str(held), "--controller", "I", "--quick", "--timestep", "2.5e-3"]
    assert report([*quick, "--out", str(tmp_path / "r.html"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert any("`I` is stable as implemented and UNSTABLE ideally" in text for text in said["answer"])
    tables = said["tables"]
    assert tables["designs"][0]["certificate"].startswith(WITHOUT)
    assert tables["norms"][0]["norm, ideal loop"] == "UNSTABLE"
    assert tables["norms"][0]["that is"] == "-"
    assert float(tables["norms"][0]["norm, as built"]) < 9  # 8.894
    assert tables["frequency-responses"]
    assert tables["regime"]


@pytest.mark.attack
def test_margins_are_of_the_controller_that_the_computer_was_thought_of_for(held, monkeypatch):
    """A sampled design keeps its gain where margins are found without the computer; where it has none, that is the reason."""
    with pytest.raises(InputError, match="because its ideal loop is not stable"):
        margins(["--vehicle", str(held), "--controller", "I"])
    held.write_text(held.read_text().replace("sample_period = 0.05", "sample_period = 0.01"))
    found = []

    def begun(vehicle, controllers, *_):
        found.extend(controllers)
        raise InputError("far enough")

    monkeypatch.setattr("sim.studies.stability.study.stability_margins", begun)
    with pytest.raises(InputError, match="far enough"):
        margins(["--vehicle", str(held), "--controller", "I"])
    (controller,) = found
    np.testing.assert_array_equal(controller.gain, design(read_vehicle(str(held)), "I").gain)


# --- `python -m synth --rates` --------------------------------------------------------------------------------------------


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
    margin = largest_sample_period(loop_of(vehicle, controller))
    # Either is found to 1e-12 of it, or there is none up to a second.
    assert made(lost_anew, vehicle, controller, 0) == pytest.approx(margin if margin < LONGEST_PERIOD else math.inf, rel=1e-9)


@pytest.mark.parametrize(("car", "delay"), [("quarter_car", 0), *attacks((("quarter_car", 3), ("half_car", 0), ("half_car", 1)))])
def test_it_is_lost_there_and_not_before(car, delay):
    """The loop that is driven grows just beyond the period at which it is lost, and at none of many before."""
    vehicle = read_vehicle(car)
    controller = design(vehicle, "II")

    def growth(period: float) -> float:
        built = replace(vehicle, implementation=Implementation(delay=delay))
        return sampled_growth(loop_of(built, controller, period).closed_loop.A)

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
        for norm, delay in ((at.undelayed_norm, 0), (at.delayed_norm, 2)):
            own = norm_as_implemented(replace(vehicle, implementation=Implementation(at.period, delay)), controller)
            assert norm.value == pytest.approx(own.value, rel=2e-8)  # each lies within 1.1e-8 of its levels


@pytest.mark.attack
@pytest.mark.parametrize("name", ["quiet", "I"])
def test_the_continuous_norm_is_what_fast_rates_tend_to(name, never_lost):
    """With a lag, and of a design that knows the noise of its sensors, it is the norm of the road alone, with the lag."""
    text = read_vehicle("quarter_car").text + (
        '\n[controllers.quiet]\nmeasured = ["suspension_deflection", "sprung_velocity"]\nnoise = true\n'
        "[limits]\nactuator_bandwidth = 100.0\n[implementation]\nnoise = { sprung_velocity = 0.01 }\nsample_period = 0.01\n"
    )
    vehicle = parse_vehicle(text)
    found = cost(vehicle, design(vehicle, name), [1e-5, 2e-5])
    off = [found.loss(at.undelayed_norm) for at in found.rates]
    assert 0 < abs(off[0]) < 6e-4  # rad, what 63 rad/s turns by in 10 us
    assert off[1] / off[0] == pytest.approx(2, rel=1e-2)  # the first power of the period
    assert found.lower_bound is not None
    assert found.lower_bound <= min(at.undelayed_norm.value for at in found.rates)


@pytest.mark.parametrize(
    ("rates", "names"),
    [
        (RATES, ("II",)),
        *attacks((rates, ("state", "I", "II", "state_printed", "I_printed", "II_printed")) for rates in (RATES, ("1", "50"))),
    ],
)
def test_losses(capsys, never_lost, norms_once, rates, names):
    """A loss is relative to the continuous norm, and no controller beats the lower bound at any rate."""
    some = [part for name in names for part in ("--controller", name)] if len(names) < 6 else []
    code, found = asked(capsys, *rates, *some)
    assert code == 0
    rows = {row["name"]: row for row in found["controllers"]}
    assert set(rows) == {*names}  # but passive, which no rate changes
    for name, row in rows.items():
        for at in row["rates"]:
            norms = [at["sampled_norm"], at["late_norm"], *([at["designed_norm"]] if name in ("state", "I", "II") else [])]
            for norm in filter(None, norms):
                assert norm["loss"] == pytest.approx(norm["value"] / row["norm"] - 1, abs=1e-12)
                assert row["lower_bound"] < norm["above"] < norm["value"] < norm["below"]
    lost = {name for name, row in rows.items() if row["rates"][-1]["late_norm"] is None}
    assert ("II" in lost) == (rates[-1] == "100")  # 1 sample late it is lost at 18 Hz


@pytest.mark.attack
def test_why_none_is_designed(monkeypatch, capsys):
    """A rate that no design is found for has a dash, and its reason below the table without what to do; in JSON all of it."""
    true = synth.vehicle.sample_rate.cost.design

    def fails_at_50_ms(problem):
        if problem.sampled.period == 0.05:
            raise DesignError("nothing was found: it is probably too slow")
        return true(problem)

    monkeypatch.setattr(synth.vehicle.sample_rate.cost, "design", fails_at_50_ms)
    code, found = asked(capsys, "10", "50", "--controller", "I")
    assert code == 0
    assert found["controllers"][0]["rates"][-1]["designed_norm"] is None
    assert found["controllers"][0]["rates"][-1]["not_designed"] == "nothing was found: it is probably too slow"
    main(["--rates", "10", "50", "--controller", "I"])
    said = capsys.readouterr().out
    (line,) = [line for line in said.splitlines() if line.startswith("  50 ms")]
    assert line.split()[-1] == "-"
    assert "no design at 50 ms: nothing was found" in prose(said)


def test_a_law_with_states_is_not_designed_for_a_rate(monkeypatch, never_lost):
    """What is designed for a rate is a gain; no search is made in place of a law with states that stands in no vehicle file."""
    vehicle = read_vehicle("quarter_car")
    monkeypatch.setattr(synth.vehicle.sample_rate.cost, "design", _not_asked_for)
    law = LinearLaw(np.array([[-5.0]]), np.array([[0.0, 1.0]]), np.array([[500.0]]), np.array([[0.0, -2000.0]]))
    (at,) = cost(vehicle, replace(design(vehicle, "I"), name="mine", law=law), [1e-2], [1e-2]).rates
    assert (at.designed_norm, at.design_failure) == (None, "")


def _not_asked_for(*given):
    raise DesignError("it does not matter here")


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (
            0.9,
            "DOES NOT HOLD: controller I at 10 ms, at once: the sampled norm 7.865064 differs from the gain that a disturbance",
        ),
        (1 + 1e-7, "at once: the sampled norm 7.865064 is below the gain that a disturbance reaches, by 1e-07"),
    ],
)
def test_what_does_not_hold_is_said(share, words, monkeypatch, capsys, never_lost):
    """If a road reaches less than the norm, or more, that is printed, and the exit code is 1."""
    true = synth.vehicle.sample_rate.cost.sampled_norm

    def other(*arguments):
        return replace(true(*arguments), reached=share * true(*arguments).value)

    monkeypatch.setattr(synth.vehicle.sample_rate.cost, "sampled_norm", other)
    monkeypatch.setattr(synth.vehicle.sample_rate.cost, "design", _not_asked_for)
    assert main(["--rates", "10", "--controller", "I"]) == 1
    assert words in prose(capsys.readouterr().out)


def test_what_is_not_designed_is_said(tmp_path, capsys, monkeypatch, never_lost):
    """A controller that cannot be designed has a reason in its place, and the others their rates; the exit code is 1."""
    car = tmp_path / "car.toml"
    hasty = '\n[controllers.blind]\nmeasured = ["suspension_deflection"]\nbounds = [{ norm = 1.0 }]\n'
    design_others = Designer.design

    def refuses(self, name):  # there is none, and to search takes seconds
        if name == "blind":
            raise DesignError("misses norm <= 1 by 600 %")
        return design_others(self, name)

    monkeypatch.setattr(Designer, "design", refuses)
    monkeypatch.setattr(synth.vehicle.sample_rate.cost, "design", _not_asked_for)
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
    lost = (replace(found, unstable_period=0.0, lost_late=0.05), replace(found, unstable_period=math.inf, lost_late=0.25))
    (table,) = [one for one in describe(lost).tables if one.name == "rates"]
    assert [row[-2:] for row in table.rows] == [("1e+05", "20"), ("-", "4")]
    assert found.lower_bound is not None
    for label, level in (("lower bound of any controller", found.lower_bound), ("in continuous time", found.ideal)):
        assert drawn(found, label) == (pytest.approx([10, 10], rel=1e-12), [level, level])


@pytest.mark.attack
def test_picture(tmp_path, monkeypatch, never_lost):
    """The curves are the norms, which end where the loop is unstable; every rate that was asked for is one of theirs."""
    vehicle = read_vehicle("quarter_car")
    found = cost(vehicle, design(vehicle, "II"), [1e-2, 3e-2, 6e-2, 0.1])
    for label, kind in (("at once", "undelayed_norm"), ("1 sample late", "delayed_norm")):
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
