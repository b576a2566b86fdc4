"""Identification: its intervals are those of theory and cover, and what logs do not determine, or what is wrong, is named.

Logs are predicted exactly for a vehicle of known parameters, and noise from a seed is added. So every claim is on the estimate.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from mcap.writer import Writer
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.logs.measured_log import read_measured_log
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.drive.__main__ import main as drive
from sim.studies.identification.allowed import allowed_results
from sim.studies.identification.columns import map_text
from sim.studies.identification.command import IdentifyStudy
from sim.studies.identification.estimation.estimate import Estimate, estimate
from sim.studies.identification.estimation.problem import IdentificationProblem
from sim.studies.identification.experiment import EXTENSION, FORCE, Channel, Experiment
from sim.studies.identification.identification import Identification, changed, identify, identify_experiments
from sim.studies.identification.log_map import LogMap, read_map
from sim.studies.identification.part_prediction import PartPrediction
from sim.studies.identification.prediction import LogPrediction
from sim.studies.identification.reading import LogStretches, read_experiments
from sim.studies.identification.report import statements, vehicle_text

BODY, HUB, TRAVEL = "sprung_acceleration", "unsprung_acceleration", "suspension_deflection"
NOISE = {BODY: 0.1, HUB: 0.5, TRAVEL: 2e-4}  # rms [m/s2, m/s2, m]
MASS = "sprung_mass"
# Relative standard deviations [%] of m_u/m_s, k_s/m_s, c_s/m_s and k_t/m_u for the paper's car over `chirp(30)` at 200 Hz: an
# independent script of 40 lines, with finite differences of an exact simulation.
RATIOS = (
    {"unsprung_mass": 1.0, MASS: -1.0},
    {"suspension_stiffness": 1.0, MASS: -1.0},
    {"suspension_damping": 1.0, MASS: -1.0},
    {"tyre_stiffness": 1.0, "unsprung_mass": -1.0},
)
CRAMER_RAO = {
    (BODY,): (1.1157, 0.4366, 1.2224, 0.1341),
    (HUB,): (34.3442, 34.7693, 33.9434, 0.0791),
    (TRAVEL,): (0.1792, 0.0248, 0.1427, 0.0165),
    (BODY, HUB): (0.7041, 0.4089, 0.7405, 0.0419),
    (BODY, TRAVEL): (0.1764, 0.0247, 0.1408, 0.0163),
    (BODY, HUB, TRAVEL): (0.1448, 0.0241, 0.1399, 0.0104),
}


def measurable(vehicle: Vehicle) -> Vehicle:
    """Returns a vehicle whose model has all signals that it can have."""
    return replace(vehicle, kind=vehicle.kind.naming({*vehicle.kind.possible}))


CAR = measurable(read_vehicle("quarter_car"))


def chirp(duration: float, step: float = 0.01, amplitude: float = 2e-3, phase: float = 0.0, top: float = 20.0) -> Array:
    """Returns a height from 0.5 Hz to the top with equal time for each octave, shape (T,), from 0."""
    t, rate = np.arange(0, duration + step / 2, step), duration / np.log(top / 0.5)
    return amplitude * (np.sin(np.pi * rate * (np.exp(t / rate) - 1) + phase) - np.sin(phase))


def log(
    truth: Vehicle,
    signals: Sequence[str],
    road: Array,
    seed: int = 0,
    step: float = 0.01,
    forces: Array | None = None,
    noise: Mapping[str, float] = NOISE,
    known: bool = False,
    added: Mapping[str, float] = {},
) -> Experiment:
    """Returns what sensors of a vehicle measure over a road, with noise; its rms is given to the estimate if it is known."""
    road = road.reshape(len(road), -1)
    forces = np.zeros((len(road), len(truth.linear_model.inputs))) if forces is None else forces
    channels = tuple(Channel(name, np.zeros(len(road)), noise[name] if known else None) for name in signals)
    empty = Experiment("log", step, road, forces, channels, added, from_rest=True)
    exact = LogPrediction(empty, lambda _: truth)({}, {}, None, [0.0] * len(signals), False).values
    random = np.random.default_rng(seed)
    measured = (values + noise[name] * random.standard_normal(len(road)) for name, values in zip(signals, exact.T, strict=True))
    return replace(empty, channels=tuple(replace(one, values=each) for one, each in zip(channels, measured, strict=True)))


def with_values(experiment: Experiment, **values: Array) -> Experiment:
    """Returns an experiment with other values of some signals."""
    channels = (replace(one, values=values.get(one.signal, one.values)) for one in experiment.channels)
    return replace(experiment, channels=tuple(channels))


def identified(
    experiments: Sequence[Experiment], vehicle: Vehicle = CAR, fix: Sequence[str] = (MASS,), free: Sequence[str] = ()
) -> Identification:
    """Returns the identification of a vehicle, whose own values are the first ones."""
    return identify_experiments([LogStretches(tuple(experiments), ())], vehicle, LogMap(), fix, free)


def said(of: Identification) -> str:
    """Returns all statements, with spaces for line ends."""
    return " ".join(one.text for one in statements(of))


def deviations_off(of: Estimate, truth: Mapping[str, float]) -> Array:
    """Returns the error of each free parameter in standard deviations."""
    return np.array([np.log(of.values[name] / truth[name]) / of.deviations[name] for name in of.free])


def problem(experiment: Experiment, vehicle: Vehicle = CAR, fix: Sequence[str] = (MASS,)) -> IdentificationProblem:
    """Returns the problem of one experiment."""
    first = {name: value for name, value in vehicle.parameters.items() if name not in fix}
    return IdentificationProblem(vehicle, changed, first, (experiment,))


def test_intervals_are_those_of_theory():
    """For six sets of sensors, standard deviations of the four ratios are those of the table of Cramer and Rao within 5 %.

    One fit has all three sensors. The information of other sets is computed from the derivatives of the same prediction.
    """
    experiment = log(CAR, (BODY, HUB, TRAVEL), chirp(30, 0.005), step=0.005, known=True)
    of = estimate(problem(experiment, fix=()), tuple(CAR.parameters))
    assert of.structure.held == (MASS,)
    for sensors, expected in CRAMER_RAO.items():
        covariance = of.covariance
        if len(sensors) < 3:
            columns = [of.residuals.channel_columns(of.x, of.noise, 0, experiment.signals.index(one)) for one in sensors]
            J = np.concatenate(columns)[:, : len(of.free)]
            covariance = np.linalg.inv(J.T @ J)
        for powers, percent in zip(RATIOS, expected, strict=True):
            weights = np.array([powers.get(name, 0.0) for name in of.free])
            assert 100 * np.sqrt(weights @ covariance @ weights) == pytest.approx(percent, rel=0.05), (sensors, powers)


@pytest.mark.attack
@pytest.mark.parametrize("seeds", [20, 200])
def test_intervals_cover(seeds):
    """Errors have zero mean, and 95 % intervals cover: both within what so many seeds allow (3 standard deviations)."""
    road, off = chirp(6, phase=1.0), []
    for seed in range(seeds):
        off.append(deviations_off(estimate(problem(log(CAR, (BODY, TRAVEL), road, seed, known=True)), [*CAR.parameters][1:]), P))
    off = np.array(off)
    assert np.abs(off.mean(axis=0)).max() < 3 / np.sqrt(seeds)
    assert np.abs(off.std(axis=0) - 1).max() < 3 / np.sqrt(2 * seeds)
    assert abs((np.abs(off) < 1.96).mean() - 0.95) < 3 * np.sqrt(0.95 * 0.05 / seeds)


P = CAR.parameters


def test_the_scale_is_named():
    """With five free parameters, motion alone gives four products, and the output says what would fix the scale."""
    of = identified([log(CAR, (BODY, TRAVEL), chirp(6))], fix=())
    assert of.estimate.structure.held == (MASS,)
    assert not of.intervals
    assert {name: round(power, 9) for name, power in of.estimate.ratios["tyre_stiffness"].items()} == {
        "tyre_stiffness": 1.0,
        MASS: -1.0,
    }
    assert "motion alone never determines the scale" in said(of)


@pytest.mark.parametrize("by", ["payload", pytest.param("force", marks=pytest.mark.attack)])
def test_a_payload_or_a_force_determines_the_scale(by):
    """A second log with a known payload, or a measured force, determine all five parameters within four standard deviations."""
    road, random = chirp(6), np.random.default_rng(5)
    force = np.asarray(lfilter([0.2], [1, -0.8], 500 * random.standard_normal((len(road), 1)), axis=0))
    experiments = [log(CAR, (BODY, TRAVEL), road, 1, forces=force if by == "force" else None)]
    if by == "payload":
        laden = log(CAR.altered({MASS: P[MASS] + 100}), (BODY, TRAVEL), road, 2)
        experiments.append(replace(laden, added={MASS: 100.0}))
    of = identified(experiments, fix=())
    assert {*of.intervals} == {*P}
    assert np.abs(deviations_off(of.estimate, P)).max() < 4


def test_both_solutions_of_the_mirror_case():
    """With a damped tyre and the body's acceleration alone, the other vehicle that fits is given, with its exact values."""
    values = {
        MASS: 250.0,
        "unsprung_mass": 30.0,
        "suspension_stiffness": 2e4,
        "suspension_damping": 600.0,
        "tyre_stiffness": 2.5e5,
    }
    car = CAR.altered({**values, "tyre_damping": 500.0})
    of = identified([log(car, (BODY,), chirp(10), noise={BODY: 0.005})], car, free=["tyre_damping"])
    share = 250 / 280
    other = {"suspension_stiffness": 2.5e5 * share, "suspension_damping": 500 * share, "tyre_stiffness": 2e4 / share}
    for name, value in other.items():
        assert of.mirror[name] == pytest.approx(value, rel=0.05)  # as noise moves both
    assert "Another vehicle fits equally well" in said(of)


