"""Second sources of what physics and equations share: roads under every wheel, loads with their levers, static loads, gravity.

Roads are heights over the way x of a wheel, written in other ways than the product's. Loads are forces at places; their moments
are cross products. A road, load or vehicle type without a second source fails here.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import importlib
import inspect
import pkgutil
from functools import cache

import mujoco
import numpy as np
import pytest
from scipy import special
from scipy.interpolate import make_interp_spline

import models.roads
from models.roads.iso8608 import Iso8608
from models.roads.loads.choice import History
from models.roads.loads.load import Brake, Cornering, Gust, Lift, Load, Payload
from models.roads.loads.road_with_loads import RoadWithLoads
from models.roads.obstacles import Flat, Pothole, Step, WattsHump
from models.roads.profile import Profile
from models.roads.rig import Rig
from models.roads.road import Bump, Departure, Road, RoadInput, ScaledRoad
from models.roads.sinusoids import Multisine, Sine, SineSweep
from models.vehicle.mjcf import build_model
from models.vehicle.vehicle import kinds, parse_vehicle, read_vehicle
from tests.support.mechanism import CORNERS, Mechanism, axle

CAR = read_vehicle("full_car").with_parameters(axle_distance_front=1.1, axle_distance_rear=1.7, track=1.5, centre_height=0.6)
LATE, V, H = 2.8, 10.0, 0.02  # m from axle to axle, m/s, s
TIME, PARTS = H * np.arange(151), H * (np.arange(400) + 0.5) / 400
RANDOM = Iso8608("C", 3, V, 1.5, length=100.0)
AT = np.array([0.0, 4.0, 11.0, 15.0, 26.0])  # m; the first 11 m climb by 2 and 1 %, the last by 1 and 0.3 %
CLIMB = np.array([[0.1, 0.2, 0.32, 0.3, 0.41], [0.0, 0.05, 0.11, 0.2, 0.233]]).T
POSTS, MOVES = ("rear_left", "front_right", "front_left", "rear_right"), np.random.default_rng(1).normal(0, 0.01, (8, 4))


def rise(s):
    """Half a period of a cosine, from 0 to 1."""
    return np.sin(np.pi / 2 * np.clip(s, 0, 1)) ** 2


def hump(x, side):
    """An arc by its chord, x (L - x) = z (z + 2 (R - h))."""
    below = 3.7**2 / 0.8 + 0.05 - 0.1
    return np.sqrt(below**2 + np.maximum(x * (3.7 - x), 0)) - below


def pit(x):
    return 0.06 * (rise((x - 1.7) / 0.3) - rise(x / 0.3))


def sweep(x, side):
    t = np.clip(x / V, 0, 2.0)
    f = 8.0 ** (t / 2.0)
    return 0.02 / f * np.sin(2 * np.pi * (f - 1.0) * 2.0 / np.log(8.0))


def lines(x, *some):
    """Sinusoids (amplitude, rad/s, phase) from x = 0 on, at their own height there."""
    turning = sum(a * (np.exp(1j * (w * x / V + phi)) - np.exp(1j * phi)) for a, w, phi in some)
    return np.where(x >= 0, np.imag(turning), 0)


@cache
def spectrum(side):
    """Complex amplitudes of 1, 2, ... 2000 waves in the length of a random road, from its heights over one length."""
    return np.fft.rfft(RANDOM.displacement(100.0 / V * np.arange(4000) / 4000, side))[1:] / 2000


def random(x, side):
    waves = np.exp(2j * np.pi / 100.0 * np.multiply.outer(x, np.arange(1, 1001))) - 1
    return np.where(x >= 0, np.real(waves @ spectrum(side)[:1000]), 0)


def profile(x, side, spline=False):
    """Heights over a plane through the first ones, which climbs by 1.5 %; behind the last one the road climbs by 0.65 %."""
    z = CLIMB[:, int(side == "right")] - CLIMB[0, int(side == "right")] - 0.015 * AT
    smooth = make_interp_spline(AT, z, bc_type=([(1, 0.0)], [(1, 0.0065 - 0.015)]))
    on = np.clip(x, 0, 26.0)
    return (smooth(on) if spline else np.interp(on, AT, z)) + (0.0065 - 0.015) * np.maximum(x - 26.0, 0)


def rig(x, post):
    z = MOVES[:, POSTS.index(post)] - MOVES[0, POSTS.index(post)]
    return make_interp_spline(0.3 * np.arange(8), z, bc_type=([(1, 0.0)], [(1, 0.0)]))(np.clip(x / V, 0, 2.1))


ROADS = [
    (Bump(0.08, 4.0, V, "left"), lambda x, side: 0.08 * np.sin(np.pi * np.clip(x, 0, 4) / 4) ** 2 * (side == "left")),
    (WattsHump(0.1, 3.7, V), hump),
    (Step(0.05, 0.5, V, 0.1), lambda x, side: 0.05 * rise((x - 1.0) / 0.5)),
    (Step(0.02, 0.0, V, 0.1), lambda x, side: 0.02 * (x > 1.0 + 1e-8)),
    (Pothole(0.06, 2.0, 0.3, V, "right"), lambda x, side: pit(x) * (side == "right")),
    (Flat(V), lambda x, side: 0.0 * x),
    (SineSweep(0.02, 1.0, 8.0, 2.0, V), sweep),
    (Sine(0.03, 2.0, float(np.degrees(0.5)), V, 0.2), lambda x, side: lines(x - 2.0, (0.03, 4 * np.pi, 0.5))),
    (Multisine((3.0, 11.0), (0.02, 0.01), (0.4, 2.0), V), lambda x, side: lines(x, (0.02, 3.0, 0.4), (0.01, 11.0, 2.0))),
    (RANDOM, random),
    (Profile(AT + 5.0, CLIMB, V), profile),
    (Profile(AT, CLIMB, V, join="smooth"), lambda x, side: profile(x, side, spline=True)),
    (Departure(Profile(AT, CLIMB, V)), profile),
    (Rig(7.0 + 0.3 * np.arange(8), MOVES, POSTS), rig),
    (ScaledRoad(Pothole(0.06, 2.0, 0.3, V, "left"), -0.5), lambda x, side: -0.5 * pit(x) * (side == "left")),
    (RoadWithLoads(Pothole(0.06, 2.0, 0.3, V), (Brake(),)), lambda x, side: pit(x)),
]


@pytest.mark.parametrize(("road", "height"), ROADS, ids=lambda one: type(one).__name__)
def test_every_wheel_meets_the_road_where_it_is(road, height):
    """Heights, rates and what is held over steps are those of the second source, and a wheelbase later under the rear wheels."""
    given, far = RoadInput(CAR, road, TIME), 1e-9 if road is RANDOM else 1e-12  # rounding, of the phases of 1000 lines
    for i, wheel in enumerate(CAR.kind.wheels):
        axle, side = wheel.road_displacement.split("_")[-2:]
        late, track = (0.0, f"{axle}_{side}") if isinstance(road, Rig) else (LATE * (axle == "rear"), side)

        def at(t, late=late, track=track):
            return height(V * t - late, track)

        np.testing.assert_allclose(given.heights[:, i], at(TIME), rtol=0, atol=far)
        np.testing.assert_allclose(given.ahead(40)[:, i], at(TIME[-1] + H * np.arange(1, 41)), rtol=0, atol=far)
        np.testing.assert_allclose(given.held_velocities[:, i], (at(TIME + H) - at(TIME)) / H, rtol=0, atol=far / H)
        means = isinstance(road, Profile | Rig | Departure)  # over steps, as points may be closer
        held = at(np.add.outer(TIME, PARTS)).mean(axis=1) if means else at(TIME + H / 2)
        np.testing.assert_allclose(given.midway[:, i], held, rtol=0, atol=1e-7 if means else far)  # of 400 parts
        back, there, on = at(TIME - 1e-7), at(TIME), at(TIME + 1e-7)
        smooth = np.abs(on - 2 * there + back) < 1e-10  # neither a kink nor a jump
        assert smooth.mean() > 0.9
        np.testing.assert_allclose(given.velocities[smooth, i], (on - back)[smooth] / 2e-7, rtol=0, atol=1e-5)


def test_a_random_road_has_the_lines_of_its_class():
    """Lines on both tracks have amplitudes of G_d(n) = 256e-6 (n / 0.1)^-2 of class C, from 0.01 to 10 cycles/m, and random
    phases; the tracks cohere by x K_1(x). Each class has twice the heights of the one before.
    """
    n, left, right = np.arange(1, 1001) / 100.0, spectrum("left"), spectrum("right")
    expected, alike = np.sqrt(2 * 256e-6 * (n / 0.1) ** -2 / 100.0), 2 * np.pi * 1.5 * n * special.k1(2 * np.pi * 1.5 * n)
    assert np.abs([left[1000:], right[1000:]]).max() < 1e-12
    left, own = left[:1000], (right[:1000] - alike * left[:1000]) / np.sqrt(1 - alike**2)
    for phasors in (left, own, left * own.conj(), left[1:] * left[:-1].conj(), left**2):
        assert np.abs(np.mean(phasors / np.abs(phasors))) < 3 / np.sqrt(1000)
    np.testing.assert_allclose(np.abs([left, own]), [expected, expected], rtol=1e-8)
    for i, name in enumerate("ABCDEFGH"):
        np.testing.assert_allclose(Iso8608(name, 3, V, 1.5, 100.0).displacement(TIME), 2.0 ** (i - 2) * RANDOM.displacement(TIME))


M, G, C = CAR.parameters["sprung_mass"], 9.81, 0.6  # kg, m/s2, m over the ground
BLOW = np.array([0.0, 0.303, 0.304, 0.9]), np.array([0.0, 200.0, -100.0, 50.0])
# Forces [N] at places from the centre of mass [m], x forward, y to the left, z up; they include those of the road on the tyres.
LOADS = [
    (Brake(0.4), [((0, 0, -C), (-0.4 * M * G, 0, 0))]),
    (Cornering(0.3), [((0, 0, -C), (0, 0.3 * M * G, 0))]),
    (Payload(80.0, 0.7, -0.4), [((0.7, -0.4, 0), (0, 0, -80.0 * G))]),
    (Lift(300.0, -1.2, 0.3), [((-1.2, 0.3, 0), (0, 0, 300.0))]),
    (Gust(500.0, 1.4), [((0, 0, 1.4 - C), (0, -500.0, 0)), ((0, 0, -C), (0, 500.0, 0))]),
    (History("a", BLOW[0], {"heave": BLOW[1], "roll": 2 * BLOW[1]}), [((0, 2.0, 0), (0, 0, 1.0))]),
]


def over_time(load, t):
    """The share of a load over time: half periods of a cosine, or straight lines."""
    if isinstance(load, History):
        return np.interp(t, *BLOW)
    start, up, hold = (getattr(load, name) for name in ("start", "rise", "hold"))
    return rise((t - start) / up) - rise((t - start - up - hold) / up)


@pytest.mark.parametrize(("load", "forces"), LOADS, ids=lambda one: type(one).__name__)
def test_loads_are_their_forces_with_levers(load, forces):
    """A load is the sum of its forces and moments, nose down and right side down, over time and held over steps."""
    given = RoadInput(CAR, RoadWithLoads(Flat(V), (load,)), TIME)
    moments = np.sum([np.cross(place, force) for place, force in forces], axis=0)
    whole = np.array([sum(force[2] for _, force in forces), moments[1], moments[0]])
    assert [one.name for one in CAR.kind.loads] == ["heave_load", "pitch_load", "roll_load"]
    np.testing.assert_allclose(given.loads, np.outer(over_time(load, TIME), whole), rtol=0, atol=1e-9)
    means = isinstance(load, History)  # over steps, as points may be closer
    held = over_time(load, np.add.outer(TIME, PARTS)).mean(axis=1) if means else over_time(load, TIME + H / 2)
    np.testing.assert_allclose(given.held_loads, np.outer(held, whole), rtol=0, atol=1e-2 if means else 1e-9)  # of 400 parts
    both = RoadInput(CAR, RoadWithLoads(Flat(V), (load, Lift(-50.0), load)), TIME).scaled(-0.5)
    np.testing.assert_allclose(both.loads, -given.loads - 0.5 * np.outer(over_time(Lift(), TIME), [-50.0, 0, 0]), atol=1e-9)


@pytest.mark.parametrize("name", kinds())
def test_rest_is_that_of_the_free_bodies(name):
    """At rest nothing moves, tyres carry the weight by the lever rule, and a wheel in the air falls under its suspension's load.

    Tyres of the half-car damp.
    """
    damped = "[parameters]\ntyre_damping_front = 900.0\ntyre_damping_rear = 1400.0"
    half = parse_vehicle(read_vehicle("half_car").text.replace("[parameters]", damped))
    vehicle = {"half_car": half, "full_car": CAR}.get(name) or read_vehicle(name)
    p, model, tyres = vehicle.parameters, build_model(vehicle, 1e-3), vehicle.kind.static_tyre_deflection(vehicle.parameters)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert np.abs(data.qacc).max() < 1e-9  # m/s2, rad/s2; measured 1e-13
    data.mocap_pos[:, 2] = -1.0
    mujoco.mj_forward(model, data)
    front, rear = (p.get(f"axle_distance_{axle}", 0.5) for axle in ("front", "rear"))
    for tyre, deflection in tyres.items():
        end = tyre.removeprefix("tyre_deflection")
        part = axle(end)
        lever = {"_front": rear, "_rear": front, "": 1.0}.get(part, 0.5) / (front + rear)
        load, wheel = p["sprung_mass"] * G * lever / max(len(tyres) / 2, 1.0), p[f"unsprung_mass{part}"]
        assert deflection * p[f"tyre_stiffness{part}"] == pytest.approx(load + wheel * G, rel=1e-12)
        assert data.qacc[model.joint(f"unsprung{end}").dofadr[0]] == pytest.approx(-G - load / wheel, rel=1e-12)


def test_everything_has_a_second_source():
    """Every road and load of the product is in the lists above."""
    for module in pkgutil.iter_modules(models.roads.__path__, "models.roads."):
        importlib.import_module(module.name)

    def concrete(base):
        every = [base, *(one for part in base.__subclasses__() for one in concrete(part))]
        own = [one for one in every if one.__module__.startswith("models.") and not one.__name__.startswith("_")]
        return [one for one in own if not inspect.isabstract(one)]

    assert {*concrete(Road)} == {type(road) for road, _ in ROADS}
    assert {*concrete(Load)} == {type(load) for load, _ in LOADS}


ALTERED = [
    ("quarter_car", {}),
    ("quarter_car", {"tyre_damping": 150.0}),
    ("half_car", {}),
    ("half_car", {"pitch_centre_height": 0.2, "anti_dive_front": 0.3, "tyre_damping_front": 150.0, "tyre_damping_rear": 90.0}),
    ("half_car_roll", {"anti_roll_stiffness": 1e4, "unsprung_mass_left": 45.0, "tyre_damping_right": 90.0}),
    ("half_car_roll", {"centre_offset": 0.1, "roll_centre_height": 0.15, "suspension_stiffness_right": 2e4}),
    ("full_car", {}),
    ("full_car", {"anti_roll_stiffness_front": 2e4, "track_rear": 1.4, "tyre_damping_front": 150.0}),
    ("full_car", {"roll_centre_height_front": 0.1, "roll_centre_height_rear": 0.15, "anti_roll_stiffness_rear": 1e4}),
    ("full_car", {"roll_centre_height_front": -0.1, "roll_centre_height_rear": 0.2, "pitch_centre_height": 0.3}),
    ("quarter_car", {"seat_mass": 88.0}),
    ("half_car", {"seat_mass": 75.0, "seat_x": 0.4}),
    ("half_car", {"seat_mass": 75.0, "seat_x": -0.3, "pitch_centre_height": 0.2, "anti_dive_front": 0.3}),
    ("half_car_roll", {"seat_mass": 75.0, "seat_y": 0.4, "roll_centre_height": 0.15, "centre_offset": 0.1}),
    ("full_car", {"seat_mass": 75.0, "seat_x": 0.2, "seat_y": 0.35}),
    (
        "full_car",
        {"seat_mass": 90.0, "seat_x": -0.8, "seat_y": -0.3, "roll_centre_height_front": 0.1, "roll_centre_height_rear": 0.15}
        | {"pitch_centre_height": 0.3, "anti_roll_stiffness_front": 1e4, "tyre_damping_front": 150.0, "seat_damping": 900.0},
    ),
]
SEAT = "\n[seat]\nmass = 80.0\nstiffness = 15e3\ndamping = 400.0\n"


@pytest.mark.parametrize(("kind", "more"), ALTERED)
def test_equations_follow_from_masses_and_lengths(kind, more):
    """Equations of motion and linear model are those that complex steps of mass matrix, lengths and potential energy give."""
    plain = read_vehicle(kind)
    vehicle = (parse_vehicle(plain.text + SEAT) if "seat_mass" in more else plain).with_parameters(**more)
    p, model = vehicle.parameters, vehicle.linear_model
    stiffness, damping = (
        np.array([p[f"suspension_{name}{axle(end)}"] for end in CORNERS[kind]]) for name in ("stiffness", "damping")
    )
    own = Mechanism(vehicle, lambda d, v, u: stiffness * d + damping * v - u + 1e3 * np.tanh(30 * d) * v**2)
    rng, n, c = np.random.default_rng(0), own.n, own.c
    x, z_r, u, w = (rng.uniform(-far, far, (40, size)) for far, size in ((0.05, 2 * n), (0.03, c), (1e3, c), (1.0, c)))
    wheels = "anti_dive_front" in more or any(name.startswith("roll_centre_height") for name in more)
    push = rng.uniform(-1e3, 1e3, (40, own.k + c * wheels))
    assert vehicle.kind.motion is not None
    motion = vehicle.kind.motion(vehicle.kind.at_wheels(p))
    loads = np.hstack([push if len(vehicle.kind.loads) else push[:, :0], w if model.tyres_damp else w[:, :0]])
    found = motion.rate(x, z_r, u, lambda d, v: 1e3 * np.tanh(30 * d) * v**2, loads)
    on = np.hstack([push, np.zeros((40, n - push.shape[1]))]) if len(vehicle.kind.loads) else 0.0
    expected = own.rate(x, z_r, u, w, on)
    assert np.abs(found - expected).max() < 1e-14 * np.abs(expected).max()
    modes = np.eye(c) if kind != "full_car" else np.array([[1, 1, 1, 1], [-1, -1, 1, 1], [1, -1, 1, -1]]) / 4
    for name, matrix in zip(("A", "B", "Bw", "Br"), own.linearised(modes), strict=True):
        of = getattr(model, "A" if name == "Br" else name)  # Br is the difference of forces over heights
        assert np.abs(getattr(model, name) - matrix).max() <= 1e-12 * np.abs(of).max(), name
