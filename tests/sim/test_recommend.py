"""Recommendations: designs, ratings, limits and files of single candidates, and whole searches against passive and own laws."""

import dataclasses
import json
import math
import signal
import threading
from typing import Any

import numpy as np
import pytest
from scipy import linalg

from models.common.toml_edit import section_lines
from models.laws.linear import LinearLaw
from models.laws.preview import RoadPreview
from models.roads.choice import choose_road
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.command.study import main as study_command
from sim.runs.run import run_controllers, sample_times
from sim.studies.recommend.bound import least_rms, lower_bound
from sim.studies.recommend.laws import body_sensors, changed_passive, semi_active, skyhook
from sim.studies.recommend.optimal import USUAL, certified, design, searched, uncertified
from sim.studies.recommend.rating import drive_candidates, margins_of, rate_expected
from sim.studies.recommend.recommend import recommendation
from sim.studies.recommend.result import RECORD, RankedContender, Recommendation, save
from sim.studies.recommend.search import families
from sim.studies.recommend.task import Contender, Task
from sim.studies.recommend.within import LIFT_RESERVE, MOST_GAIN, Usage, Within, read_within
from sim.studies.ride.expected import expect
from sim.studies.ride.scores import strokes_used
from synth import GeneralizedPlant, lqg_design
from synth.controller.law_margins import law_margins
from synth.plant.loop import hold_intervals
from synth.vehicle.designer import Designer
from tests.support.commands import refused

VAN = """
type = "quarter_car"
[parameters]
sprung_mass = "900 kg"
unsprung_mass = "65 kg"
suspension_stiffness = "55 kN/m"
tyre_stiffness = "320 kN/m"
[curves]
suspension_damping = { velocity = [-1, 0, 1], force = [-2000, 0, 4000] }
[performance]
sprung_acceleration = { filter = "iso2631_wk" }
suspension_deflection = 0.1
tyre_deflection = 0.2
control_force = 4e-3
[limits]
suspension_stroke = { bump = "85 mm", rebound = "95 mm" }
stop_stiffness = ["100 N/mm", 0, 4e8]
actuator_force = "4 kN"
actuator_bandwidth = "6 Hz"
[implementation]
sample_period = "4 ms"
delay = 1
noise = { suspension_deflection = "0.5 mm", sprung_acceleration = "0.05 m/s2" }
[controllers]
best = { measured = ["sprung_acceleration"], A = [[-1.0]], B = [[1.0]], C = [[-1500.0]], D = [[0.0]] }
"""
MASS = {"A": [[0, 1], [-4, -0.1]], "B": [[0], [1]], "Bw": [[0], [1]]}
OSCILLATOR = MASS | {"C": [[1, 0], [0, 0]], "D": [[0], [0.1]], "Dw": [[0], [0]]}


def task_of(vehicle, speed=25.0, road="iso8608:class=C", **more):
    """Returns the task of a vehicle on a road."""
    return Task(vehicle, choose_road(road).build(vehicle, speed, 0, 16 * speed), **more)


@pytest.fixture(scope="module")
def van():
    """The task of a van on class C at 90 km/h."""
    return task_of(parse_vehicle(VAN))


@pytest.fixture(scope="module")
def rated(van):
    """Candidates of the van with their expected ratings: passive, LQG with usual weights, own skyhook."""
    lqg = design(van, "LQG", van.sensors, {name: USUAL[name] for name in searched(van)})
    own = Designer(van.vehicle, search=False).design("best")
    some = [Contender("passive", van.passive, van.vehicle), Contender("LQG", certified(van, lqg), van.vehicle, "weights")]
    every = [*some, Contender("best (file)", own, van.vehicle, own=True)]
    return {one.name: (one, rate_expected(van, one)) for one in every}


def law_of(*numbers):
    """Returns the law of one state with these numbers."""
    A, B, C, D = (np.array([[one]]) for one in numbers)
    return LinearLaw(A, B, C, D)


def result_of(task, rated, **more) -> Any:
    """Returns a recommendation of candidates that were not driven."""
    rows = [RankedContender(one, rating, False, {}) for one, rating in rated.values()]
    rows.sort(key=lambda row: row.rating.value(task))
    return Recommendation(task, tuple(rows), {}, None, {}, 0.1, **more)