@pytest.mark.parametrize(
    ("signal", "factor", "message"),
    [
        (TRAVEL, 1000, "thousandths of its unit, such as mm"),
        (BODY, 1 / 9.80665, "in g instead of m/s2"),
        (BODY, -1, "is opposite to the sign .* sign = -1"),
    ],
)
def test_wrong_units_and_signs_are_named(signal, factor, message):
    """A column in mm or g, or with the opposite sign, is refused with its name before anything is fitted."""
    right = log(CAR, (BODY, TRAVEL), chirp(6))
    wrong = with_values(right, **{one.signal: factor * one.values for one in right.channels if one.signal == signal})
    with pytest.raises(InputError, match=f"{signal} .*{message}"):
        identified([wrong])


def forced(gain: float, strength: float = 500.0, duration: float = 6.0, seed: int = 1) -> Experiment:
    """Returns a log with a random control force [N], whose column contains the force times a number."""
    road, random = chirp(duration), np.random.default_rng(5)
    force = np.asarray(lfilter([0.2], [1, -0.8], strength * random.standard_normal((len(road), 1)), axis=0))
    return replace(log(CAR, (BODY, TRAVEL), road, seed, forces=force), forces=gain * force)


@pytest.mark.parametrize(
    ("changes", "strength", "message"),
    [
        ({}, 500.0, "is opposite to the sign of this force in the vehicle model"),
        ({"suspension_stiffness": 1.5}, 100.0, "grow so much that the force has no effect"),
    ],
)
def test_a_force_of_the_opposite_sign_is_named(changes, strength, message):
    """A force of the wrong sign is refused: before the fit, or after a fit that makes all masses and stiffnesses infinite."""
    start = CAR.altered({name: factor * P[name] for name, factor in changes.items()})
    with pytest.raises(InputError, match=f"control_force .*{message}.*sign = -1 below .signals.control_force"):
        identified([forced(-1.0, strength, 3.0)], start, fix=())
    assert not identified([forced(1.0, strength, 3.0)], start, fix=()).remarks


