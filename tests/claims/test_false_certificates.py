"""A false claim in the certificate of a vehicle file is named by `synth --check` and by every command that drives its gain."""

import dataclasses
import json
import re

import numpy as np
import pytest

from models.common.errors import InputError
from models.laws.linear import LinearLaw, static_law
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import ControllerEntry, Vehicle, read_vehicle
from sim import bump
from sim.campaign import __main__ as campaign
from synth.__main__ import main as synth
from synth.analysis.certificate import certify
from synth.analysis.record import false_claims, to_record
from synth.command.check import UNPROVED_BOUND, check, prove_controller
from synth.command.save import save
from synth.controller.controller import Controller
from synth.plant.generalized import GeneralizedPlant
from synth.vehicle.certified_vehicle import changed_since
from synth.vehicle.designer import Designer, certify_given
from tests.support.commands import refused
from tests.support.drives import EVERY_DRIVE

ACCELERATIONS = {
    "quarter_car": ("suspension_deflection", "sprung_acceleration"),
    "half_car": ("heave_acceleration", "suspension_deflection_front", "suspension_deflection_rear"),
}


def failures(vehicle: Vehicle, controller: Controller, record: dict, law: LinearLaw | None = None) -> tuple[str, ...]:
    """Returns the failures that `--check` finds in a record, which goes through text as in a file."""
    entry = ControllerEntry("mine", controller.measured, law or controller.law, json.loads(json.dumps(record)))
    (row,) = check(Designer(dataclasses.replace(vehicle, controllers={"mine": entry})), None)
    assert ("checked: every claim of the saved certificate holds" in row.notes) == (not row.failures)
    return row.failures


# --- a gain ----------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def honest(designer):
    """Controller I with everything that can be claimed of it."""
    controller = designer.design("I")
    return controller, to_record(controller.certificate)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"X": None, "bound": 0.1}, "claims the bound 0.1, but contains no X to prove it"),
        ({"X": None}, "but contains no X to prove it"),
        ({"bound": None}, "contains an X, but no bound"),
        ({"bound": 7.843188}, "LMI"),  # the norm itself, to 7 digits: nothing proves it with this X
        ({"peak_frequency": 63.7}, "reached at 63.7 rad/s, but it is not"),
        ({"peak_frequency": 0}, "reached at 0 rad/s, but it is not"),
        ({"norm": 0.0}, "claims that the norm is 0, but it is 7.843187604"),
        ({"norm": 7.8431881}, "claims that the norm is 7.8431881"),
        ({"lower_bound": 7.84, "limit_at": 60.0}, "claims that the lower bound is 7.84"),
        ({"limit_at": None}, "claims that the lower bound is"),
    ],
)
def test_false_claim(designer, honest, change, message):
    """A claim without its proof, or that is not true, is named."""
    controller, record = honest
    changed = {key: value for key, value in {**record, **change}.items() if value is not None}
    assert any(message in failure for failure in failures(designer.vehicle, controller, changed))


def test_claims_alone(designer, honest):
    """A certificate with only a bound fails; one with only a true norm holds."""
    controller, record = honest
    assert any("no X to prove it" in failure for failure in failures(designer.vehicle, controller, {"bound": 0.001}))
    only = {"norm": record["norm"], "peak_frequency": record["peak_frequency"]}
    assert failures(designer.vehicle, controller, only) == ()


@pytest.mark.parametrize(
    ("key", "value"),
    [("norm", -1), ("bound", 0.0), ("bound", 1e200), ("lower_bound", True), ("peak_frequency", "7"), ("limit_at", 10**400)],
)
def test_impossible_number(designer, honest, key, value):
    """A number that no vehicle has is refused in one line, with the other claims or alone."""
    controller, record = honest
    for changed in ({**record, key: value}, {key: value}):
        with refused(match=f"controllers.mine.*{key} = .* is not between 1e-60 and 1e\\+60"):
            failures(designer.vehicle, controller, changed)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda X: X * 1e-100, "a diagonal entry is below"),
        (lambda X: X * 1e100, "up to 1e\\+60"),
        (lambda X: -X, "a diagonal entry is below"),
        (lambda X: X + 1e-6 * np.triu(X, 1), "X in a certificate is not symmetric"),
        (lambda X: X[:3], "is not a matrix of shape"),
    ],
)
def test_impossible_matrix(designer, honest, change, message):
    """An X that is not symmetric, of another shape or out of range is refused in one line."""
    controller, record = honest
    with refused(match=message):
        failures(designer.vehicle, controller, {**record, "X": change(np.array(record["X"])).tolist()})


