"""Preview LQ: gains and mean square by two routes each, MuJoCo on every kind of vehicle, its logs, and what cannot hold it."""

import dataclasses
import json
from collections.abc import Mapping
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import legendre
from scipy import integrate, linalg

from models.laws.preview import RoadPreview
from models.roads.iso8608 import Iso8608
from models.roads.obstacles import Step
from models.roads.road import Bump, RoadInput
from models.roads.sinusoids import sinusoid
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim import bump
from sim.inspect.log import read_log
from sim.inspect.proof import prove
from sim.linear.frequency_response import continuous_frequency_response, sampled_frequency_response
from sim.linear.sampled_response import continuous_response, sampled_response
from sim.runs.run import run_controllers, sample_times
from sim.studies.ride.between_samples import exact
from sim.studies.ride.expected import expect
from synth import closed_loop, law_system
from synth.command.save import saved_text
from synth.controller.controller import Controller
from synth.controller.export.matlab import mat_file
from synth.controller.problem import generalized_plant
from synth.design.full_order.preview import preview_design
from synth.design.full_order.quadratic import lqr_design
from synth.plant.generalized import GeneralizedPlant
from synth.vehicle.designer import Designer
from tests.support.commands import attacks, main_of, refused

KINDS = ("quarter_car", "half_car", "full_car")
SECTION = '\n[controllers.ahead]\ndesign = "preview"\npreview = {}\n'
LQR = '\n[controllers.lqr]\ndesign = "lqr"\n'


def car(kind: str = "quarter_car", more: str = "", preview: float = 0.3) -> Vehicle:
    """A vehicle that ships, with a preview of its road and more sections."""
    return parse_vehicle(f"{read_vehicle(kind).text}\n{more}{LQR}{SECTION.format(preview)}")


@cache
def controller(kind: str = "quarter_car", preview: float = 0.3) -> Controller:
    """Its preview LQ."""
    return Designer(car(kind, preview=preview)).design("ahead")


