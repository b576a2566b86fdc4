"""Warnings about laws, and controllers that cannot be designed: each is named in a line, and hides nothing else."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from models.roads.road import Bump
from models.vehicle.limits_and_implementation import Limits
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.bump import main as bump
from sim.drive.__main__ import main as drive
from sim.runs.report import reasons, verdict
from sim.runs.run import run_controllers, sample_times
from synth import design_controllers
from synth.__main__ import main as synth
from synth.controller.disk_margin import disk_margin
from synth.controller.law_margins import law_margins
from synth.controller.stability_margins import gain_crossings
from tests.support.analysed import cut_loop
from tests.support.commands import main_of, prose, refused
from tests.synth.test_windup import FAST, SLOW, limited, section, semi_active

CORNER = """type = "quarter_car"

[parameters]
sprung_mass = 380.0
unsprung_mass = 42.0
suspension_stiffness = 22000.0
suspension_damping = 1500.0
tyre_stiffness = 190000.0

[performance]
sprung_acceleration = 1.0
suspension_deflection = 5.0
tyre_deflection = 300.0
control_force = 1e-4

[limits]
actuator_force = 300.0
actuator_bandwidth = 50.3

[implementation]
sample_period = 0.005
noise = { suspension_deflection = 0.0005, sprung_acceleration = 0.05 }
"""
MEASURED = 'measured = ["suspension_deflection", "sprung_acceleration"]\n'
Q = f'\n[controllers.q]\n{MEASURED}design = "lqg"\n'  # its law on these readings has a pole at +21920 1/s
FULL = f'\n[controllers.full]\n{MEASURED}order = "full"\nnoise = true\nsampled = true\nlag = true\n'
NO_LOOP = f"\n[controllers.loop]\n{MEASURED}gain = [[0.0, 380.0]]\n"  # the acceleration has 1 / 380 of the force in it
TOO_FAST = "which is too fast for a sample period of 0.005 s; give a shorter sample period, or, if the law measures acc"


@pytest.fixture
def corner(tmp_path):
    """A function that writes a vehicle file with some controllers, and returns its path."""

    def written(*sections, **parameters):
        text = CORNER
        for name, value in parameters.items():
            text = text.replace(f"{name} = 1500.0", f"{name} = {value}")
        path = tmp_path / "corner.toml"
        path.write_text(text + "".join(sections))
        return str(path)

    return written


def test_a_law_that_no_computer_runs_hides_no_other(corner, capsys):
    """An LQG law too fast for the sample period has the row of its ideal loop and a reason; others have theirs, exit code 1."""
    car = corner(Q)
    assert synth(["--vehicle", car, "--controller", "passive", "--controller", "q"]) == 1
    out = capsys.readouterr().out
    assert f"q FAILS: the law has an unstable pole at +2.192e+04 1/s, {TOO_FAST}" in prose(out)
    assert [line.split()[0] for line in out.splitlines() if line.startswith(("passive ", "q "))] == ["q", "passive", "q"]
    assert prose(out).endswith("not every claim holds: q FAILS; control law UNSTABLE by itself: q")


def test_a_controller_that_is_left_out_is_named(corner, capsys):
    """A run of several controllers leaves out one that has no loop, says so on stderr, and its exit code is 1."""
    arguments = ["--vehicle", corner(NO_LOOP), "--controller", "passive", "--controller", "loop"]
    road = ["--duration", "0.2", "--no-logs"]
    assert bump([*arguments, *road, "--json"]) == 1
    printed = capsys.readouterr()
    result = json.loads(printed.out)
    assert [one["controller"]["name"] for one in result["runs"]] == ["passive"]
    assert result["left_out"] == ["loop"]
    (line,) = printed.err.splitlines()
    assert line.startswith("roadproof: controller 'loop' is not simulated: ")
    assert synth(arguments) == 1
    out = prose(capsys.readouterr().out)
    assert "loop NOT DESIGNED: " in out
    assert "not every claim holds: loop is not designed" in out
    for command, options in ((bump, road), (synth, [])):  # alone it is bad input
        with refused("I - D_c D is singular"):
            command(["--vehicle", arguments[1], "--controller", "loop", *options])


@pytest.mark.attack
@pytest.mark.parametrize(
    ("command", "options"), [("sim.drive", ["--duration", "0.2", "--no-logs"]), ("sim.sweep", []), ("sim.report", ["--quick"])]
)
def test_every_command_leaves_out_such_a_controller(command, options, corner, tmp_path, monkeypatch, capsys):
    """Every other command of several controllers leaves it out likewise, names it, and its exit code is 1."""
    monkeypatch.chdir(tmp_path)
    names = ["--controller", "passive", "--controller", "loop"]
    assert main_of(command)(["--vehicle", corner(NO_LOOP), *names, *options, "--timestep", "5e-3", "--json"]) == 1
    printed = capsys.readouterr()
    assert json.loads(printed.out)["left_out"] == ["loop"]
    assert "controller 'loop' is not simulated: " in printed.err


LAWS = {
    "state": read_vehicle("quarter_car"),
    "I": read_vehicle("half_car"),
    "accelerometer": read_vehicle("quarter_car_accelerometer"),
}


@pytest.mark.parametrize("name", LAWS)
def test_margins_are_those_of_the_ideal_loop(name):
    """Gain and disk margin are those that `sim.margins` predicts for the ideal loop, whatever the limits of the file."""
    vehicle = LAWS[name]
    (controller,) = design_controllers(vehicle, [name])
    loop = cut_loop(vehicle, controller)
    found = law_margins(replace(vehicle, limits=Limits(actuator_bandwidth=30.0)), controller)
    factors = gain_crossings(loop)
    assert found.gain == pytest.approx(min(each for each in factors if each > 1), rel=1e-8)  # bisected to 1e-9
    assert found.gain_lower == max((each for each in factors if 0.5 < each < 1), default=0.0)
    assert found.disk == disk_margin(loop).size
    assert 1 < found.gain < 2
    assert not found.instability


def test_published_gains_have_small_margins(capsys):
    """The paper's `state` and I are named with gain margins of 1.11 and 1.21, in dB and degrees, too, and II is not."""
    assert synth([]) == 0
    out = capsys.readouterr().out
    pairs = "state, state_printed 1.11 (0.9 dB)/0.10 (5.93°); I, I_printed 1.21 (1.66 dB)/0.19 (10.9°) Limit"
    assert f"margins of the ideal loop (gain/disk): {pairs}" in prose(out)
    assert bump(["--controller", "I", "--duration", "0.5", "--no-logs"]) == 0
    assert "\nI: gain margin 1.21 (1.66 dB), disk margin 0.19 (10.9°)\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("vehicle", "winds_up"),
    [
        (limited(SLOW, Limits(actuator_force=3000.0)), "at 3 kN"),
        (semi_active(SLOW), "at the limits of the semi-active dampers"),
        (limited(SLOW, Limits()), ""),
        (
            parse_vehicle(limited(SLOW, Limits()).text + "anti_windup = 40.0\n[limits]\nactuator_force = 50.0\n", source="kept"),
            "",
        ),
    ],
)
def test_what_winds_up(vehicle, winds_up):
    """A law winds up if it is unstable by itself and clipped without anti-windup; an integrator or a stable law does not."""
    (controller,) = design_controllers(vehicle, [f"law_{SLOW:g}"])
    found = law_margins(vehicle, controller)
    assert found.winds_up == winds_up
    assert found.instability == f"unstable by itself (+30 1/s){f', winds up {winds_up}' if winds_up else ''}"
    assert found.record["winds_up"] == bool(winds_up)
    for rate in (0.0, -1.0):
        stable = replace(controller, law=replace(controller.law, A=np.array([[rate]])))
        assert not law_margins(vehicle, stable).winds_up


