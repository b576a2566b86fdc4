"""Half-cars and full car: their equations are their physics to first order, and their limits are the smaller vehicles."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import dataclasses

import mujoco
import numpy as np
import pytest

from models.kinds.links import SIDES
from models.roads.choice import choose_road
from models.roads.loads.load import Cornering
from models.roads.loads.road_with_loads import RoadWithLoads
from models.roads.rig import Rig
from models.roads.road import Bump, RoadInput
from models.vehicle.mjcf import build_model
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.drive import sensor_readout as readout
from sim.recording.scene import scene_of
from sim.runs.run import run_controllers, sample_times
from sim.studies.frequency.identification import difference
from synth.vehicle.designer import Designer
from tests.conftest import random_vehicles
from tests.support.analysed import sampled_response, simulate
from tests.support.commands import in_the_suite, refused
from tests.support.shared import designed

CARS = ["half_car", "half_car_roll", "full_car"]


@pytest.fixture(scope="module", params=CARS)
def car(request):
    return read_vehicle(request.param)


@pytest.fixture(scope="module")
def car_designer(car):
    return Designer(car)


def signals_of(vehicle, model, qpos, qvel, ctrl, road):
    """Every output signal of the linear model from MuJoCo's sensors, and qacc."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, ctrl
    for wheel, height in zip(vehicle.kind.wheels, road, strict=True):
        data.mocap_pos[model.body(wheel.road_body).mocapid[0], 2] = height
    mujoco.mj_forward(model, data)
    values = []
    for name in vehicle.linear_model.outputs:
        parts = vehicle.kind.combined.get(name, {name: 1.0})
        values.append(
            sum(f * data.sensor(part).data @ model.sensor(part).user[: len(data.sensor(part).data)] for part, f in parts.items())
        )
    return np.array(values), data.qacc.copy()


def derivative(vehicle, model, which, count, h=1e-4):
    """Central differences of the signals in one argument of `signals_of`, shape (signals, count)."""
    rest = {"qpos": np.zeros(model.nq), "qvel": np.zeros(model.nv), "ctrl": np.zeros(model.nu)}
    rest["road"] = np.zeros(len(vehicle.kind.wheels))
    columns = []
    for direction in h * np.eye(count):
        up, down = (signals_of(vehicle, model, **{**rest, which: sign * direction})[0] for sign in (1, -1))
        columns.append((up - down) / (2 * h))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("index", in_the_suite((1,), range(4)))
def test_linearisation_is_the_hand_derived_one(car, index):
    """Found by differences in MuJoCo's coordinates, motion obeys A, B, Bw and Br, and signals C, D and Cr."""
    vehicle = [car, *random_vehicles(car, 3, 0.3)][index]
    model, linear = build_model(vehicle, 1e-3), vehicle.linear_model
    sizes = {"qpos": model.nq, "qvel": model.nv, "ctrl": model.nu, "road": len(vehicle.kind.wheels)}
    of = {which: derivative(vehicle, model, which, count) for which, count in sizes.items()}
    states = [linear.outputs.index(state) for state in linear.states]
    scale = np.abs(linear.A).max()
    tolerance = {"atol": 1e-7 * scale}  # asked for; differences of a smooth function: h^2 times its third derivative
    # The state is a function of qpos, qvel and the road: x = X_q q + X_v v - (...) z_r, all by sensors of those names.
    for which in ("qpos", "qvel", "road"):
        expected = linear.C @ of[which][states] + (linear.Cr if which == "road" else 0)
        np.testing.assert_allclose(of[which], expected, **tolerance)
    np.testing.assert_allclose(of["ctrl"], linear.D, atol=1e-7 * np.abs(linear.D).max())
    np.testing.assert_allclose(of["road"][states], linear.Bw, **tolerance)
    # x' = X_q v + X_v qacc: qacc by differences too.
    X_q, X_v = of["qpos"][states], of["qvel"][states]
    rest = {name: np.zeros(size) for name, size in sizes.items()}

    def qacc_derivative(which, count, h=1e-4):
        pairs = [[signals_of(vehicle, model, **{**rest, which: sign * d})[1] for sign in (1, -1)] for d in h * np.eye(count)]
        return np.stack([(up - down) / (2 * h) for up, down in pairs], axis=-1)

    np.testing.assert_allclose(X_v @ qacc_derivative("qpos", model.nq), linear.A @ X_q, **tolerance)
    np.testing.assert_allclose(X_q + X_v @ qacc_derivative("qvel", model.nv), linear.A @ X_v, **tolerance)
    np.testing.assert_allclose(X_v @ qacc_derivative("ctrl", model.nu), linear.B, atol=1e-7 * np.abs(linear.B).max())
    count = len(vehicle.kind.wheels)
    np.testing.assert_allclose(X_v @ qacc_derivative("road", count), linear.A @ linear.Bw + linear.Br, **tolerance)


