"""Loads on the body: what they push with, in MuJoCo as in linear analysis, and what the commands say of them."""

import dataclasses
import itertools
import json
import math
import re

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.integrate import solve_ivp

import sim.command.comparison
from models.common.errors import InputError
from models.kinds.kind import GRAVITY
from models.kinds.rigid_motion import SHORTEST, STRUT
from models.roads.choice import choose_road
from models.roads.description import described_road
from models.roads.iso8608 import Iso8608
from models.roads.loads.choice import History, choose_load
from models.roads.loads.load import LOADS
from models.roads.loads.road_with_loads import RoadWithLoads
from models.roads.obstacles import Flat
from models.roads.road import Bump, RoadInput, delays, under_wheels
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.campaign.__main__ import main as campaign
from sim.drive.__main__ import main
from sim.drive.regime import LIFT_OFF
from sim.drive.response import Response
from sim.inspect.__main__ import main as inspect
from sim.runs.report import INVALID_EQUATIONS, NO_STATE, reasons, verdict
from sim.runs.run import run_controllers, sample_times
from sim.studies.ride.metrics import PITCH, ROLL, Meter, measure
from sim.studies.ride.run_metrics import static_angles
from tests.support.analysed import continuous_response, energy, sampled_response, simulate
from tests.support.analysed import simulate_inputs as simulate_inputs
from tests.support.commands import attacks, in_the_suite, once, prose
from tests.support.shared import designed

BAR = "[parameters]\nanti_roll_stiffness_front = 2e4"
REALITIES = {
    "ideal": (Implementation(), Limits()),
    "slow": (Implementation(sample_period=0.004), Limits()),
    "late": (Implementation(sample_period=0.002, delay=3), Limits()),
    "between": (Implementation(sample_period=0.004, delay=1.5), Limits()),
    "lagging": (Implementation(delay=1), Limits(actuator_bandwidth=60.0)),
}
QUARTER = ("flat + payload:mass=60", "bump:height=0.05 + lift:force=-500:hold=0.4:rise=0.1")


def road_of(text, vehicle, speed=20.0, duration=2.0):
    """A road with loads, from its text."""
    return choose_road(text).build(vehicle, speed, 0, speed * duration)


def car(kind, more=""):
    """A car that ships, perhaps with more parameters."""
    return parse_vehicle(read_vehicle(kind).text.replace("[parameters]", more or "[parameters]", 1))


AS_BUILT = [*zip(itertools.cycle(QUARTER), REALITIES, strict=False)]


@pytest.mark.parametrize(
    ("text", "reality"), in_the_suite([(QUARTER[1], "ideal"), *AS_BUILT[-2:]], [*AS_BUILT, (QUARTER[1], "ideal")])
)
def test_exact_in_the_quarter_car(text, reality):
    """However its controller is built, MuJoCo follows the exact sampled response to RK4's own error; no geometry."""
    implementation, limits = REALITIES[reality]
    vehicle = dataclasses.replace(read_vehicle("quarter_car"), implementation=implementation, limits=limits)
    controllers, time = [designed(vehicle, name) for name in ("passive", "I")], sample_times(vehicle, 1.3, 1e-3)
    runs = run_controllers(vehicle, controllers, road_of(text, vehicle), time)
    for run in runs:
        assert run.agreement.agrees
        assert max(one.sampled for one in run.agreement.signals.values()) < 2e-6  # RK4's at 1 ms; measured up to 1.4e-6
        assert run.energy is not None
        assert run.energy.residual < 1e-6  # measured 5e-8


@pytest.mark.parametrize(
    ("name", "reality"), [("I", "ideal"), ("I", "late"), ("accelerometer", "slow"), ("accelerometer", "late")]
)
def test_accelerometers_feel_loads(name, reality):
    """A measured acceleration has the load in it, as it was until then, in MuJoCo as in the response that is predicted."""
    implementation = REALITIES[reality][0]
    vehicle = dataclasses.replace(read_vehicle("quarter_car_accelerometer"), implementation=implementation)
    time, road = sample_times(vehicle, 1.2, 1e-3), road_of("flat + lift:force=400:rise=0.05", vehicle)
    (run,) = run_controllers(vehicle, [designed(vehicle, name)], road, time)
    assert run.agreement.agrees
    assert max(one.sampled for one in run.agreement.signals.values()) < 2e-6  # measured 1e-7; without the load in it 1e-2