LIMITS = {
    "": Within(),
    "stroke=90%, force": Within(stroke=0.9),
    "gain_margin=12dB,disk=none": Within(gain_margin=10**0.6, disk=None),
    "disk=12dB": Within(disk=2 * (10**0.6 - 1) / (10**0.6 + 1)),
    "off_ground=0.01,gain_margin=3": Within(off_ground=0.01, gain_margin=3.0),
}


@pytest.mark.parametrize(("text", "limits"), LIMITS.items())
def test_limits(text, limits):
    """Limits that are not given keep their defaults."""
    assert dataclasses.astuple(read_within(text)) == pytest.approx(dataclasses.astuple(limits))


@pytest.mark.parametrize("text", ["ride=3", "stroke=2", "stroke=90%,stroke=80%", "stroke=6dB", "force=much"])
def test_wrong_limits(text):
    """Other limits are refused in a line with what to do."""
    with refused("--within", {"ride=3": "known are", "stroke=6dB": "omit unit"}.get(text, "give")):
        read_within(text)


def test_each_limit_counts():
    """Each limit is used by its own share, and a reserve is of stroke and force, and a larger one of the time off the ground."""
    usage = Usage(0.95, 1.0, 2.0, 0.3, 1e-3)
    assert [*Within().used(usage).values()] == pytest.approx([1.0] * 5)
    assert [*Within().used(usage, 0.5).values()] == pytest.approx([2.0, 2.0, 1.0, 1.0, 1 / (1 - LIFT_RESERVE)])
    assert not Within(None, None, None, None, None).used(usage)


def test_usual_lqg_is_better_than_passive(van, rated):
    """Even LQG with the weights at which the search begins has a ride 15 % below that of passive, within the margins."""
    (_, passive), (_, lqg) = rated["passive"], rated["LQG"]
    assert lqg.value(van) < 0.85 * passive.value(van)
    assert lqg.usage.disk > 0.3
    assert passive.usage.force == 0


def test_expected_ride_is_that_of_the_implemented_loop(van, rated):
    """The rating has the expectation of `sim.drive` for the linear twin, to what a coarser step of the road changes."""
    one, rating = rated["LQG"]
    expected: Any = expect(van.line, one.controller, van.spectrum, van.timestep, 10.0)
    assert rating.values["ride"] == pytest.approx(expected.mean["sprung_acceleration_weighted"], rel=5e-3)


def test_margins_are_those_of_other_commands(van, rated):
    """No margin exceeds that of the ideal loop, and a gain at the margin is on the verge of stability."""
    one, _ = rated["LQG"]
    gain, disk = margins_of(van, one.controller)
    assert disk <= (law_margins(van.line, one.controller).disk or 0.0) * (1 + 1e-6)  # the norm's own accuracy
    if gain < MOST_GAIN:
        up, down = (uncertified(van, "x", one.controller.measured, one.controller.law.scaled(1.1 * gain**k)) for k in (1, -1))
        assert margins_of(van, up)[0] == 1.0 or margins_of(van, down)[0] < 1.1 * gain


def test_skyhook_is_the_textbooks(van):
    """On a quarter-car the law is c times the integrated acceleration, and a virtual mass."""
    sensors: Any = body_sensors(van)
    law: Any = skyhook(van, sensors, "skyhook", [math.log(0.5), math.log(2.0), math.log(1.5)], False).controller.law
    by_hand = law_of(-2.0, 1.0, -0.5 * 10 * 900, -0.15 * 900)
    for s in (0.3, 5.0, 60.0):
        assert law.response(s) == pytest.approx(by_hand.response(s), rel=1e-9)


def test_skyhook_damps_each_mode_of_a_car():
    """With sensors of heave and pitch, each force is proportional to the body's velocity over its own suspension."""
    car = task_of(read_vehicle("half_car"), 20.0)
    sensors: Any = body_sensors(car)
    one: Any = skyhook(car, sensors, "skyhook", [0.0, 0.0, 0.0], False).controller
    assert one.measured == ("heave_velocity", "pitch_rate")
    model = car.vehicle.linear_model
    columns = [model.states.index(name) for name in one.measured]
    over = model.rows(["sprung_velocity_front", "sprung_velocity_rear"])[0][:, columns]
    masses = np.array([*car.static_loads.values()]) / 9.81
    assert pytest.approx(-10 * masses[:, None] * over, rel=1e-9) == one.law.D