def delay_line(r: int, seconds: float, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the dynamics of the Legendre coefficients of what is known ahead, by the tau method, and what they are now."""
    D = np.zeros((degree + 1, degree + 1))
    for i in range(1, degree + 1):
        slope = legendre.legder(np.eye(degree + 1)[i])
        D[: len(slope), i] = slope * 2 / seconds
    signs = (-1.0) ** np.arange(degree)
    own = D[:degree, :degree] - D[:degree, degree:]  # the last coefficient makes the end what comes in
    return np.kron(np.eye(r), own), np.kron(np.eye(r), signs - (-1.0) ** degree)


@pytest.mark.parametrize("kind", ["quarter_car", *attacks(("half_car", "full_car"))])
def test_gains_of_the_augmented_plant(kind):
    """Feedback and preview are the gain of the Riccati equation of the plant with the road ahead as a delay line in its state."""
    plant, seconds, degree = generalized_plant(read_vehicle(kind)), 0.1, 30
    found = preview_design(plant, seconds)
    assert found.preview is not None
    (n, r), m = plant.Bw.shape, plant.B.shape[1]
    line, now = delay_line(r, seconds, degree)
    A = np.block([[plant.A, plant.Bw @ now], [np.zeros((len(line), n)), line]])
    B, C = np.vstack([plant.B, np.zeros((len(line), m))]), np.hstack([plant.C, np.zeros((len(plant.C), len(line)))])
    X = linalg.solve_continuous_are(A, B, C.T @ C, plant.D.T @ plant.D, s=C.T @ plant.D)
    rough = -np.linalg.solve(plant.D.T @ plant.D, B.T @ X + plant.D.T @ C)
    z = C + plant.D @ rough
    X = linalg.solve_continuous_lyapunov((A + B @ rough).T, -z.T @ z)  # a step of Newton's method, as SciPy's solver leaves 1e-9
    K = -np.linalg.solve(plant.D.T @ plant.D, B.T @ X + plant.D.T @ C)
    at, weights = legendre.leggauss(60)
    F = [found.preview.C @ linalg.expm(found.preview.A * seconds * (x + 1) / 2) @ found.preview.B for x in at]
    moments = np.einsum("k,kmr,ki->mri", weights * seconds / 2, F, legendre.legvander(at, degree - 1)).reshape(m, -1)
    np.testing.assert_allclose(found.law.D, K[:, :n], rtol=0, atol=1e-9 * np.abs(K[:, :n]).max())  # found: 3e-11
    np.testing.assert_allclose(moments, K[:, n:], rtol=0, atol=1e-9 * np.abs(K[:, n:]).max())  # found: 4e-10


@pytest.mark.parametrize("kind", ["quarter_car", "full_car"])
def test_what_acts_by_its_height_is_known_too(kind):
    """A vehicle's preview is F(s) on its road's velocities, and on the heights where they act as such, as a twist does."""
    model, plant, designed = read_vehicle(kind).linear_model, generalized_plant(read_vehicle(kind)), controller(kind)
    X = linalg.solve_continuous_are(plant.A, plant.B, plant.C.T @ plant.C, plant.D.T @ plant.D, s=plant.C.T @ plant.D)
    R, loop = plant.D.T @ plant.D, plant.A + plant.B @ designed.state_gain(read_vehicle(kind))
    assert designed.preview is not None
    for s in (0.0, 0.02, 0.2):
        F = -np.linalg.solve(R, plant.B.T @ linalg.expm(loop.T * s) @ X)
        of = designed.preview.C @ linalg.expm(designed.preview.A * s)
        for found, expected in ((of @ designed.preview.B, F @ model.Bw), (of @ designed.preview.H, F @ model.Br)):
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7 * np.abs(F).max())  # SciPy's solver
    assert np.any(designed.preview.H) == (kind == "full_car")


def mean_square(plant: GeneralizedPlant, K: np.ndarray, ahead: RoadPreview, scale: float = 1.0) -> float:
    """The mean square of z under white noise known ahead: the energy of z around an impulse that is known since T before it.

    The preview may be scaled.
    """
    T, n, loop, z = ahead.seconds, len(plant.A), plant.A + plant.B @ K, plant.C + plant.D @ K
    before = np.block([[loop, scale * plant.B @ ahead.C], [np.zeros((len(ahead.A), n)), -ahead.A]])
    start = np.vstack([np.zeros_like(plant.Bw), linalg.expm(ahead.A * T) @ ahead.B])
    read, (at, weights) = np.hstack([z, scale * plant.D @ ahead.C]), legendre.leggauss(60)
    waits = [np.sum((read @ linalg.expm(before * T * (x + 1) / 2) @ start) ** 2) for x in at]
    after = (linalg.expm(before * T) @ start)[:n] + plant.Bw
    left = linalg.solve_continuous_lyapunov(loop.T, -z.T @ z)
    return float(weights @ waits * T / 2 + np.trace(after.T @ left @ after))


@pytest.mark.parametrize("kind", KINDS)
def test_mean_square_by_two_routes(kind):
    """The H2 norm in closed form is that of the loop's impulse response, and a preview of another size has a larger one."""
    plant = generalized_plant(read_vehicle(kind))
    found = preview_design(plant, 0.1)
    assert found.preview is not None
    square, saved = found.h2_norm**2, found.without**2 - found.h2_norm**2
    assert mean_square(plant, found.law.D, found.preview) == pytest.approx(square, rel=1e-9)  # rounding; found: 4e-13
    for share in (1.0, -1.0, 0.1):  # a parabola around its least value, which for no preview is LQR's
        other = mean_square(plant, found.law.D, found.preview, 1 + share)
        assert other - square == pytest.approx(share**2 * saved, rel=1e-6)  # of a small difference


@pytest.mark.parametrize("kind", KINDS)
def test_the_further_ahead_the_better(kind):
    """The mean square falls with the preview, begins with that of LQR, and so does the law."""
    plant = generalized_plant(read_vehicle(kind))
    lqr, designs = lqr_design(plant), [preview_design(plant, seconds) for seconds in (0.0, 0.01, 0.1, 0.5, 2.0)]
    norms = [each.h2_norm for each in designs]
    assert norms[0] == pytest.approx(lqr.h2_norm, rel=1e-9)  # two Lyapunov equations
    assert designs[0].preview is None
    assert all(later < earlier for earlier, later in pairwise(norms))
    assert all(np.array_equal(each.law.D, lqr.law.D) for each in designs)


def test_weights_are_exact_where_the_road_is_straight():
    """A computer's sum over heights is the integral of the preview for a road that goes straight between its samples."""
    ahead = RoadPreview(0.35, *map(np.array, ([[-2.0, 1.0], [-5.0, -30.0]], [[1.0], [2.0]], [[0.3], [-4.0]], [[5.0, 7.0]])))
    period = 0.05
    heights = np.random.default_rng(0).standard_normal(ahead.samples(period))
    grid = period * np.arange(len(heights))

    def integrand(s: float) -> float:
        k = min(int(s / period), len(heights) - 2)
        rate = (heights[k + 1] - heights[k]) / period
        d = ahead.B[:, 0] * rate + ahead.H[:, 0] * (heights[k] + rate * (s - grid[k]))
        return float((ahead.C @ linalg.expm(ahead.A * s) @ d)[0])

    parts = [integrate.quad(integrand, left, right, epsrel=1e-12)[0] for left, right in pairwise(grid)]
    force = ahead.forces(heights[:, None], 1, period, 1)[0, 0]
    assert force == pytest.approx(sum(parts), rel=1e-11)  # the quadrature
    omega = np.array([0.3, 4.0])
    coarse, fine = (ahead.sampled_response(omega, h) / (1j * omega)[:, None, None] for h in (1e-2, 1e-3))
    exact = ahead.response(omega)
    ratio = np.abs(coarse - exact) / np.abs(fine - exact)
    np.testing.assert_allclose(ratio, 100.0, rtol=0.05)  # straight pieces of a sinusoid: of second order in the period


@pytest.mark.parametrize(
    ("kind", "more"),
    [
        ("quarter_car", ""),
        ("half_car", "[implementation]\nsample_period = 0.004\ndelay = 1\n"),
        ("full_car", "[limits]\nactuator_bandwidth = 100.0\n"),
        *attacks(
            [
                ("full_car", ""),
                ("quarter_car", "[implementation]\nsample_period = 0.008\ndelay = 0.5\nnoise = { sprung_velocity = 1e-3 }\n"),
                ("full_car", "[implementation]\nsample_period = 0.004\n"),
            ]
        ),
    ],
)
def test_physics_follows(kind, more):
    """MuJoCo agrees with the exact sampled response to RK4's own error, and its energy balances, as built and behind a lag."""
    vehicle = car(kind, more)
    road = Bump(height=0.02, track="left") if kind == "full_car" else Bump(height=0.02)
    (run,) = run_controllers(vehicle, [Designer(vehicle).design("ahead")], road, sample_times(vehicle, 0.5, 1e-3))
    assert run.passed
    force = vehicle.linear_model.inputs[0]
    assert more or run.physics[force][0] != 0.0  # it pushes before the road does


def test_the_body_hardly_moves():
    """With the road known 0.3 s ahead the body's peak acceleration over the bump is a third of LQR's at most."""
    vehicle = car()
    designs = [controller(), Designer(vehicle).design("lqr")]
    ahead, lqr = run_controllers(vehicle, designs, Bump(height=0.02), sample_times(vehicle, 0.8, 1e-3))
    assert ahead.physics.peak("sprung_acceleration") < lqr.physics.peak("sprung_acceleration") / 3
    assert np.array_equal(controller().law.D, designs[1].law.D)


@pytest.mark.parametrize(
    ("kind", "road"),
    [
        ("quarter_car", Bump(height=0.02)),
        ("quarter_car", Bump(height=0.02, length=10.0)),  # which lasts beyond what is known at the end of the run
        *attacks([("full_car", Bump(height=0.02)), ("full_car", Iso8608("C", speed=20.0, track_width=1.4))]),
    ],
)
def test_the_continuous_response_depends_on_no_step(kind, road):
    """The continuous response is exact: steps of which the preview is no whole number make the same, of kinks and lines."""
    vehicle, designed = car(kind), controller(kind)
    whole, other = (
        continuous_response(designed, RoadInput(vehicle, road, np.arange(round(0.42 / h) + 1) * h)) for h in (1e-3, 7e-4)
    )
    for name in vehicle.linear_model.states:
        one, two = whole[name][::7], other[name][::10]
        assert np.abs(one - two).max() <= 1e-10 * np.abs(whole.values).max()  # found: 1e-13
    assert np.abs(whole["control_force" if kind == "quarter_car" else "control_force_front_left"]).max() > 1.0


def test_a_vertical_step_is_the_limit_of_steep_ones():
    """The road ahead holds a jump as an impulse; the feedback goes on where the preview ends, so that the force does not leap."""
    vehicle, time = car("quarter_car", preview=0.05), np.arange(201) * 1e-3
    designed = controller("quarter_car", 0.05)
    steep, steeper, vertical = (
        continuous_response(designed, RoadInput(vehicle, Step(0.01, edge, 8.0, 0.1), time)).values for edge in (2e-3, 1e-3, 0.0)
    )
    apart = np.abs(2 * steeper - steep - vertical)[[*range(100), *range(102, 201)]]  # but at the edge itself
    assert np.all(apart.max(axis=0) <= 1e-4 * np.abs(vertical).max(axis=0) + 1e-12)  # of second order in 0.25 ms: 2e-5
    (run,) = run_controllers(vehicle, [designed], Step(0.01, 0.0, 8.0, 0.1), time)
    pieces = exact(run, ("control_force",))["control_force"]
    leaps = pieces.values[1:, 0] - pieces.values[:-1, -1]
    (known,) = np.flatnonzero(np.abs(leaps) > 1e-6 * np.abs(vertical).max())
    assert pieces.start[known + 1] == pytest.approx(0.05)  # where it comes into view


def test_frequency_responses_are_those_of_time():
    """A sinusoid of the road comes to what the sampled frequency response says, and for short steps the continuous one says."""
    vehicle, designed, h, omega = car(), controller(), 5e-3, 9.0
    time = np.arange(round(160.0 / h)) * h  # the slowest mode then is 1e-12 of its start
    run = sampled_response(designed, RoadInput(vehicle, sinusoid(omega, 10.0), time))
    last = time > 140.0
    shapes = np.stack([np.cos(omega * time[last]), -np.sin(omega * time[last]), np.ones(last.sum())], axis=-1)
    real, imaginary, _ = np.linalg.lstsq(shapes, np.stack([run[name][last] for name in vehicle.linear_model.outputs], -1))[0]
    road = np.linalg.lstsq(shapes, run["road_velocity"][last])[0]
    measured = (real + 1j * imaginary) / (road[0] + 1j * road[1])
    expected = sampled_frequency_response(vehicle, designed, np.array([omega]), h)[0, :, 0]
    np.testing.assert_allclose(measured, expected, rtol=0, atol=1e-9 * np.abs(expected).max())  # what is left of free motion
    continuous = continuous_frequency_response(vehicle, designed, np.array([omega]))[0, :, 0]
    apart = [
        np.abs(sampled_frequency_response(vehicle, designed, np.array([omega]), step)[0, :, 0] - continuous).max()
        for step in (1e-3, 5e-4)
    ]
    assert apart[0] == pytest.approx(2 * apart[1], rel=0.05)  # held forces: of first order in the step


def test_expected_values_are_those_of_the_spectrum():
    """The expected rms on a random road is the integral of the sampled frequency response over its lines, summed by hand."""
    vehicle, designed, road = car(), controller(), Iso8608("C", speed=20.0)
    found = expect(vehicle, designed, road.spectrum, 2e-3, 10.0)
    assert found is not None
    omega = 2 * np.pi * 20.0 * road.n
    i = vehicle.linear_model.outputs.index("suspension_deflection")
    lines = np.abs(sampled_frequency_response(vehicle, designed, omega, 2e-3)[:, i, 0]) ** 2
    rms = np.sqrt(road.spectrum.density * np.sum(lines) * 20.0 / road.length)
    assert found.mean["suspension_deflection_rms"] == pytest.approx(rms, rel=1e-3)  # of second order in the lines' spacing


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A log of a run over the bump."""
    folder = tmp_path_factory.mktemp("log")
    (folder / "car.toml").write_text(car().text, encoding="utf-8")
    arguments = ["--vehicle", str(folder / "car.toml"), "--controller", "ahead", "--duration", "0.2", "--logs", str(folder)]
    assert bump.main(arguments) == 0
    (path,) = folder.glob("*.mcap")
    return path


def test_a_log_proves_it(log, capsys):
    """A log has the preview in numbers, and its replay answers the road as they do."""
    assert main_of("sim.inspect")([str(log), "-v"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "also uses the road 0.3 s ahead" in printed


def changed(preview: Mapping[str, Any], **parts: Any) -> str:
    """Returns a preview in numbers with other parts."""
    return json.dumps({**preview, **parts})


@pytest.mark.parametrize(
    ("forged", "said"),
    [
        ({"C": 1.001}, "of its peak"),
        ({"seconds": 0.5}, "the logged preview is 0.5 s, but the preview in vehicle.toml is 0.3 s"),
        ({"B": "none"}, "B has shape (); expected a matrix"),
    ],
)
def test_a_forged_preview_is_found(log, forged, said):
    """Numbers of a preview that are others than those that drove the vehicle, or none, do not hold."""
    whole = read_log(log)
    (run,) = whole.runs
    preview = json.loads(run.claims["preview"])
    parts = {name: (np.array(preview[name]) * value).tolist() if name == "C" else value for name, value in forged.items()}
    claims = {**run.claims, "preview": changed(preview, **parts)}
    proof = prove(dataclasses.replace(whole, runs=[dataclasses.replace(run, claims=claims)]))
    assert not proof.holds
    assert any(said in finding.text for one in proof.runs for finding in one.findings)


def test_a_filter_has_states_that_none_measures():
    """A filtered weight, or road, is refused in a line about previews."""
    text = car().text.replace("[performance]", "[performance]\nroad = { numerator = [1.0], denominator = [1.0, 5.0] }", 1)
    with refused("a design with preview must measure all states", "give constant weights"):
        Designer(parse_vehicle(text)).design("ahead")


def test_what_holds_a_law_alone_refuses_it(tmp_path):
    """Saved sections, exports and state-space systems hold a law of what is measured, and say that a preview is none."""
    vehicle, designed, said = car(), controller(), "controller 'ahead' has a preview of the road"
    for holds in (
        lambda: saved_text(tmp_path / "saved.toml", vehicle, [designed]),
        lambda: law_system(vehicle, designed),
        lambda: closed_loop(vehicle, designed),
        lambda: mat_file(vehicle, [designed]),
    ):
        with refused(said, "choose a controller without preview"):
            holds()


def test_a_file_of_many_leaves_it_out(tmp_path, capsys):
    """A saved vehicle and a file for MATLAB hold the other controllers, and name the one with a preview as left out."""
    (tmp_path / "car.toml").write_text(car().text, encoding="utf-8")
    for option, name in (("--save", "saved.toml"), ("--export", "laws.mat")):
        command = ["--vehicle", str(tmp_path / "car.toml"), option, str(tmp_path / name)]
        assert (
            main_of("synth")([*command, *(["--controller", "lqr", "--controller", "ahead"] if option == "--save" else [])]) == 0
        )
        assert "omitted: ahead, because this file cannot contain a preview" in capsys.readouterr().out
    saved = read_vehicle(tmp_path / "saved.toml").controllers
    assert "lqr_designed" in saved
    assert "ahead_designed" not in saved
    assert b"lqr" in (tmp_path / "laws.mat").read_bytes()


CAMPAIGN = """
vehicles = ["half_car.toml"]
controllers = ["ahead"]
roads = ["bump:height=0.01"]
speeds = [10.0, 12.5]
duration = 0.8
settle = 0.1
timestep = 1e-3
"""


def test_a_campaign_compares_it(tmp_path):
    """Every row of a campaign has the exact linear response with the road ahead beside MuJoCo's, and its metrics."""
    parquet = pytest.importorskip("pyarrow.parquet", reason="needs the extra [campaign]")
    (tmp_path / "half_car.toml").write_text(car("half_car").text, encoding="utf-8")
    (tmp_path / "campaign.toml").write_text(CAMPAIGN, encoding="utf-8")
    arguments = [str(tmp_path / "campaign.toml"), "--results", str(tmp_path / "results"), "--workers", "1"]
    assert main_of("sim.campaign")(arguments) == 0
    rows = parquet.read_table(tmp_path / "results" / "results.parquet").to_pylist()
    assert len(rows) == 2
    for row in rows:
        assert row["linear_error"] < 1e-4  # RK4 at 1 ms, 4e-6, and the geometry of a bump of 10 mm
        for name in ("sprung_acceleration_front_rms", "control_force_front_rms", "dynamic_load_front"):
            assert row[f"linear_{name}"] == pytest.approx(row[name], rel=1e-3)  # accelerations are metered midway