@pytest.mark.parametrize(
    ("kind", "text", "name"),
    [
        ("half_car", "bump:height=0.02 + payload:mass=80:x=-1.2", "I"),
        *attacks([("full_car", "flat + brake:g=0.3 + corner:g=0.2:start=0.8", "I")]),
    ],
)
def test_geometry_is_all_that_differs_in_cars(kind, text, name):
    """A car agrees; at a hundredth of road and loads, where it hardly turns, linear analysis has these loads to RK4's error."""
    vehicle = car(kind, BAR if kind == "full_car" else "")
    controller, road, time = designed(vehicle, name), road_of(text, vehicle), sample_times(vehicle, 1.3, 1e-3)
    (run,) = run_controllers(vehicle, [controller], road, time)
    assert run.agreement.agrees
    assert run.energy is not None
    assert run.energy.residual < 1e-6
    (small,) = run_controllers(vehicle, [controller], road.scaled(0.01), time, balanced=False)
    assert max(one.sampled for one in small.agreement.signals.values()) < 1e-5  # measured up to 2e-6


def test_what_no_step_confirms_is_not_compared():
    """A payload that squeezes struts to nothing ends the comparison where the exact equations take no state, and says so."""
    car = read_vehicle("half_car")
    road = road_of("flat + payload:mass=3000:rise=1.5", car)
    (run,) = run_controllers(car, [designed(car, "passive")], road, sample_times(car, 1.4, 1e-3))
    agreement = run.agreement
    assert run.passed
    assert agreement.steps is not None
    assert agreement.equations_invalid
    assert agreement.until == agreement.steps.until < agreement.end_times[LIFT_OFF.name]
    shortest = STRUT + np.minimum(*(run.physics[f"suspension_deflection_{axle}"] for axle in ("front", "rear")))
    assert agreement.until == run.physics.time[(shortest <= SHORTEST).argmax()]
    assert f"until {agreement.until:.4g} s ({INVALID_EQUATIONS})" in verdict(run).text
    assert any(NO_STATE in line.text for line in reasons(run))


def test_a_flat_road_has_no_roughness(capsys):
    """Over a flat road no IRI is printed, which would be rounding; over a bump it is."""
    options = ["--vehicle", "half_car", "--controller", "passive", "--duration", "1", "--no-logs"]
    for road, rows in (("flat", 0), ("bump", 1)):
        assert main([*options, "--road", road, "--load", "brake:g=0.1", "-v"]) == 0
        assert capsys.readouterr().out.count("[m/km]: iri ") == rows


def test_error_is_of_the_fourth_order(paper, designer):
    """Held midway through a step, a load leaves MuJoCo RK4's order: half the step, a sixteenth of the difference."""
    road, controller = road_of("flat + lift:force=-500:rise=0.1", paper), designer.design("I")
    errors = []
    for step in (2e-3, 1e-3):
        time = sample_times(paper, 1.5, step)
        physics = simulate([paper], [controller], [road], time).response.run(0)
        sampled = sampled_response(paper, controller, road, time)
        errors.append(max(np.abs(physics[n] - sampled[n]).max() / sampled.scale(n) for n in paper.linear_model.states))
    assert math.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.3)  # the next order


def test_a_blow_within_a_step_is_felt(paper):
    """A file's blow of 0.3 ms that no middle of a step meets has its whole impulse."""
    blow = History("blow.csv", np.array([0.0, 0.01005, 0.0102, 0.01035]), {"heave": np.array([0.0, 0.0, 1e4, 0.0])})
    run = run_controllers(paper, [designed(paper, "passive")], RoadWithLoads(Flat(20.0), [blow]), sample_times(paper, 0.1, 1e-3))[
        0
    ]
    assert run.passed
    impulse = run.continuous["sprung_velocity"] * paper.parameters["sprung_mass"]
    assert np.abs(impulse).max() == pytest.approx(1e4 * 0.15e-3, rel=0.01)  # the damper takes some of it within a step
    late = run.continuous["sprung_velocity"] - run.physics["sprung_velocity"]
    assert np.abs(late).max() < 0.01 * np.abs(run.continuous["sprung_velocity"]).max()  # the blow is spread over the step