def test_another_damper_changes_the_curve(van):
    """A factor on the damper acts on a curve, and the passive rating follows it."""
    soft = changed_passive(van, "best damper", [math.log(0.8)])
    assert soft.vehicle.curves["suspension_damping"].force == pytest.approx([-1600, 0, 3200])
    assert "x 0.8" in soft.setting
    other, own = (rate_expected(van, one) for one in (soft, Contender("passive", van.passive, van.vehicle)))
    assert other is not None
    assert own is not None
    assert other.value(van) != own.value(van)


def test_lower_bound_is_below_every_candidate(van, rated):
    """No candidate has a better ride than the bound."""
    bound: Any = lower_bound(van)
    assert 0 < bound < min(rating.value(van) for _, rating in rated.values())


def test_lower_bound_comes_to_the_continuous_one():
    """The bound of a short period is that of continuous LQG with the same noise, and delay raises it."""
    oscillator = GeneralizedPlant(**OSCILLATOR).measured([[0, 1]])
    ideal = lqg_design(oscillator, noise=[0.01]).h2_norm

    def least(period, delay):
        return least_rms(oscillator, hold_intervals(period, delay), [0.01 / math.sqrt(period)])

    assert ideal < least(1e-4, 0) < ideal * (1 + 1e-5)  # the difference is of second order in the period
    assert ideal < least(0.1, 0) < least(0.1, 0.5) < least(0.1, 1) < least(0.1, 2)


@pytest.mark.parametrize("delay", [0, 0.4, 1])
def test_no_gain_is_below_the_lower_bound(delay):
    """Held gains on a sensor without noise have at least the bound, by covariances over small steps; at once, one is near it."""
    plant, period, steps = GeneralizedPlant(**OSCILLATOR).measured([[0, 1]]), 0.5, 100
    parts, rms, unit = hold_intervals(period, delay), list[float](), np.eye(5)
    move: Any
    output: Any
    F = np.block([[plant.A, plant.B], [np.zeros((1, 3))]])
    move, noise = linalg.block_diag(linalg.expm(F * period / steps), np.eye(2)), np.diag([0.0, period / steps, 0.0, 0.0, 0.0])
    output = np.hstack([plant.C, plant.D, np.zeros((2, 2))])
    for gain in np.linspace(-2.0, 0.5, 11):
        # The state is x, the acting force, and the last two that were computed.
        whole, spread, cost, size = np.vstack([unit[:3], gain * unit[1], unit[3]]), np.zeros((5, 5)), 0.0 * unit, 0.0
        for part in parts:
            change = np.vstack([unit[:2], unit[3 + part.delay_samples], unit[3:]])
            whole, spread = change @ whole, change @ spread @ change.T
            for _ in range(round(part.duration / period * steps)):
                whole, spread = move @ whole, move @ spread @ move.T + noise
                cost += whole.T @ output.T @ output @ whole / steps
                size += float(np.trace(output @ spread @ output.T)) / steps
        if np.abs(np.linalg.eigvals(whole)).max() < 1:
            rms.append(math.sqrt(float(np.trace(cost @ linalg.solve_discrete_lyapunov(whole, spread))) + size))
    bound = least_rms(plant, parts, [1e-6])
    assert len(rms) > 3
    assert bound < min(rms)
    assert delay or min(rms) < 1.2 * bound


def test_sensors_are_those_of_the_file(van):
    """Sensors are signals with noise or in controllers, by groups of all corners; a file without any gets travel."""
    assert van.sensors == ("suspension_deflection", "sprung_acceleration")
    half = task_of(read_vehicle("half_car"), 20.0)
    assert [*half.groups] == ["suspension_deflection", "heave_velocity", "pitch_rate"]
    bare = dataclasses.replace(half, vehicle=dataclasses.replace(half.vehicle, controllers={}))
    assert bare.sensors[:2] == ("suspension_deflection_front", "suspension_deflection_rear")
    assert len(bare.assumed) == 2
    assert not van.assumed


