"""Options of vehicles: bars, links, tyres that damp, struts without springs, and heights; in the equations as in MuJoCo."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import math
import re
from typing import Any

import mujoco
import numpy as np
import pytest

from models.common.errors import InputError
from models.kinds.kind import GRAVITY
from models.roads.choice import choose_road
from models.roads.loads.choice import choose_load
from models.roads.road import RoadInput
from models.vehicle.mjcf import build_model, build_spec
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.drive.__main__ import main as drive
from sim.drive.sensor_readout import reads_out
from sim.inspect.__main__ import main as inspect
from sim.linear.frequency_response import continuous_frequency_response
from sim.runs.agreement import compare
from sim.runs.run import run_controllers, sample_times
from sim.studies.ride.metrics import PITCH, ROLL
from sim.studies.ride.run_metrics import static_angles
from synth.controller.design_notes import twist_lines
from synth.controller.problem import generalized_plant
from synth.vehicle.designer import Designer
from tests.conftest import random_vehicles
from tests.models import test_cars
from tests.support.analysed import simulate
from tests.support.analysed import simulate_inputs as simulate_met
from tests.support.commands import in_the_suite, prose, refused
from tests.support.faults import built_with, places, scaled
from tests.support.rewriting import contents
from tests.support.shared import designed

KINDS = ("quarter_car", "half_car", "full_car")
FRONT, REAR = 24000.0, 9000.0  # N m/rad, of a passenger car
BARS = f"anti_roll_stiffness_front = {FRONT}\nanti_roll_stiffness_rear = {REAR}"
TRACKS = "track_front = 1.387\ntrack_rear = 1.2"  # m; further apart than on a car, so that a confusion shows
ON_THE_GROUND = "roll_centre_height_front = 0.0\nroll_centre_height_rear = 0.0"
AXES = "roll_centre_height_front = 0.04\nroll_centre_height_rear = 0.13\npitch_centre_height = 0.31"
ANTI = "anti_dive_front = 0.35\nanti_lift_rear = 0.2\nanti_squat_rear = 0.6\nanti_lift_front = 0.1"
WHEELS = "wheel_centre_height_front = 0.31\nwheel_centre_height_rear = 0.33"
LINKS = {
    "half_car": f"pitch_centre_height = 0.3\n{ANTI}\n{WHEELS}",
    "full_car": f"{AXES}\n{ANTI}\n{WHEELS}\nanti_roll_stiffness_front = 2e4",
}
AXLES = "tyre_damping_front = 900.0\ntyre_damping_rear = 1400.0"  # N s/m; they differ, so that none stands in for another
TYRES = {"quarter_car": "tyre_damping = 1500.0", "half_car": AXLES, "full_car": AXLES}
HARD = {
    "half_car": "bump:height=0.06 + brake:g=0.4:start=0.1",
    "full_car": "bump:height=0.06:track=left + corner:g=0.3:start=0.1 + brake:g=0.4:start=0.1 + gust:force=700:start=0.2",
}
RISE = 0.05  # m


def with_parameters(kind: str, lines: str) -> Vehicle:
    """A vehicle that ships, with more parameters."""
    return parse_vehicle(read_vehicle(kind).text.replace("[parameters]", f"[parameters]\n{lines}", 1))


def without_springs(kind: str) -> Vehicle:
    """A vehicle without springs and dampers, under its LQR."""
    text = re.sub(r"^(suspension_(?:stiffness|damping)\w* = ).*$", r"\g<1>0.0", read_vehicle(kind).text, flags=re.M)
    return parse_vehicle(f'{text}\n[controllers.lqr]\ndesign = "lqr"\n')


def with_heights(kind: str) -> tuple[Vehicle, list[str]]:
    """A vehicle with its heights named, at no weight."""
    plain = read_vehicle(kind)
    names = [signal.name for signal in plain.kind.on_demand if re.search(r"displacement(_|$)", signal.name)]
    lines = "\n".join(["[performance]", *(f"{name} = 0.0" for name in names)])
    return parse_vehicle(plain.text.replace("[performance]", lines)), names


def driven(vehicle: Vehicle, text: str, duration: float = 0.8, name: str = "passive", speed: float = 20.0):
    """The run of one controller over a road with loads."""
    road = choose_road(text).build(vehicle, speed, 0, speed * duration)
    return run_controllers(vehicle, [designed(vehicle, name)], road, sample_times(vehicle, duration, 1e-3))[0]


def at_rest(vehicle: Vehicle, *texts: str) -> dict[str, float]:
    """The linear model's signals in equilibrium without control under loads, and the body's angles [rad]."""
    model, p = vehicle.linear_model, vehicle.parameters
    pushed = dict.fromkeys(model.loads, 0.0)
    for text in texts:
        for name, values in choose_load(text).at(np.array([99.0]), p, vehicle.kind).items():
            pushed[name] += values.item()
    load = np.array([*pushed.values()])
    x = np.linalg.solve(model.A, -model.Bl @ load)
    found = dict(zip(model.outputs, (model.C @ x + model.Dl @ load).tolist(), strict=True))
    sums = vehicle.kind.angles(p).items()
    return found | {angle: float(sum(share * found.get(name, 0.0) for name, share in parts.items())) for angle, parts in sums}


# --- the equations are the physics -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "lines", "index"),
    [
        ("half_car", LINKS["half_car"], 1),
        ("full_car", f"{LINKS['full_car']}\n{TRACKS}", 1),
    ],
)
def test_equations_are_the_physics(kind, lines, index):
    """By differences in MuJoCo, a car with bars or links obeys its A, B, Bw and Br, C, D and Cr, to 1e-7."""
    test_cars.test_linearisation_is_the_hand_derived_one(with_parameters(kind, lines), index)


CASES: dict[str, Any] = {  # a vehicle, a road with loads, and the error that rounding leaves in a step
    "bars": (lambda: with_parameters("full_car", BARS), "bump:height=0.05:track=left", 1e-12),
    "tracks": (lambda: with_parameters("full_car", f"{LINKS['full_car']}\n{TRACKS}"), HARD["full_car"], 1e-12),
    **{f"links {kind}": (lambda kind=kind: with_parameters(kind, LINKS[kind]), HARD[kind], 1e-12) for kind in LINKS},
    "links on the ground": (lambda: with_parameters("full_car", f"{ON_THE_GROUND}\n{ANTI}"), HARD["full_car"], 1e-12),
    "wheels' own inertia": (lambda: with_parameters("full_car", f"{ANTI}\n{WHEELS}"), HARD["full_car"], 1e-12),
    **{f"tyres {kind}": (lambda kind=kind: with_parameters(kind, TYRES[kind]), "iso8608:class=B", 1e-10) for kind in KINDS},
    **{f"strut {kind}": (lambda kind=kind: without_springs(kind), "bump:height=0.03", 1e-10) for kind in KINDS},
}

ATTACKED = ("strut full_car", "links on the ground", "bars", "tyres half_car")


@pytest.mark.parametrize(
    "case",
    in_the_suite(
        ["tracks", "links half_car", "wheels' own inertia", "tyres quarter_car", "strut quarter_car", "strut half_car"], CASES
    ),
)
def test_steps_are_those_of_the_exact_equations(case):
    """Each step in MuJoCo is that of the exact equations, to rounding, and energy balances."""
    make, text, rounding = CASES[case]
    vehicle = make()
    run = driven(vehicle, text, 0.4, "lqr" if case.startswith("strut") else "passive")
    assert run.passed
    assert run.agreement.steps is not None
    assert run.agreement.steps.until == math.inf
    assert run.agreement.steps.error < rounding  # measured 3e-14, and 1e-11 where a tyre's force adds more
    assert run.energy is not None
    assert run.energy.residual < 1e-5  # RK4's share
    assert all(np.isinf(when) for when in run.agreement.end_times.values())


def off_by_2_percent(what: str, spec: Any) -> Any:
    """The fault of a tyre's damping, or of a hinge, in a model."""
    if what != "tyre":
        return scaled(next(place for place in places(spec) if place[:2] == ("joint", what)), 0.02)

    def fault(spec: Any) -> None:
        first = next(actuator for actuator in spec.actuators if actuator.name.startswith("fitted_damped_"))
        first.gainprm[0] *= 1.02
        first.biasprm[2] *= 1.02

    return fault


