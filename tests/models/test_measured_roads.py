"""Measured roads: the start in steady motion, straight lines between points, `--from`, one road in MuJoCo and analysis."""

import itertools
import json
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy import linalg

import sim.linear.sampled_response
from models.common.errors import InputError
from models.roads.choice import choose_road
from models.roads.iri import roughness_of
from models.roads.opencrg import read_surface
from models.roads.profile import Profile
from models.roads.rig import Rig
from models.roads.road import RoadInput
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.campaign.__main__ import main as campaign
from sim.drive.__main__ import main
from sim.drive.case import Case, batch_of
from sim.inspect.__main__ import main as inspect
from sim.linear.sampled_response import continuous_response
from sim.observers.steps import EXACT
from sim.runs.run import Run, replay_driver, run_controllers, sample_times
from sim.runs.start import start_effect
from synth.vehicle.designer import Designer, design
from tests.support.commands import prose, refused

UNEVEN = Path(__file__).parent / "uneven_profile.csv"
V, GRID = 20.0, 1e-4  # m/s; s, on which all kinks under all wheels of these vehicles lie
CORNERS = {
    "quarter_car": ("",),
    "half_car": ("_front", "_rear"),
    "full_car": tuple(f"_{a}_{s}" for a in ("front", "rear") for s in ("left", "right")),
}


@cache
def car(kind: str, damping: float = 0.0) -> Vehicle:
    """A vehicle that ships, with tyres that damp [N s/m]."""
    more = {"quarter_car": ("",)}.get(kind, ("_front", "_rear"))
    lines = "".join(f"tyre_damping{axle} = {damping}\n" for axle in more) if damping else ""
    return parse_vehicle(read_vehicle(kind).text.replace("[parameters]\n", f"[parameters]\n{lines}"))


def points(bank: float, slope: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """A rough road at uneven distances: stations [m], heights [m] of the left and the right track."""
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.integers(15, 250, 120)) * V * GRID + 340.0
    z = np.cumsum(rng.normal(0, 0.002, (120, 2)), axis=0) * [1.0, 0.3]
    z[:, 1] += 0.7 * z[:, 0]
    return x, 212.0 + slope * (x - x[0])[:, None] + z + [bank / 2, -bank / 2]