def test_limit_at_a_pole_of_the_vehicle(designer, honest):
    """A frequency response at a pole of the vehicle on the axis proves no lower bound."""
    controller, _ = honest
    undamped = dataclasses.replace(designer.vehicle, parameters={**designer.vehicle.parameters, "suspension_damping": 0.0})
    at = float(np.imag(np.linalg.eigvals(undamped.linear_model.A)).max())
    assert failures(undamped, controller, {"lower_bound": 100.0, "limit_at": at})


def first_order(c: float, d: float) -> GeneralizedPlant:
    """d + c / (s + 1)."""
    A, B, Bw, C, D, Dw = (np.full((1, 1), entry) for entry in (-1.0, 0.0, 1.0, c, 0.0, d))
    return GeneralizedPlant(A, B, Bw, C, D, Dw)


def test_flat_peak():
    """If the gain is the same at every frequency each of them is a peak; otherwise only that of the norm is."""
    flat = certify(first_order(-2.0, 1.0), np.zeros((1, 1)))
    assert all(flat.peaks_at(omega) for omega in (0.0, 1e-5, 1.0, 1e5))
    low = certify(first_order(1.0, 0.0), np.zeros((1, 1)))
    assert low.peaks_at(0.0)
    assert low.peaks_at(1e-6)  # 5e-13 below
    assert not low.peaks_at(1e-4)  # 5e-9 below
    high = certify(first_order(-1.0, 1.0), np.zeros((1, 1)))
    assert high.norm.peak_frequency == np.inf
    assert "peak_frequency" not in to_record(high)
    assert not high.peaks_at(1.0)


def test_peak_is_good_to_what_flatness_allows(designer, honest):
    """A peak frequency that is 1e-6 off has the norm to 1e-9 and holds; one that is a thousandth off does not."""
    controller, record = honest
    for factor, holds in ((1 + 1e-6, True), (1 - 1e-6, True), (1.001, False), (0.999, False)):
        found = failures(designer.vehicle, controller, {**record, "peak_frequency": factor * record["peak_frequency"]})
        assert (found == ()) == holds


@pytest.mark.parametrize("apart", [1e-4, 1e-8, 1e-12, 0.0])
def test_norm_of_poles_that_nearly_meet(apart):
    """However near two poles and their eigenvectors are, the norm is known to rounding, and another one fails."""
    A = np.array([[-1.0, 1.0], [0.0, -1.0 - apart]])
    plant = GeneralizedPlant(A, np.eye(2)[:, 1:], np.eye(2)[:, 1:], np.eye(2)[:1], np.zeros((1, 1)), np.zeros((1, 1)))
    certificate = certify(plant, np.zeros((1, 2)))
    assert certificate.norm.value == pytest.approx(1 / (1 + apart), rel=1e-12)
    assert all(false_claims({**to_record(certificate), "norm": claim}, certificate) for claim in (0.0, 1.05, 100.0))


# --- a law with states -----------------------------------------------------------------------------------------------------


def law_of(vehicle: Vehicle, states: int, period: float | None = None) -> LinearLaw:
    """A weak random law on what `ACCELERATIONS` has of the vehicle."""
    rng = np.random.default_rng(7)
    m, q = len(vehicle.linear_model.inputs), len(ACCELERATIONS[vehicle.kind.name])
    A = -np.diag(np.geomspace(3, 80, states)) + np.triu(rng.uniform(-3, 3, (states, states)), 1)
    law = LinearLaw(A, rng.standard_normal((states, q)), 20 * rng.standard_normal((m, states)), 10 * rng.standard_normal((m, q)))
    return law if period is None else law.sampled(period)


def with_a_bound(vehicle: Vehicle, law: LinearLaw) -> Controller:
    """A law on what is measured, with the bound that `--prove` finds."""
    found, said = prove_controller(Designer(vehicle), certify_given(vehicle, "mine", ACCELERATIONS[vehicle.kind.name], law))
    assert said
    certificate = found.certificate
    assert certificate.bound is not None
    assert 0 < certificate.bound / certificate.norm.value - 1 < 1.1e-6  # the closest margin that is tried
    return dataclasses.replace(found, designed=True)


@pytest.fixture(scope="module")
def dynamic(paper):
    """A law of three states with everything that can be claimed of it."""
    controller = with_a_bound(paper, law_of(paper, 3))
    return controller, to_record(controller.certificate)


@pytest.mark.parametrize("name", ["quarter_car", "half_car"])  # a full car's lower bounds take ten seconds
def test_saved_and_checked(name, tmp_path, capsys):
    """A law with states on accelerations that `--save` writes is confirmed by `--check`, and its bound is in the table."""
    vehicle = read_vehicle(name)
    law = law_of(vehicle, 3)
    save(tmp_path / "car.toml", vehicle, [with_a_bound(vehicle, law)])
    found = read_vehicle(tmp_path / "car.toml").controllers["mine_designed"]
    assert found.law is not None
    assert found.law.record == law.record
    assert np.shape((found.certificate or {})["X"]) == (len(vehicle.linear_model.A) + 3,) * 2
    assert synth(["--check", str(tmp_path / "car.toml"), "--json"]) in (0, 1)  # the printed gains of the paper come without one
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["controllers"]}
    assert rows["mine_designed"]["failures"] == []
    assert rows["mine_designed"]["notes"] == ["checked: every claim of the saved certificate holds"]
    assert rows["mine_designed"]["lmi"]["proved"]