@pytest.mark.parametrize(
    ("kind", "lines", "what"),
    [("full_car", LINKS["full_car"], "pitch"), ("full_car", LINKS["full_car"], "roll")]
    + [(kind, TYRES[kind], "tyre") for kind in ("quarter_car", "full_car")],
)
def test_what_is_off_is_found(kind, lines, what):
    """A hinge that is 2 % too low under the centre of mass, or a tyre's damping that is 2 % off, is found step by step."""
    vehicle = with_parameters(kind, lines)
    road = choose_road(HARD.get(kind, "bump:height=0.05")).build(vehicle, 20.0, 0, 10.0)
    passive, time = designed(vehicle, "passive"), sample_times(vehicle, 0.4, 1e-3)
    (clean,) = run_controllers(vehicle, [passive], road, time)
    assert clean.passed
    with built_with(off_by_2_percent(what, build_spec(vehicle, 1e-3))):
        made = simulate_met([passive], [RoadInput(vehicle, road, time)])
    wrong = compare(clean.prediction, made.recordings[0])
    assert wrong.steps is not None
    assert not wrong.steps.agrees
    assert wrong.steps.error > 1e-7  # of a peak in one step; a clean one has 3e-14


@pytest.mark.parametrize(
    ("kind", "lines"),
    [
        ("full_car", "anti_roll_stiffness_front = 0.0"),
        *((kind, "anti_dive_front = 0.0\nwheel_centre_height_rear = 0.0") for kind in LINKS),
        ("quarter_car", "tyre_damping = 0.0"),
    ],
)
def test_without_an_option_nothing_changes(kind, lines):
    """A vehicle file without bars, links or tyre damping has the numbers of a file that gives 0 for them, bit for bit."""
    plain, zero = read_vehicle(kind), with_parameters(kind, lines)
    assert not any("centre_height_" in name or name.startswith(("anti_dive", "tyre_damping")) for name in plain.parameters)
    assert (build_model(zero, 1e-3).ntendon, build_model(zero, 1e-3).nu) == (2 * len(zero.kind.wheels), len(zero.kind.wheels))
    passive, time = designed(plain, "passive"), sample_times(plain, 0.5, 2e-3)
    road = choose_road(HARD.get(kind, "iso8608:class=C")).build(plain, 20.0, 0, 10.0)
    both = [simulate([one], [passive], [road], time).response.values for one in (plain, zero)]
    np.testing.assert_array_equal(both[0], both[1])
    for name in ("A", "B", "Bw", "Br", "C", "D", "Cr"):
        np.testing.assert_array_equal(getattr(plain.linear_model, name), getattr(zero.linear_model, name))