def own_response(vehicle: Vehicle, x: np.ndarray, z: np.ndarray, duration: float) -> dict[str, np.ndarray]:
    """Signals every `GRID` seconds of a passive car in absolute heights, by matrix exponentials of its equations of motion."""
    p, ends = vehicle.parameters, CORNERS[vehicle.kind.name]
    axle = ["_" + end.split("_")[1] if end else "" for end in ends]
    forward = np.array(
        [{"": 0.0, "_front": p.get("axle_distance_front"), "_rear": -p.get("axle_distance_rear", 0)}[a] for a in axle]
    )
    lateral = np.array([0.5 * p.get("track", 0) * (end.endswith("left") - end.endswith("right")) for end in ends])
    k, c, kt, m_u = (np.array([p[f"{name}{a}"] for a in axle]) for name in (
        "suspension_stiffness", "suspension_damping", "tyre_stiffness", "unsprung_mass"))  # fmt: skip
    ct = np.array([p.get(f"tyre_damping{a}", 0.0) for a in axle])
    S = np.stack([np.ones(len(ends)), -forward, lateral], axis=1)[:, : {1: 1, 2: 2, 4: 3}[len(ends)]]
    body = [p["sprung_mass"], p.get("pitch_inertia"), p.get("roll_inertia")][: S.shape[1]]
    r, q = len(ends), S.shape[1]
    D, U = np.hstack([S, -np.eye(r)]), np.hstack([np.zeros((r, q)), np.eye(r)])  # deflections, hubs
    inverse = np.diag(1 / np.array([*body, *m_u]))
    K, C = D.T @ np.diag(k) @ D + U.T @ np.diag(kt) @ U, D.T @ np.diag(c) @ D + U.T @ np.diag(ct) @ U
    n = q + r
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ C]])
    on_z, on_w = (np.vstack([np.zeros((n, r)), inverse @ U.T @ np.diag(one)]) for one in (kt, ct))
    whole = np.block([[A, on_z, on_w], [np.zeros((r, 2 * n + r)), np.eye(r)], [np.zeros((r, 2 * n + 2 * r))]])
    step = linalg.expm(whole * GRID)[: 2 * n]

    sides = [int(end.endswith("right")) for end in ends]
    tracks = z if r == 4 else z[:, [0, 0]]
    reach = [np.interp(x[0] + 11.0, x, track) - track[0] for track in tracks.T]
    slope, datum = np.mean(reach) / 11.0, tracks[0].mean()
    at = V * GRID * np.arange(round(duration / GRID) + 2)[:, None] + (forward - forward[0])
    road = np.stack([
        np.where(s < 0, tracks[0, i] + slope * s, np.interp(s + x[0], x, tracks[:, i])) for s, i in zip(at.T, sides, strict=True)
    ], axis=1) - datum  # fmt: skip
    bank = np.diff(tracks[0])[0] / -p.get("track", 1.0)
    state = np.concatenate([[-slope * forward[0], -slope, bank][:q], road[0], V * slope * np.eye(1, q)[0], np.full(r, V * slope)])
    rates, states = np.diff(road, axis=0) / GRID, []
    for z_r, w in zip(road, rates, strict=False):
        states.append(state)
        state = step @ np.concatenate([state, z_r, w])
    y, dy = np.array(states)[:, :n], np.array(states)[:, n:]
    found = {"sprung_velocity" if r == 1 else "heave_velocity": dy[:, 0]}
    for i, end in enumerate(ends):
        found |= {f"suspension_deflection{end}": y @ D[i], f"tyre_deflection{end}": y @ U[i] - road[:-1, i]}
        found |= {f"unsprung_velocity{end}": dy @ U[i], f"road_displacement{end}": road[:-1, i]}
    return found


def driven(vehicle: Vehicle, road, duration: float, name: str = "passive") -> Run:
    """A run with 1 ms a step."""
    return run_controllers(vehicle, [design(vehicle, name)], road, sample_times(vehicle, duration, 1e-3))[0]


@pytest.mark.parametrize(("kind", "damping"), [("quarter_car", 900.0), ("half_car", 0.0), ("full_car", 900.0)])
def test_every_car_is_in_steady_motion_at_first(kind, damping):
    """On a banked, rough climb at uneven points every signal is that of an own integration in absolute heights."""
    vehicle, (x, z) = car(kind, damping), points(bank=0.06, slope=0.04)
    run = driven(vehicle, Profile(x, z, V), 0.3)
    own = own_response(vehicle, x, z, 0.3)
    assert run.passed
    for name, exact in own.items():
        size = np.abs(exact).max()
        # Rounding of 212 m over 11 m, at V, is 1e-12 of a velocity.
        assert np.abs(run.continuous[name] - exact[:3001:10]).max() < 1e-9 * size, name
        # MuJoCo holds the road for 1 ms, in which a wheel at 10 Hz turns by 0.06 rad.
        assert np.abs(run.physics[name] - exact[:3001:10]).max() < 0.06 * size, name
    assert run.agreement.steps is not None
    assert run.agreement.steps.error < EXACT
    if kind == "full_car":  # the bank is kept, and the body leans by it from the start
        left, right = (run.physics[f"road_displacement_front_{side}"][0] for side in ("left", "right"))
        assert left - right == pytest.approx(z[0, 0] - z[0, 1], rel=1e-12)
        roll = sum(share * run.physics[name][0] for name, share in vehicle.kind.angles(vehicle.parameters)["roll_angle"].items())
        assert roll == pytest.approx((left - right) / vehicle.parameters["track"], rel=1e-9)


def dense(join: str):
    """A road with a point every 4 mm, five in a timestep at V, rough at every point; or posts that move so."""
    rng, x = np.random.default_rng(3), np.arange(0, 6, 0.004)
    z = rng.normal(0, 5e-4, len(x)) + np.interp(x, np.arange(7), rng.normal(0, 2e-3, 7))
    return Rig(x / V, z[:, None], ("road_displacement",)) if join == "rig" else Profile(x, np.stack([z, z], axis=1), V, join=join)