SOFT = """
[controllers.soft]
measured = ["sprung_velocity"]
gain = [[-3000.0]]
"""


def test_an_unsound_law_is_never_the_best(tmp_path, capsys):
    """A law that is unstable by itself and has the least force gets no star; the legend names it."""
    path, weak = tmp_path / "mine.toml", section(SLOW).replace("1e4", "1e-6")  # as if it had no state, for half a second
    path.write_text(read_vehicle("quarter_car").text + SOFT + weak + "[limits]\nactuator_force = 3000.0\n")
    arguments = ["--vehicle", str(path), *(f"--controller={name}" for name in ("II", "soft", "mine")), "--no-logs"]
    arguments += ["--duration", "0.5"]
    bump([*arguments, "--json"])
    result = json.loads(capsys.readouterr().out)
    forces = {one["controller"]: one["force_peak"] for one in result["compared"]["controllers"]}
    assert min((name for name in forces if name != "passive"), key=lambda name: forces[name]) == "mine"
    assert result["compared"]["best"]["force_peak"] == ["soft"]
    assert not any("mine" in names for names in result["compared"]["best"].values())
    assert [run["margins"]["winds_up"] for run in result["runs"]] == [False, False, True]
    bump(arguments)
    out = prose(capsys.readouterr().out)
    assert "mine: unstable by itself (+30 1/s), winds up at 3 kN" in out
    assert "*: best without mine (unstable by itself);" in out