@pytest.mark.parametrize("period", [None, 0.004])
def test_every_matrix_counts(paper, period):
    """With another entry of A, B, C or D, or another sample period, the certificate of a law fails."""
    vehicle = dataclasses.replace(paper, implementation=Implementation(sample_period=period))
    law = law_of(vehicle, 3, period)
    controller = with_a_bound(vehicle, law)
    record = to_record(controller.certificate)
    assert failures(vehicle, controller, record) == ()
    for name in "ABCD":
        matrix = np.array(getattr(law, name))
        matrix[0, -1] *= 1.01
        assert matrix[0, -1]
        assert failures(vehicle, controller, record, dataclasses.replace(law, **{name: matrix})), name
    if period:
        for other in (1.01 * period, None):
            assert failures(vehicle, controller, record, dataclasses.replace(law, sample_period=other))


def test_states_have_no_names(paper, dynamic):
    """The same law in other coordinates has the same claims; its proof goes with the coordinates, and no other one does."""
    controller, record = dynamic
    law = controller.law
    T = np.array([[1.0, 2.0, 0.0], [0.0, 0.5, 1.0], [1.0, 0.0, 4.0]])
    turned = LinearLaw(np.linalg.solve(T, law.A) @ T, np.linalg.solve(T, law.B), law.C @ T, law.D)
    whole = np.eye(7)
    whole[4:, 4:] = np.linalg.inv(T)
    X = whole @ np.array(record["X"]) @ whole.T
    assert failures(paper, controller, {**record, "X": ((X + X.T) / 2).tolist()}, turned) == ()
    assert any("LMI (20)" in said for said in failures(paper, controller, record, turned))
    without = {key: value for key, value in record.items() if key not in ("X", "bound")}
    assert failures(paper, controller, without, turned) == ()


def test_another_x(paper, dynamic):
    """An X of the right shape that proves another bound fails; one of the vehicle's states alone is refused in one line."""
    controller, record = dynamic
    X = np.array(record["X"])
    for other in (X * 0.9, X + 0.3 * np.eye(7), np.diag(np.diag(X))):
        assert any("(20)" in said for said in failures(paper, controller, {**record, "X": other.tolist()}))
    with refused(match=r"is not a matrix of shape \(7, 7\)"):
        failures(paper, controller, {**record, "X": np.eye(4).tolist()})


def test_an_unstable_loop_claims_nothing(paper, dynamic):
    """A law that makes the loop unstable is reported as such, with or without the certificate of a stable one."""
    controller, record = dynamic
    for wild in (controller.law.scaled(-1e4), dataclasses.replace(controller.law, A=-np.array(controller.law.A))):
        assert any("unstable" in said for said in failures(paper, controller, record, wild))
        assert not certify_given(paper, "wild", controller.measured, wild).certificate.stable


@pytest.mark.parametrize(("vehicle", "name"), [("quarter_car", "I_printed"), ("quarter_car_accelerometer", "accelerometer")])
def test_a_given_law_has_a_close_bound_when_asked(vehicle, name, capsys):
    """Static, or with states on an accelerometer: a bound a millionth above the norm, if asked; else none."""
    options = ("--vehicle", vehicle, "--controller", name)
    found = []
    for more in ([], ["--prove"]):
        assert synth([*options, *more, "--json"]) == 0
        found += [row for row in json.loads(capsys.readouterr().out)["controllers"] if row["name"] == name]
    plain, asked = found
    assert plain["bound"] is None
    assert asked["lmi"]["proved"]
    assert asked["norm"] == plain["norm"]
    assert 0 < asked["bound"] / asked["norm"] - 1 < 1.1e-6  # the closest margin that is tried
    assert asked["notes"] == [*plain["notes"], "the law is from the vehicle file, and its bound is proved here"]
    for row in (asked, plain):
        for key in ("bound", "lmi", "notes", "certificate"):
            del row[key]
    assert asked == plain  # all else


def test_what_is_designed_unstable_or_cannot_be_proved_is_as_it_was(paper, designer, monkeypatch):
    """A designed law keeps its own proof; an unstable loop, and one for which no X is found, have none, and the notes say so."""
    designed = designer.design("I")
    assert prove_controller(designer, designed) == (designed, ())
    wild, calm = (certify_given(paper, "mine", ("sprung_velocity",), static_law(np.array([[k]]))) for k in (9000.0, -9000.0))
    assert prove_controller(designer, wild) == (wild, ())
    monkeypatch.setattr("synth.command.check.certify_tightly", lambda *_: calm.certificate)
    assert prove_controller(designer, calm) == (calm, (UNPROVED_BOUND,))