@pytest.mark.parametrize("name", ["quarter_car", *CARS])
def test_the_file_alone_is_the_vehicle_that_ships(name):
    """The MJCF opens by itself with the shipped vehicle's numbers in it, its timestep and its integrator."""
    car = read_vehicle(name)
    alone, written = mujoco.MjModel.from_xml_path(str(car.kind.mjcf)), build_model(car, 1e-3)
    for field in ("body_mass", "body_inertia", "body_pos", "site_pos", "tendon_stiffness", "tendon_damping"):
        np.testing.assert_array_equal(getattr(alone, field), getattr(written, field))
    np.testing.assert_allclose(alone.tendon_lengthspring, written.tendon_lengthspring, rtol=1e-15)  # the last bit of a sum
    assert alone.opt.timestep == written.opt.timestep
    assert alone.opt.integrator == written.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4


@pytest.mark.parametrize(("name", "track"), [("half_car", "both"), ("half_car_roll", "left"), ("full_car", "left")])
def test_error_vanishes_with_the_amplitude(name, track):
    """The difference from the sampled response falls with the square of the height; at 1 mm it is below 1e-4 of the peak."""
    car = read_vehicle(name)
    controller, time = designed(car, "I"), sample_times(car, 1.0, 1e-3)
    heights = np.array([0.1, 0.05, 0.025, 0.0125, 0.001])
    roads = [Bump(height=height, track=track) for height in heights]
    physics = simulate([car] * 5, [controller] * 5, roads, time).response
    errors = []
    for i, road in enumerate(roads):
        sampled = sampled_response(car, controller, road, time)
        errors.append(
            max(np.abs(physics.run(i)[name] - sampled[name]).max() / sampled.scale(name) for name in car.linear_model.outputs)
        )
    slopes = np.diff(np.log(errors[:4])) / np.diff(np.log(heights[:4]))
    if track == "both":
        np.testing.assert_allclose(slopes, 2.0, atol=0.15)  # even in the angles; the next order, and RK4's 1e-7 below
    else:  # roll and pitch together: the order of the hinges shows, a product of two angles against their sum
        assert np.all(slopes > 0.95)
    assert errors[4] < 1e-4


def test_verdict_says_how_much_is_geometry(car, car_designer):
    """At the full bump a run agrees, and its distance from linear analysis is larger than RK4's own error: it is geometry's."""
    road = Bump(0.04, track="left") if car.kind.name == "half_car_roll" else Bump()  # under both wheels it would not roll
    (run,) = run_controllers(car, [car_designer.design("II")], road, sample_times(car, 1.0, 1e-3))
    assert run.passed
    assert run.agreement.cause == "geometry"
    assert 1e-4 < max(signal.sampled for signal in run.agreement.signals.values()) < 1e-3  # RK4's is below 1e-6


@pytest.mark.parametrize("name", ["state", "I", "II"])
def test_designs_are_certified_and_modest(car, car_designer, name):
    """Every controller is proved, close to its own optimum, far better than passive, and asks no actuator for the impossible."""
    controller, passive = car_designer.design(name), car_designer.design("passive")
    assert controller.certificate.failures == ()
    assert controller.steps.optimum_gap < 1e-6
    share = 0.47 if car.kind.name == "half_car_roll" else 0.45
    assert controller.certificate.norm.value < share * passive.certificate.norm.value
    assert np.abs(controller.gain).max() < 2e5  # N/m, N s/m: of the size of the tyre's stiffness


def test_half_car_norms_are_the_prototypes():
    """The half-car's norms are those that a prototype of this design found before: 15.4 passive, 5.55, and 6.1 to 6.3."""
    designer = Designer(read_vehicle("half_car"))
    norms = {name: designer.design(name).certificate.norm.value for name in ("passive", "state", "I", "II")}
    assert norms["passive"] == pytest.approx(15.4, abs=0.05)
    assert norms["state"] == pytest.approx(5.55, abs=0.05)
    assert 6.1 < norms["II"] < norms["I"] < 6.3


def test_gains_beyond_any_actuator_are_refused():
    """With the paper's weight of the force, I of the half-car tends to an infinite gain: it stops short, and says how far."""
    half = read_vehicle("half_car")
    text = half.text.replace("= 2e-4", "= 1e-4")
    controller = Designer(parse_vehicle(text)).design("I")
    assert controller.certificate.failures == ()
    assert 1e-5 < controller.steps.optimum_gap < 0.05
    assert controller.certificate.speed_up < 100


