"""Designs for the loop that a computer closes: as good as is known, unique, kept in files, driven as designed; refusals."""

import json
import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from models.common.errors import InputError
from models.laws.linear import static_law
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from synth.analysis.norm import hinf_norm
from synth.analysis.sampled_loop import HoldInterval, SampledDataProblem
from synth.analysis.sampled_norm import sampled_norm
from synth.controller.implementation_norm import held_problem, norm_as_implemented
from synth.design.sampled_data import _level, held_design, norm_of, two_steps
from synth.design.two_step import state_path
from synth.lmi.output_feedback import l_matrix, nullspace, r_matrix
from synth.lmi.sdp import solve_lmi
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError, InfeasibleError, TooLargeError
from synth.vehicle.designer import Designer, certify_given
from tests.commands import attacks, in_the_suite, main_of

ASKED = "\n[implementation]\nsample_period = {period}\nsampled = true\ndelay = {delay}\n"
EYE = np.eye(4)
ROWS = {"state": EYE, "I": EYE[[0, 2]], "II": EYE[[2]]}


def asked(name: str = "quarter_car", period: float = 0.01, delay: float = 0, more: str = ""):
    """A vehicle whose designs are for its sampled loop."""
    return parse_vehicle(read_vehicle(name).text + ASKED.format(period=period, delay=delay) + more)


@pytest.mark.parametrize(("name", "best"), attacks([("I", 7.8613), ("state", 7.857), ("II", 7.881)]))
def test_at_ten_milliseconds(name, best):
    """At 10 ms the exact norm of each design is at most the best that was known, and below the level of its LMI."""
    vehicle = asked()
    controller = Designer(vehicle).design(name)
    norm = norm_as_implemented(vehicle, controller)
    assert norm.value <= best
    assert norm.reached == pytest.approx(norm.value, rel=1e-6)  # by an actual road, to the claim's own tolerance
    problem = held_problem(vehicle, Designer(vehicle)._entry(name))
    gain, level = two_steps(problem, 7.8, None)
    assert norm_of(problem, gain, 7.8) <= level * (1 + 1e-8)  # what the limit of a path leaves
    assert norm.value <= level * (1 + 1e-8)
    assert controller.certificate.failures == ()


@pytest.mark.attack
def test_in_the_time_of_sixty_plain_solves(paper):
    """All three designs take less processor time than sixty solves of (22) by cvxpy as it reads."""
    plant = Designer(paper).plant
    solve_lmi(plant, np.zeros((4, 0)), EYE)  # imports cvxpy
    start = time.process_time()
    for _ in range(10):
        solve_lmi(plant, np.zeros((4, 0)), EYE)
    plain = (time.process_time() - start) / 10
    start = time.process_time()
    for rows in ROWS.values():
        held_design(SampledDataProblem(plant, rows, np.zeros((len(rows), 1)), (HoldInterval(0.01, 0),)), 7.8)
    assert time.process_time() - start < 60 * plain


@pytest.mark.parametrize("start", [1e-3, 1.0, 3.9, 300.0])
def test_a_level_where_the_norm_falls_steeply(start):
    """A norm of 2 / level has its level at once, and one that jumps from 3 to 0.01 at 2 is followed there from either side."""

    def found(norm):
        asked = []

        def path(level: Any) -> Any:
            asked.append(level)
            return [SimpleNamespace(gamma=norm(level))]

        posed: Any = SimpleNamespace(at=lambda level: level)
        return *_level(posed, path, start), asked

    level, (point,), asked = found(lambda level: 2 / level)
    assert level == pytest.approx(2, rel=1e-12)  # rounding
    assert point.gamma == pytest.approx(1, abs=1e-9)  # CLOSE
    assert len(asked) <= 2  # the guess of one pair is the level
    level, (point,), _ = found(lambda level: 3.0 if level < 2 else 0.01)
    assert level == pytest.approx(2, rel=2e-9)  # CLOSE
    assert point.gamma < 1