def test_a_force_in_another_unit_is_named():
    """A force in kN gives masses in t, and a remark. With a known mass, the factor of the force is a cause of the misfit."""
    of = identified([forced(1e-3, duration=3.0)], fix=())
    assert of.estimate.values[MASS] == pytest.approx(1e-3 * P[MASS], rel=0.05)
    assert "times their first values, in proportion to control_force" in of.remarks[0]
    assert "such as km or kN" in of.remarks[0]
    assert identified([forced(0.9, duration=3.0)]).causes[0].words.startswith("control_force scaled by a factor of 1.1")


@pytest.mark.attack
def test_logs_that_contradict_each_other_are_named():
    """Two logs whose forces differ by a factor of 0.7 give other masses alone, and a remark; equal logs give no remark."""
    logs = [forced(1.0, duration=2.0), replace(forced(0.7, duration=2.0, seed=2), name="second")]
    remark = " ".join(identified(logs, fix=()).remarks)
    assert "the logs contradict each other" in remark
    assert "in second, and" in remark
    assert not identified([logs[0], forced(1.0, duration=2.0, seed=2)], fix=()).remarks


@pytest.mark.attack
def test_an_interval_does_not_end_at_a_limit_of_the_search():
    """If a force is too small to determine the scale, all masses, stiffnesses and dampings are open above."""
    of = identified([forced(1.0, 1e-3)], fix=())
    assert all(one.high is None for one in of.intervals.values())
    assert said(of).count("is not determined in practice: its confidence interval has no lower end or") == len(P)