@pytest.mark.parametrize(
    ("kind", "text", "name"),
    [
        ("quarter_car", "bump + payload:mass=40", "I"),
        ("quarter_car_accelerometer", "flat + lift:force=300:rise=0.0305:hold=0.1", "I"),
        ("half_car", "bump:height=0.02 + brake:g=0.1:start=0.3", "passive"),
    ],
)
def test_continuous_response_is_that_of_the_differential_equation(kind, text, name):
    """The continuous loop's response to road and load is what an independent integrator makes of x' = A x + B u + Bw w + Bl f."""
    damping = "tyre_damping_front = 900.0\ntyre_damping_rear = 1400.0"  # whose force feels the road's velocity at once
    vehicle = car(kind, f"[parameters]\n{damping}" if kind == "half_car" else "")
    controller = designed(vehicle, name)
    road, time, model = road_of(text, vehicle), sample_times(vehicle, 0.8, 1e-2), vehicle.linear_model
    m, rows = len(model.inputs), [model.outputs.index(name) for name in controller.measured]
    D = model.D[rows]
    K = np.linalg.solve(np.eye(m) - controller.gain @ D, controller.gain)

    def pushed(t):
        t = np.array([t])
        return under_wheels(road.velocity, road, vehicle, t)[0], road.loads(vehicle, t)[0]

    def force(t, x):
        return K @ (model.C[rows] @ x + model.Dl[rows] @ pushed(t)[1])

    def rate(t, x):
        w, load = pushed(t)
        return model.A @ x + model.B @ force(t, x) + model.Bw @ w + model.Bl @ load

    kinks = [kink + delay for kink in road.kinks for delay in delays(road, vehicle)]
    response, edges = continuous_response(vehicle, controller, road, time), sorted({0.0, 0.8, *kinks, *road.load_kinks})
    found, x = {}, np.zeros(len(model.A))
    for start, end in itertools.pairwise(edges):  # no integrator steps over a kink
        if start < 0.8:
            solved = solve_ivp(rate, (start, min(end, 0.8)), x, "DOP853", rtol=1e-11, atol=1e-13, dense_output=True)
            found |= {t: solved.sol(t) for t in time if start <= t <= min(end, 0.8)}
            x = solved.y[:, -1]
    for k, t in enumerate(time):
        w, load = pushed(t)
        outputs = model.C @ found[t] + model.D @ force(t, found[t]) + model.Dw @ w + model.Dl @ load
        outputs += model.Cr @ under_wheels(road.displacement, road, vehicle, np.array([t]))[0]
        for name, value in zip(model.outputs, outputs, strict=True):
            assert abs(response[name][k] - value) <= 1e-8 * response.scale(name), name  # the integrator's interpolant


def test_a_law_in_python_carries_too(tmp_path):
    """A law in Python under a load is held against the exact response to its forces and the load."""
    (tmp_path / "mine.py").write_text(
        "def step(sample, state):\n"
        "    return 9000.0 * sample['suspension_deflection'] - 1500.0 * sample['sprung_velocity'], state\n"
    )
    entry = '\n[controllers.mine]\nmeasured = ["suspension_deflection", "sprung_velocity"]\nlaw = "mine.py:step"\n'
    path = tmp_path / "car.toml"
    path.write_text(read_vehicle("quarter_car").text + entry)
    vehicle = read_vehicle(path)
    time, road = sample_times(vehicle, 1.5, 1e-3), road_of("bump + payload:mass=50", vehicle)
    (run,) = run_controllers(vehicle, [vehicle.controllers["mine"].driver()], road, time)
    assert run.agreement.agrees
    assert max(one.sampled for one in run.agreement.signals.values()) < 2e-6
    assert max(one.continuous for one in run.agreement.signals.values()) < 1e-2


@pytest.mark.parametrize("kind", LOADS)
def test_a_text_chooses_a_load(kind):
    """A load has kinks where its rise and fall begin and end, and its text chooses it again."""
    load = choose_load(f"{kind}:start=0.4:rise=0.2:hold=0.3")
    assert load.kinks == pytest.approx((0.4, 0.6, 0.9, 1.1))
    assert choose_load(load.text) == load
    assert choose_load(kind).text.count("hold") == (kind == "gust")