@pytest.mark.parametrize("join", ["straight", "smooth", "rig"])
def test_points_closer_than_a_step_do_not_alias(join):
    """Over five points a step MuJoCo moves as the car over the continuous road does, which no step holds."""
    vehicle, road = car("quarter_car"), dense(join)
    run = driven(vehicle, road, 0.3)
    assert run.passed
    for name in ("sprung_velocity", "unsprung_velocity"):
        # Holding means turns a wave of w rad/s into 1 - (w h)^2 / 24: 1e-3 at 150 rad/s, above which a hub hardly moves.
        assert np.abs(run.physics[name] - run.continuous[name]).max() < 2e-3 * run.continuous.scale(name), name
    on = run.prediction.input
    batch = batch_of([Case(vehicle, replay_driver(run.prediction, on.time), road)], on.time, [0], streamed=True)  # of a campaign
    assert batch.midway[:, 0] == pytest.approx(on.midway, abs=1e-15)  # times are rounded otherwise
    t, h = np.arange(-0.01, road.duration + 0.01, 0.0137), 7e-3
    fine = (np.arange(20000) + 0.5) / 20000 * h - h / 2  # midpoints: lines and cubics to (h / 20000)^2 beside kinks
    mean = road.departure(t[:, None] + fine, "").mean(axis=1)
    assert road.mean_departure(t, h, "") == pytest.approx(mean, abs=1e-8)


@pytest.mark.parametrize("kind", CORNERS)
def test_a_climb_has_no_bump(kind):
    """On a steady climb with a bank nothing moves for passive and for a law that measures velocities, and the car climbs."""
    vehicle, x = car(kind), np.arange(0, 60, 0.5)
    z = np.round(0.05 * x, 4)[:, None] + [0.03, -0.03]
    for name in ("passive", "I"):
        run = driven(vehicle, Profile(x, z, V), 0.3, name)
        assert run.passed
        for response in (run.physics, run.sampled, run.continuous):
            for signal in vehicle.kind.suspensions:
                assert np.abs(response[signal.deflection]).max() < 1e-12, signal  # m; MuJoCo's rounding at equilibrium
            climbing = response["sprung_velocity" if kind == "quarter_car" else "heave_velocity"]
            assert climbing == pytest.approx(0.05 * V, rel=1e-12)


def test_the_crest_is_felt_where_it_is(tmp_path):
    """A road that climbs and then is level moves the car when the first wheel is at its kink, and not before."""
    x = np.arange(0, 40, 0.5)
    run = driven(car("quarter_car"), Profile(x, np.minimum(0.05 * x, 0.6)[:, None] * np.ones(2), V), 1.5)
    travel = np.abs(run.physics["suspension_deflection"])
    assert travel[: round(12 / V / 1e-3)].max() < 1e-12
    assert travel.max() > 0.03
    assert run.physics["road_displacement"][[0, -1]] == pytest.approx([0, 0.6])


def test_a_climb_in_a_file(tmp_path, capsys):
    """A 5 % climb in a file has no travel and no remark, its own IRI of 0, and goes on straight behind its end."""
    rows = [f"{x:.4f},{0.05 * x:.4f}" for x in np.arange(0, 50, 0.5)]
    (tmp_path / "grade.csv").write_text("\n".join(["distance [m],height [m]", *rows, "", ",", ";"]).replace(";", ",,"))
    arguments = ["--controller", "passive", "--road", str(tmp_path / "grade.csv"), "--speed", "22.2222", "--no-logs"]
    assert main([*arguments, "--duration", "4", "--json"]) == 0
    signals = json.loads(capsys.readouterr().out)["runs"][0]["signals"]
    assert signals["suspension_deflection"]["peak"]["mujoco"] < 1e-12
    assert main([*arguments, "--duration", "0.3"]) == 0
    assert "remark" not in capsys.readouterr().out


