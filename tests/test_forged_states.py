"""Certificates of laws with states: saved, checked, and forged in every matrix, in vehicle files and in logs of all vehicles."""

import dataclasses
import json

import numpy as np
import pytest

from models.common.errors import InputError
from models.laws.linear import LinearLaw
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import ControllerEntry, Vehicle, read_vehicle
from sim.bump import main as bump
from sim.inspect.__main__ import main as inspect
from synth.__main__ import main as synth
from synth.analysis.bounding import certify_tightly
from synth.analysis.record import to_record
from synth.command.check import check
from synth.command.save import save
from synth.controller.controller import Controller
from synth.plant.augmented import on_larger_plant
from synth.vehicle.designer import Designer, certify_given
from tests.commands import attacks, in_the_suite
from tests.rewriting import contents, written

ACCELERATIONS = {
    "quarter_car": ("suspension_deflection", "sprung_acceleration"),
    "half_car": ("heave_acceleration", "suspension_deflection_front", "suspension_deflection_rear"),
    "full_car": ("heave_acceleration", "roll_rate", "suspension_deflection_front_left", "suspension_deflection_rear_right"),
}


def law_of(vehicle: Vehicle, states: int, period: float | None = None) -> LinearLaw:
    """A weak random law on what `ACCELERATIONS` says of the vehicle."""
    rng = np.random.default_rng(7)
    m, q = len(vehicle.linear_model.inputs), len(ACCELERATIONS[vehicle.kind.name])
    A = -np.diag(np.geomspace(3, 80, states)) + np.triu(rng.uniform(-3, 3, (states, states)), 1)
    law = LinearLaw(A, rng.standard_normal((states, q)), 20 * rng.standard_normal((m, states)), 10 * rng.standard_normal((m, q)))
    return law if period is None else law.sampled(period)


def proved(vehicle: Vehicle, law: LinearLaw, name: str = "mine") -> Controller:
    """A law on what is measured, with a bound that is proved."""
    measured = ACCELERATIONS[vehicle.kind.name]
    controller = certify_given(vehicle, name, measured, law)
    designer = Designer(vehicle)
    loop = on_larger_plant(designer.plant, vehicle.linear_model.rows(measured)[0], controller.law_on_states(vehicle))
    certificate = certify_tightly(*loop, controller.certificate.below, designer.plant)
    assert certificate.bound is not None
    return dataclasses.replace(controller, certificate=certificate, designed=True)


def failures(vehicle: Vehicle, controller: Controller, law: LinearLaw, record: dict) -> tuple[str, ...]:
    """Returns what `--check` says of a law and a record, which go through text."""
    entry = ControllerEntry("mine", controller.measured, law, json.loads(json.dumps(record)))
    (row,) = check(Designer(dataclasses.replace(vehicle, controllers={"mine": entry})), None)
    assert ("checked: every claim of its certificate holds" in row.notes) == (not row.failures)
    return row.failures


def changed(law: LinearLaw, name: str, at: tuple[int, int], factor: float) -> LinearLaw:
    """The law with one entry of one of its matrices multiplied."""
    matrix = np.array(getattr(law, name))
    matrix[at] *= factor
    return dataclasses.replace(law, **{name: matrix})


@pytest.mark.parametrize("name", ["quarter_car", "half_car"])  # a full car's lower bounds take ten seconds; its log is below
def test_saved_and_checked(name, tmp_path, capsys):
    """What `--save` writes of a law with states on accelerations, `--check` confirms, and the table has its bound."""
    vehicle = read_vehicle(name)
    law = law_of(vehicle, 3)
    save(tmp_path / "car.toml", vehicle, [proved(vehicle, law)])
    found = read_vehicle(tmp_path / "car.toml").controllers["mine_designed"]
    assert found.law is not None
    assert found.law.record == law.record
    assert np.shape((found.certificate or {})["X"]) == (len(vehicle.linear_model.A) + 3,) * 2
    assert synth(["--check", str(tmp_path / "car.toml"), "--json"]) in (0, 1)  # the printed gains of the paper come without one
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["controllers"]}
    assert rows["mine_designed"]["failures"] == []
    assert rows["mine_designed"]["notes"] == ["checked: every claim of its certificate holds"]
    assert rows["mine_designed"]["lmi"]["proved"]