def test_an_overflow_is_not_blamed_on_the_physics():
    """Where a law overflows and a step or the energy is off, the verdict names the law, and no sentence accuses the physics."""
    vehicle = semi_active(FAST)
    (controller,) = design_controllers(vehicle, [f"law_{FAST:g}"])
    (run,) = run_controllers(vehicle, [controller], Bump(height=0.02), sample_times(vehicle, 0.6, 1e-3))
    assert run.physics.law_diverged
    assert run.passed
    said = f"no linear analysis; energy balances; law overflow at {run.diverged:.4g} s"
    assert verdict(run).text == f"MuJoCo agrees with the model; {said}"
    assert run.energy is not None
    steps = run.agreement.steps
    assert steps is not None
    off = replace(run, energy=replace(run.energy, residual=1.0))
    late = replace(off, agreement=replace(off.agreement, steps=replace(steps, error=1.0)))
    for one in (off, late):
        said = " ".join([verdict(one).text, *(one.text for one in reasons(one))])
        assert verdict(one).text.startswith(f"LAW OVERFLOW at {run.diverged:.4g} s: ")
        assert "DOES NOT" not in said
        assert "the vehicle does not have" not in said
        assert "energy is not evaluated" in said


@pytest.mark.attack
def test_a_full_order_law_that_winds_up(corner, capsys):
    """A sampled full-order law that is unstable by itself is named by design and drive, and its overflow is its own."""
    car = corner(FULL)
    assert synth(["--vehicle", car, "--controller", "full"]) == 0
    out = prose(capsys.readouterr().out)
    assert "Control laws that are unstable by themselves, winding up at 300 N: full (+" in out
    assert out.endswith("; control law UNSTABLE by itself: full")
    drive(["--vehicle", car, "--controller", "full", "--class", "E", "--speed", "25", "--duration", "12", "--no-logs"])
    out = prose(capsys.readouterr().out)
    assert "full: unstable by itself (+" in out
    assert "law overflow" in out.lower()
    assert "the vehicle does not have" not in out


def test_a_vehicle_without_damping_is_no_failure(corner, capsys):
    """A passive vehicle without damping has its natural frequencies in a line, and the exit code is 0."""
    car = corner(suspension_damping=0.0)
    M, K = np.diag([380.0, 42.0]), np.array([[22000.0, -22000.0], [-22000.0, 212000.0]])
    slow, fast = np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K))[[0, 1]]) / (2 * math.pi)
    slow, fast = sorted((slow, fast))
    assert synth(["--vehicle", car, "--controller", "passive"]) == 0
    out = prose(capsys.readouterr().out)
    assert f"passive: undamped without control; natural frequencies {slow:.3g} Hz, {fast:.3g} Hz" in out
    assert out.endswith("every claim holds for 1 controller")
    assert synth(["--vehicle", car, "--controller", "passive", "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["controllers"]
    assert (row["stability"], row["failures"]) == ("marginal", [])


FEELS = {  # measurements, gain [N s2/m], and factor from sample to sample, for 1 / m_s and -1 / m_u of the force in them
    "body": ('["sprung_acceleration"]', "[[-600.0]]", 600 / 504.5),
    "inerter80": ('["sprung_acceleration", "unsprung_acceleration"]', "[[-80.0, 80.0]]", 80 / 504.5 + 80 / 62),
    "inerter30": ('["sprung_acceleration", "unsprung_acceleration"]', "[[-30.0, 30.0]]", 30 / 504.5 + 30 / 62),
    "near": ('["sprung_acceleration"]', "[[480.0]]", 480 / 504.5),
}


@pytest.mark.parametrize("name", FEELS)
def test_a_force_in_its_own_measurements(paper, tmp_path, capsys, name):
    """From a factor of 1 on, synth warns, a run grows for this reason, and margins are refused, all with the factor.

    Below 1 only a positive share of the force is close to instability. A passive inerter never is, ideally.
    """
    measured, gain, factor = FEELS[name]
    path = tmp_path / "car.toml"
    path.write_text(f"{paper.text}\n[controllers.{name}]\nmeasured = {measured}\ngain = {gain}\n")
    options = ["--vehicle", str(path), "--controller", name]
    vehicle = read_vehicle(path)
    (controller,) = design_controllers(vehicle, [name])
    assert law_margins(vehicle, controller).direct_feedback == pytest.approx(factor, rel=1e-12)
    assert synth(options) == 0
    out, times = prose(capsys.readouterr().out), f"{factor:.4g} times"
    assert (f"WARNING: measurements contain the law's own force at once: {name} {times}" in out) == (factor >= 1)
    assert ("Small stability margins" in out) == (not name.startswith("inerter"))
    assert ("1.051 (0.432 dB)" in out) == (name == "near")
    assert drive([*options, "--class", "C", "--duration", "0.2", "--no-logs"]) == (factor >= 1)
    out = prose(capsys.readouterr().out)
    assert (f"the measurements contain {times} the law's own force at once" in out) == (factor >= 1)
    assert ("every step, by direct feedback of its own force" in out) == ("UNSTABLE loop" in out) == (factor >= 1)
    if factor >= 1:
        with refused(f"returns in its measurements {times} as large"):
            main_of("sim.margins")(options)