def test_cars_are_stepped_side_by_side():
    """In a batch a car with other roll centres or bars moves as it does alone; one without bars needs another batch."""
    links, barred = with_parameters("full_car", LINKS["full_car"]), with_parameters("full_car", BARS)
    softer = barred.with_parameters(anti_roll_stiffness_front=1.0)
    keys = [reads_out(one, 1e-3) for one in (read_vehicle("full_car"), barred, softer)]
    assert keys[0] != keys[1] == keys[2]
    for cars in ([links, links.with_parameters(roll_centre_height_front=0.2)], [barred, softer]):
        passive, time = designed(cars[0], "passive"), sample_times(cars[0], 0.4, 2e-3)
        roads = [choose_road("bump:track=left + corner:g=0.3:start=0.0:rise=0.1").build(car, 20.0, 0, 8.0) for car in cars]
        together = simulate(cars, [passive] * 2, roads, time).response.values
        for i in range(2):
            np.testing.assert_array_equal(together[i], simulate([cars[i]], [passive], [roads[i]], time).response.values[0])
        assert np.abs(together[0] - together[1]).max() > 1e-3


# --- closed forms ----------------------------------------------------------------------------------------------------------


def test_bars_are_stiff_against_roll_alone():
    """A body that rolls over its axles meets a moment of both bars' stiffness times the angle; other motion meets none."""
    with_bars, without = (build_model(one, 1e-3) for one in (with_parameters("full_car", BARS), read_vehicle("full_car")))

    def push(model, motion):
        data = mujoco.MjData(model)
        for joint, value in motion.items():
            data.joint(joint).qpos[0] = value
        mujoco.mj_forward(model, data)
        return data.qfrc_passive.copy()

    roll, side = 0.01, read_vehicle("full_car").parameters["track"] / 2 * 0.01
    wheels = {f"unsprung_{axle}_{name}": sign * side for axle in ("front", "rear") for name, sign in (("left", 1), ("right", -1))}
    for motion, moment in (({"roll": roll}, FRONT + REAR), ({"heave": 0.02, "pitch": 0.01}, 0), ({"roll": roll, **wheels}, 0)):
        extra = push(with_bars, motion) - push(without, motion)
        found = dict(zip([with_bars.joint(i).name for i in range(with_bars.njnt)], extra, strict=True))
        assert found["roll"] == pytest.approx(-moment * roll, abs=1e-9)  # rounding of 460 N m beside the weight
        assert found["heave"] == found["pitch"] == pytest.approx(0.0, abs=1e-9)
        assert found["unsprung_front_left"] == pytest.approx(FRONT * roll / (2 * side) * roll if moment else 0.0, abs=1e-9)


