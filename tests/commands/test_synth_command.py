"""`python -m synth`: what it prints, saves and checks."""

import dataclasses
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import synth.command.cross_check
from models.common.errors import InputError
from models.laws.python_law import PythonLaw
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.bump import main as bump
from synth.__main__ import main
from synth.command.cross_check import cross_check
from synth.command.table import limit_text, pole_words
from synth.lmi.full_order_bound import bound_beyond_control
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer
from tests.commands.golden import golden
from tests.support.commands import attacks, prose, refused
from tests.support.pages import hopper


@pytest.mark.parametrize("options", [[], *attacks([["--controller", "I"], ["--controller", "state", "--refine"]])])
def test_what_is_flat_is_the_gain_in_the_table(tmp_path, capsys, options):
    """If the path ends at gains beyond any actuator, what is printed is of the designed gain, and has a width."""
    car = str(hopper(tmp_path))
    _, found = table(capsys, "--vehicle", car, *options)
    shown = [row["gain"] for row in found["controllers"] if row["name"] == "state"]
    ((*gains,),) = shown[0] if shown else Designer(read_vehicle(car)).design("state").gain.tolist()
    moves = found["flat"]["gain_down_up"]
    assert [move[0] for move in moves.values()] == gains  # with one force a state's largest gain is its gain
    assert all(None in ends or sum(ends) > 0 for _, *ends in moves.values())