def test_a_delay_is_named():
    """A sensor that is 20 ms late is named as the first cause of residuals that are not white."""
    right = log(CAR, (BODY, TRAVEL), chirp(3, top=4.0))
    late = with_values(right, **{TRAVEL: np.concatenate([np.zeros(2), right.channels[1].values[:-2]])})
    of = identified([late])
    assert not of.estimate.white
    assert TRAVEL in of.causes[0].words
    assert "later than in the map" in of.causes[0].words


@pytest.mark.attack
def test_a_delay_is_estimated():
    """The delay of a sensor that is 20 ms late is estimated within 1 ms, and residuals are white."""
    right = log(CAR, (BODY, TRAVEL), chirp(6))
    late = with_values(right, **{TRAVEL: np.concatenate([np.zeros(2), right.channels[1].values[:-2]])})
    channels = tuple(replace(one, delay_estimated=one.signal == TRAVEL) for one in late.channels)
    of = identified([replace(late, channels=channels)])
    assert of.estimate.delays[TRAVEL] == pytest.approx(0.02, abs=1e-3)
    assert of.estimate.white


@pytest.mark.attack
def test_robust_intervals_cover_under_coloured_noise():
    """Noise with a correlation of 0.9 from sample to sample fails whiteness, and robust intervals cover in 90 to 98 %."""
    road, off, white = chirp(15), [], 0
    for seed in range(60):
        exact, random = log(CAR, (BODY, TRAVEL), road, noise=dict.fromkeys(NOISE, 0.0)), np.random.default_rng(seed)
        coloured = {
            one.signal: one.values
            + lfilter([NOISE[one.signal] * np.sqrt(1 - 0.9**2)], [1, -0.9], random.standard_normal(len(road)))
            for one in exact.channels
        }
        of = estimate(problem(with_values(exact, **coloured)), [*P][1:])
        off.append(deviations_off(of, P))
        white += of.white
    assert not white
    assert 0.90 < (np.abs(off) < 1.96).mean() < 0.985


FRICTION = """
[parts.rub]
kind = "dahl"
force = 20.0
damping = 0.0
rho = 300.0
"""


@pytest.mark.attack
@pytest.mark.parametrize("seed", range(10))
def test_friction_that_is_left_out_is_found(seed):
    """If friction of 20 N is left out, residuals are not white, and friction is the first cause, within 5 N."""
    car = measurable(parse_vehicle(read_vehicle("quarter_car").text + FRICTION))
    of = identified([log(car, (BODY, HUB, TRAVEL), chirp(8, 0.0025), seed, step=0.0025)])
    assert not of.estimate.white
    words = of.causes[0].words.split()
    assert words[0] == "friction"
    assert float(words[2]) == pytest.approx(20, abs=5)


@pytest.mark.parametrize("seed", [0, *(pytest.param(one, marks=pytest.mark.attack) for one in range(1, 10))])
def test_tyre_damping_that_is_left_out_is_found(seed):
    """If the tyre's damping is left out, residuals are not white, and tyre damping is the cause."""
    of = identified([log(CAR.altered({"tyre_damping": 400.0}), (BODY, HUB, TRAVEL), chirp(8), seed)])
    assert not of.estimate.white
    assert "tyre_damping" in " ".join(one.words for one in of.causes)