# --- the commands ----------------------------------------------------------------------------------------------------------

GIVEN = "II_designed"  # what a saved design of II is called


@pytest.fixture(scope="module")
def vehicles(tmp_path_factory):
    """A vehicle file with a gain and its certificate; the same with another norm claimed; and with a norm that is a word."""
    folder = tmp_path_factory.mktemp("vehicles")
    honest, false, broken = (folder / f"{name}.toml" for name in ("honest", "false", "broken"))
    synth(["--controller", "II", "--save", str(honest)])
    text = honest.read_text()
    norm = re.search(r"^norm = (\S+)$", text, re.M)
    assert norm
    false.write_text(text.replace(norm[0], f"norm = {float(norm[1]) / 2}"))
    broken.write_text(text.replace(norm[0], "norm = 'low'"))
    return {"honest": honest, "false": false, "broken": broken}


@EVERY_DRIVE
def test_said_by(vehicles, capsys, main, options):
    """One line names the controller and the false claim, and nothing else changes; a true certificate causes no line."""
    said, every = {}, vehicles if main is bump.main else {name: vehicles[name] for name in ("honest", "false")}
    for name, vehicle in every.items():
        code = main(["--vehicle", str(vehicle), "--controller", GIVEN, *options])
        printed = capsys.readouterr()
        lines = [line for line in printed.err.splitlines() if line.startswith("roadproof: ")]
        said[name] = (code, printed.out.replace(str(vehicle), "FILE"), lines)
    assert said["honest"][2] == []
    for name, why in {"false": "claims that the norm is", "broken": "norm = 'low' in a certificate is not between"}.items():
        if name not in said:
            continue
        code, out, (line,) = said[name]
        assert (code, out) == said["honest"][:2]
        assert line.startswith("roadproof: the certificate of controller 'II_designed' in the vehicle file does not hold (")
        assert why in line


def test_said_by_a_campaign(vehicles, tmp_path, capsys):
    """A campaign prints the line once for a vehicle whose certificate is false, and drives the gain."""
    files = ", ".join(f'"{vehicles[name]}"' for name in ("honest", "false"))
    text = f'vehicles = [{files}]\ncontrollers = ["{GIVEN}"]\nroads = ["bump"]\nspeeds = [10.0]\nduration = 0.1\n'
    (tmp_path / "campaign.toml").write_text(text)
    assert campaign.main([str(tmp_path / "campaign.toml")]) == 0
    assert capsys.readouterr().err.count("the certificate of controller 'II_designed' in the vehicle file does not hold") == 1


def test_said_by_check(vehicles, capsys):
    """`synth --check` of a false claim exits with 1 and names it; of a claim that is not a number, with 2 and one line."""
    assert synth(["--check", str(vehicles["false"]), "--controller", GIVEN]) == 1
    assert "FAILS: the certificate claims that the norm is" in capsys.readouterr().out
    with pytest.raises(InputError, match="norm = 'low' in a certificate is not between"):
        synth(["--check", str(vehicles["broken"]), "--controller", GIVEN])


@pytest.mark.parametrize("recorded", [True, False], ids=["saved now", "saved before"])
def test_what_changed_since_a_certificate_is_named(recorded, tmp_path, capsys):
    """A payload, a parameter or a weight that changed after `--save` is named; the payload also for older files."""
    assert synth(["--controller", "II", "--save", str(tmp_path / "car.toml")]) == 0
    text = (tmp_path / "car.toml").read_text()
    text = text if recorded else re.sub(r"\nvehicle = .*", "", text)
    cases = {
        "payload 100 kg": text + "\n[payload]\nmass = 100.0\n",
        "sprung_mass 550 instead of 504.5 kg": text.replace("sprung_mass = 504.5", "sprung_mass = 550.0", 1),
        "[performance] tyre_deflection 0.4 instead of 0.2": text.replace("tyre_deflection = 0.2", "tyre_deflection = 0.4", 1),
    }
    for change, changed in [*cases.items()][: 3 if recorded else 1]:
        (tmp_path / "changed.toml").write_text(changed)
        capsys.readouterr()
        assert synth(["--check", str(tmp_path / "changed.toml"), "--controller", "II_designed", "--json"]) == 1
        (row,) = json.loads(capsys.readouterr().out)["controllers"]
        assert row["failures"] == [f"the vehicle is no longer the one that was certified: {change}"]
        vehicle = read_vehicle(tmp_path / "changed.toml")
        assert changed_since(vehicle, vehicle.controllers["II_designed"]) == row["failures"][0]  # as commands that drive print