def test_a_run_beside_a_loaded_one_is_as_it_is_alone(paper, designer):
    """In one batch, a run without loads is bit for bit what it is among its like."""
    time, passive = sample_times(paper, 1.0, 1e-3), designer.design("passive")
    loaded, plain = road_of("bump + payload", paper), Bump()
    together = simulate([paper] * 4, [passive] * 4, [loaded, plain] * 2, time).response.values
    alone = simulate([paper] * 4, [passive] * 4, [plain] * 4, time).response.values
    np.testing.assert_array_equal(together[1], alone[1])
    assert np.abs(together[0] - alone[0]).max() > 1e-3


def test_the_work_of_loads_is_in_the_balance(paper, designer):
    """A load that the balance does not know of is left over."""
    time, passive, road = sample_times(paper, 1.5, 1e-3), designer.design("passive"), road_of("flat + payload:mass=50", paper)
    runs = simulate([paper], [passive], [road], time)
    found = energy(paper, runs, 0, road)
    assert found.balances
    assert found.loads == pytest.approx(50 * GRAVITY * -runs.response.run(0)["suspension_deflection"][-1], rel=0.3)
    assert not energy(paper, runs, 0, Flat()).balances


HISTORY = "time [s], pitch [kN m], heave [N]\n0.2, 0, 0\n0.5, 1.5, -100\n1.5, 1.5, 50\n1.6, 0, 0\n"


def test_a_file_is_its_numbers(tmp_path):
    """A CSV file is read in its headings' units, drawn straight between its points, and written down with every digit."""
    file = tmp_path / "pull + push;1.csv"
    file.write_text(HISTORY)
    load = choose_load(str(file))
    assert isinstance(load, History)
    came = load.at(np.array([0.0, 0.35, 0.5, 1.0, 9.0]), {})
    np.testing.assert_allclose(came["pitch_load"], [0.0, 750.0, 1500.0, 1500.0, 0.0])
    np.testing.assert_allclose(came["heave_load"], [0.0, -50.0, -100.0, -25.0, 0.0])
    for second, newton, moment, factor in (("ms", "kN", "Nm", 1e3), ("s", "kN", "kNm", 1e3), ("s", "N", "N m", 1.0)):
        other = tmp_path / "other.csv"
        turned = 1.0 if moment.startswith("N") else 1e3
        other.write_text(f"time [{second}],heave [{newton}],pitch [{moment}]\n0,2,3\n1,2,3\n")
        there = choose_load(str(other))
        assert isinstance(there, History)
        assert there.time[1] == (1e-3 if second == "ms" else 1.0)
        assert (there.columns["heave"][0], there.columns["pitch"][0]) == (2 * factor, 3 * turned)
    road = described_road(json.loads(json.dumps(RoadWithLoads(Bump(), [load, choose_load("brake")]).describe())))
    assert isinstance(road, RoadWithLoads)
    again, brake = road.on_body
    assert isinstance(again, History)
    np.testing.assert_array_equal(again.time, load.time)
    assert again.text == load.text
    assert brake == choose_load("brake")
    half = load.scaled(0.5).at(np.array([0.5]), {})
    assert half["pitch_load"] == 750.0


def drive(folder, capsys, *arguments):
    """Returns what `sim.drive` prints, and the log that it writes."""
    assert (
        main(["--controller", "passive", "--duration", "0.6", "--timestep", "2e-3", "--logs", str(folder), *arguments, "-v"]) == 0
    )
    (log,) = folder.glob("*.mcap")
    return prose(capsys.readouterr().out), log