@pytest.mark.parametrize("period", [None, 0.004])
def test_every_entry_counts(paper, period):
    """Another number in any place of A, B, C or D, or another sample period, is not what the certificate is of."""
    vehicle = dataclasses.replace(paper, implementation=Implementation(sample_period=period))
    law = law_of(vehicle, 3, period)
    controller = proved(vehicle, law)
    record = to_record(controller.certificate)
    assert failures(vehicle, controller, law, record) == ()
    for name in "ABCD":
        for at in np.ndindex(getattr(law, name).shape):
            if getattr(law, name)[at]:
                assert failures(vehicle, controller, changed(law, name, at, 1.01), record), (name, at)
    if period:
        assert failures(vehicle, controller, dataclasses.replace(law, sample_period=1.01 * period), record)
        assert failures(vehicle, controller, dataclasses.replace(law, sample_period=None), record)


def test_states_have_no_names(paper):
    """The same law in other coordinates has the same claims; its proof goes with the coordinates, and no other one does."""
    law = law_of(paper, 3)
    controller = proved(paper, law)
    record = to_record(controller.certificate)
    T = np.array([[1.0, 2.0, 0.0], [0.0, 0.5, 1.0], [1.0, 0.0, 4.0]])
    turned = LinearLaw(np.linalg.solve(T, law.A) @ T, np.linalg.solve(T, law.B), law.C @ T, law.D)
    whole = np.eye(7)
    whole[4:, 4:] = np.linalg.inv(T)
    X = whole @ np.array(record["X"]) @ whole.T
    assert failures(paper, controller, turned, {**record, "X": ((X + X.T) / 2).tolist()}) == ()
    assert any("LMI (20)" in said for said in failures(paper, controller, turned, record))
    assert failures(paper, controller, turned, {key: value for key, value in record.items() if key not in ("X", "bound")}) == ()


@pytest.mark.parametrize(
    "forge",
    [lambda X: X * 1.1, lambda X: X * 0.9, lambda X: X + 0.3 * np.eye(7), lambda X: np.diag(np.diag(X)), lambda X: X * 1e-40],
)
def test_another_x(paper, forge):
    """An X of the right shape that proves another thing, or nothing, is seen."""
    controller = proved(paper, law_of(paper, 3))
    record = to_record(controller.certificate)
    X = forge(np.array(record["X"]))
    assert any("(20)" in said for said in failures(paper, controller, controller.law, {**record, "X": X.tolist()}))


@pytest.mark.parametrize("size", [3, 4, 6, 8])
def test_an_x_of_another_size(paper, size):
    """An X is of the vehicle's states and the law's together: of the vehicle's alone, or one more, it is refused in one line."""
    controller = proved(paper, law_of(paper, 3))
    record = to_record(controller.certificate)
    with pytest.raises(InputError, match=r"is not a matrix of finite numbers of shape \(7, 7\)"):
        failures(paper, controller, controller.law, {**record, "X": np.eye(size).tolist()})


def test_an_unstable_loop_claims_nothing(paper):
    """A law that makes the loop unstable is said to, with or without a certificate of the one that does not."""
    law = law_of(paper, 3)
    controller = proved(paper, law)
    for wild in (law.scaled(-1e4), dataclasses.replace(law, A=-np.array(law.A))):
        assert any("unstable" in said for said in failures(paper, controller, wild, to_record(controller.certificate)))
        assert not certify_given(paper, "wild", controller.measured, wild).certificate.stable


@pytest.fixture(scope="module")
def log(request, tmp_path_factory):
    """A log of a law with states on accelerations, and its vehicle."""
    folder = tmp_path_factory.mktemp("states")
    vehicle = read_vehicle(request.param)
    period = 0.004 if request.param == "quarter_car" else None
    built = f"\n[implementation]\nsample_period = {period}\n" if period else ""
    vehicle = dataclasses.replace(vehicle, text=vehicle.text + built, implementation=Implementation(sample_period=period))
    save(folder / "car.toml", vehicle, [proved(vehicle, law_of(vehicle, 2, period))])
    run = ["--vehicle", str(folder / "car.toml"), "--controller", "mine_designed", "--duration", "0.2", "--logs", str(folder)]
    assert bump(run) in (0, 1)
    return next(folder.glob("*.mcap"))