def table(capsys, *arguments) -> tuple[int, dict]:
    code = main([*arguments, "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_table(capsys):
    """Every controller has a gain, a norm that both routes give, poles and a gap to what no controller can beat."""
    code, found = table(capsys)
    assert code == 0
    rows = {row["name"]: row for row in found["controllers"]}
    assert set(rows) == {"passive", "state", "I", "II", "state_printed", "I_printed", "II_printed"}
    assert rows["I"]["norm"] == pytest.approx(7.843188, abs=1e-6)  # given with 7 digits
    assert rows["I"]["gap"] == pytest.approx(8.588e-4, abs=1e-6)  # 7.843188 / 7.836458 - 1
    assert rows["state"]["gap"] == pytest.approx(0, abs=1e-9)  # the path's end
    assert rows["passive"]["norm"] == pytest.approx(35.0720, abs=5e-4)
    assert all(row["routes_gap"] < 1e-10 and row["failures"] == [] for row in rows.values())
    assert found["invariant_limit"] == {"norm": pytest.approx(7.83645764, rel=1e-8), "frequency": pytest.approx(63.757, abs=1e-3)}
    # Half a percent either way of the gain on the deflection, a fifth of that on the tyre's, for 1e-4 of gamma.
    gain, down, up = found["flat"]["gain_down_up"]["tyre_deflection"]
    assert gain == pytest.approx(2333.4, abs=0.1)
    assert 0.1 * gain < down < 0.3 * gain
    assert 0.1 * gain < up < 0.3 * gain


def test_all_of_the_quarter_car_on_a_screen():
    """With -v the answer is first, gains have units and signals, and small margins are warnings."""
    out = golden("synth", "plain", "-v").out
    assert out.index("above it") < out.index("controller passive")
    assert "controller I, gain: 10825.2 N/m suspension_deflection, -2069.5 N s/m sprung_velocity poles" in prose(out)
    assert "  WARNING: small gain margin 1.21 (1.66 dB), disk margin 0.19 (10.9°)\n" in out


def test_modes():
    """A pair of poles has its natural frequency and damping ratio beside it: of s^2 + 2 s + 4 they are 2 rad/s and 1/2."""
    assert [pole_words(one) for one in (complex(-1, 3**0.5), complex(-2))] == ["-1 +- 1.732j (0.318 Hz, damping 0.5)", "-2"]


@pytest.mark.parametrize("vehicle", ["half_car", pytest.param("full_car", marks=pytest.mark.attack)])
def test_other_vehicles(capsys, vehicle):
    """Every controller of the other cars that ship is designed and certified, within 11 % of the best possible."""
    code, found = table(capsys, "--vehicle", vehicle)
    assert code == 0
    gaps = {row["name"]: row["gap"] for row in found["controllers"]}
    assert gaps["state"] == pytest.approx(0, abs=1e-8)
    assert 0 < gaps["I"] < 0.11
    assert 0 < gaps["II"] < 0.11


def test_the_limit_of_a_mode_that_has_to_be_held_is_no_invariant_point():
    """For an integrator that z does not see, the limit at 0 rad/s is of forces that hold it; others could change all of z."""
    one = np.ones((1, 1))
    plant = GeneralizedPlant(A=0 * one, B=one, Bw=one, C=0 * one, D=2 * one, Dw=0 * one)  # z = 2 u, and x' = u + w
    limit = bound_beyond_control(plant)
    assert limit.gamma == pytest.approx(2, rel=1e-12)  # it is rounded down
    assert limit.limit_at == 0.0
    assert limit_text(limit, plant).startswith(
        "Limit: no controller has a norm below 2, because control must stabilise the mode at 0 Hz"
    )


MERELY = ": at {at}, no controller lowers the gain to z further. Without control, this gain is {free:.7g}."
SAME = ": no force changes z at {at}."


@pytest.mark.parametrize(("more", "said"), [("", SAME), ("tyre_damping = 1000.0\n", MERELY)], ids=["paper", "damped tyre"])
def test_an_invariant_point_is_one(more, said):
    """Only if z without control is at the limit, to 0.1 %, it is said that no control changes z; of damped tyres it is not."""
    text = read_vehicle("quarter_car").text.replace("[parameters]", f"[parameters]\n{more}", 1)
    plant = Designer(parse_vehicle(text)).plant
    bound = bound_beyond_control(plant)
    assert bound.limit_at is not None
    resolvent = np.linalg.inv(1j * bound.limit_at * np.eye(4) - plant.A)
    of_w, of_u = plant.C @ resolvent @ plant.Bw + plant.Dw, plant.C @ resolvent @ plant.B + plant.D
    across = float(np.linalg.norm(of_w - of_u @ np.linalg.pinv(of_u) @ of_w))
    alone = float(np.linalg.norm(of_w))
    assert bound.gamma == pytest.approx(across, rel=1e-9)  # rounding of the pseudo-inverse
    where = f"{bound.limit_at / (2 * np.pi):.5g} Hz"
    assert limit_text(bound, plant) == f"Limit: no controller has a norm below {across:.7g}{said.format(free=alone, at=where)}"
    assert (alone <= 1.001 * across) == (said == SAME)


def test_the_case_is_said(capsys, tmp_path):
    """If nothing but the force counts no force is best, and every designed controller's row says so."""
    file = tmp_path / "car.toml"
    head, _, tail = read_vehicle("quarter_car").text.partition("[performance]")
    file.write_text(f"{head}[performance]\ncontrol_force = 1e-4\n[controllers.I]{tail.partition('[controllers.I]')[2]}")
    code, found = table(capsys, "--vehicle", str(file), "--controller", "state", "--controller", "I")
    assert code == 0
    for row in found["controllers"]:
        assert row["notes"] == ["without control w does not affect z; no force is applied"]
        assert row["norm"] == 0
        assert not any(map(any, row["gain"]))


@pytest.mark.parametrize("weighted", [True, False])
@pytest.mark.parametrize("name", ["state", "II_printed", "passive"])
def test_forces_without_a_weight_are_named(name, weighted, capsys, tmp_path):
    """The text names the forces that no weight limits if a controller is designed, and not for a given gain."""
    text = read_vehicle("quarter_car").text
    (tmp_path / "car.toml").write_text(text if weighted else re.sub("^control_force = .*$", "", text, flags=re.MULTILINE))
    main(["--vehicle", str(tmp_path / "car.toml"), "--controller", name])
    said = "No weight limits control_force, so gains can become very large: add control_force = 1e-4 to [performance]"
    assert (said in prose(capsys.readouterr().out)) == (name == "state" and not weighted)


def test_text_says_where_there_is_no_limit(capsys, tmp_path):
    """For the deflection alone, one signal and one force, control can change all; it is said, and in JSON it is null."""
    text = read_vehicle("quarter_car").text
    weights = text.split("[performance]")[1].split("[")[0]
    file = tmp_path / "car.toml"
    file.write_text(text.replace(weights, "\nsuspension_deflection = 1.0\n\n"))
    main(["--vehicle", str(file), "--controller", "passive", "-v"])
    said = "Limit: none. At every frequency, control forces can change the whole response of z to the road"
    assert said in prose(capsys.readouterr().out)
    _, found = table(capsys, "--vehicle", str(file), "--controller", "passive")
    assert found["invariant_limit"] is None


def test_laws_that_are_left_out_are_named(capsys):
    """Laws to which linear analysis does not apply are in one sentence, by all their names."""
    vehicle = read_vehicle("quarter_car_semi_active")
    main(["--vehicle", "quarter_car_semi_active", "-v"])
    (named,) = re.findall(r"does not apply to (.*?)\. roadproof drive", prose(capsys.readouterr().out))
    assert sorted([*vehicle.linear_names, *named.split(", ")]) == sorted(vehicle.controller_names)


def test_remark_4(capsys):
    """With L = 0 neither controller can be designed, and each says why."""
    code, found = table(capsys, "--zero-l")
    assert code == 1
    assert [row["name"] for row in found["controllers"]] == ["I", "II"]
    assert all("no solution with eta > 0 for L = 0" in row["reason"] for row in found["controllers"])


@pytest.mark.parametrize("vehicle", ["quarter_car", *attacks(("half_car", "full_car"))])
def test_the_table_says_what_refine_would_gain(capsys, vehicle):
    """The promise of the table is kept by the command that it names: each norm falls by at least as much; none for state."""
    assert main(["--vehicle", vehicle, "-v"]) == 0
    text = capsys.readouterr().out
    promised = {name: float(share) for name, share in re.findall(r"(\w+) by at least ([\d.e+-]+) %", prose(text))}
    code, before = table(capsys, "--vehicle", vehicle)
    assert code == 0
    for row in before["controllers"]:
        share = row["refine_lowers_by_at_least"]
        assert (share is not None) == (row["name"] in promised)
        if share is not None:
            assert 0.9 * share <= promised[row["name"]] / 100 <= share  # cut after two digits
    assert set(promised) == {"I", "II"}
    code, after = table(capsys, "--vehicle", vehicle, "--controller", "I", "--controller", "II", "--refine")
    assert code == 0
    norms = {row["name"]: row["norm"] for row in before["controllers"]}
    for row in after["controllers"]:
        assert row["norm"] <= norms[row["name"]] * (1 - promised[row["name"]] / 100)
        assert row["refine_lowers_by_at_least"] is None


def test_what_cannot_be_refined_fails_as_it_is(tmp_path, capsys):
    """An unstable law that a file gives is not refined, and its claims fail with `--refine` as without."""
    (tmp_path / "car.toml").write_text(
        f'{read_vehicle("quarter_car").text}\n[controllers.wild]\nmeasured = ["sprung_velocity"]\ngain = [[9e4]]\n'
    )
    for options in ([], ["--refine"]):
        assert main(["--vehicle", str(tmp_path / "car.toml"), "--controller", "wild", *options]) == 1
        assert "not every claim holds: wild FAILS" in prose(capsys.readouterr().out)


def test_refine_belongs_to_the_designer(designer, capsys):
    """`Designer.refine` is what the command prints: the gain, where it came from, what was traded.

    Refined, controller I comes within 1e-4 of the best any controller could do, and does not walk to [-72240, -82631].
    """
    refined = designer.refine("II")
    code, found = table(capsys, "--controller", "I", "--controller", "II", "--refine")
    assert code == 0
    first, row = found["controllers"]
    assert first["gap"] < 1e-4
    assert max(map(abs, first["gain"][0])) < 11000
    assert any(note.startswith("refined: gamma 7.843188 -> ") and "not accepted" in note for note in first["notes"])
    assert row["gain"] == refined.controller.gain.tolist()
    assert row["notes"] == [refined.trade_off_text]
    assert refined.start is not None
    assert refined.start.certificate.norm.value == pytest.approx(refined.refinement.before, rel=1e-9)  # where the search stops
    assert refined.controller.certificate.norm.value == pytest.approx(refined.refinement.after, rel=1e-8)  # likewise
    with pytest.raises(InputError, match="has no gain to refine"):
        designer.refine("passive")


def test_refine_from_nothing():
    """If the two steps find no gain, as with L = 0, it starts from what stabilises the car, and says from where."""
    refined = Designer(read_vehicle("quarter_car")).refine("II", zero_l=True)
    assert refined.start is None
    assert refined.trade_off_text.startswith(f"refined: from {refined.origin}; gamma ")
    assert refined.controller.certificate.failures == ()


@pytest.mark.parametrize("vehicle", ["quarter_car", *attacks(["half_car", "full_car"])])
def test_cross_check(capsys, vehicle):
    """Clarabel's optimum of every LMI problem is ours, and with our gain fixed it reaches the same: to its tolerance."""
    code, found = table(capsys, "--vehicle", vehicle, "--cross-check")
    assert code == 0
    witnesses = {row["name"]: row["cross_check"] for row in found["controllers"] if row["cross_check"] is not None}
    assert {name: each["problem"] for name, each in witnesses.items()} == {"state": "(22)", "I": "(25)", "II": "(25)"}
    for name, each in witnesses.items():
        bound = next(row["bound"] for row in found["controllers"] if row["name"] == name)
        assert each["ours"] == pytest.approx(bound, rel=1e-12)  # the path's end
        assert each["said"] == ""
        assert abs(each["apart"]) < 2e-6  # measured 7e-7 for I of the quarter-car, 3e-8 for the rest
        assert abs(each["above"]) < 2e-6
        assert each["theirs"] == pytest.approx(each["ours"] * (1 + each["apart"]), rel=1e-12)


def test_a_witness_against_is_a_failure(designer, monkeypatch):
    """A gain that is off the face, an optimum that is another, a missing answer: each is said."""
    state = designer.design("state")
    assert state.certificate.proof is not None
    seven = dataclasses.replace(state.certificate.proof, eta=1 / 49)
    moved = dataclasses.replace(state, certificate=dataclasses.replace(state.certificate, proof=seven))
    for wrong, said in ((dataclasses.replace(state, law=state.law.scaled(0.9)), "gain attains"), (moved, "of this design, 7")):
        witness = cross_check(designer, wrong)
        assert witness is not None
        assert said in witness.failures[0]

    def gives_up(*given):
        raise DesignError("Clarabel gave up")

    monkeypatch.setattr(synth.command.cross_check, "solve_lmi", gives_up)
    witness = cross_check(designer, state)
    assert witness is not None
    assert witness.text == "no cross-check: problem (22): Clarabel gave up; problem (22) with the designed gain: Clarabel gave up"


@pytest.mark.parametrize("section", ["", "[limits]\nactuator_bandwidth = 60.0\n", "[implementation]\ndelay = 3\n"])
def test_which_loop_is_said(capsys, tmp_path, section):
    """The output says that bound, norm and poles are of the ideal loop when, and only when, there is another."""
    file = tmp_path / "car.toml"
    file.write_text(read_vehicle("quarter_car").text + "\n" + section)
    main(["--vehicle", str(file), "--controller", "passive", "-v"])
    said = "Bound, norm and poles are those of the ideal loop: continuous, without [limits] and [implementation]"
    assert (said in prose(capsys.readouterr().out)) == bool(section)


def test_save_and_check(capsys, tmp_path):
    """A saved design reads back with a certificate that holds, and other commands drive it. `--check` imports no solver."""
    file = tmp_path / "car.toml"
    code, saved = table(capsys, "--save", str(file))
    assert code == 0
    code, checked = table(capsys, "--check", str(file), "--controller", "I_designed")
    assert code == 0
    before = next(row for row in saved["controllers"] if row["name"] == "I")
    (after,) = checked["controllers"]
    for claim in ("norm", "bound", "lower_bound"):
        assert after[claim] == pytest.approx(before[claim], rel=1e-12)
    assert bump(["--vehicle", str(file), "--controller", "II_designed", "--no-logs", "--duration", "0.5"]) == 0
    code = (
        "import sys; sys.modules['cvxpy'] = sys.modules['clarabel'] = sys.modules['control'] = None; "
        "from synth.__main__ import main; sys.exit(main(sys.argv[1:]))"
    )
    done = subprocess.run([sys.executable, "-c", code, "--check", str(file)], capture_output=True, text=True, check=True)
    assert "checked: every claim of the saved certificate holds" in prose(done.stdout)
    assert "the file has no certificate for it" in prose(done.stdout)


def test_check_sees_what_is_not_true(capsys, tmp_path):
    """A number of a saved certificate that was changed is found, and the exit code is 1."""
    file = tmp_path / "car.toml"
    table(capsys, "--controller", "I", "--save", str(file))
    head, tail = file.read_text().split("[controllers.I_designed]")
    for old, new, message in (
        ("norm = 7.84", "norm = 7.83", "claims that the norm is 7.83"),
        ("lower_bound = 7.836", "lower_bound = 7.837", "claims that the lower bound is 7.837"),
        ("bound = 7.87", "bound = 7.81", "exceeds the bound"),
        ("gain = [[10825", "gain = [[20825", "LMI"),
        ("X = [[0.", "X = [[9.", "LMI"),
    ):
        assert old in tail
        file.write_text(head + "[controllers.I_designed]" + tail.replace(old, new, 1))
        code, found = table(capsys, "--check", str(file), "--controller", "I_designed")
        assert code == 1
        assert any(message in failure for failure in found["controllers"][0]["failures"]), old


def test_a_saved_file_replaces_only_its_own(capsys, tmp_path):
    """`--save` replaces its own or an empty file, and leaves nothing else. It refuses other files, and a name that is taken."""
    own, saved = tmp_path / "car.toml", tmp_path / "saved.toml"
    own.write_text(read_vehicle("quarter_car").text)
    saved.touch()
    for _ in range(2):
        table(capsys, "--controller", "I", "--save", str(saved))
    assert "I_designed" in read_vehicle(saved).controllers
    with refused(f"--save {own} already exists, but was not written by --save; give another name, or remove the existing file"):
        main(["--controller", "I", "--save", str(own)])
    with refused("already has a controller 'I_designed'"):
        main(["--vehicle", str(saved), "--controller", "I", "--save", str(tmp_path / "more.toml")])
    assert own.read_text() == read_vehicle("quarter_car").text
    assert {path.name for path in tmp_path.iterdir()} == {"car.toml", "saved.toml"}


def test_a_saved_file_finds_its_laws(capsys, tmp_path, monkeypatch):
    """A file that is saved above names laws in Python from there; where it could not name them it is refused, before the work."""
    monkeypatch.chdir(tmp_path)
    for folder in ("cars", "cars/laws", "other"):
        Path(folder).mkdir()
    Path("cars/laws/sky.py").write_text("def step(y, t, h):\n    return [0.0]\n")
    law = '[controllers.sky]\nmeasured = ["sprung_velocity"]\nlaw = "laws/sky.py:step"  # mine\n'
    Path("cars/car.toml").write_text(f"{read_vehicle('quarter_car').text}\n{law}")
    for place, named in (("saved.toml", "cars/laws/sky.py"), ("cars/saved.toml", "laws/sky.py"), ("cars/laws/a.toml", "sky.py")):
        table(capsys, "--vehicle", "cars/car.toml", "--controller", "I", "--save", place)
        python = read_vehicle(place).controllers["sky"].source
        assert isinstance(python, PythonLaw)
        assert (python.file, python.source()) == (named, Path("cars/laws/sky.py").read_text())
    with refused("--save other/saved.toml: ", "law laws/sky.py:step is outside the folder other, in which"):
        main(["--vehicle", "cars/car.toml", "--controller", "I", "--save", "other/saved.toml"])


@pytest.mark.parametrize("option", [["--save", "saved.toml"], ["--export", "out"]])
def test_nothing_is_added_to_an_inline_table(tmp_path, monkeypatch, option):
    """A file that gives its controllers as one inline table is no TOML with a section more; one line asks for sections."""
    monkeypatch.chdir(tmp_path)
    rest = read_vehicle("quarter_car").text.partition("[controllers")[0]
    Path("car.toml").write_text('controllers = { mine = { measured = ["sprung_velocity"] } }\n' + rest)
    with refused("the vehicle file has controllers = { ... }", "write each controller as [controllers.NAME]"):
        main(["--vehicle", "car.toml", "--controller", "mine", *option])


@pytest.mark.parametrize(
    ("certificate", "message"),
    [
        ("norms = 1.0", "a certificate has the unknown key 'norms'"),
        ("X = [[1.0, 2.0]]", "is not a matrix of shape"),
        ("state = { X = [[1.0]], eta = 1.0 }", "a certificate does not fit the vehicle"),
    ],
)
def test_malformed_certificate(tmp_path, certificate, message):
    """So is a certificate that is none."""
    file = tmp_path / "car.toml"
    file.write_text(read_vehicle("quarter_car").text + f"\n[controllers.I_printed.certificate]\n{certificate}\n")
    with pytest.raises(InputError, match=message):
        main(["--check", str(file), "--controller", "I_printed"])
