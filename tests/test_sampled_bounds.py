"""The lower bound of a sampled loop, and laws of full order and gains against it, with noise, lag and delay."""

import json
from dataclasses import replace

import numpy as np
import pytest

from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from synth.analysis.norm import hinf_norm
from synth.analysis.sampled_loop import HoldInterval, SampledDataProblem
from synth.analysis.sampled_norm import sampled_norm
from synth.controller.implementation_norm import held_problem, norm_as_implemented
from synth.controller.report import norm_lines
from synth.design.full_order.sampled_data import WITHIN, law_gain, sampled_full_order
from synth.design.sampled_data import held_design
from synth.lmi.sampled_bound import find_sampled_bound
from synth.plant.augmented import on_larger_plant
from synth.plant.generalized import GeneralizedPlant
from synth.vehicle.designer import Designer
from tests.commands import attacks, main_of
from tests.test_sampled_norm import any_loop

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
    ("period", "delay", "lag", "known"),
    [(0.1, 0, None, 8.50036), *attacks(((0.02, 2, 40, 8.07702), (0.005, 0.5, 30, 7.96082), (0.005, 1, 60, 7.83797)))],
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
    """`--refine` goes on where the gain of the two steps stayed, and says what it bought."""
    vehicle = built(0.005, 1, None, f"{I}sampled = true\n")
    designer = Designer(vehicle)
    start, refined = designer.design("mine"), designer.refine("mine")
    before, after = (norm_as_implemented(vehicle, one).value for one in (start, refined.controller))
    assert after < before
    assert refined.refinement.after == pytest.approx(after, rel=PROVED)
    assert f"the sampled norm {before:.7g} -> {after:.7g}" in refined.traded


def anywhere(rng: np.random.Generator) -> SampledDataProblem:
    """The problem of a random vehicle at a random period, delay and lag, with or without noise."""
    period, delay = float(10 ** rng.uniform(-2.5, -0.7)), float(rng.choice([0.0, 1.0, round(rng.uniform(0, 2.5), 1)]))
    lag, section = rng.choice([0.0, 10 ** rng.uniform(1.3, 2.3)]), str(rng.choice([I, FELT]))
    vehicle = built(round(period, 4), delay, float(lag) or None, section)
    factors = {name: value * rng.uniform(0.7, 1.4) for name, value in vehicle.parameters.items()}
    problem = held_problem(vehicle.with_parameters(**factors), vehicle.controllers["mine"])
    return replace(problem, rms=np.array([0.01, 0.05])) if rng.random() < 0.5 else problem


@pytest.mark.attack
@pytest.mark.parametrize("seed", range(4))
def test_nothing_beats_the_lower_bound(seed):
    """No gain of a random search and no law of full order has less than the lower bound, and the law is next to it."""
    rng = np.random.default_rng(seed)
    problem = anywhere(rng)
    bound = find_sampled_bound(problem, 8.0)
    assert bound is not None
    assert bound.holds
    law = sampled_full_order(problem, bound, 8.0)
    assert bound.level <= law.norm <= bound.level * (1 + WITHIN) or law.remark
    gains = [np.array([[1.0, 0.3]]) * rng.standard_normal(2) * 10 ** rng.uniform(1, 4.5) for _ in range(20)]
    assert min(sampled_norm(problem.loop(K), 8.0).value for K in gains) >= bound.level


@pytest.mark.attack
def test_the_bound_is_where_the_law_ends():
    """At a level below the bound the level's plant has no law with a norm below 1, and above it the law designed has."""
    problem = held_problem(vehicle := built(0.02, 2, 40, I), vehicle.controllers["mine"])
    bound = find_sampled_bound(problem, 8.0)
    assert bound is not None
    found = sampled_full_order(problem, bound, 8.0)
    for level in (found.norm * (1 - 1e-6), found.norm * (1 + 1e-6)):  # well beyond what a norm's own levels are apart
        plant = problem.at(level)
        assert plant is not None
        larger, G = on_larger_plant(plant, problem.rows, found.law)
        assert (hinf_norm(larger.closed_loop(G)).value < 1) == (level > found.norm)
    assert found.norm < 8.07702 * (1 - 0.02)  # what states buy against the best static gain


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
    assert bound.level <= held_design(problem, 8.0).norm  # of a static gain on these readings


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
    problem = SampledDataProblem(plant, C, np.zeros((1, 1)), (HoldInterval(period, 0),))
    bound = find_sampled_bound(problem, of_example)
    assert bound is not None
    assert bound.holds
    found = sampled_full_order(problem, bound, of_example)
    assert bound.level <= found.norm < of_example
    assert found.norm <= bound.level * (1 + WITHIN) or found.remark


@pytest.mark.parametrize("seed", range(3))
def test_two_routes_meet_with_noise(seed):
    """For any loop with noise, what an actual disturbance reaches is the norm, and no other angle's gain is above it."""
    rng = np.random.default_rng(seed)
    loop = any_loop(rng)
    loop = replace(loop, noise=rng.standard_normal((len(loop.K) + len(loop.A_register), 2)))
    norm = sampled_norm(loop)
    assert norm.value >= sampled_norm(replace(loop, noise=None)).value * (1 - PROVED)
    if norm.inside:
        return
    assert norm.gap < 1e-7 or loop.period * np.linalg.norm(loop.plant.A, 2) > 50  # as many time constants, by polynomials
    assert norm.upper < norm.value * (1 + PROVED)


def test_noise_tends_to_that_of_the_continuous_loop():
    """At a fast rate the norm with noise of the readings is the continuous one, whose noise counts as much: first power of T."""
    off = []
    for period in (1e-3, 5e-4):
        vehicle = built(period, 0, None, f"{I}gain = [[9000.0, -8000.0]]\nnoise = true\n", "sprung_velocity = 1.0")
        controller = Designer(vehicle).design("mine")
        off.append(norm_as_implemented(vehicle, controller).value / controller.certificate.norm.value - 1)
        without = norm_as_implemented(vehicle, controller.quiet).value
        assert norm_as_implemented(vehicle, controller).value > without * 1.01  # so that the noise is seen at all
        both = [norm_lines(vehicle, one, norm_as_implemented(vehicle, one))[1] for one in (controller, controller.quiet)]
        assert ["a road with noise reaches" in line for line in both] == [True, False]
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


@pytest.mark.parametrize("what", ["level", "proof", "vehicle"])
def test_a_forged_bound_is_refused(saved, tmp_path, capsys, what):
    """A higher level, a proof of another frequency or dual, and another vehicle fail the check."""
    record = parse_vehicle(saved).controllers["mine_designed"].certificate
    assert record is not None
    level, proof = record["sampled_lower_bound"], record["sampled_proof"]
    line = next(line for line in saved.splitlines() if line.startswith("sampled_proof"))
    text = {
        "level": saved.replace(f"sampled_lower_bound = {level!r}", f"sampled_lower_bound = {level * (1 + 2e-6)!r}"),
        "proof": saved.replace(line, "sampled_proof = { limit_at = 20.0 }" if "limit_at" in proof else "sampled_proof = {}"),
        "vehicle": saved.replace("tyre_stiffness = 252000.0", "tyre_stiffness = 240000.0"),
    }[what]
    assert text != saved
    (tmp_path / "forged.toml").write_text(text, encoding="utf-8")
    options = ["--check", str(tmp_path / "forged.toml"), "--controller", "mine_designed"]
    assert main_of("synth")(options) == 1
    printed = " ".join(capsys.readouterr().out.split())
    assert "the lower bound of the sampled loop is claimed to be" in printed
    assert "its proof does not hold with this vehicle" in printed
