"""Designs for the loop that a computer closes: as good as is known, and next to the lower bound."""

import json
import time
from dataclasses import replace

import numpy as np
import pytest

from models.common.errors import InputError
from models.laws.linear import static_law
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from synth.analysis.norm import hinf_norm
from synth.analysis.sampled_loop import HoldInterval, SampledDataProblem
from synth.analysis.sampled_norm import sampled_norm
from synth.controller.implementation_norm import held_problem, norm_as_implemented
from synth.design.methods import design
from synth.design.problem import DesignProblem, DesignResult
from synth.design.sampled_data import WITHIN, by_levels, norm_of, refined_further, two_steps
from synth.design.two_step import l_matrix, nullspace, r_matrix, state_path
from synth.lmi.sampled_bound import find_sampled_bound
from synth.lmi.sdp import solve_lmi
from synth.plant.generalized import GeneralizedPlant, law_gain
from synth.plant.numerics import DesignError, InfeasibleError, TooLargeError
from synth.vehicle.designer import Designer, certify_given
from tests.support.commands import attacks, main_of

ASKED = "\n[implementation]\nsample_period = {period}\nsampled = true\ndelay = {delay}\n"
EYE = np.eye(4)


def held(problem: SampledDataProblem, near: float, **more) -> DesignResult:
    """The design for a sampled loop: a static gain, or what is asked for."""
    return design(DesignProblem(problem.plant, sampled=problem, near=near, thorough=False, **more))


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
    problem = held_problem(vehicle, Designer(vehicle).entry(name))
    gain, level = two_steps(problem, 7.8, None)
    assert norm_of(problem, gain, 7.8) <= level * (1 + 1e-8)  # what the limit of a path leaves
    assert norm.value <= level * (1 + 1e-8)
    assert controller.certificate.failures == ()


@pytest.mark.parametrize("name", ["I", "II"])
def test_the_second_step_by_another_solver(paper, name):
    """At the level that is reached, problem (25) has the optimum 1 by Clarabel, too, in which L is (14)'s."""
    plant, Cy = Designer(paper).plant, ROWS[name]
    units = np.diag([0.77, 0.045, 0.9, 2.9])  # of the states; Clarabel gives up in SI units
    plant = plant.in_coordinates(units).with_inputs(1e4 * np.eye(1))
    problem = SampledDataProblem(plant.measured(Cy @ units), (HoldInterval(0.01, 0),))
    gain, level = two_steps(problem, 7.8, None)
    _, alone = two_steps(replace(problem, plant=plant.measured(EYE)), 7.8, None)
    at_best, held = problem.at(alone), problem.at(level)
    assert at_best is not None
    assert held is not None
    rows = problem.plant.Cy
    Q = nullspace(rows)
    R = r_matrix(rows, Q, l_matrix(state_path(at_best)[-1].X, rows, Q))
    solution = solve_lmi(held.measured(rows), Q, R)
    assert solution.gamma == pytest.approx(1, abs=1e-5)  # Clarabel's tolerance
    K = np.linalg.lstsq(rows.T, np.linalg.solve(solution.X, solution.Y.T))[0].T  # Y X^-1 = K C_y
    # Two points of the optimal face: their gains differ, and neither is far.
    np.testing.assert_allclose(gain, K, rtol=0.02)


def test_tends_to_the_continuous_design(paper):
    """At 10 kHz state feedback is that of (22), a thousandth away, and its norm that of the continuous loop to 1e-6."""
    vehicle = asked(period=1e-4)
    designed, ideal = Designer(vehicle).design("state"), Designer(paper).design("state")
    np.testing.assert_allclose(designed.gain, ideal.gain, rtol=1e-2)  # first order in the period: 9e-3 of the second entry
    assert norm_as_implemented(vehicle, designed, 1e-4).value == pytest.approx(ideal.certificate.norm.value, rel=1e-6)


LAG = "[limits]\nactuator_bandwidth = 200.0\n"
FELT_ALONE = '[controllers.felt]\nmeasured = ["suspension_deflection", "sprung_acceleration"]\n'