@pytest.mark.attack
def test_samples_in_the_air_do_not_count():
    """Samples with the wheel in the air are named, and those that remain give the truth within four standard deviations."""
    high = log(CAR, (BODY, TRAVEL), chirp(8, amplitude=4e-3))
    of = identified([high])
    assert any("in the air" in one for one in of.remarks)
    assert sum(len(one.road) for one in of.estimate.problem.experiments) < len(high.road)
    assert np.abs(deviations_off(of.estimate, P)).max() < 4


def test_an_unknown_road_gives_two_ratios():
    """With the hub's acceleration instead of the road, k_s and c_s over m_s are determined, and no signal feels hub and tyre."""
    whole = log(CAR, (BODY, HUB, TRAVEL), chirp(6, 0.005, top=5.0), step=0.005, noise={BODY: 0.1, HUB: 0.0, TRAVEL: 2e-4})
    hub = whole.channels[1].values[:, None]
    of = identified([replace(whole, road=hub, hubs=True, from_rest=False, channels=whole.channels[::2])], fix=())
    assert {*of.estimate.structure.silent} == {"unsprung_mass", "tyre_stiffness"}
    for name in ("suspension_stiffness", "suspension_damping"):
        value, deviation = of.estimate.combination(of.estimate.ratios[name])
        assert abs(np.log(value / (P[name] / P[MASS]))) < 4 * deviation
        assert deviation < 0.02


@pytest.mark.attack
@pytest.mark.parametrize("name", ["half_car", "full_car"])
def test_other_vehicles(name):
    """The parameters of a half- and of a full car are within four standard deviations of the truth, given its mass."""
    car = measurable(read_vehicle(name))
    signals = [one for one in car.linear_model.outputs if one.startswith((BODY, TRAVEL))]
    road = np.stack([chirp(8, phase=0.9 * i) for i in range(len(car.kind.wheels))], axis=-1)
    noise = {one: 0.05 if one.startswith(BODY) else 2e-4 for one in signals}
    of = identified([log(car, signals, road, noise=noise)], car)
    assert {*of.intervals} == {*of.estimate.free}
    assert len(of.estimate.free) >= 7
    assert np.abs(deviations_off(of.estimate, car.parameters)).max() < 4


def test_a_log_with_faults(tmp_path):
    """Missing cells, a gap and repeated, rounded times: what is wrong is said, and the truth is within four deviations."""
    experiment = log(CAR, (BODY, TRAVEL), chirp(6))
    time = np.round(experiment.time, 2)
    rows = np.column_stack([time, experiment.road, 1e3 * experiment.channels[1].values]).tolist()
    lines = [f"{t:.2f};{road:.7f};{'' if i % 50 == 7 else f'{travel:.4f}'}" for i, (t, road, travel) in enumerate(rows)]
    del lines[400:440]  # a gap of 0.4 s
    lines.insert(300, lines[299])  # a repeated time
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time [s];road_displacement [m];travel [mm]", *lines]).replace(".", ","), encoding="utf-8")
    (tmp_path / "map.toml").write_text(map_text([path], CAR), encoding="utf-8")
    of = identify([path], CAR, tmp_path / "map.toml", [MASS])
    assert any("2 stretches" in one for one in of.remarks)
    assert np.abs(deviations_off(of.estimate, P)).max() < 4


def test_a_first_map(tmp_path):
    """Headings that name a signal become sections, with warnings about units that are missing; others are comments."""
    path = tmp_path / "rig.csv"
    path.write_text(
        "time [s];AccZ [g];Hub acc [m/s2];shock travel;post mm;Temp\n" + "0;0;0;0;0;0\n1;1;1;1;1;1\n", encoding="utf-8"
    )
    text = map_text([path], CAR)
    sections = {line.partition("]")[0][9:] for line in text.splitlines() if line.startswith("[signals.")}
    assert sections == {BODY, HUB, TRAVEL, "road_displacement"}
    assert 'column = "shock travel [m]"  # the heading has no unit: m is assumed; many logs have mm' in text
    assert "# rig.csv, column 6: Temp" in text