def test_uneven_profile(capsys):
    """The measured profile that ships with the tests has the travel and the IRI of independent calculations; smooth is more."""
    arguments = ["--controller", "passive", "--road", str(UNEVEN), "--speed", "22.2222", "--duration", "4", "--no-logs", "--json"]
    assert main(arguments) == 0
    result = json.loads(capsys.readouterr().out)
    travel = result["runs"][0]["signals"]["suspension_deflection"]["peak"]
    assert travel["mujoco"] == pytest.approx(0.0239, abs=5e-5)  # as it was given, in mm to a decimal
    assert result["iri"]["iri"]["road"] == pytest.approx(3.95, abs=5e-3)
    profile = choose_road(f"{UNEVEN}:join=smooth").build(car("quarter_car"), 22.2222, 0, 1.0)
    (smooth,) = roughness_of(profile, car("quarter_car"), 88.9)
    assert 1.03 < smooth.iri / 3.95 < 1.12  # a cubic swings between points


@pytest.mark.parametrize("kind", ["quarter_car", "full_car"])
def test_steps_with_kinks_are_exact(kind, monkeypatch):
    """The interpolated exponentials are exact over a measured road's kinks, preview and tyres that damp included."""
    ahead = '\n[controllers.ahead]\ndesign = "preview"\npreview = 0.1\n' if kind == "quarter_car" else ""
    vehicle = parse_vehicle(car(kind).text + ahead)
    cars = [
        (vehicle, Designer(vehicle).design("ahead" if ahead else "I")),
        (car(kind, 900.0), design(car(kind, 900.0), "passive")),
    ]
    for one, controller in cars:
        on = RoadInput(one, Profile(*points(0.02, 0.01), V), np.arange(200) * 1e-3)
        usual = continuous_response(controller, on)
        monkeypatch.setattr(sim.linear.sampled_response, "CHEBYSHEV", 24)
        finer = continuous_response(controller, on)
        monkeypatch.undo()
        for name in usual.names:
            assert np.abs(usual[name] - finer[name]).max() <= 1e-12 * usual.scale(name), name  # rounding of some hundred steps


def test_from_is_the_rest_of_the_file(tmp_path):
    """A road from a distance on is the road of a file that begins there, for tables and settings alike."""
    x, z = points(0.05, 0.01)
    rows = "\n".join(",".join(map(repr, row)) for row in np.column_stack([x, z]).tolist())
    (tmp_path / "road.csv").write_text(rows)
    start = float(x[20] + x[21]) / 2
    found = choose_road(f"road.csv:from={start!r}", tmp_path).build(car("full_car"), V, 0, 10.0)
    there = np.concatenate([[start], x[21:]])
    cut = Profile(there, np.stack([np.interp(there, x, track) for track in z.T], axis=1), V)
    t = np.linspace(-0.2, 2.0, 100)
    for side in ("left", "right"):
        assert np.array_equal(found.displacement(t, side), cut.displacement(t, side))
    assert found.describe()["from"] == start
    whole = f"start at a distance from {x[0]} m to less than {x[-1]} m"
    for text in ("road.csv:from=3", "road.csv:from=1e4", f"road.csv:from={float(x[-1])!r}"):
        with refused(f"from = {float(text.split('=')[1]):g} m is not on the road; {whole}"):
            choose_road(text, tmp_path)


def test_a_log_of_a_measured_road(tmp_path, capsys):
    """A log of a drive from a distance on proves what it claims, from the log alone."""
    arguments = ["--controller", "I", "--road", str(UNEVEN), "--from", "20", "--duration", "0.5", "--logs", str(tmp_path)]
    assert main(arguments) == 0
    assert "remark: the unknown road before the start could change" in prose(capsys.readouterr().out)
    (log,) = tmp_path.glob("*.mcap")
    assert inspect([str(log), "--json"]) == 0
    capsys.readouterr()