def inspected(path, capsys) -> tuple[int, list]:
    """Returns what sim.inspect says of a log."""
    capsys.readouterr()
    code = inspect([str(path), "--json"])
    found = json.loads(capsys.readouterr().out)
    return code, [*found["findings"], *(finding for run in found["runs"] for finding in run["findings"])]


@pytest.mark.parametrize("log", in_the_suite(["quarter_car", "half_car"], ACCELERATIONS), indirect=True)
def test_a_log_proves_itself(log, capsys):
    """From the log alone the law, its certificate, its linear response and the physics are confirmed."""
    code, findings = inspected(log, capsys)
    assert code == 0, findings


CARS = pytest.mark.parametrize(  # one with a computer of its own, one of several forces, and one as large as they come
    "log", ["quarter_car", *attacks(["half_car", "full_car"])], indirect=True
)


@CARS
@pytest.mark.parametrize("key", ["A", "B", "C", "D", "sample_period", "measured", "gain"])
def test_a_forged_log_is_found(log, key, tmp_path, capsys):
    """Another entry of A, B, C or D, another sample period, a gain beside them: each is found, in run and vehicle both."""
    parts = contents(log)
    (run,) = [name for name, one in parts.metadata if name.startswith("run/")]
    claims = dict(next(one for name, one in parts.metadata if name == run))
    attachments = parts.attachments
    if key == "gain" or (key == "sample_period" and key not in claims):
        new = {**claims, key: json.dumps([[1.0]] if key == "gain" else 0.003)}
    elif key == "measured":
        new = {**claims, key: json.dumps(json.loads(claims[key])[::-1])}
    elif key == "sample_period":
        new = {**claims, key: "0.003"}
    else:
        rows = json.loads(claims[key])
        rows[0][0] *= 1.001
        new = {**claims, key: json.dumps(rows)}
        old, other = claims[key], new[key]
        lines = f"\n{key} = {old}".encode(), f"\n{key} = {other}".encode()
        attachments = parts.with_attachment("vehicle.toml", lambda data: data.replace(*lines)).attachments
        assert attachments != parts.attachments
    forged = [dataclasses.replace(parts, metadata=[(name, new if name == run else one) for name, one in parts.metadata])]
    if key in "ABCD":
        forged.append(dataclasses.replace(forged[0], attachments=attachments))
    for i, one in enumerate(forged):
        (tmp_path / f"{i}.mcap").write_bytes(written(one))
        code, findings = inspected(tmp_path / f"{i}.mcap", capsys)
        assert code == 1
        assert any(one["verdict"] == "FAILS" for one in findings), findings


@CARS
@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("A", "[]"),
        ("A", "1e9"),
        ("A", json.dumps(np.eye(201).tolist())),
        ("A", "[[1e308, 1], [1, 1]]"),
        ("A", "[[NaN, 1], [1, 1]]"),
        ("A", "[[1, 1]]"),
        ("B", "[[[[1]]]]"),
        ("sample_period", "-1.0"),
        ("sample_period", '"x"'),
        ("sample_period", "1e300"),
    ],
)
def test_a_law_that_is_none(log, key, value, tmp_path, capsys):
    """A law in a log that is none, or too large, fails in words, at once."""
    parts = contents(log)
    (run,) = [name for name, one in parts.metadata if name.startswith("run/")]
    one = dataclasses.replace(
        parts, metadata=[(name, {**each, key: value} if name == run else each) for name, each in parts.metadata]
    )
    (tmp_path / "forged.mcap").write_bytes(written(one))
    code, findings = inspected(tmp_path / "forged.mcap", capsys)
    assert code == 1
    assert any(found["part"] == "controller" and found["verdict"] == "FAILS" for found in findings), findings