@pytest.mark.parametrize("way", ["with a road", *attacks(("alone", "from a file"))])
def test_a_log_carries_its_loads_and_proves_them(tmp_path, capsys, way):
    """Driven alone, over a road or from a file, a log proves its loads again, from itself alone; of others it says so."""
    (tmp_path / "pull.csv").write_text(HISTORY)
    arguments = {
        "alone": ["--load", "brake:g=0.2", "--load", "payload:mass=50:x=-1"],
        "with a road": ["--road", "bump + brake:g=0.3", "--load", "payload:mass=50"],
        "from a file": ["--load", str(tmp_path / "pull.csv"), "--class", "B"],
    }[way]
    printed, log = drive(tmp_path / "logs", capsys, "--vehicle", "half_car", *arguments)
    assert re.search(r"energy balances, to \S+ of the \S+ J exchanged, work of loads included", printed)
    assert {"alone": "flat, speed 20 m/s, loads brake:g=0.2:", "with a road": "loads brake:g=0.3:", "from a file": "pull.csv"}[
        way
    ] in printed
    assert "time [s]" not in printed  # a file's rows are in the log, and not in a title
    (tmp_path / "pull.csv").unlink()
    assert inspect([str(log), "-v"]) == 0
    assert "time [s]" not in capsys.readouterr().out


@pytest.mark.parametrize("kind", ["half_car", "full_car"])
@pytest.mark.parametrize("name", ["passive", "I"])
def test_static_angles_are_the_closed_form(kind, name):
    """A loop rests at K q = f, with the vehicle's springs and, of a controller, the stiffness of its deflection gains.

    Tyres that damp do not change it.
    """
    rubber = "[parameters]\ntyre_damping_front = 900.0\ntyre_damping_rear = 1400.0"
    vehicle = car(kind, rubber if kind == "half_car" else BAR)
    controller, p = designed(vehicle, name), vehicle.parameters
    text = "flat + brake:g=0.02 + payload:mass=5:x=0.3" + (" + corner:g=0.01" if kind == "full_car" else "")
    road, wheels = road_of(text, vehicle), vehicle.kind.wheels
    found = static_angles(vehicle, controller, road, 9.0)
    x = [-wheel.behind(p) + p["axle_distance_front"] for wheel in wheels]
    y = [wheel.lateral(p) for wheel in wheels]
    S = np.stack([np.ones(len(x)), -np.array(x), np.array(y)], axis=-1)[:, : 2 if kind == "half_car" else 3]
    axles = ["front" if each > 0 else "rear" for each in x]
    springs = np.diag([p[f"suspension_stiffness_{axle}"] for axle in axles])
    if kind == "full_car":
        arm = np.array([1.0, -1.0, 0.0, 0.0]) / p["track"]
        springs = springs + 2e4 * np.outer(arm, arm)
    C, _ = vehicle.linear_model.rows(controller.measured) if controller.measured else (np.zeros((0, 1)), None)
    names = [one.deflection for one in vehicle.kind.suspensions]
    if len(C):
        columns = [list(controller.measured).index(name) for name in names]
        springs = springs - controller.gain[:, columns]  # u = K d is a spring of -K
    tyres = np.diag([p[f"tyre_stiffness_{axle}"] for axle in axles])
    # Suspensions and tyres one upon the other; S q is what both give together.
    together = np.linalg.inv(np.linalg.inv(springs) + np.linalg.inv(tyres))
    q = np.linalg.solve(S.T @ together @ S, road.loads(vehicle, np.array([9.0]))[0])
    expected = np.degrees(q[1:])
    np.testing.assert_allclose(list(found.values()), expected, rtol=1e-9)  # rounding of a stiff loop's inverse