@pytest.mark.attack
@pytest.mark.parametrize(
    ("name", "delay", "more", "controllers"),
    [("quarter_car", 2, LAG, ("state", "II")), ("quarter_car", 1, FELT_ALONE, ("felt",))],
)
def test_the_loop_as_built_is_that_designed_for(name, delay, more, controllers):
    """With delay, lag and accelerometers the norm that was designed is the one of the loop as built, put together elsewhere."""
    vehicle = asked(name, delay=delay, more=more)
    designer = Designer(vehicle)
    for each in controllers:
        problem, controller = held_problem(vehicle, designer.entry(each)), designer.design(each)
        norm = sampled_norm(problem.loop(controller.law.D), 7.8).value
        plant = problem.at(norm)
        assert plant is not None
        # The plant of the level that is the norm closes to a norm of one: what is remembered stands where it is read.
        assert hinf_norm(plant.closed_loop(controller.law.D @ problem.rows)).value == pytest.approx(1, rel=1e-6)
        assert norm_as_implemented(vehicle, controller).value == pytest.approx(norm, rel=1e-7)  # a norm's levels lie that close
        found = held(problem, 7.8)
        assert norm <= found.value * (1 + 1e-7)
        assert found.level is None or found.value <= found.level * (1 + 1e-7)


@pytest.mark.attack
def test_a_filter_in_z():
    """With a filter in z, whose states nothing measures, state feedback is designed from the vehicle's own states."""
    text = read_vehicle("quarter_car").text.replace(
        "sprung_acceleration = 1.0", "sprung_acceleration = { numerator = [1.0, 2.0], denominator = [1.0, 20.0] }"
    )
    vehicle = parse_vehicle(text + ASKED.format(period=0.01, delay=0))
    problem = held_problem(vehicle, Designer(vehicle).entry("state"))
    found = held(problem, 7.8)
    assert found.gain.shape == (1, 4)
    assert sampled_norm(problem.loop(found.gain), 7.8).value == pytest.approx(found.value, rel=1e-9)