@pytest.mark.parametrize("name", ["I", "II"])
def test_the_second_step_by_another_solver(paper, name):
    """At the level that is reached, the LMI with a slack variable has the optimum 1 by Clarabel, too, in which L is (14)'s."""
    plant, Cy = Designer(paper).plant, ROWS[name]
    units = np.diag([0.77, 0.045, 0.9, 2.9])  # of the states; Clarabel gives up in SI units
    plant = plant.in_coordinates(units).with_inputs(1e4 * np.eye(1))
    problem = SampledDataProblem(plant, Cy @ units, np.zeros((len(Cy), 1)), (HoldInterval(0.01, 0),))
    gain, level = two_steps(problem, 7.8, None)
    _, alone = two_steps(replace(problem, Cy=EYE, through=np.zeros((4, 1))), 7.8, None)
    at_best, held = problem.at(alone), problem.at(level)
    assert at_best is not None
    assert held is not None
    Q = nullspace(problem.Cy)
    R = r_matrix(problem.Cy, Q, l_matrix(state_path(at_best)[-1].X, problem.Cy, Q))
    n, (q, d) = 4, (len(Cy), len(held.C))
    X, eta = cp.Variable((n, n), symmetric=True), cp.Variable()
    W_R, Y_R = cp.Variable((q, q)), cp.Variable((1, q))
    W = Q @ cp.Variable((n - q, n)) + R @ W_R @ R.T
    moved, seen = held.A @ W + held.B @ Y_R @ R.T, held.C @ W + held.D @ Y_R @ R.T
    F = cp.bmat(
        [
            [-X + eta * held.Bw @ held.Bw.T, np.zeros((n, d)), moved],
            [np.zeros((d, n)), -np.eye(d), seen],
            [moved.T, seen.T, X - W - W.T],
        ]
    )
    cp.Problem(cp.Maximize(eta), [F << 0]).solve(solver=cp.CLARABEL)
    assert eta.value == pytest.approx(1, abs=1e-5)  # Clarabel's tolerance
    K = np.asarray(Y_R.value) @ np.linalg.inv(np.asarray(W_R.value, dtype=float))
    # Two points of the optimal face: their gains differ, and neither is far.
    np.testing.assert_allclose(gain, K, rtol=0.02)


@pytest.mark.attack
@pytest.mark.parametrize("name", in_the_suite(("II",), ROWS))
def test_no_unit_decides(paper, name):
    """In other units of states, force and time the gain of the two steps is the same, and so is the norm of the design."""
    plant, Cy, rate = Designer(paper).plant, ROWS[name], 10.0
    states, force = np.diag([3.0, 0.2, 7.0, 50.0]), 1234.0
    scaled = plant.in_coordinates(states).with_inputs(force * np.eye(1))
    slower = replace(scaled, A=scaled.A / rate, B=scaled.B / rate, Bw=scaled.Bw / rate)
    one = SampledDataProblem(plant, Cy, np.zeros((len(Cy), 1)), (HoldInterval(0.01, 0),))
    other = SampledDataProblem(slower, Cy @ states, np.zeros((len(Cy), 1)), (HoldInterval(0.01 * rate, 0),))
    # Time in tenths of seconds: w and z in the new unit of it have a gain that is sqrt and sqrt of it, so the same.
    # The last descent gains less than 1e-5, and the two steps stay where descents gain less than 5e-5.
    assert held_design(other, 8.5).norm == pytest.approx(held_design(one, 7.8).norm, rel=6e-5)
    (gain, level), (scaled_gain, scaled_level) = two_steps(one, 7.8, None), two_steps(other, 8.5, None)
    assert scaled_level == pytest.approx(level, rel=1e-6)
    # The path ends 3e-6 of the largest entry short of its limit; what is flat there moves more.
    assert np.abs(force * scaled_gain - gain).max() < 1e-3 * np.abs(gain).max()


@pytest.mark.parametrize(("name", "period"), attacks([("I", 0.02), ("state", 0.05), ("II", 0.05)]))
def test_better_than_the_continuous_design(paper, name, period):
    """As it runs, what is designed for the sampled loop gains less than what is designed for the ideal one."""
    vehicle = asked(period=period)
    ideal = Designer(replace(paper, implementation=vehicle.implementation)).design(name)
    designed = Designer(vehicle).design(name)
    assert norm_as_implemented(vehicle, designed).value < norm_as_implemented(vehicle, ideal).value
    assert "designed for the sampled loop" in designed.remarks[0]