@pytest.mark.attack
def test_angles_are_measured_and_printed(monkeypatch, capsys):
    """Dive, squat and roll stand in the table as in `--json`, of MuJoCo and sampled; static angles are their ends."""
    arguments = ["--vehicle", "full_car", "--controller", "passive", "--load", "brake:g=0.1:hold=2", "--load", "corner:g=-0.1"]
    arguments += ["--duration", "10", "--timestep", "2e-3", "--no-logs"]
    monkeypatch.setattr(sim.command.comparison, "run_named", once(sim.command.comparison.run_named))
    assert main([*arguments, "--json"]) == 0
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    metrics = {name: one for name, one in run["metrics"].items() if "angle" in name}
    assert list(metrics) == [f"{PITCH}_{what}" for what in ("dive", "squat", "at_end")] + [f"{ROLL}_peak", f"{ROLL}_at_end"]
    assert all(one["unit"] == "deg" for one in metrics.values())
    for one in metrics.values():
        assert one["mujoco"] == pytest.approx(one["linear"], rel=2e-3, abs=1e-3)  # geometry at a degree
    assert metrics["pitch_angle_dive"]["linear"] > 0.3
    assert metrics["pitch_angle_squat"]["linear"] > 0.05  # it swings back when the brake goes
    assert metrics["roll_angle_at_end"]["linear"] == pytest.approx(run["static_angles"][ROLL], rel=1e-4)
    assert run["static_angles"][ROLL] < -1
    assert run["static_angles"][PITCH] == pytest.approx(0.0, abs=1e-9)
    assert main(arguments) == 0
    brief = prose(capsys.readouterr().out)
    angles = " ".join(f"{one['mujoco']:.3g}" for one in metrics.values())
    assert f"angles [deg] pitch dive pitch squat pitch at end roll peak roll at end passive {angles} " in brief
    assert main([*arguments, "-v"]) == 0
    printed = prose(capsys.readouterr().out)
    assert "The model neglects the moment that the body's own weight causes when the body rolls and pitches." in printed
    assert f" passive {angles} " in printed
    assert f"roll_angle {run['static_angles'][ROLL]:.4g} deg. Pitch is positive nose down" in printed


def test_angles_are_those_of_the_body():
    """Measured from deflections, tyres and road, the angles are MuJoCo's own joints' to the square of the angle."""
    vehicle = car("full_car")
    time, road = sample_times(vehicle, 3.0, 1e-3), road_of("bump:height=0.05:track=left + brake:g=0.3 + corner:g=0.2", vehicle)
    (run,) = run_controllers(vehicle, [designed(vehicle, "passive")], road, time)
    found = measure(vehicle, run.physics, 0, loaded=True)
    assert run.qpos is not None
    pitch, roll = np.degrees(run.qpos[:, 5]), np.degrees(run.qpos[:, 6])
    assert found["pitch_angle_dive"] == pytest.approx(pitch.max(), rel=3e-3)
    assert found["roll_angle_peak"] == pytest.approx(np.abs(roll).max(), rel=3e-3)
    assert found["roll_angle_at_end"] == pytest.approx(roll[-1], rel=3e-3)
    blocks = Meter([vehicle], 1e-3, 0, loaded=True)
    for start in range(0, len(time), 700):
        blocks.update(run.physics.values[start : start + 700, :, None])
    assert {name: float(value[0]) for name, value in blocks.result().items() if "angle" in name} == {
        name: value for name, value in found.items() if "angle" in name
    }


@pytest.mark.attack
def test_campaigns_know_loads_of_files(tmp_path):
    """A road has loads of files, too; another content is another campaign, the same road without them another road."""
    (tmp_path / "push.csv").write_text("time [s],heave [N]\n0,0\n0.2,500\n1,500\n")
    (tmp_path / "road.csv").write_text("distance [m],height [m]\n0,0\n20,0\n40,0\n60,0\n")
    roads = '["bump", "bump + push.csv", "flat + push.csv+lift:force=100", "road.csv + push.csv", "road.csv"]'
    text = f'vehicles = ["quarter_car"]\ncontrollers = ["passive"]\nroads = {roads}\nspeeds = [20.0]\nduration = 1.0\n'
    file, folder = tmp_path / "campaign.toml", tmp_path / "results"
    file.write_text(text)
    assert campaign([str(file), "--results", str(folder)]) == 0
    rows = pq.read_table(folder / "results.parquet").to_pylist()
    travel = [row["suspension_deflection_rms"] for row in rows]
    assert travel[4] < 1e-9 < travel[3]  # a flat road, to rounding
    assert travel[1] != travel[0]
    assert all(row["linear_error"] < 1e-5 for row in rows[:4])  # RK4 at 1 ms
    assert campaign(["--verify", str(folder)]) == 0
    (tmp_path / "push.csv").write_text("time [s],heave [N]\n0,0\n0.2,501\n1,501\n")
    with pytest.raises(InputError, match="contains the results of another campaign, or the files of this campaign have changed"):
        campaign([str(file), "--results", str(folder)])
    file.write_text(text.replace('"road.csv"]', '"flat + ./push.csv+lift:force=100"]'))
    with pytest.raises(InputError, match="are the same; list only one of them"):
        campaign([str(file), "--results", str(tmp_path / "other")])