def test_plots_that_labview_exported(tmp_path):
    """Each plot has a column of times in s, although its heading ends with the plot's unit; plots at other times are refused."""
    path, car = tmp_path / "rig.csv", log(CAR, (TRAVEL,), chirp(1))
    heading = '"Time - Plate, Road (m)","Amplitude - Plate, Road (m)",Time - shock travel (m),Amplitude - shock travel (m)'
    rows = np.column_stack([car.time, car.road, car.time, car.channels[0].values])
    np.savetxt(path, rows, delimiter=",", header=heading, comments="")
    (tmp_path / "map.toml").write_text(map_text([path], CAR), encoding="utf-8")
    read = read_experiments(path, CAR, read_map(tmp_path / "map.toml", CAR))
    assert not read.remarks
    np.testing.assert_allclose(read.experiments[0].road, car.road, atol=1e-12)
    assert read.experiments[0].step == pytest.approx(car.step)
    rows[:, 2] += 0.005
    np.savetxt(path, rows, delimiter=",", header=heading, comments="")
    with pytest.raises(InputError, match="contain different times"):
        read_experiments(path, CAR, read_map(tmp_path / "map.toml", CAR))


def test_a_log_in_parquet(tmp_path, monkeypatch):
    """A Parquet file is read as the same table in text is; a file that is too large is refused with what to do."""
    columns = {
        "time [s]": [0.0, 0.1, 0.2, 0.3],
        "suspension_deflection [mm]": [1.0, None, 3.0, 4.0],
        "note": ["a", "b", "c", "d"],
    }
    pyarrow.parquet.write_table(pyarrow.table(columns), tmp_path / "log.parquet")
    read = read_measured_log(tmp_path / "log.parquet", {TRAVEL: "m"})
    np.testing.assert_allclose(read.signals[TRAVEL], [1e-3, np.nan, 3e-3, 4e-3])
    np.testing.assert_allclose(read.time, [0.0, 0.1, 0.2, 0.3])
    monkeypatch.setattr("models.common.table.MOST_BYTES", 100)
    with pytest.raises(InputError, match="shorten the record, or resample it"):
        read_measured_log(tmp_path / "log.parquet", {TRAVEL: "m"})


def check_recording(path: Path, acceleration: str, travel: str) -> None:
    """Asserts that a recording has sin(t) g, and 10 t mm at every other time, at the times of the former."""
    read = read_measured_log(path, {BODY: "m/s2", TRAVEL: "m"}, None, {BODY: acceleration, TRAVEL: travel})
    np.testing.assert_allclose(read.time, 0.01 * np.arange(101), atol=1e-9)
    np.testing.assert_allclose(read.signals[BODY], 9.80665 * np.sin(read.time), atol=1e-9)
    np.testing.assert_allclose(read.signals[TRAVEL], 1e-2 * read.time, atol=1e-9)


@pytest.mark.parametrize("own", [True, False])
def test_a_foreign_mcap_file(tmp_path, own):
    """Channels in JSON are columns topic.field, at their own times or at those of the log; other encodings are named."""
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        imu, pot = (writer.register_channel(topic, "json", 0) for topic in ("/body/imu", "/pot"))
        for i in range(101):
            time = {"time": 0.01 * i} if own else {}
            moment = 10**18 + (i if own else i * 10**7)
            message = {**time, "acc": {"z": float(np.sin(0.01 * i))}, "valid": True, "frame": "body"}
            writer.add_message(imu, moment, json.dumps(message).encode(), moment)
            if i % 2 == 0:
                writer.add_message(pot, moment, json.dumps({**time, "travel": 0.1 * i}).encode(), moment)
        writer.finish()
    check_recording(path, "body.imu.acc.z [g]", "pot.travel [mm]")
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_message(writer.register_channel("/imu", "cdr", 0), 1, b"1", 1)
        writer.finish()
    with pytest.raises(InputError, match="channels in cdr cannot be read"):
        read_measured_log(path, {BODY: "m/s2"})


@pytest.mark.extra
def test_an_mdf4_file(tmp_path):
    """Channels of groups with different clocks are columns with their units; a file that is not MDF4 is refused."""
    mdf = pytest.importorskip("asammdf")
    time = 0.01 * np.arange(101)
    with mdf.MDF(version="4.10") as file:
        file.append([mdf.Signal(np.sin(time), time, unit="g", name="AccZ")])
        file.append([mdf.Signal(10 * time[::2], time[::2], unit="mm", name="shock/front")])
        file.save(tmp_path / "log.mf4")
    check_recording(tmp_path / "log.mf4", "AccZ", "shock.front")
    (tmp_path / "no.mf4").write_bytes(b"no MDF4")
    with pytest.raises(InputError, match="not an MDF4 file, or it is damaged"):
        read_measured_log(tmp_path / "no.mf4", {BODY: "m/s2"})