def stiffness(p) -> list[float]:
    """The stiffness of each axle against roll, of springs, bar and tyres in series [N m/rad]."""
    found = []
    for axle in ("front", "rear"):
        track = p.get(f"track_{axle}") or p["track"]
        springs = p[f"suspension_stiffness_{axle}"] * track**2 / 2 + p[f"anti_roll_stiffness_{axle}"]
        tyres = p[f"tyre_stiffness_{axle}"] * track**2 / 2
        found.append(springs * tyres / (springs + tyres))
    return found


def test_a_car_rolls_about_the_ground_as_the_books_say():
    """With roll centres on the ground the full car rolls at 0.3 g by m_s a h / (K - m_s g h), 4.41 degrees, not by 3.51."""
    plain, car = read_vehicle("full_car"), with_parameters("full_car", ON_THE_GROUND)
    p, K = car.parameters, sum(stiffness(car.parameters))
    moment, turning = (p["sprung_mass"] * GRAVITY * share * p["centre_height"] for share in (0.3, 1.0))
    closed = math.degrees(moment / (K - turning))
    assert round(closed, 2) == 4.41
    passive, road = designed(car, "passive"), choose_road("flat + corner:g=0.3").build(car, 20.0, 0, 40.0)
    assert static_angles(car, passive, road, 9.0)[ROLL] == pytest.approx(closed, rel=1e-12)
    without = static_angles(plain, passive, road, 9.0)[ROLL]
    assert without == pytest.approx(math.degrees(moment / K), rel=1e-12)
    assert round(without, 2) == 3.51
    time, parts = sample_times(car, 12.0, 4e-3), car.kind.angles(p)[ROLL]
    roads = [choose_road(f"flat + corner:g={g}").build(car, 20.0, 0, 240.0) for g in (0.3, 0.01)]
    runs = simulate([car] * 2, [passive] * 2, roads, time).response
    for i, (g, off) in enumerate(((0.3, 3e-3), (0.01, 2e-5))):  # sin(phi) is phi - phi^3 / 6; and what still moves after 12 s
        rolled = sum(share * runs.run(i)[name][-1] for name, share in parts.items())
        assert math.degrees(rolled) * 0.3 / g == pytest.approx(closed, rel=off)


def test_axles_of_different_track_are_springs_in_parallel():
    """At 0.3 g a sedan with tracks of 1.387 and 1.364 m rolls by m_s a h over both axles' stiffness; no `track` is needed."""
    text = read_vehicle("full_car").text.replace("track = 1.51", "track_front = 1.387\ntrack_rear = 1.364")
    car = parse_vehicle(text.replace("[parameters]", f"[parameters]\n{BARS}", 1))
    p = car.parameters
    closed = math.degrees(0.3 * p["sprung_mass"] * GRAVITY * p["centre_height"] / sum(stiffness(p)))
    road = choose_road("flat + corner:g=0.3").build(car, 20.0, 0, 40.0)
    assert static_angles(car, designed(car, "passive"), road, 9.0)[ROLL] == pytest.approx(closed, rel=1e-12)
    wider = with_parameters("full_car", BARS)
    assert static_angles(wider, designed(wider, "passive"), road, 9.0)[ROLL] < 0.95 * closed