def test_campaigns_measure_angles(tmp_path):
    """A campaign with loads has a car's angles among its columns, with their unit, as the linear response has them."""
    text = """
vehicles = ["half_car"]
controllers = ["passive"]
roads = ["flat + brake:g=0.2", "bump:height=0.02"]
speeds = [20.0]
duration = 1.5
"""
    (tmp_path / "campaign.toml").write_text(text)
    assert campaign([str(tmp_path / "campaign.toml"), "--results", str(tmp_path / "results"), "--workers", "1"]) == 0
    table = pq.read_table(next((tmp_path / "results").glob("*.parquet")))
    assert table.schema.field("pitch_angle_dive").metadata[b"unit"] == b"deg"
    for row in table.to_pylist():
        assert row["linear_pitch_angle_dive"] == pytest.approx(row["pitch_angle_dive"], rel=1e-3)
    assert table["pitch_angle_dive"][0].as_py() > 0.5


def test_a_payload_does_not_vary_a_tyre_s_load():
    """The dynamic load of a vehicle with loads is about what tyres carry in the mean; of one without it is the rms."""
    vehicle, h, first = read_vehicle("quarter_car"), 1e-3, 1000
    passive, time = designed(vehicle, "passive"), np.arange(6001) * 1e-3
    rough, laden = Iso8608("C", 3, 20.0), RoadWithLoads(Iso8608("C", 3, 20.0), (choose_load("payload:mass=150:rise=0.5"),))
    values = simulate([vehicle] * 2, [passive] * 2, [rough, laden], time).response.values
    meter = Meter([vehicle] * 2, h, first, loaded=True, pushed=[False, True])
    meter.update(np.moveaxis(values, 0, -1))
    found = meter.result()["dynamic_load"]
    static = vehicle.kind.static_tyre_deflection(vehicle.parameters)["tyre_deflection"]
    tyre = [signal.name for signal in vehicle.kind.signals].index("tyre_deflection")
    alone, carrying = (np.minimum(one[first:, tyre], static) / static for one in values)
    assert found[0] == pytest.approx(np.sqrt(np.mean(alone**2)), rel=1e-12)
    assert found[1] == pytest.approx(carrying.std(), rel=1e-9)
    assert np.sqrt(np.mean(carrying**2)) > found[1] + 0.02  # what the payload alone shifts: 150 kg of 566
    assert found[0] == measure(vehicle, Response(time, vehicle.kind.signals, values[0]), first)["dynamic_load"]


@pytest.mark.parametrize(
    ("kind", "load"), [("quarter_car", "payload:mass=60"), ("half_car", "brake:g=0.001"), ("full_car", "corner:g=0.001")]
)
def test_loads_that_rise_are_of_second_order(kind, load):
    """A quarter of the error is left at half the step, in every signal of MuJoCo and of the sampled response.

    A run of an earlier version, whose accelerations were under the load half a step later, is repeated as it was.
    """
    vehicle, errors = read_vehicle(kind), []
    road = road_of(f"flat + {load}", vehicle)
    for step in (4e-3, 2e-3):
        time = sample_times(vehicle, 1.2, step)
        (run,) = run_controllers(vehicle, [designed(vehicle, "passive")], road, time)
        exact = run.continuous
        scales = {name: exact.scale(name) for name in vehicle.linear_model.outputs}
        moving = [name for name, scale in scales.items() if scale and exact.peak(name) > 0.01 * scale]
        apart = [np.abs(one[name] - exact[name]).max() / scales[name] for one in (run.sampled, run.physics) for name in moving]
        errors.append(apart)
        assert run.agrees
    rough, fine = np.array(errors)
    assert rough.max() < 5e-4  # of a peak; of first order it was 2e-2
    assert np.log2(rough / fine).min() > 1.9  # geometry of a car on struts is left out by so small a load
    earlier = simulate_inputs([designed(vehicle, "passive")], [RoadInput(vehicle, road, time, earlier=True)]).run(0)
    assert max(np.abs(earlier[name] - run.physics[name]).max() / scales[name] for name in moving) > 5e-3