@pytest.mark.attack
def test_a_campaign_over_measured_roads(tmp_path, capsys):
    """A campaign over a measured road has the travel of `sim.drive`, verifies, and tells roads by where they begin."""
    text = (
        'vehicles = ["quarter_car", "full_car"]\ncontrollers = ["passive"]\nspeeds = [22.2222]\nduration = 2.0\n'
        f'roads = ["{UNEVEN}", "{UNEVEN}:from=20", "{UNEVEN}:join=smooth"]\n'
    )
    (tmp_path / "campaign.toml").write_text(text)
    assert campaign([str(tmp_path / "campaign.toml"), "--results", str(tmp_path / "out")]) == 0
    rows = pq.read_table(tmp_path / "out" / "results.parquet").to_pylist()
    for row in rows:
        (run,) = [driven(car(row["vehicle"]), choose_road(row["road"]).build(car(row["vehicle"]), 22.2222, 0, 10.0), 2.0)]
        assert row["linear_error"] < 1e-3  # geometry, over some centimetres
        names = [part.deflection for part in car(row["vehicle"]).kind.suspensions]
        peak = max(float(run.physics.peak(name)) for name in names)
        assert max(row[f"{name}_peak"] for name in names) == pytest.approx(peak, rel=1e-12)  # sums in another order
    assert len(rows) == 6
    assert campaign(["--verify", str(tmp_path / "out")]) == 0
    assert "roads.csv" not in capsys.readouterr().err
    (tmp_path / "roads.csv").write_text("0,0\n1,0\n2,0\n3,0\n40,0\n")
    (tmp_path / "gap.toml").write_text(text.replace(f'"{UNEVEN}"', '"roads.csv"'))
    assert campaign([str(tmp_path / "gap.toml"), "--results", str(tmp_path / "gap")]) == 0
    err = prose(capsys.readouterr().err)
    assert "remark: road 'roads.csv': there is no point between 3 m and 40 m" in err
    assert "remark: road 'roads.csv' is shorter than a run of 2 s at 22.2222 m/s; the straight road after its last point" in err
    (tmp_path / "twice.toml").write_text(text.replace(":join=smooth", ":join=straight"))
    with pytest.raises(InputError, match="are the same"):
        campaign([str(tmp_path / "twice.toml"), "--results", str(tmp_path / "no")])
    capsys.readouterr()


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (
            "0,0\n1,0\n2,1e5\n3,0\n",
            "3 m long in steps of 1 m, with heights from 0 to 1e+05 m. Its rms slope of 8.16e+04 is steeper",
        ),
        (
            "0,0\n.001,.02\n.002,-.01\n.003,0\n4,0\n",
            "heights from -0.01 to 0.02 m. Its rms slope of 18.7 is steeper than that of real",
        ),
        ("0,0\n1,20\n2,-10\n3,0\n", "give the right units, as in :distance_unit=km or :height_unit=mm"),
    ],
)
def test_no_road_is_that_steep(tmp_path, rows, said):
    """Numbers in wrong units are told by the slope of what is driven."""
    (tmp_path / "road.csv").write_text(rows)
    with refused(said):
        main(["--controller", "passive", "--road", str(tmp_path / "road.csv"), "--duration", "0.2", "--no-logs"])


def test_a_mountain_road_is_driven(tmp_path, capsys):
    """A road may climb by 700 m in points 50 m apart, and what is not driven may be absurd."""
    x = np.arange(0.0, 10000, 50)
    rows = [f"{a},{b}" for a, b in zip(x, 20 + 0.07 * x + np.sin(x), strict=True)]
    (tmp_path / "pass.csv").write_text("\n".join(["distance [m],altitude [m]", *rows, "9951,8000"]))
    arguments = ["--controller", "passive", "--road", str(tmp_path / "pass.csv"), "--no-logs", "--duration", "1"]
    assert main([*arguments, "--from", "9000", "-v", "--vehicle", "half_car", "--load", "brake:g=0.1"]) == 0
    assert "no iri: the road's points are 50 m apart, but ASTM E1926 allows at most 0.3 m" in prose(capsys.readouterr().out)
    with refused("steeper than that of real roads"):
        main([*arguments, "--from", "9940"])
    assert "there is no point" not in capsys.readouterr().err