def test_tends_to_the_continuous_design(paper):
    """At 10 kHz state feedback is that of (22), a thousandth away, and its norm that of the continuous loop to 1e-6."""
    vehicle = asked(period=1e-4)
    designed, ideal = Designer(vehicle).design("state"), Designer(paper).design("state")
    np.testing.assert_allclose(designed.gain, ideal.gain, rtol=1e-2)  # first order in the period: 9e-3 of the second entry
    assert norm_as_implemented(vehicle, designed, 1e-4).value == pytest.approx(ideal.certificate.norm.value, rel=1e-6)


LAG = "[limits]\nactuator_bandwidth = 200.0\n"
FELT = '[controllers.felt]\nmeasured = ["suspension_deflection", "sprung_acceleration"]\n'


@pytest.mark.attack
@pytest.mark.parametrize(
    ("name", "delay", "more", "controllers"),
    [
        pytest.param("quarter_car", 1, "", ("I",), marks=pytest.mark.attack),
        pytest.param("quarter_car", 2, LAG, ("state",), marks=pytest.mark.attack),
        ("quarter_car", 0, FELT, ("felt",)),
        pytest.param("quarter_car", 1, FELT, ("felt",), marks=pytest.mark.attack),
        pytest.param("quarter_car", 2, LAG, ("II",), marks=pytest.mark.attack),
        pytest.param("quarter_car", 0, LAG, ("I",), marks=pytest.mark.attack),
        pytest.param("half_car", 0, "", ("I",), marks=pytest.mark.attack),
    ],
)
def test_the_loop_as_built_is_that_designed_for(name, delay, more, controllers):
    """With delay, lag and accelerometers the norm that was designed is the one of the loop as built, put together elsewhere."""
    vehicle = asked(name, delay=delay, more=more)
    designer = Designer(vehicle)
    for each in controllers:
        problem, controller = held_problem(vehicle, designer._entry(each)), designer.design(each)
        norm = sampled_norm(problem.loop(controller.law.D), 7.8).value
        plant = problem.at(norm)
        assert plant is not None
        # The plant of the level that is the norm closes to a norm of one: what is remembered stands where it is read.
        assert hinf_norm(plant.closed_loop(controller.law.D @ problem.rows)).value == pytest.approx(1, rel=1e-6)
        assert norm_as_implemented(vehicle, controller).value == pytest.approx(norm, rel=1e-7)  # a norm's levels lie that close
        found = held_design(problem, 7.8)
        assert norm <= found.norm * (1 + 1e-7)
        assert found.level is None or found.norm <= found.level * (1 + 1e-7)


@pytest.mark.attack
def test_a_filter_in_z():
    """With a filter in z, whose states nothing measures, state feedback is designed from the vehicle's own states."""
    text = read_vehicle("quarter_car").text.replace(
        "sprung_acceleration = 1.0", "sprung_acceleration = { numerator = [1.0, 2.0], denominator = [1.0, 20.0] }"
    )
    vehicle = parse_vehicle(text + ASKED.format(period=0.01, delay=0))
    problem = held_problem(vehicle, Designer(vehicle)._entry("state"))
    found = held_design(problem, 7.8)
    assert found.gain.shape == (1, 4)
    assert sampled_norm(problem.loop(found.gain), 7.8).value == pytest.approx(found.norm, rel=1e-9)


BRIEF = ["--duration", "0.2", "--no-logs", "--json"]