def test_families_of_a_task(van):
    """Families with sensors that a file lacks are not searched, and semi-active laws need adjustable dampers."""
    names = [family.name for family, _ in families(van)]
    assert {"best damper", "skyhook", "LQG", "LQG, a", "LQG, b", "H-infinity", "H-inf., 2 states", "H-inf., static"} <= {*names}
    assert "preview" not in names
    assert not semi_active(van)
    adjustable = task_of(read_vehicle("quarter_car_semi_active"), 20.0)
    laws = semi_active(adjustable)
    assert {"skyhook law", "hybrid law", "groundhook law"} <= {one.name for one in laws}
    assert all(not one.pushes for one in laws)
    assert section_lines(("controllers", "best"), laws[0].controller.law.record)[1].startswith("semi_active = ")


def test_saved_controller_is_the_recommended_one(van, rated, tmp_path):
    """The section has a free name, comments and a certificate that holds, and the law that the table rates."""
    result, path = result_of(van, rated), tmp_path / "saved.toml"
    assert result.best is not None
    name = save(path, result)
    assert name == "best_2"  # the file has a controller `best`
    text = path.read_text(encoding="utf-8")
    assert "# Best ride: `LQG`" in text
    again = Designer(read_vehicle(path), search=False).design(name)
    assert not again.false_claims
    for omega in (1.0, 30.0):
        assert again.law.response(omega) == pytest.approx(result.best.candidate.controller.law.response(omega))


def test_saved_file_in_another_folder(van, rated, tmp_path):
    """Numbers of files that the vehicle file names are in the saved file, wherever it is."""
    (tmp_path / "car").mkdir()
    (tmp_path / "car" / "damper.csv").write_text("velocity [m/s],force [N]\n-1,-2000\n0,0\n1,4000\n")
    table = "suspension_damping = { velocity = [-1, 0, 1], force = [-2000, 0, 4000] }"
    (tmp_path / "car" / "van.toml").write_text(VAN.replace(table, 'suspension_damping = { file = "damper.csv" }'))
    own = read_vehicle(tmp_path / "car" / "van.toml")
    save(tmp_path / "saved.toml", result_of(dataclasses.replace(van, vehicle=own), rated))
    assert read_vehicle(tmp_path / "saved.toml").curves["suspension_damping"](np.array([0.5])) == pytest.approx([2000])


def test_next_best_is_saved_for_preview(van, rated, tmp_path):
    """A controller with preview cannot be in a file: the best of the others is written instead."""
    (lqg, rating), ahead = rated["LQG"], dict(rated)
    known = dataclasses.replace(lqg.controller, preview=RoadPreview(0.1, *np.zeros((4, 1, 1))))
    less = {key: value * 0.9 if key == "ride" else value for key, value in rating.values.items()}
    ahead["preview"] = dataclasses.replace(lqg, name="preview", controller=known), dataclasses.replace(rating, values=less)
    result = result_of(van, ahead)
    assert result.best is not None
    assert result.best.candidate.name == "preview"
    save(tmp_path / "saved.toml", result)
    assert "# Best ride: `LQG`" in (tmp_path / "saved.toml").read_text(encoding="utf-8")


def test_text_and_json(van, rated):
    """The table marks the best, the sentence has the change from passive, and JSON has the numbers of the table."""
    result = result_of(van, rated, interrupted=True)
    document, found = result.summary, json.loads(json.dumps(RECORD(result), allow_nan=False))
    row = next(row for row in document.tables[0].rows if row[0] == "LQG")
    assert row[1].endswith("*")
    change = result.best.rating.value(van) / result.passive.rating.value(van) - 1
    assert f"{100 * change:+.0f} % from passive" in document.statements[0].text
    assert "interrupted" in document.statements[-1].text
    assert found["best"] == "LQG"
    assert found["candidates"][0]["values"]["ride"] == pytest.approx(result.best.rating.value(van))


def test_driven_rating_has_strokes_by_side(van, rated):
    """In MuJoCo, travel counts on the side that uses the larger share of its stroke, and a broken run has no values."""
    coarse = dataclasses.replace(van, timestep=4e-3)
    away = uncertified(van, "away", ["sprung_acceleration"], law_of(900.0, 1.0, 1e6, 0.0))
    some = [rated["passive"][0], Contender("away", away, van.vehicle)]
    passive, broken = drive_candidates(coarse, some, lambda text: None, [0])
    [run] = run_controllers(van.vehicle, [van.passive], van.road, sample_times(van.vehicle, 15.0, 4e-3))
    used = strokes_used(van.vehicle, run.physics, round(5.0 / 4e-3))  # the unstable law is waited for as long as any is
    assert passive.usage.stroke == pytest.approx(max(most / stroke for most, stroke in used.values()), rel=1e-9)
    assert broken.usage.gain_margin == 1.0
    assert drive_candidates(coarse, [], lambda text: None) == []