def test_lines_need_two_points(tmp_path, capsys):
    """Straight lines take two points and a wide gap, which is remarked, as heights of no road are; a spline takes four."""
    (tmp_path / "road.csv").write_text("distance [m],height [m]\n0,0\n20,0.1\n40,0.1\n100,0.1\n")
    (tmp_path / "flat.csv").write_text("0,0\n1,0\n2,0.02\n3,0\n40,0\n")
    road = choose_road("road.csv:from=30", tmp_path).build(car("quarter_car"), V, 0, 10.0)
    assert road.describe()["points"] == 3
    arguments = ["--controller", "passive", "--no-logs", "--brief", "--duration", "0.5", "--road"]
    assert main([*arguments, str(tmp_path / "flat.csv")]) == 0
    assert "there is no point between 3 m and 40 m, but other points are 1 m apart" in capsys.readouterr().err
    assert main([*arguments, str(tmp_path / "road.csv")]) == 0
    assert "remark" not in capsys.readouterr().err
    (tmp_path / "road.csv").write_text("distance [m],height [mm]\n0,0\n1,0.001\n2,0.04\n3,0.02\n12,0\n")  # heights in m
    assert main([*arguments, str(tmp_path / "road.csv")]) == 0
    assert "rms; no road is so smooth: check the units of heights" in capsys.readouterr().err
    (tmp_path / "road.csv").write_text("distance [m],height [m]\n0,0\n20,0.1\n40,0.1\n100,0.1\n")
    with refused("a smooth profile needs at least 4 points, but this one has 3"):
        choose_road("road.csv:from=30:join=smooth", tmp_path)
    with refused("gap from 3 m to 40 m"):
        choose_road("flat.csv:join=smooth", tmp_path)


def test_the_start_is_remarked_where_it_counts():
    """A start that the road before could change shows in a peak soon after it, not in a bump that comes when it has died away."""
    x = np.arange(0, 200, 0.25)
    rough = np.cumsum(np.random.default_rng(2).normal(0, 0.001, len(x)))
    vehicle = read_vehicle("half_car")
    late = rough + np.where((x > 170) & (x < 173), 0.1 * np.sin(np.pi * (x - 170) / 3) ** 2, 0.0)
    effects = [
        start_effect([driven(vehicle, Profile(x, z[:, None] * np.ones(2), V), time)]) for z, time in ((rough, 1), (late, 9.5))
    ]
    assert effects[0] is not None
    assert effects[0][0] > 0.02
    assert effects[1] is None


@pytest.mark.parametrize("name", ["passive", "I"])
def test_a_motionless_start_has_no_share(name):
    """Nothing is a share of the rounding that a steady climb leaves, though a road before it might have moved the car."""
    x = np.array([0.0, 10, 20, 40, 60, 80, 100])
    run = driven(car("quarter_car"), Profile(x, np.minimum(0.08 * x, 3.2)[:, None] * np.ones(2), 10.0), 3.0, name)
    assert np.abs(run.physics["sprung_acceleration"]).max() < 1e-12
    assert start_effect([run]) is None


def test_earlier_is_advised_where_there_is_a_road(capsys):
    """A run from the first point of a file on cannot start earlier; one that starts later can."""
    arguments = ["--controller", "passive", "--road", f"{UNEVEN}", "--duration", "0.5", "--no-logs"]
    assert main(arguments) == 0
    assert "; start elsewhere with --from" in prose(capsys.readouterr().out)
    assert main([*arguments[:3], f"{UNEVEN}:from=2000cm", *arguments[4:]]) == 0
    assert "start earlier or elsewhere with --from" in prose(capsys.readouterr().out)


def test_posts_start_at_rest_where_they_are():
    """Posts of different first heights keep their offsets, and the vehicle stands on them at rest, twisted as they are."""
    vehicle, t = read_vehicle("full_car"), np.arange(0, 1, 0.01)
    first = np.array([0.02, 0.0, 0.0, 0.01])
    moves = first + 0.004 * (1 - np.cos(2 * np.pi * 2 * t))[:, None]
    run = driven(vehicle, Rig(t, moves, CORNERS_OF_POSTS), 0.8)
    assert run.passed
    for name, height in zip(CORNERS_OF_POSTS, first, strict=True):
        assert run.physics[f"road_displacement_{name}"][0] == pytest.approx(height - first.mean(), abs=1e-15)
    model = vehicle.linear_model
    rest = np.linalg.solve(model.A, -model.Br @ (first - first.mean()))
    for name, value in zip(model.states, rest, strict=True):
        assert run.sampled[name][0] == pytest.approx(value, abs=1e-12)
        assert run.physics[name][0] == pytest.approx(value, abs=1e-12)
    assert np.abs(rest).max() > 1e-3