@pytest.mark.parametrize("index", range(3))
def test_wheels_gain_in_a_curve_what_balances_it(index):
    """In a curve each axle's wheels gain the load of its links, its own wheels and its springs; together they balance it.

    Links carry s F h_axle, wheels m_u a r, springs what the body rolls over the axle. The sum balances inertia and the swayed
    weight about the ground.
    """
    car = random_vehicles(with_parameters("full_car", LINKS["full_car"]), 3, 0.3)[index]
    p, found, a, g = car.parameters, at_rest(car, "corner:g=0.25"), 0.25 * GRAVITY, GRAVITY
    lengths = {"front": p["axle_distance_front"], "rear": p["axle_distance_rear"]}
    L, half, total = sum(lengths.values()), p["track"] / 2, 0.0
    axis = (p["roll_centre_height_front"] * lengths["rear"] + p["roll_centre_height_rear"] * lengths["front"]) / L
    for axle, other in (("front", "rear"), ("rear", "front")):
        gained = -p[f"tyre_stiffness_{axle}"] * found[f"tyre_deflection_{axle}_right"]
        assert found[f"tyre_deflection_{axle}_left"] == pytest.approx(-found[f"tyre_deflection_{axle}_right"], rel=1e-9)
        links = p["sprung_mass"] * a * lengths[other] / L * p[f"roll_centre_height_{axle}"]
        wheels = 2 * p[f"unsprung_mass_{axle}"] * a * p[f"wheel_centre_height_{axle}"]
        over_axle = found[ROLL] - gained / p[f"tyre_stiffness_{axle}"] / half
        springs = p[f"suspension_stiffness_{axle}"] * p["track"] ** 2 / 2 + p[f"anti_roll_stiffness_{axle}"]
        assert gained * p["track"] == pytest.approx(links + wheels + springs * over_axle, rel=1e-9)
        total += gained * p["track"]
    own = sum(2 * p[f"unsprung_mass_{axle}"] * p[f"wheel_centre_height_{axle}"] for axle in lengths)
    swayed = p["sprung_mass"] * g * (p["centre_height"] - axis) * found[ROLL]
    assert total == pytest.approx((p["sprung_mass"] * p["centre_height"] + own) * a + swayed, rel=1e-9)


@pytest.mark.parametrize("text", ["brake:g=0.4", "brake:g=-0.3"])
@pytest.mark.parametrize("kind", LINKS)
def test_axles_exchange_under_brakes_what_balances_them(kind, text):
    """Under brakes or power the axles exchange what balances inertia and swayed weight, and links relieve springs."""
    car = random_vehicles(with_parameters(kind, LINKS[kind]), 1, 0.3)[0]
    p, found, a = car.parameters, at_rest(car, text), float(text.rpartition("=")[2]) * GRAVITY
    wheels, L = (1 if kind == "half_car" else 2), p["axle_distance_front"] + p["axle_distance_rear"]
    own = wheels * sum(p[f"unsprung_mass_{axle}"] * p[f"wheel_centre_height_{axle}"] for axle in ("front", "rear"))
    swayed = p["sprung_mass"] * GRAVITY * (p["centre_height"] - p["pitch_centre_height"]) * found[PITCH]
    gained = ((p["sprung_mass"] * p["centre_height"] + own) * a + swayed) / L
    names = ("anti_dive_front", "anti_lift_rear") if a > 0 else ("anti_lift_front", "anti_squat_rear")
    for axle, sign, anti in (("front", 1.0, names[0]), ("rear", -1.0, names[1])):
        end = "" if kind == "half_car" else "_left"
        tyres = -wheels * p[f"tyre_stiffness_{axle}"] * found[f"tyre_deflection_{axle}{end}"]
        springs = -wheels * p[f"suspension_stiffness_{axle}"] * found[f"suspension_deflection_{axle}{end}"]
        assert tyres == pytest.approx(sign * gained, rel=1e-9)
        links = p[anti] * p["sprung_mass"] * a * p["centre_height"] / L
        assert springs == pytest.approx(sign * (gained - own * a / L - links), rel=1e-9)


@pytest.mark.parametrize("kind", ["half_car", "full_car"])
def test_a_payload_pushes_where_it_lies(kind):
    """A weight right over an axle, or a side, is carried by the springs of that axle, or side, alone."""
    vehicle = with_parameters(kind, TYRES[kind])
    p, weight = vehicle.parameters, 10 * GRAVITY
    places = [(-p["axle_distance_rear"], 0.0, "rear"), (p["axle_distance_front"], 0.0, "front")]
    places += [(0.0, p["track"] / 2, "left")] if kind == "full_car" else []
    for x, y, where in places:
        found = at_rest(vehicle, f"payload:mass=10:x={x}" + (f":y={y}" if y else ""))
        carried = {True: 0.0, False: 0.0}
        for one in vehicle.kind.suspensions:
            axle = "front" if "front" in one.deflection else "rear"
            carried[where in one.deflection] -= p[f"suspension_stiffness_{axle}"] * found[one.deflection]
        assert carried == pytest.approx({True: weight, False: 0.0}, abs=1e-9 * weight)