def test_a_public_vehicle():
    """The first car of the CommonRoad vehicle models has the poles of its linear equations of ride, written down here.

    Their unsprung masses are those of axles, and their auxiliary roll stiffness is negative.
    """
    ms, pitch, roll, mu, k, c = 1094.542, 1342.259768, 244.0472306, 65.672 / 2, 21898.332429, 1459.390293
    a, b, front, rear, kt, bar = 0.88392, 1.50876, 1.389888, 1.423416, 189785.547723, 12880.270509
    own = {"sprung_mass": ms, "pitch_inertia": pitch, "roll_inertia": roll, "axle_distance_front": a, "axle_distance_rear": b}
    of_axles = {"unsprung_mass": mu, "suspension_stiffness": k, "suspension_damping": c, "tyre_stiffness": kt}
    own |= {f"{name}_{axle}": value for name, value in of_axles.items() for axle in ("front", "rear")}
    own |= {"track_front": front, "track_rear": rear, "anti_roll_stiffness_front": bar}
    lines = "".join(f"{name} = {value}\n" for name, value in own.items())
    vehicle = parse_vehicle(f'type = "full_car"\n[parameters]\n{lines}[performance]\nheave_acceleration = 1.0\n')
    T = np.column_stack([np.ones(4), [-a, -a, b, b], np.array([front, -front, rear, -rear]) / 2, -np.eye(4)])
    turned = np.array([0, 0, 1, -1 / front, 1 / front, 0, 0])
    M, K = np.diag([ms, pitch, roll, *[mu] * 4]), k * T.T @ T + np.diag([0, 0, 0, *[kt] * 4]) + bar * np.outer(turned, turned)
    A = np.block([[np.zeros((7, 7)), np.eye(7)], [-np.linalg.solve(M, K), -c * np.linalg.solve(M, T.T @ T)]])
    poles = [np.sort_complex(np.linalg.eigvals(one).round(6)) for one in (A, vehicle.linear_model.A)]
    assert poles[1] == pytest.approx(poles[0], abs=3e-6)


# Half-cars in the roll plane of others: sprung mass, roll inertia, track, and at each wheel mass, spring, damper and tyre.
ROLL_CARS = {
    "ysaholic/half-car-model-roll-response": (750.0, 320.0, 0.6, 35.0, 20e3, 1500.0, 200e3),
    "Notabot123/simweave, demo 18": (1200.0, 2200.0, 1.6, 60.0, 20e3, 1500.0, 150e3),
    "Liyucheng1997/08_experiment-active-suspension": (1500.0, 600.0, 1.55, 100.0, 60e3, 4000.0, 400e3),
}


def roll_car(ms=600.0, roll=250.0, track=1.5, mu=40.0, k=2e4, c=1200.0, kt=2e5, **more) -> Vehicle:
    """A half-car in the roll plane with equal sides."""
    each = {"unsprung_mass": mu, "suspension_stiffness": k, "suspension_damping": c, "tyre_stiffness": kt}
    own = {"sprung_mass": ms, "roll_inertia": roll, "track": track} | more
    own |= {f"{name}_{side}": value for name, value in each.items() for side in ("left", "right") if f"{name}_{side}" not in more}
    lines = "".join(f"{name} = {value!r}\n" for name, value in own.items())
    return parse_vehicle(f'type = "half_car"\nplane = "roll"\n[parameters]\n{lines}[performance]\nroll_acceleration = 1.0\n')


@pytest.mark.parametrize("numbers", [(600.0, 250.0, 1.5, 40.0, 2e4, 1200.0, 2e5), *ROLL_CARS.values()], ids=["own", *ROLL_CARS])
def test_heave_and_roll_have_their_closed_forms(numbers):
    """Each of heave and roll of equal sides is a car of two masses; over rigid tyres its frequency is that of a single mass."""
    ms, roll, track, mu, k, c, kt = numbers
    poles, bar = [], 9e3
    for mass, more in ((ms / 2, 0.0), (2 * roll / track**2, 2 * bar / track**2)):  # reduced to the wheel of one side
        strut = np.array([[1.0, -1.0], [-1.0, 1.0]])
        M, K = np.diag([mass, mu]), (k + more) * strut + np.diag([0.0, kt])
        A = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, c * strut)]])
        poles += np.linalg.eigvals(A).tolist()
    found = np.linalg.eigvals(roll_car(*numbers, anti_roll_stiffness=bar).linear_model.A)
    far = np.abs(found[:, None] - np.array(poles))
    assert max(far.min(axis=0).max(), far.min(axis=1).max()) < 1e-9 * np.abs(found).max()
    rigid = np.linalg.eigvals(roll_car(ms, roll, track, 1e-2, k, 0.0, 1e10, anti_roll_stiffness=bar).linear_model.A)
    expected = np.sort([np.sqrt(2 * k / ms), np.sqrt((k * track**2 / 2 + bar) / roll)])
    np.testing.assert_allclose(np.sort(np.abs(rigid))[:4:2], expected, rtol=1e-4)