CORNERS_OF_POSTS = tuple(end[1:] for end in CORNERS["full_car"])


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (
            "road.dat",
            "the file exists, but '.dat' files cannot be read (readable are .csv, .txt, .xlsx and .mat files with columns",
        ),
        ("road", "the file exists, but its name has no ending (readable are .csv"),
        ("drive.rsp", "rename or convert the file; RPC III files (.rsp, .drv) cannot be read"),
    ],
)
def test_files_of_other_types(name, said, tmp_path):
    """A file that exists is not called an unknown road: what is read, and what to do, is said."""
    (tmp_path / name).write_text("0,0\n")
    for text in (name, f"{name}:columns=1,2"):
        with refused(said):
            choose_road(text, tmp_path)
    (tmp_path / "folder").mkdir()
    with refused("); give a file in this folder"):
        choose_road("folder", tmp_path)
    with refused("unknown road 'none.dat'"):
        choose_road("none.dat", tmp_path)


RDF = """! road data file
[UNITS]
LENGTH = 'mm'
[MODEL]
ROAD_TYPE = 'poly_line'  $ heights over distance
[PARAMETERS]
OFFSET = 0
(XZ_DATA)
{x zl zr}
-9000 -1 0 $ far behind the start
1000 4 10
1020 -100 -100
1031 50 50
5000 0 0
[OTHER]
ROTATION = 0.0
"""


def test_poly_line(tmp_path):
    """A road of a tyre model begins at its distance 0, in its own unit; other types and cut files are refused in one line."""
    (tmp_path / "road.rdf").write_text(RDF)
    profile = choose_road("road.rdf", tmp_path).build(car("full_car"), V, 0, 10.0)
    assert isinstance(profile, Profile)
    assert profile.distance == pytest.approx([0, 1, 1.02, 1.031, 5])
    assert profile.heights == pytest.approx(np.array([[3.5, 9], [4, 10], [-100, -100], [50, 50], [0, 0]]) / 1e3)
    for old, new, said in (
        ("'poly_line'", "'sine'", "ROAD_TYPE = 'sine' cannot be read"),
        ("(XZ_DATA)", "", "has no table (XZ_DATA)"),
        ("1020 -100", "1020 x", "line 12, column 2: 'x' is not a finite number"),
        ("'mm'", "'furlong'", "has the unit 'furlong' (allowed: "),
        ("LENGTH = 'mm'", "", "has no LENGTH in [UNITS]"),
        ("OFFSET = 0", "ROTATION_ANGLE_XY_PLANE = 90 $ degrees", "ROTATION_ANGLE_XY_PLANE = 90 rotates the road"),
    ):
        (tmp_path / "road.rdf").write_text(RDF.replace(old, new))
        with refused(said):
            choose_road("road.rdf", tmp_path)


def test_a_step_and_distances(tmp_path):
    """Two columns without headings are two tracks, but not if the first rises evenly by about the step, in m or ft."""
    x, z = 478.0 + 0.25 * np.arange(40), np.cumsum(np.random.default_rng(1).normal(0, 0.003, (40, 2)), axis=0)
    for distance in (x, x / 0.3048):
        np.savetxt(tmp_path / "road.txt", np.column_stack([distance, z[:, 1]]), "%.4f")
        with refused("step is given, but the file has distances"):
            choose_road("road.txt:step=0.25", tmp_path)
    second = choose_road("road.txt:step=0.25:columns=2", tmp_path).profile
    rising = z + 0.1 * (x - x[0])[:, None]  # a steep hill
    np.savetxt(tmp_path / "road.txt", rising, "%.9f")
    both = choose_road("road.txt:step=0.25", tmp_path).profile
    assert second is not None
    assert both is not None
    np.testing.assert_allclose(second.heights, z[:, [1, 1]], atol=1e-4)
    np.testing.assert_allclose(both.heights, rising, atol=1e-8)