def test_a_controller_on_the_vehicles_that_a_log_allows():
    """The bound of a controller is proved on the estimate and on both ends of each axis of the ellipse, and is largest there."""
    found = identified([log(CAR, (BODY, TRAVEL), chirp(6))])
    [one] = allowed_results(found, ["II_printed"])
    assert one.vehicles == 1 + 2 * len(found.estimate.free)
    assert one.bound is not None
    assert one.worst_bound is not None
    assert one.bound < one.worst_bound < 1.1 * one.bound


DAHL = {"force": 60.0, "rho": 2000.0, "damping": 800.0}
BOUC_WEN = {"alpha": 6e4, "A": 1.0, "beta": 1e6, "gamma": 1e5, "exponent": 2.0, "k0": 500.0, "c0": 800.0}


def on_a_dyno(kind: str, numbers: Mapping[str, float]) -> Vehicle:
    """Returns the car with a part."""
    lines = [f"{key} = {value}" for key, value in numbers.items()]
    return parse_vehicle(read_vehicle("quarter_car").text + "\n".join(["", "[parts.mr]", f'kind = "{kind}"', *lines]))


@pytest.mark.parametrize(("kind", "numbers"), [("dahl", DAHL), ("bouc_wen", BOUC_WEN)])
def test_the_force_of_a_part_over_a_motion(kind, numbers):
    """Its force is that of a solver with error control within 0.3 % of the peak, the error of steps; so are its derivatives."""
    from scipy.integrate import solve_ivp

    car, time = on_a_dyno(kind, numbers), 0.01 * np.arange(150)
    travel = 0.012 * np.sin(2 * np.pi * 1.3 * time)
    one = Experiment("dyno", 0.01, travel[:, None], np.zeros((150, 0)), (Channel(FORCE, time),), from_rest=True, part="mr")
    force = PartPrediction(one, lambda values: changed(car, values))
    d, part = CubicSpline(time, travel), car.elements[0].part
    z = solve_ivp(lambda t, z: part.rate(d(t), d(t, 1), z), (0, time[-1]), [0.0], "LSODA", time, rtol=1e-9, atol=1e-12).y.T
    exact = part.pull(travel, d(time, 1), z)
    sizes = {f"mr.{key}": value for key, value in numbers.items()}
    of = force(sizes, sizes, None, [0.0])
    assert np.abs(of.values[:, 0] - exact).max() < 3e-3 * np.abs(exact).max()
    for i, (name, value) in enumerate(sizes.items()):
        ends = [force({**sizes, name: value * (1 + side * 1e-4)}, {}, None, [0.0], False).values for side in (1, -1)]
        slope = (ends[0] - ends[1]) / (2e-4 * value)
        assert np.abs(of.by_parameter[i] - slope).max() <= 1e-4 * np.abs(slope).max(), name


def test_a_dyno_log_gives_the_numbers_of_a_part(tmp_path):
    """Dahl's numbers are within four standard deviations, and are written to the vehicle file; the car's own are not free.

    Of Bouc and Wen's numbers, the scale of the state is named as not determined.
    """
    car, random = on_a_dyno("dahl", DAHL), np.random.default_rng(3)
    travel = 5 * chirp(4, top=3.0)
    empty = Experiment(
        "dyno", 0.01, travel[:, None], np.zeros((len(travel), 0)), (Channel(FORCE, travel),), from_rest=True, part="mr"
    )
    force = PartPrediction(empty, lambda _: car)({}, {}, None, [0.0], False).values[:, 0] + random.standard_normal(len(travel))
    rows = zip(empty.time, 1e3 * travel, force, strict=True)
    path, log_map = tmp_path / "dyno.csv", tmp_path / "map.toml"
    path.write_text("\n".join(["time [s],x [mm],load cell [N]", *(f"{t:.2f},{x:.9f},{f:.6f}" for t, x, f in rows)]))
    log_map.write_text(f'part = "mr"\n[signals.{EXTENSION}]\ncolumn = "x"\n[signals.{FORCE}]\ncolumn = "load cell"\n')
    first = on_a_dyno("dahl", {name: 1.5 * value for name, value in DAHL.items()})
    of = identify([path], first, log_map)
    assert {*of.intervals} == {f"mr.{name}" for name in DAHL}
    assert of.estimate.white
    assert np.abs(deviations_off(of.estimate, {f"mr.{name}": value for name, value in DAHL.items()})).max() < 4
    again = parse_vehicle(vehicle_text(of, [path])).elements[0]
    assert again.numbers["mr.force"][0] == pytest.approx(60, rel=0.05)
    assert of.estimate.values["mr.rho"] == pytest.approx(again.numbers["mr.rho"][0])
    scale = identify(
        [path], on_a_dyno("bouc_wen", {"alpha": 60.0, "A": 2000.0, "beta": 2000.0, "gamma": 0.0}), log_map, ["mr.exponent"]
    )
    assert scale.estimate.structure.held == ("mr.alpha",)
    assert "motion alone" not in said(scale)