@pytest.mark.parametrize("kind", ["half_car", "full_car"])
def test_full_anti_dive_leaves_no_dive(kind):
    """With an anti-dive of 1 the front springs do not move under brakes, however little the rear ones lift."""
    for lift in (0.0, 1.0):
        car = with_parameters(kind, f"anti_dive_front = 1.0\nanti_lift_rear = {lift}")
        corner = "suspension_deflection_front" if kind == "half_car" else "suspension_deflection_front_left"
        found, dived = at_rest(car, "brake:g=0.4"), at_rest(read_vehicle(kind), "brake:g=0.4")
        assert abs(found[corner]) < 1e-12
        assert dived[corner] < -0.01
        assert (abs(found[PITCH]) < 0.3 * dived[PITCH]) == (lift == 1.0)  # tyres yield all the same


def test_a_body_leans_on_a_banked_road():
    """On a banked road the body leans over it by m_s g b / (K - m_s g b) of the bank, as axles share it."""
    car = with_parameters("full_car", LINKS["full_car"])
    p, model = car.parameters, car.linear_model
    height, (front, rear) = 0.01, stiffness(p)
    x = np.linalg.solve(model.A, -model.Br @ (height * np.array([1.0, -1.0, 1.0, -1.0])))
    L = p["axle_distance_front"] + p["axle_distance_rear"]
    axis = (0.04 * p["axle_distance_rear"] + 0.13 * p["axle_distance_front"]) / L
    turning = p["sprung_mass"] * GRAVITY * (p["centre_height"] - axis)
    leans = turning / (front + rear - turning) * height  # m at a wheel, of the body over the road
    springs = p["suspension_stiffness_front"] * p["track"] ** 2 / 2 + p["anti_roll_stiffness_front"]
    assert x[model.states.index("suspension_deflection_front_left")] == pytest.approx(leans * front / springs, rel=1e-9)


def test_the_optimum_is_thompsons():
    """The four gains of Thompson's strut, by a Riccati equation of an own plant: 1 / sqrt(0.8e-9) is the spring, exactly."""
    gain = Designer(read_vehicle("models/gallery/thompson/car.toml")).design("lqr").law.D[0]
    assert gain == pytest.approx([-35355.33905933, 21878.65376721, -4826.50789578, 1385.70230169], rel=1e-9)


def test_a_passive_car_without_springs_has_no_norm():
    """A body without springs floats: nothing decays, and nothing is claimed of it."""
    assert not Designer(without_springs("quarter_car")).design("passive").certificate.stability.stable


# --- heights ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_heights_come_to_the_kerb(kind):
    """Behind a kerb all heights of body, corners and hubs are the kerb's, and the analysis has them as MuJoCo does."""
    vehicle, names = with_heights(kind)
    run = driven(vehicle, f"step:height={RISE}:edge=1", 3.0, speed=12.5)
    assert run.passed
    assert run.agreement.steps is not None
    assert run.agreement.steps.error < 1e-10
    assert len(names) == {"quarter_car": 2, "half_car": 5, "full_car": 9}[kind]
    for name in names:
        # The slowest mode of a passive car has a tenth of its amplitude left.
        assert run.physics[name][-1] == pytest.approx(RISE, rel=0.35), name
        assert run.prediction.sampled[name][-1] == pytest.approx(run.physics[name][-1], rel=1e-3), name


@pytest.mark.parametrize("kind", KINDS)
def test_rates_of_heights_are_the_velocities(kind):
    """Over the road's velocity the response of a height is that of its velocity over s, exactly."""
    vehicle, names = with_heights(kind)
    omega = np.array([0.3, 6.0, 70.0])
    response = continuous_frequency_response(vehicle, designed(vehicle, "passive"), omega)
    outputs = vehicle.linear_model.outputs
    for name in names:
        rate = response[:, outputs.index(name.replace("displacement", "velocity"))]
        height = response[:, outputs.index(name)] * 1j * omega[:, None]
        assert np.abs(height - rate).max() < 1e-9 * np.abs(rate).max()