def test_every_tyre_counts():
    """The time off the ground of a car with several wheels is that of its worst tyre."""
    car = task_of(read_vehicle("half_car"), road="iso8608:class=D", timestep=4e-3)
    [passive] = drive_candidates(car, [Contender("passive", car.passive, car.vehicle)], lambda text: None, [0])
    assert 1e-3 < passive.usage.off_ground == passive.values["off_ground"]


def test_command_refuses_bad_options(tmp_path):
    """Bad options are refused before any work."""
    with refused("--class and --road cannot be combined"):
        study_command("recommend", ["--class", "C", "--road", "flat"])
    with refused("--within"):
        study_command("recommend", ["--within", "speed=3"])
    with refused("a vehicle file is TOML"):
        study_command("recommend", ["--save", str(tmp_path / "saved.csv")])


@pytest.mark.attack
def test_the_van(van):
    """The best controller has a ride 7 % below passive within all limits, and keeps them on roads that no search has seen."""
    task = dataclasses.replace(van, effort=0.25)
    result: Any = recommendation(task, lambda text: None)
    best, passive = result.best, result.passive
    assert best.rating.value(van) < 0.93 * passive.rating.value(van)
    assert best.rating.usage.disk >= 0.3
    assert best.rating.usage.stroke <= 0.95
    assert best.proved
    assert best.rating.value(van) > result.bound
    [unseen] = drive_candidates(van, [best.candidate], lambda text: None, range(100, 120))
    assert all(share <= 1.02 for share in van.within.used(unseen.usage).values())


def test_interrupted_search(van, tmp_path):
    """Ctrl-C within a search ends with what it has, also of the family in work, and nothing is driven or saved."""

    def stop(text: str) -> None:
        if "skyhook" in text:
            raise KeyboardInterrupt

    result = recommendation(dataclasses.replace(van, effort=0.02), stop)
    assert result.interrupted
    assert {row.candidate.name for row in result.rows} == {"passive", "best damper", "damper, spring"}
    assert not any(row.driven for row in result.rows)
    with refused("--save has nothing to write"):
        save(tmp_path / "saved.toml", result)


@pytest.mark.attack
def test_interrupted_while_runs_are_driven(van):
    """Ctrl-C while threads drive MuJoCo ends with the candidates so far, and two searches of the same effort have the same."""
    task = dataclasses.replace(van, effort=0.02, timestep=4e-3)

    def stop(text: str) -> None:
        if "simulated" in text:
            threading.Timer(0.3, lambda: signal.raise_signal(signal.SIGINT)).start()

    first, second = (recommendation(task, stop) for _ in range(2))
    assert first.interrupted
    assert {"passive", "skyhook", "LQG", "H-infinity", "best (file)"} <= {row.candidate.name for row in first.rows}
    assert RECORD(first) == RECORD(second)
    assert "the candidates so far" in first.summary.statements[-1].text


@pytest.mark.parametrize(("goal", "road"), [("holding", "bump"), ("travel", "iso8608:class=C")])
def test_goals_and_roads_without_a_spectrum(van, goal, road):
    """Another goal fixes its own weight, and a road without a spectrum is driven whole once, after designs for class C."""
    car = task_of(van.vehicle, road=road, goal=goal)
    weights = {name: USUAL[name] for name in searched(car)}
    assert ("tyre" if goal == "holding" else "travel") not in weights
    one = Contender("LQG", design(car, "LQG", car.sensors, weights), car.vehicle)
    expected = rate_expected(car, one)
    assert expected is not None
    assert expected.value(car) == expected.values["dynamic_load" if goal == "holding" else "peak_travel"]
    if road == "bump":
        assert not car.random
        [driven] = drive_candidates(dataclasses.replace(car, timestep=4e-3), [one], lambda text: None)
        assert 0 < driven.usage.stroke < 2
