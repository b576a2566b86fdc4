"""Runs from another state than rest: drops and releases in MuJoCo, in the linear response and in the verdict."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from models.common.errors import InputError
from models.kinds.kind import GRAVITY
from models.roads.obstacles import Flat
from models.roads.road import Bump
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim import run
from sim.campaign.__main__ import main as campaign
from sim.drive.__main__ import main
from sim.inspect.__main__ import main as inspect
from sim.runs.decay import modes_of
from tests.support.commands import answer, attacks, prose

STARTS = {
    "quarter_car": {"suspension_deflection": 0.02, "sprung_velocity": -0.1},
    "half_car": {"suspension_deflection_front": 0.01, "pitch_rate": 0.02},
    "full_car": {"suspension_deflection_rear_left": 0.01, "roll_rate": 0.02, "tyre_deflection_heave": -0.001},
}
MARGIN = 1e-5  # of a peak; RK4's own error at 1 ms is a tenth of it for one wheel, and large angles make the rest


@pytest.mark.parametrize("kind", ["quarter_car", "half_car", *attacks(["full_car"])])
def test_a_release_is_the_matrix_exponential(kind):
    """From a small start every state is exp(A t) x0, for MuJoCo and linear analysis, and the run passes."""
    vehicle = read_vehicle(kind).starting(**{name: 1e-3 * value for name, value in STARTS[kind].items()})
    (one,) = run(vehicle, "passive", Flat(), duration=1.0)
    model, times = vehicle.linear_model, one.physics.time[::100]
    x0 = np.array([vehicle.start.get(name, 0.0) for name in model.states])
    states = np.stack([expm(model.A * t) @ x0 for t in times])
    assert one.passed
    assert math.isinf(one.agreement.until)
    for name, expected in zip(model.states, states.T, strict=True):
        for response in (one.physics, one.sampled, one.continuous):
            assert response[name][::100] == pytest.approx(expected, abs=MARGIN * one.physics.scale(name)), name


@pytest.mark.parametrize(("kind", "controller"), [("quarter_car", "I"), ("half_car", "I"), *attacks([("full_car", "I")])])
def test_starts_add_to_what_the_road_does(kind, controller):
    """Over a bump with a law, MuJoCo follows the sampled response from the start, and the energy balances."""
    (one,) = run(read_vehicle(kind).starting(**STARTS[kind]), controller, Bump(height=0.02), duration=1.0)
    assert one.passed
    assert one.energy is not None
    assert one.energy.balances
    assert max(signal.sampled for signal in one.agreement.signals.values()) < 1e-3  # large angles; measured 1.2e-4


def test_a_dropped_car_falls(paper):
    """In the air the centre of mass falls with g. Linear analysis has ended, and steps and commands are still checked."""
    vehicle = paper.starting(height="80 mm", suspension_deflection=0.03)
    (one,) = run(vehicle, "passive", Flat(), duration=1.0)
    (begin, end), *_ = one.agreement.lift_off
    masses = [vehicle.parameters[name] for name in ("sprung_mass", "unsprung_mass")]
    speed = np.average([one.physics["sprung_velocity"], one.physics["unsprung_velocity"]], axis=0, weights=masses)
    falling = one.physics.time < end
    assert begin == one.agreement.until == 0
    assert speed[falling] == pytest.approx(-GRAVITY * one.physics.time[falling], abs=1e-9)
    assert one.passed
    assert one.agreement.steps is not None
    assert math.isinf(one.agreement.steps.until)


@pytest.mark.parametrize("kind", ["quarter_car", "half_car", *attacks(["full_car"])])
def test_a_free_decay_has_the_modes_of_the_loop(kind):
    """Frequencies and damping ratios of a small release are those of the eigenvalues that it moves, to 1e-4."""
    vehicle = read_vehicle(kind).starting(**{name: 1e-2 * value for name, value in STARTS[kind].items()})
    (one,) = run(vehicle, "passive", Flat(), duration=2.0)
    s = np.linalg.eigvals(vehicle.linear_model.A)
    modes = modes_of(one, one.physics)
    assert len(modes) >= 2
    for mode in modes:
        nearest = s[np.abs(np.abs(s) / (2 * np.pi) - mode.frequency).argmin()]
        assert mode.frequency == pytest.approx(abs(nearest) / (2 * np.pi), rel=1e-4)
        assert mode.damping_ratio == pytest.approx(-nearest.real / abs(nearest), rel=1e-3)
    assert sum(mode.share for mode in modes) == pytest.approx(1.0, abs=0.02)


def test_a_curved_car_starts_where_it_is_told():
    """With curves the response is that of RK4 from the same start, and a semi-active law is checked command by command."""
    vehicle = read_vehicle("quarter_car_semi_active").starting(suspension_deflection=0.03)
    for one in run(vehicle, ["passive", "skyhook"], Flat(), duration=0.5):
        assert one.passed
        assert one.physics["suspension_deflection"][0] == pytest.approx(0.03, abs=1e-12)


def test_commands_take_starts(tmp_path, capsys, monkeypatch):
    """An option, a section of a file and a log give the same run; the decay is printed, and in JSON."""
    monkeypatch.chdir(tmp_path)
    text = read_vehicle("quarter_car").text + "\n[start]\nsuspension_deflection = 0.02\n"
    (tmp_path / "mine.toml").write_text(text)
    command = ["--controller", "passive", "--road", "flat", "--duration", "1"]
    by_file = answer(capsys, main, "--vehicle", "mine.toml", *command, "--no-logs")
    by_option = answer(capsys, main, *command, "--start", "suspension_deflection=20mm", "--logs", "logs")
    assert by_file["runs"] == by_option["runs"]
    slow, fast = by_option["runs"][0]["decay"]["mujoco"]
    assert (slow["frequency"], fast["frequency"]) == pytest.approx((0.79103, 10.40293), rel=1e-4)
    assert inspect([by_option["logs"]["mcap"]]) == 0
    assert "the log still proves what it claims" in capsys.readouterr().out
    assert main([*command, "--no-logs", "--start", "suspension_deflection=20mm"]) == 0
    assert "passive: free decay: 0.791 Hz, damping ratio 0.072; 10.4 Hz, damping ratio 0.050" in prose(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ("suspension=0.1", "--start: unknown state 'suspension'; give one of height, sprung_velocity, suspension_deflection"),
        ("suspension_deflection", "--start suspension_deflection has no value; give STATE=VALUE, as in height=50mm"),
        ("height=3kg", "--start height = '3kg' has the unit 'kg', but a unit of m is expected"),
    ],
)
def test_wrong_starts_are_one_line(start, words):
    """An unknown state, a missing value and a wrong unit are named."""
    with pytest.raises(InputError) as caught:
        main(["--controller", "passive", "--road", "flat", "--no-logs", "--start", start])
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_section_names_its_wrong_key():
    """A start in a file that is no state of the vehicle is refused, with the section."""
    with pytest.raises(InputError, match=r"\[start\]: unknown state 'speed'"):
        parse_vehicle(read_vehicle("quarter_car").text + "\n[start]\nspeed = 1\n")


def test_campaigns_start_as_the_file_says(tmp_path, capsys):
    """Rows of a campaign over a flat road have the release's travel, and their linear twins start alike."""
    text = read_vehicle("quarter_car").text + "\n[start]\nsuspension_deflection = 0.02\n"
    (tmp_path / "mine.toml").write_text(text)
    file = tmp_path / "campaign.toml"
    file.write_text(
        'vehicles = ["mine.toml"]\ncontrollers = ["passive"]\nroads = ["bump:height=0.001"]\nspeeds = [12.5]\nduration = 1.0\n'
    )
    assert campaign([str(file), "--results", str(tmp_path / "out")]) == 0
    capsys.readouterr()
    import pyarrow.parquet as pq

    (row,) = pq.read_table(tmp_path / "out" / "results.parquet").to_pylist()
    assert row["suspension_deflection_peak"] == pytest.approx(0.02, rel=1e-3)
    assert row["linear_error"] < 1e-5