def test_a_height_has_a_norm_where_the_road_has_a_height():
    """With a road filter that is 0 at 0 rad/s the plant's z is the height, to rounding; without one it is refused."""
    text = read_vehicle("quarter_car").text
    road = "road = { numerator = [0.07, 0.0], denominator = [0.01, 0.3, 1.0] }"
    weighed = text.replace("[performance]", f"[performance]\n{road}\nsprung_displacement = 2.0")
    vehicle, omega = parse_vehicle(weighed), np.array([1e-3, 5.0, 64.0])
    plant = generalized_plant(vehicle)
    row = [name for name, weight in vehicle.performance.items() if weight].index("sprung_displacement")
    response = continuous_frequency_response(vehicle, designed(vehicle, "passive"), omega)
    own = response[:, vehicle.linear_model.outputs.index("sprung_displacement"), 0]
    s = 1j * omega
    own = 2.0 * own * 0.07 * s / (0.01 * s**2 + 0.3 * s + 1)
    assert np.abs(plant.frequency_response(omega)[:, row, 0] - own).max() < 1e-9 * np.abs(own).max()
    certificate = Designer(vehicle).design("I").certificate
    assert certificate.bound is not None
    assert certificate.norm.value <= certificate.bound < np.inf
    without = parse_vehicle(text.replace("[performance]", "[performance]\nsprung_displacement = 2.0"))
    with pytest.raises(InputError, match="sprung_displacement has no norm, because this height above"):
        Designer(without).design("I")


# --- what is refused, and said ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "lines", "words"),
    [
        ("full_car", "roll_centre_height_front = 0.1", ["without roll_centre_height_rear", "give both heights, or neither"]),
        ("full_car", f"{ON_THE_GROUND}\ncentre_height = 3.0", ["falls over when it rolls", "N m/rad", "stiffen", "roll centres"]),
        ("half_car", "pitch_centre_height = -2.0\ncentre_height = 30.0", ["falls over when it pitches", "pitch centre"]),
        ("half_car", ON_THE_GROUND, ["only heaves and pitches", "use a full_car"]),
    ],
)
def test_refusals_say_why(kind, lines, words):
    """An option that makes no car is refused in one line that says why."""
    with refused(*words):
        with_parameters(kind, lines)


@pytest.mark.attack
def test_designs_weigh_banks_and_loads_on_wheels():
    """A design for a car with roll centres weighs a bank by its height, beside the twist, and the loads of wheels."""
    entry = '\n[controllers.held]\nmeasured = ["heave_velocity", "pitch_rate", "roll_rate"]\n'
    entry += "loads = { roll_load = 1000.0, wheel_load_front_left = 500.0 }\n"
    car = parse_vehicle(with_parameters("full_car", LINKS["full_car"]).text + entry)
    controller = designed(car, "held")
    assert controller.certificate.bound is not None
    assert controller.certificate.bound >= controller.certificate.norm.value
    assert driven(car, HARD["full_car"], 0.6, "held").passed
    assert "roll_acceleration" not in car.linear_model.measurable  # it has the road's height in it
    assert "the height of the road's pitch, roll, twist; 1 m of this height counts as" in twist_lines(car)[0]


@pytest.mark.attack
def test_commands_say_what_is_modelled(tmp_path, capsys):
    """A drive in a curve logs the loads on the wheels, its log is proved, and what is left out is printed."""
    path, logs = tmp_path / "car.toml", tmp_path / "logs"
    path.write_text(with_parameters("full_car", f"{ON_THE_GROUND}\n{WHEELS}").text)
    arguments = ["--vehicle", str(path), "--controller", "passive", "--load", "corner:g=0.3"]
    assert drive([*arguments, "--duration", "1", "--timestep", "4e-3", "--logs", str(logs), "-v"]) == 0
    said = prose(capsys.readouterr().out)
    assert "The model neglects the moment that the body's own weight causes when the body pitches." in said
    (log,) = logs.glob("*.mcap")
    assert any(b"wheel_load_front_right" in schema.data for schema in contents(log).schemas)
    assert inspect([str(log)]) == 0