def test_a_public_rough_road(tmp_path):
    """A public road of a tyre model, sines of 0.1 m in points 0.2 m apart, is that of exact exponentials under a quarter-car."""
    x, z = np.append([-1e4, 0.0, 40.0], 40 + 0.2 * np.arange(1, 151)), np.zeros(153)
    z[3:] = np.round(0.1 * np.sin(0.04 * np.pi * np.arange(1, 151)), 3)
    rows = "".join(f"{a:.3f} {b:.3f} {b:.3f}\n" for a, b in zip(x, z, strict=True))
    (tmp_path / "rough.rdf").write_text(f"[MODEL]\nROAD_TYPE = 'poly_line'\n[UNITS]\nLENGTH = 'meter'\n(XZ_DATA)\n{rows}")
    vehicle, time = car("quarter_car"), np.arange(0, 4.6, 1e-3)
    road = choose_road("rough.rdf", tmp_path).build(vehicle, 15.0, 0, 69.0)
    ms, mu, ks, cs, kt = vehicle.parameters.values()
    A = np.zeros((6, 6))
    A[0, 1] = A[2, 3] = A[4, 5] = 1
    A[1, :4], A[3, :5] = np.array([-ks, -cs, ks, cs]) / ms, np.array([ks, cs, -ks - kt, -cs, kt]) / mu
    ends = np.unique(np.concatenate([time, x[(x > 0) & (x < 69)] / 15.0]))
    state, travel = np.zeros(4), {0.0: 0.0}
    for start, end in itertools.pairwise(ends):
        low, high = np.interp([15 * start, 15 * end], x, z)
        state = (linalg.expm(A * (end - start)) @ [*state, low, (high - low) / (end - start)])[:4]
        travel[end] = state[0] - state[2]
    response = continuous_response(design(vehicle, "passive"), RoadInput(vehicle, road, time))
    own = np.array([travel[t] for t in time])
    assert response["suspension_deflection"] == pytest.approx(own, abs=1e-9 * np.abs(own).max())


@pytest.mark.extra
def test_opencrg_between_its_lines(tmp_path):
    """Between the lines of an OpenCRG grid a wheel's height is PyOpenCRG's own, bilinear, also from a distance on."""
    pyopencrg = pytest.importorskip("pyopencrg")
    rng = np.random.default_rng(5)
    surface = pyopencrg.CrgRoad(rng.normal(0, 0.01, (300, 9)).cumsum(axis=0), u_inc=0.1, v=np.arange(-1, 1.01, 0.25))
    surface.save(tmp_path / "road.crg", fmt="KDBI")
    again = pyopencrg.CrgRoad.read(tmp_path / "road.crg")
    u = np.random.default_rng(6).uniform(12.0, 29.0, 200)
    for text, start in (("road.crg", 0.0), ("road.crg:from=11.03", 11.03)):
        road = choose_road(text, tmp_path).build(car("full_car"), V, 0, 10.0)
        tracks = {side: again.uv_to_z(u, np.full(len(u), y)) for side, y in (("left", 0.755), ("right", -0.755))}
        first = [float(again.uv_to_z(np.array([start]), np.array([y]))[0]) for y in (0.755, -0.755)]
        for side, heights in tracks.items():
            assert road.displacement((u - start) / V, side) == pytest.approx(heights - np.mean(first), abs=1e-9)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "names.crg").write_text("$CT\n$ROAD_CRG_FILE\n ../road.crg ! data are there\n$\n")
    there = read_surface(tmp_path / "other" / "names.crg")
    assert np.array_equal(there.z, read_surface(tmp_path / "road.crg").z)
    with refused("OpenCRG file contains its own units", "the name 'join' in 'join=smooth' is unknown; give one of from"):
        choose_road("road.crg:join=smooth", tmp_path)