def at_front(name: str) -> str:
    """The signal of a full car's front axle."""
    stem, _, side = name.rpartition("_")
    return f"{stem}_front_{side}" if side in SIDES else name


def test_a_full_car_of_equal_axles_is_two_half_cars_in_the_roll_plane():
    """With the same road under both axles: poles, gains of road and loads over frequency, and runs in MuJoCo, to rounding."""
    half = roll_car(roll_centre_height=0.1, anti_roll_stiffness=8e3, centre_height=0.6, wheel_centre_height=0.3)
    p = {name.removesuffix("_left"): value for name, value in half.parameters.items() if not name.endswith("_right")}
    of_car = {"sprung_mass": 1200.0, "roll_inertia": 500.0, "pitch_inertia": 2000.0, "track": 1.5, "centre_height": 0.6}
    of_axles = {f"{name}_{axle}": p[name] for name in p if name not in of_car for axle in ("front", "rear")}
    of_axles |= {"axle_distance_front": 1.4, "axle_distance_rear": 1.4}
    full = dataclasses.replace(read_vehicle("full_car"), parameters=of_car | of_axles)
    poles, own = (np.linalg.eigvals(car.linear_model.A) for car in (full, half))
    assert (np.abs(own[:, None] - poles).min(axis=1) < 1e-9 * np.abs(own)).all()

    s, gains = 2j * np.pi * np.array([0.5, 1.5, 9.0, 30.0])[:, None, None], list[np.ndarray]()
    for car, of in ((full, at_front), (half, str)):
        model, rows = car.linear_model, [car.linear_model.outputs.index(of(name)) for name in half.linear_model.outputs]
        left = np.array([[float(name.endswith("left"))] for name in model.disturbances])
        pushed = Cornering(g=1.0).at(np.array([9.0]), car.parameters, car.kind)
        push = np.array([pushed.get(name, np.zeros(1)) for name in model.loads])
        acts = np.concatenate([(model.Bw + model.Br / s) @ left, np.broadcast_to(model.Bl @ push, (4, len(model.A), 1))], axis=-1)
        gains.append(model.C[rows] @ np.linalg.solve(s * np.eye(len(model.A)) - model.A, acts))
    np.testing.assert_allclose(*gains, rtol=1e-9, atol=1e-12)

    time, t = sample_times(half, 0.6, 1e-3), np.linspace(0.0, 0.5, 6)
    moves = np.array([[0.0], [0.02], [0.06], [-0.03], [0.0], [0.01]]) * [1.0, 0.4]
    posts = tuple(f"{axle}_{side}" for axle in ("front", "rear") for side in SIDES)
    rigs = Rig(t, np.hstack([moves, moves]), posts), Rig(t, moves, SIDES)
    on = [RoadWithLoads(rig, (Cornering(g=0.3, start=0.2),)) for rig in rigs]
    passive = [Designer(car).design("passive") for car in (full, half)]
    whole, part = (
        simulate([car], [one], [road], time).response.run(0) for car, one, road in zip((full, half), passive, on, strict=True)
    )
    for name in half.linear_model.outputs:
        assert np.abs(whole[at_front(name)] - part[name]).max() <= 1e-9 * part.scale(name), name
    heights = [RoadInput(car, choose_road("iso8608").build(car, 15.0, 0, 1.0), time).heights[:, :2] for car in (full, half)]
    assert np.array_equal(heights[0], heights[1]), "both tracks are those of a full car's front axle"


def test_a_payload_above_the_centre_of_mass_turns_with_the_body():
    """A roof load raises mass, roll inertia and centre of mass; a place ahead has no effect in the cross-section."""
    text = read_vehicle("half_car_roll").text
    p, laden = read_vehicle("half_car_roll").parameters, parse_vehicle(f"{text}[payload]\nmass = 70.0\nz = 0.9\n").parameters
    reduced = 730.0 * 70.0 / 800.0
    assert (laden["sprung_mass"], laden["roll_inertia"]) == pytest.approx((800.0, 230.0 + reduced * 0.81), rel=1e-12)
    assert laden["centre_height"] - p["centre_height"] == pytest.approx(70.0 / 800.0 * 0.9, rel=1e-12)
    with refused("x has no effect", "does not pitch"):
        parse_vehicle(f"{text}[payload]\nmass = 70.0\nx = 0.9\n")