def test_what_is_printed_saved_and_driven(tmp_path, capsys):
    """The table and --json have the design's sampled norm; saved, it is checked and read as the gain that it is."""
    file, saved = tmp_path / "car.toml", tmp_path / "saved.toml"
    file.write_text(asked().text, encoding="utf-8")
    options = ["--vehicle", str(file), "--controller", "I"]
    assert main_of("synth")([*options, "--json", "--save", str(saved)]) == 0
    (row,) = json.loads(capsys.readouterr().out)["controllers"]
    assert row["design"] == "sampled"
    assert row["sampled_norm"] <= 7.8613
    assert main_of("synth")([*options, "-v"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert f"{row['sampled_norm']:.7g}" in printed
    assert "by descent on the sampled norm, for they come to 7.861089, and descent from them to 7.857" in printed
    share = f"{100 * row['sampled_gap']:.2g} % above {row['sampled_lower_bound']:.7g}, which no controller with these"
    assert f"sampled norm {share} measurements beats at this rate" in printed
    assert main_of("synth")(["--check", str(saved), "--json"]) == 0
    capsys.readouterr()
    assert main_of("sim.bump")(["--vehicle", str(saved), "--controller", "I", "--controller", "I_designed", *BRIEF]) == 0
    designed, read = json.loads(capsys.readouterr().out)["runs"]
    kept = read_vehicle(saved).controllers["I_designed"].law
    assert kept is not None
    assert kept.D.tolist() == row["gain"]
    assert designed["signals"] == read["signals"]


def test_refused_where_it_is_done(tmp_path, capsys):
    """L = 0 of such a design is refused in one line, and so is a vehicle that lost its period."""
    vehicle = asked()
    designer = Designer(vehicle)
    with pytest.raises(InputError, match="sampled = true with --zero-l: there is no L"):
        designer.design("I", zero_l=True)
    lost = replace(vehicle, implementation=replace(vehicle.implementation, sample_period=None))
    with pytest.raises(InputError, match=r"\[implementation\] gives no sample period"):
        Designer(lost).design("I")


@pytest.mark.attack
def test_one_section_alone():
    """A section may ask for itself, and may leave out what [implementation] asks of all."""
    text = read_vehicle("quarter_car").text
    one = text.replace("[controllers.I]", "[controllers.I]\nsampled = true") + "\n[implementation]\nsample_period = 0.01\n"
    all_but = text.replace("[controllers.I]", "[controllers.I]\nsampled = false") + ASKED.format(period=0.01, delay=0)
    for whole, expected in ((one, {"I"}), (all_but, {"II", "state"})):
        designer = Designer(parse_vehicle(whole))
        assert {name for name in ROWS if designer.design(name).sampled} == expected


def test_what_no_gain_stabilises():
    """If no gain is found without proof that there is none, that is no InfeasibleError; what to do comes first."""
    A, B, C = np.array([[0.0, 1], [4, 0]]), np.array([[0.0], [1]]), np.vstack([np.eye(2), np.zeros((1, 2))])
    plant = GeneralizedPlant(A, B, B, C, np.array([[0.0], [0], [1]]), np.zeros((3, 1)))
    with pytest.raises(DesignError, match=r"^no static gain found; measure more signals, .*; the two steps: .*\(25\)") as caught:
        held_design(SampledDataProblem(plant, np.array([[1.0, 0]]), np.zeros((1, 1)), (HoldInterval(0.1, 0),)), 2.0)
    assert not isinstance(caught.value, InfeasibleError)
    assert "\n" not in str(caught.value)


def test_the_exact_norm_decides(paper):
    """A gain next to the designed one has another exact norm than the level says: the norm is of the gain itself."""
    problem = SampledDataProblem(Designer(paper).plant, ROWS["II"], np.zeros((1, 1)), (HoldInterval(0.01, 0),))
    found = held_design(problem, 7.8)
    assert sampled_norm(problem.loop(found.gain), 7.8).value == pytest.approx(found.norm, rel=1e-9)
    assert sampled_norm(problem.loop(0.5 * found.gain), 7.8).value > found.norm * 1.001


@pytest.mark.parametrize("delay", [0.25, 1.5])
@pytest.mark.parametrize("measured", ["sprung_velocity", "sprung_acceleration"])
def test_a_fraction_of_a_sample_is_designed_for(paper, delay, measured):
    """A level's discrete plant is below 1 just where the loop's own norm is below the level, a force in what is read or not."""
    how = f"\n[implementation]\nsample_period = 0.02\ndelay = {delay}\n"
    vehicle = parse_vehicle(f'{paper.text}{how}[controllers.mine]\nmeasured = ["{measured}"]\nsampled = true\n')
    problem = held_problem(vehicle, vehicle.controllers["mine"])
    K = np.array([[-2000.0 if measured == "sprung_velocity" else -40.0]])
    norm = sampled_norm(problem.loop(K), 8.0)
    assert norm.stable
    assert norm.value == pytest.approx(
        norm_as_implemented(vehicle, certify_given(vehicle, "given", (measured,), static_law(K))).value, rel=1e-7
    )
    for level in (norm.value * 0.999, norm.value * 1.001):
        plant = problem.at(level)
        assert plant is not None
        assert (hinf_norm(plant.closed_loop(K @ problem.rows)).value < 1) == (level > norm.value)


BUILT = [(0.001, 0), (0.001, 1), (0.02, 5), (0.2, 0), (0.5, 0), (0.5, 2.5), (1.0, 1)]
CARS = [("quarter_car", name, *built) for name, every in (("I", 1), ("II", 2)) for built in BUILT[every - 1 :: every]]
CARS += [("quarter_car", "state", 0.5, 1)]
CARS += [("half_car", "I", 0.2, 0), ("half_car", "II", 0.001, 0)]
# By two steps and by descent, at once and late.
SOME = [("quarter_car", "I", 0.5, 0)]


def never_worse(name: str, controller: str, period: float, delay: float) -> None:
    """A design for a sampled loop gains no more than the continuous design there, and than no control."""
    vehicle = asked(name, period, delay)
    designer = Designer(replace(read_vehicle(name), implementation=vehicle.implementation))
    ideal, built = designer.design(controller), Designer(vehicle).design(controller)
    assert built.sampled
    reached = norm_as_implemented(vehicle, built).value
    others = [norm_as_implemented(vehicle, ideal).value, norm_as_implemented(vehicle, designer.design("passive")).value]
    assert reached <= min(others) * (1 + 2e-7)  # how near a level counts as reached, and the rounding of two norms
    assert built.fallback_method.startswith("not by the two steps but by descent") == ("promises" not in built.remarks[0])


@pytest.mark.parametrize(("name", "controller", "period", "delay"), in_the_suite(SOME, CARS))
def test_never_worse_than_what_is_there(name, controller, period, delay):
    """The claim of `never_worse`, at fast rates and slow ones, at once and late."""
    never_worse(name, controller, period, delay)


@pytest.mark.attack
@pytest.mark.parametrize(("controller", "period"), [("II", 0.2)])
def test_never_worse_of_a_full_car(controller, period):
    """The same of a full car."""
    never_worse("full_car", controller, period, 0)


@pytest.mark.attack
@pytest.mark.parametrize("seed", range(3))
def test_never_worse_wherever(seed):
    """The same at random rates and delays, of fractions too."""
    rng = np.random.default_rng(seed)
    delay = (0, int(rng.integers(1, 4)), round(rng.uniform(0, 3), 2))[rng.integers(3)]
    never_worse(str(rng.choice(["quarter_car", "half_car"])), str(rng.choice(list(ROWS))), 10 ** rng.uniform(-3, 0), delay)


@pytest.mark.attack
@pytest.mark.parametrize(
    ("period", "delay", "known"),
    [
        (0.5, 0, 29.76),
        (0.2, 0, 8.508),
        (0.1, 1, 10.48),
        (0.5, 1, 20.83),
    ],
)
def test_descent_finds_the_valley(paper, period, delay, known):
    """For one gain the least norm is known by trying every gain: the descent of II finds that valley, whichever side of zero."""
    problem = SampledDataProblem(Designer(paper).plant, ROWS["II"], np.zeros((1, 1)), (HoldInterval(period, delay),))
    found = held_design(problem, 7.8, [Designer(paper).design("II").law.D])
    tried = [norm_of(problem, np.array([[sign * k]]), 8.0) for sign in (-1, 1) for k in np.geomspace(50, 1e4, 12)]
    assert found.norm <= known
    assert found.norm <= min(tried) * (1 + 1e-4)  # flat valleys: a descent that gains less than that is the last


@pytest.mark.attack
def test_long_delays():
    """For many samples of delay the design is by descent, in words that are true, and of too many it is refused, at once."""
    found = Designer(asked(period=0.001, delay=30)).design("II")
    assert (
        "the LMI problem has 630 unknowns, and the two steps of a sampled loop are gone with at most 260" in found.fallback_method
    )
    assert "force more" not in found.fallback_method
    start = time.process_time()
    with pytest.raises(TooLargeError, match=r"forces of 50 samples on their way make it 108 states") as caught:
        Designer(asked("half_car", period=0.001, delay=50)).design("II")
    assert time.process_time() - start < 5  # a second or so; before it was minutes
    assert "\n" not in str(caught.value)