def test_what_is_printed_and_saved(tmp_path, capsys):
    """The table and --json have the design's sampled norm; saved, it is checked and read as the gain that it is."""
    file, saved = tmp_path / "car.toml", tmp_path / "saved.toml"
    file.write_text(asked().text, encoding="utf-8")
    options = ["--vehicle", str(file), "--controller", "II"]
    assert main_of("synth")([*options, "--json", "--save", str(saved)]) == 0
    (row,) = json.loads(capsys.readouterr().out)["controllers"]
    assert row["design"] == "sampled"
    assert row["sampled_norm"] <= 7.881  # the best that was known
    assert main_of("synth")([*options, "-v"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert f"{row['sampled_norm']:.7g}" in printed
    assert f"{row['sampled_lower_bound']:.7g} {100 * row['sampled_gap']:.2g} %" in printed
    assert main_of("synth")(["--check", str(saved), "--json"]) == 0
    kept = read_vehicle(saved).controllers["II_designed"].law
    assert kept is not None
    assert kept.D.tolist() == row["gain"]


def test_refused_where_it_is_done():
    """A vehicle that lost its period is refused in one line."""
    vehicle = asked()
    lost = replace(vehicle, implementation=replace(vehicle.implementation, sample_period=None))
    with pytest.raises(InputError, match=r"\[implementation\] has no sample period"):
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


@pytest.mark.attack
def test_what_no_gain_stabilises():
    """If no gain is found without proof that there is none, that is no InfeasibleError; what to do comes first."""
    A, B, C = np.array([[0.0, 1], [4, 0]]), np.array([[0.0], [1]]), np.vstack([np.eye(2), np.zeros((1, 2))])
    plant = GeneralizedPlant(A, B, B, C, np.array([[0.0], [0], [1]]), np.zeros((3, 1)))
    with pytest.raises(DesignError, match=r"^no static gain found; measure .*; the two-step method: .*\(25\)") as caught:
        held(SampledDataProblem(plant.measured([[1.0, 0]]), (HoldInterval(0.1, 0),)), 2.0)
    assert not isinstance(caught.value, InfeasibleError)
    assert "\n" not in str(caught.value)


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


@pytest.mark.attack
@pytest.mark.parametrize(
    ("name", "controller", "period", "delay"),
    [
        ("quarter_car", "I", 0.001, 1),
        ("quarter_car", "I", 0.5, 0),
        ("quarter_car", "II", 0.02, 5),
        ("quarter_car", "state", 0.5, 1.3),
        ("half_car", "I", 0.2, 0),
    ],
)
def test_never_worse_than_what_is_there(name, controller, period, delay):
    """A design for a sampled loop gains no more than the continuous design there, and than no control."""
    vehicle = asked(name, period, delay)
    designer = Designer(replace(read_vehicle(name), implementation=vehicle.implementation))
    ideal, built = designer.design(controller), Designer(vehicle).design(controller)
    assert built.sampled
    reached = norm_as_implemented(vehicle, built).value
    others = [norm_as_implemented(vehicle, ideal).value, norm_as_implemented(vehicle, designer.design("passive")).value]
    assert reached <= min(others) * (1 + 2e-7)  # how near a level counts as reached, and the rounding of two norms
    assert built.fallback_method.startswith("designed by descent") == ("by the LMI" not in built.remarks[0])


@pytest.mark.attack
@pytest.mark.parametrize(("period", "delay", "known"), [(0.5, 0, 29.76), (0.2, 0, 8.508), (0.1, 1, 10.48), (0.5, 1, 20.83)])
def test_descent_finds_the_valley(paper, period, delay, known):
    """For one gain the least norm is known by trying every gain: the descent of II finds that valley, whichever side of zero."""
    problem = SampledDataProblem(Designer(paper).plant.measured(ROWS["II"]), (HoldInterval(period, delay),))
    found = held(problem, 7.8, known=[Designer(paper).design("II").law])
    tried = [norm_of(problem, np.array([[sign * k]]), 8.0) for sign in (-1, 1) for k in np.geomspace(50, 1e4, 12)]
    assert found.value <= known
    assert found.value <= min(tried) * (1 + 1e-4)  # flat valleys: a descent that gains less than that is the last


@pytest.mark.attack
def test_long_delays():
    """For many samples of delay the design is by descent, in words that are true, and of too many it is refused, at once."""
    found = Designer(asked(period=0.001, delay=30)).design("II")
    assert (
        "the LMI problem has 630 unknowns, but the two-step method for sampled loops allows at most 260" in found.fallback_method
    )
    assert "force more" not in found.fallback_method
    start = time.process_time()
    with pytest.raises(TooLargeError, match=r"a delay of 50 samples gives the loop 108 states") as caught:
        Designer(asked("half_car", period=0.001, delay=50)).design("II")
    assert time.process_time() - start < 5  # a second or so; before it was minutes
    assert "\n" not in str(caught.value)


# --- the lower bound, and laws of full order -----------------------------------------------------------------------------


PROVED = 2e-8  # relative: the levels on either side of a norm are 1.1e-8 apart


def built(period: float, delay: float, lag: float | None, section: str, noise: str = "") -> Vehicle:
    """The paper's car with a computer, and a controller of its own."""
    limits = f"[limits]\nactuator_bandwidth = {lag}\n" if lag else ""
    how = f"[implementation]\nsample_period = {period}\ndelay = {delay}\n{f'noise = {{ {noise} }}' if noise else ''}\n"
    return parse_vehicle(f"{read_vehicle('quarter_car').text}\n{how}{limits}[controllers.mine]\n{section}")


I = 'measured = ["suspension_deflection", "sprung_velocity"]\n'  # noqa: E741  # the paper's name
FELT = 'measured = ["suspension_deflection", "sprung_acceleration"]\n'


@pytest.mark.attack
@pytest.mark.parametrize(
    ("period", "delay", "lag", "known"), [(0.1, 0, None, 8.50036), (0.02, 2, 40, 8.07702), (0.005, 0.5, 30, 7.96082)]
)
def test_what_is_known_by_hand(period, delay, lag, known):
    """A static design is as good as the best gain that a search by hand found, and neither beats the lower bound."""
    vehicle = built(period, delay, lag, f"{I}sampled = true\n")
    designer = Designer(vehicle)
    controller = designer.design("mine")
    norm, bound = norm_as_implemented(vehicle, controller).value, designer.sampled_bound(controller)
    assert norm <= known * (1 + 1e-5)  # printed with six digits; the last descent gains less than that
    assert bound is not None
    assert bound.holds
    assert bound.level <= norm


@pytest.mark.attack
def test_refined():
    """`--refine` goes on from any gain, never raises the norm of the sampled loop, and says what it bought."""
    vehicle = built(0.005, 1, None, f"{I}sampled = true\n")
    designer = Designer(vehicle)
    start, refined = designer.design("mine"), designer.refine("mine")
    before, after = (norm_as_implemented(vehicle, one).value for one in (start, refined.controller))
    assert after <= before
    assert refined.refinement.after == pytest.approx(after, rel=PROVED)
    assert f"the sampled norm {before:.7g} -> {after:.7g}" in refined.trade_off_text
    problem = held_problem(vehicle, vehicle.controllers["mine"])
    half = refined_further(problem, start.law.D / 2, 8.0)
    assert before * (1 - 1e-3) < half.after < half.before * (1 - 1e-4)


def anywhere(rng: np.random.Generator) -> SampledDataProblem:
    """The problem of a random vehicle at a random period, delay and lag, with or without noise."""
    period, delay = float(10 ** rng.uniform(-2.5, -0.7)), float(rng.choice([0.0, 1.0, round(rng.uniform(0, 2.5), 1)]))
    lag, section = rng.choice([0.0, 10 ** rng.uniform(1.3, 2.3)]), str(rng.choice([I, FELT]))
    vehicle = built(round(period, 4), delay, float(lag) or None, section)
    factors = {name: value * rng.uniform(0.7, 1.4) for name, value in vehicle.parameters.items()}
    problem = held_problem(vehicle.with_parameters(**factors), vehicle.controllers["mine"])
    return replace(problem, rms=np.array([0.01, 0.05])) if rng.random() < 0.5 else problem


@pytest.mark.attack
@pytest.mark.parametrize("seed", range(2))
def test_nothing_beats_the_lower_bound(seed):
    """No gain of a random search and no law of full order has less than the lower bound, and the law is next to it."""
    rng = np.random.default_rng(seed)
    problem = anywhere(rng)
    bound = find_sampled_bound(problem, 8.0)
    assert bound is not None
    assert bound.holds
    law = held(problem, 8.0, order="full", sampled_bound=bound)
    assert bound.level <= law.value <= bound.level * (1 + WITHIN) or law.remark
    gains = [np.array([[1.0, 0.3]]) * rng.standard_normal(2) * 10 ** rng.uniform(1, 4.5) for _ in range(20)]
    assert min(sampled_norm(problem.loop(K), 8.0).value for K in gains) >= bound.level


@pytest.mark.attack
def test_the_bound_is_where_the_law_ends():
    """At a level below the bound the level's plant has no law with a norm below 1, and above it the law designed has."""
    problem = held_problem(vehicle := built(0.02, 2, 40, I), vehicle.controllers["mine"])
    bound = find_sampled_bound(problem, 8.0)
    assert bound is not None
    found = held(problem, 8.0, order="full", sampled_bound=bound)
    for level in (found.value * (1 - 1e-6), found.value * (1 + 1e-6)):  # well beyond what a norm's own levels are apart
        plant = problem.at(level)
        assert plant is not None
        larger, G = plant.with_law(found.law)
        assert (hinf_norm(larger.closed_loop(G)).value < 1) == (level > found.value)
    assert found.value < 8.07702 * (1 - 0.02)  # what states buy against the best static gain


@pytest.mark.attack
def test_an_accelerometer_one_sample_late():
    """The use case: an accelerometer, 5 ms, one sample late, with noise: within 0.1 % of what no controller beats."""
    noise = "suspension_deflection = 0.005, sprung_acceleration = 0.5"
    vehicle = built(0.005, 1, None, f'{FELT}order = "full"\nnoise = true\nsampled = true\n', noise)
    designer = Designer(vehicle)
    controller = designer.design("mine")
    bound, norm = designer.sampled_bound(controller), norm_as_implemented(vehicle, controller)
    assert bound is not None
    assert bound.level <= norm.value <= bound.level * (1 + WITHIN)
    assert norm.reached == pytest.approx(norm.value, rel=1e-6)  # by an actual road and noise, to the claim's own tolerance
    assert controller.law.sample_period == 0.005
    problem = held_problem(vehicle, vehicle.controllers["mine"])
    # The loop that was designed for, put together elsewhere.
    assert sampled_norm(problem.loop(law_gain(controller.law)), 8.0).value == pytest.approx(norm.value, rel=PROVED)
    assert bound.level <= held(problem, 8.0).value  # of a static gain on these readings


@pytest.mark.attack
def test_stable_by_itself():
    """With `stable`, the law itself decays, as it is run."""
    controller = Designer(built(0.005, 1, None, f'{FELT}order = "full"\nstable = true\nsampled = true\n')).design("mine")
    assert controller.law.states
    assert controller.law.growth == 0.0


@pytest.mark.parametrize(("period", "of_example"), attacks([(0.75, 3.7912), (0.2, 1.00468)]))
def test_example_of_a_manual(period, of_example):
    """For the plant of MATLAB's sdhinfnorm, [1; 1] p [1 1], p = 30 / (s (s + 30)), a law is better than the example's -k."""
    A, B, C = np.array([[0.0, 1.0], [0.0, -30.0]]), np.array([[0.0], [30.0]]), np.array([[1.0, 0.0]])
    plant = GeneralizedPlant(A, B, B, C, np.zeros((1, 1)), np.zeros((1, 1)))
    problem = SampledDataProblem(plant.measured(C), (HoldInterval(period, 0),))
    bound = find_sampled_bound(problem, of_example)
    assert bound is not None
    assert bound.holds
    found = held(problem, of_example, order="full", sampled_bound=bound)
    assert bound.level <= found.value < of_example
    assert found.value <= bound.level * (1 + WITHIN) or found.remark


def test_noise_tends_to_that_of_the_continuous_loop():
    """At a fast rate the norm with noise of the readings is the continuous one, whose noise counts as much: first power of T."""
    off = []
    for period in (1e-3, 5e-4):
        vehicle = built(period, 0, None, f"{I}gain = [[9000.0, -8000.0]]\nnoise = true\n", "sprung_velocity = 1.0")
        controller = Designer(vehicle).design("mine")
        off.append(norm_as_implemented(vehicle, controller).value / controller.certificate.norm.value - 1)
        without = norm_as_implemented(vehicle, controller.without_noise).value
        assert norm_as_implemented(vehicle, controller).value > without * 1.01  # so that the noise is seen at all
    assert abs(off[0]) < 0.01
    assert off[0] / off[1] == pytest.approx(2, rel=0.05)  # the next term is of order two


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A vehicle file with a law of full order for the sampled loop, saved with its certificate."""
    folder = tmp_path_factory.mktemp("saved")
    vehicle = built(0.02, 1, None, f'{I}order = "full"\nsampled = true\n')
    (folder / "car.toml").write_text(vehicle.text, encoding="utf-8")
    options = ["--vehicle", str(folder / "car.toml"), "--controller", "mine", "--save", str(folder / "saved.toml")]
    assert main_of("synth")(options) == 0
    return (folder / "saved.toml").read_text(encoding="utf-8")


def test_saved_and_checked(saved, tmp_path, capsys):
    """The saved law holds when it is checked, without a solver, and is read as it was designed."""
    (tmp_path / "saved.toml").write_text(saved, encoding="utf-8")
    assert main_of("synth")(["--check", str(tmp_path / "saved.toml"), "--json"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["controllers"]}
    record = read_vehicle(tmp_path / "saved.toml").controllers["mine_designed"].certificate
    assert record is not None
    assert record["sampled_lower_bound"] <= rows["mine_designed"]["sampled_norm"]


@pytest.mark.parametrize("what", ["level", "vehicle"])
def test_a_false_bound_fails(saved, tmp_path, capsys, what):
    """A higher level, and the proof of another vehicle, fail the check."""
    record = parse_vehicle(saved).controllers["mine_designed"].certificate
    assert record is not None
    level = record["sampled_lower_bound"]
    text = {
        "level": saved.replace(f"sampled_lower_bound = {level!r}", f"sampled_lower_bound = {level * (1 + 2e-6)!r}"),
        "vehicle": saved.replace("tyre_stiffness = 252000.0", "tyre_stiffness = 240000.0"),
    }[what]
    assert text != saved
    (tmp_path / "false.toml").write_text(text, encoding="utf-8")
    options = ["--check", str(tmp_path / "false.toml"), "--controller", "mine_designed"]
    assert main_of("synth")(options) == 1
    printed = " ".join(capsys.readouterr().out.split())
    assert "claims that the lower bound of the sampled loop is" in printed
    assert "its proof does not hold for this vehicle" in printed


def test_the_law_of_a_section_reads_the_sensors_as_they_are():
    """A law for a sampled loop acts on accelerations, which contain the force: it is the law of the loop's problem."""
    law = 'order = "full"\nsampled = true\nmeasured = ["sprung_acceleration", "suspension_deflection"]\n'
    vehicle = parse_vehicle(
        f"{read_vehicle('quarter_car').text}\n[implementation]\nsample_period = 0.01\n[controllers.own]\n{law}"
    )
    designer, entry = Designer(vehicle), vehicle.controllers["own"]
    found, problem = designer.design("own").law, held_problem(vehicle, entry)
    near = designer.lower_bound(entry.measured).gamma
    bound = find_sampled_bound(problem, near)
    np.testing.assert_array_equal(found.D, held(problem, near, order="full", sampled_bound=bound).law.D)


def test_one_search_over_levels(paper):
    """A method gets the plant of a level, then that of the norm it reached; a level without a law is raised; the best stays."""
    problem = SampledDataProblem(Designer(paper).plant.measured(ROWS["II"]), (HoldInterval(0.01, 0),))
    gains, levels = iter([None, -4000.0, -9000.0, -6000.0]), list[float]()
    norms = {k: norm_of(problem, np.array([[k]]), 8.0) for k in (-4000.0, -9000.0, -6000.0)}

    def method(plant, level, law):
        levels.append(level)
        gain = next(gains)
        if gain is None:
            raise DesignError("nothing at this level")
        own = problem.at(level)
        assert own is not None
        np.testing.assert_array_equal(plant.Bw, own.Bw)
        return static_law(np.array([[gain]])), (f"{gain:g}",)

    best, ended = by_levels(problem, 7.0, method, lambda norm, level, before: False, higher=1.2)
    assert levels == pytest.approx([7.0, 8.4, norms[-4000.0], norms[-9000.0]], rel=1e-7)
    lowest = min(norms, key=norms.__getitem__)
    assert (best.law.D, best.remarks, ended) == ([[lowest]], (f"{lowest:g}",), False)
    assert best.norm == pytest.approx(norms[lowest], rel=1e-7)
    gains = iter([None] * 4)
    with pytest.raises(DesignError, match="nothing at this level"):
        by_levels(problem, 7.0, method, lambda norm, level, before: True)