def test_roll_that_symmetry_forbids_is_rounding():
    """Over a bump under both wheels the only angle is silent: its differences count over a displacement's scale, as at 1 m."""
    car = read_vehicle("half_car_roll")
    (run,) = run_controllers(car, [designed(car, "I")], Bump(), sample_times(car, 1.0, 1e-3))
    assert 0 < run.sampled.peak("roll_rate") < 1e-6 * run.sampled.peak("heave_velocity")
    fastest = max(run.sampled.peak(one.name) for one in run.sampled.signals if one.unit == "m/s")
    assert run.sampled.scale("roll_rate") == 1e-3 * fastest
    assert run.qpos is not None
    assert scene_of(run.prediction.input, run.physics, run.qpos).flat, "it is seen from behind"
    assert max(signal.sampled for signal in run.agreement.signals.values()) < 1e-5
    gains, units = np.array([[1e-12, 2.0], [0.5, 2.0]]), ("rad/s", "m/s")
    np.testing.assert_allclose(difference(gains + [1e-12, 0.0], gains, units), [[5e-10, 0.0], [2e-12, 0.0]], rtol=1e-3)


def test_a_steady_curve_moves_load_by_its_closed_form():
    """Springs, bar and tyres in series hold the body, and links, wheels and the body's sway add their moments."""
    car, a = roll_car(roll_centre_height=0.12, wheel_centre_height=0.3, centre_height=0.6, anti_roll_stiffness=9e3), 0.2 * 9.81
    ms, mu, b, on_tyres = 600.0, 40.0, 0.48, 2 / (2e5 * 1.5**2)  # rad per N m
    in_series, by_links = 1 / (2e4 * 1.5**2 / 2 + 9e3) + on_tyres, ms * a * 0.12 + 2 * mu * a * 0.3  # links turn only the axle
    phi = (ms * a * b * in_series + by_links * on_tyres) / (1 - ms * 9.81 * b * in_series)
    model, pushed = car.linear_model, Cornering(g=0.2).at(np.array([9.0]), car.parameters, car.kind)
    rest = np.linalg.solve(model.A, -model.Bl @ [float(pushed.get(name, [0.0])[0]) for name in model.loads])
    state = dict(zip(model.outputs, model.C @ rest, strict=True))
    angle = sum(share * state.get(name, 0.0) for name, share in car.kind.angles(car.parameters)["roll_angle"].items())
    assert angle == pytest.approx(phi, rel=1e-9)
    moved = 2e5 * state["tyre_deflection_left"]
    assert moved == pytest.approx((ms * a * 0.6 + 2 * mu * a * 0.3 + ms * 9.81 * b * phi) / 1.5, rel=1e-9)
    assert state["tyre_deflection_right"] == pytest.approx(-state["tyre_deflection_left"], rel=1e-9)


def test_the_third_inertia_hardly_counts(monkeypatch):
    """Any yaw inertia that a body can have moves a car that pitches and rolls by 5e-4 of a peak."""
    vehicle = read_vehicle("full_car")
    passive, road = Designer(vehicle).design("passive"), Bump(0.1, 5.0, 12.5, "left")
    p, time = vehicle.parameters, sample_times(vehicle, 1.5, 1e-3)
    roll, pitch = p["roll_inertia"], p["pitch_inertia"]

    def driven(yaw):
        def build(*arguments, **options):
            model = build_model(*arguments, **options)
            body = model.body("sprung").id
            np.testing.assert_allclose(model.body_inertia[body], [roll, pitch, pitch])
            model.body_inertia[body][2] = yaw
            mujoco.mj_setConst(model, mujoco.MjData(model))
            return model

        monkeypatch.setattr(readout, "build_model", build)
        readout.prepared_readout.cache_clear()
        return simulate([vehicle], [passive], [road], time).response.run(0)

    try:
        ours, *others = (driven(yaw) for yaw in (pitch, pitch - roll, pitch + roll))
    finally:
        readout.prepared_readout.cache_clear()
    moved = [
        max(np.abs(other[name] - ours[name]).max() / np.abs(ours[name]).max() for name in vehicle.linear_model.outputs[:-4])
        for other in others
    ]
    assert max(moved) < 5e-4
    assert moved == pytest.approx([4.5e-4] * 2, rel=0.2)  # measured; with the amplitude squared