def test_a_log_without_noise_is_no_evidence_against_the_vehicle(tmp_path):
    """A log of `drive` is fitted to 1e-4 of its signals: that is said, the exit code is 0, and parameters are exact to 1e-4."""
    assert drive(["--controller", "passive", "--class", "B", "--duration", "2", "--logs", str(tmp_path)]) == 0
    [path] = tmp_path.glob("*.mcap")
    of = identify([path], read_vehicle("quarter_car"), fix=[MASS])
    assert IdentifyStudy("identify").holds(of)
    assert max(of.estimate.noiseless.values()) < 1e-4
    assert "there is no noise to test" in said(of)
    assert all(of.estimate.values[name] == pytest.approx(P[name], rel=1e-4) for name in of.estimate.free)


def test_a_channel_without_values_is_refused():
    """A channel of NaN alone, or a road with a gap, is one line."""
    right = log(CAR, (BODY, TRAVEL), chirp(2))
    with pytest.raises(InputError, match=f"log: {BODY} contains only NaN, no number; omit"):
        with_values(right, **{BODY: np.full(len(right.road), np.nan)})
    with pytest.raises(InputError, match="height or a force is missing"):
        replace(right, road=np.where(np.arange(len(right.road))[:, None] == 5, np.nan, right.road))


def test_a_log_whose_times_are_too_coarse_for_its_road(tmp_path):
    """Values in mm under a heading in m, times rounded to 0.1 s and a road at 4 Hz: each is one line that says what to do."""
    time = np.sort(np.random.default_rng(2).uniform(0, 12, 120))
    lines = ["t_s,road_displacement_m,d1_m", *(f"{t:.1f},{0.015 * np.sin(25 * t):.6f},{5 * np.cos(25 * t):.5f}" for t in time)]
    path, log_map = tmp_path / "session.csv", tmp_path / "map.toml"
    path.write_text("\n".join(lines))
    head = '[signals.road_displacement]\ncolumn = "road_displacement_m"\n[signals.suspension_deflection]\ncolumn = '
    log_map.write_text(f'{head}"d1_m"\n')
    with pytest.raises(InputError, match=r"moves by .* in mm, write its unit in the map"):
        identify([path], CAR, log_map)
    log_map.write_text(f'{head}"d1_m [mm]"\n')
    with pytest.raises(
        InputError, match=r"rad of phase at the road.s usual frequency of .* so this phase is unknown; export times with more"
    ):
        identify([path], CAR, log_map)


def test_a_fast_hub_does_not_bias_the_suspension():
    """An unknown road with a chirp to 20 Hz, sampled at 200 Hz without noise: both ratios are within 0.1 %."""
    fine = log(CAR, (BODY, HUB, TRAVEL), chirp(6, 0.0005), step=0.0005, noise=dict.fromkeys(NOISE, 1e-6))
    body, hub, travel = (replace(one, values=one.values[::10]) for one in fine.channels)
    driven = replace(fine, step=0.005, road=hub.values[:, None], forces=fine.forces[::10], hubs=True, from_rest=False)
    names = ["suspension_stiffness", "suspension_damping"]
    others = [name for name in P if name not in names]
    of = estimate(problem(replace(driven, channels=(body, travel)), fix=others), names)
    assert all(of.values[name] == pytest.approx(P[name], rel=1e-3) for name in names)
