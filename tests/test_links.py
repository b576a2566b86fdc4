"""Links of cars: roll centres, a pitch centre, anti-dive and anti-squat, and the wheels' own share of the transfer."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import math

import numpy as np
import pytest

from models.kinds.kind import GRAVITY
from models.roads.load_choice import choose_load
from models.roads.road import RoadInput
from models.vehicle.mjcf import build_spec
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.drive import main as drive
from sim.inspect.__main__ import main as inspect
from sim.physics.simulate import simulate as simulate_met
from sim.runs.agreement import compare
from sim.runs.run import run_controllers, sample_times
from sim.studies.ride.metrics import PITCH, ROLL, static_angles
from synth.controller.report import twist_lines
from synth.vehicle.designer import Designer
from tests import test_cars
from tests.analysed import simulate
from tests.commands import in_the_suite, prose, refused
from tests.conftest import random_vehicles
from tests.faults import built_with, places, scaled
from tests.rewriting import contents
from tests.shared import designed
from tests.test_loads import road_of

ON_THE_GROUND = "roll_centre_height_front = 0.0\nroll_centre_height_rear = 0.0"
AXES = "roll_centre_height_front = 0.04\nroll_centre_height_rear = 0.13\npitch_centre_height = 0.31"
ANTI = "anti_dive_front = 0.35\nanti_lift_rear = 0.2\nanti_squat_rear = 0.6\nanti_lift_front = 0.1"
WHEELS = "wheel_centre_height_front = 0.31\nwheel_centre_height_rear = 0.33"
HALF = f"pitch_centre_height = 0.3\n{ANTI}\n{WHEELS}"
ALL = {"half_car": HALF, "full_car": f"{AXES}\n{ANTI}\n{WHEELS}\nanti_roll_stiffness_front = 2e4"}
CASES = [*ALL.items(), ("full_car", f"{ON_THE_GROUND}\n{ANTI}"), ("full_car", f"{ANTI}\n{WHEELS}")]
HARD = {
    "half_car": "bump:height=0.06 + brake:g=0.4:start=0.1",
    "full_car": "bump:height=0.06:track=left + corner:g=0.3:start=0.1 + brake:g=0.4:start=0.1 + gust:force=700:start=0.2",
}


def linked(kind: str, lines: str) -> Vehicle:
    """A car that ships, with these parameters."""
    return parse_vehicle(read_vehicle(kind).text.replace("[parameters]", f"[parameters]\n{lines}", 1))


def at_rest(vehicle: Vehicle, *texts: str) -> dict[str, float]:
    """The linear model's signals at rest without control under loads, and the body's angles [rad]."""
    model, p = vehicle.linear_model, vehicle.parameters
    pushed = dict.fromkeys(model.loads, 0.0)
    for text in texts:
        for name, values in choose_load(text).over(np.array([99.0]), p, vehicle.kind).items():
            pushed[name] += values.item()
    load = np.array([*pushed.values()])
    x = np.linalg.solve(model.A, -model.Bl @ load)
    found = dict(zip(model.outputs, (model.C @ x + model.Dl @ load).tolist(), strict=True))
    sums = vehicle.kind.angles(p).items()
    return found | {angle: float(sum(share * found.get(name, 0.0) for name, share in parts.items())) for angle, parts in sums}


def stiffness(p) -> list[float]:
    """Of each axle against roll, springs, bar and tyres in series [N m/rad]."""
    found = []
    for axle in ("front", "rear"):
        springs = p[f"suspension_stiffness_{axle}"] * p["track"] ** 2 / 2 + p[f"anti_roll_stiffness_{axle}"]
        tyres = p[f"tyre_stiffness_{axle}"] * p["track"] ** 2 / 2
        found.append(springs * tyres / (springs + tyres))
    return found


def test_a_car_rolls_about_the_ground_as_the_books_say():
    """With roll centres on the ground the full car rolls at 0.3 g by m_s a h / (K - m_s g h), 4.41 degrees, not by 3.51."""
    plain, car = read_vehicle("full_car"), linked("full_car", ON_THE_GROUND)
    p, K = car.parameters, sum(stiffness(car.parameters))
    moment, turning = (p["sprung_mass"] * GRAVITY * share * p["centre_height"] for share in (0.3, 1.0))
    closed = math.degrees(moment / (K - turning))
    assert round(closed, 2) == 4.41
    passive, road = designed(car, "passive"), road_of("flat + corner:g=0.3", car)
    assert static_angles(car, passive, road, 9.0)[ROLL] == pytest.approx(closed, rel=1e-12)
    without = static_angles(plain, passive, road_of("flat + corner:g=0.3", plain), 9.0)[ROLL]
    assert without == pytest.approx(math.degrees(moment / K), rel=1e-12)
    assert round(without, 2) == 3.51
    time, parts = sample_times(car, 12.0, 2e-3), car.kind.angles(p)[ROLL]
    runs = simulate([car] * 2, [passive] * 2, [road_of(f"flat + corner:g={g}", car) for g in (0.3, 0.01)], time).response
    for i, (g, off) in enumerate(((0.3, 3e-3), (0.01, 2e-5))):  # sin(phi) is phi - phi^3 / 6; and what still moves after 12 s
        rolled = sum(share * runs.run(i)[name][-1] for name, share in parts.items())
        assert math.degrees(rolled) * 0.3 / g == pytest.approx(closed, rel=off)


@pytest.mark.parametrize("index", range(4))
def test_wheels_gain_in_a_curve_what_balances_it(index):
    """At rest in a curve every axle's wheels gain s F h_axle and their own m_u a r by links, and by springs what the body rolls
    over the axle; together they balance inertia and the swayed weight about the ground."""
    car = random_vehicles(linked("full_car", ALL["full_car"]), 4, 0.3)[index]
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
@pytest.mark.parametrize("kind", ["half_car", "full_car"])
def test_axles_exchange_under_brakes_what_balances_them(kind, text):
    """At rest under brakes, or power, the axles exchange all inertia's moment and that of the swayed weight, over the wheelbase;
    springs carry of theirs what links do not."""
    car = random_vehicles(linked(kind, ALL[kind]), 1, 0.3)[0]
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
def test_full_anti_dive_leaves_no_dive(kind):
    """With an anti-dive of 1 the front springs do not move under brakes, however little the rear ones lift; in MuJoCo, too."""
    for lift in (0.0, 1.0):
        car = linked(kind, f"anti_dive_front = 1.0\nanti_lift_rear = {lift}")
        corner = "front" if kind == "half_car" else "front_left"
        found, dived = at_rest(car, "brake:g=0.4"), at_rest(read_vehicle(kind), "brake:g=0.4")
        assert abs(found[f"suspension_deflection_{corner}"]) < 1e-12
        assert dived[f"suspension_deflection_{corner}"] < -0.01
        assert (abs(found[PITCH]) < 0.3 * dived[PITCH]) == (lift == 1.0)  # tyres yield all the same
    time, road = sample_times(car, 12.0, 2e-3), road_of("flat + brake:g=0.4", car)
    run = simulate([car], [designed(car, "passive")], [road], time).response.run(0)
    rest, squeezed = (abs(run[f"{part}_deflection_{corner}"][-1]) for part in ("suspension", "tyre"))
    assert rest < 1e-6 + 3e-5 * squeezed  # m; struts lean by a few milliradian


@pytest.mark.parametrize("index", range(3))
@pytest.mark.parametrize("kind", ["half_car", "full_car"])
def test_equations_are_the_physics(kind, index):
    """Found by differences in MuJoCo, a car with axes obeys its A, B, Bw and Br, C, D and Cr, to 1e-7."""
    test_cars.test_linearisation_is_the_hand_derived_one(linked(kind, ALL[kind]), index)


@pytest.mark.parametrize(("kind", "lines"), in_the_suite(CASES[:2], CASES))
def test_steps_are_those_of_the_exact_equations(kind, lines):
    """Over a bump of 0.06 m in a curve under brakes each step of random cars is that of Lagrange's equations, to rounding, and
    energy balances; a hundredth of it is a hundred times nearer to the linear response."""
    car = linked(kind, lines)
    for other in [car, *random_vehicles(car, 1 if kind == "half_car" and lines == ALL[kind] else 0, 0.3)]:
        road = road_of(HARD[kind], other)
        (run,) = run_controllers(other, [designed(other, "passive")], road, sample_times(other, 0.8, 1e-3))
        assert run.passed
        assert run.agreement.steps is not None
        assert run.agreement.steps.until == math.inf
        assert run.agreement.steps.error < 1e-12  # rounding; measured 3e-14
        assert run.energy is not None
        assert run.energy.residual < 1e-5  # RK4's share
        far = run.agreement.signals[f"suspension_deflection_{'front' if kind == 'half_car' else 'front_left'}"]
        assert far.small is None or far.small < 0.03 * far.sampled  # geometry goes with the square


@pytest.mark.parametrize("joint", ["pitch", "roll"])
def test_a_hinge_that_is_off_is_found(joint):
    """A hinge that lies 2 % too low under the centre of mass is found, step by step, in a curve as under brakes."""
    car = linked("full_car", ALL["full_car"])
    (place,) = [place for place in places(build_spec(car, 1e-3)) if place[:2] == ("joint", joint)]
    road, passive, time = road_of(HARD["full_car"], car), designed(car, "passive"), sample_times(car, 0.5, 1e-3)
    (clean,) = run_controllers(car, [passive], road, time)
    assert clean.passed
    with built_with(scaled(place, 0.02)):
        made = simulate_met([passive], [RoadInput(car, road, time)])
    wrong = compare(clean.prediction, made.run(0), made.requested_force[0])
    assert not wrong.step_by_step
    assert wrong.steps is not None
    assert wrong.steps.error > 1e-7  # of a peak in one step; a clean one has 3e-14


def test_cars_without_links_are_as_they_were():
    """A file that says nothing of links has no such parameter, no load on a wheel and struts; shares of 0 change no number."""
    for kind in ("half_car", "full_car"):
        plain, zero = read_vehicle(kind), linked(kind, "anti_dive_front = 0.0\nwheel_centre_height_rear = 0.0")
        assert not any("centre_height_" in name or name.startswith(("anti_dive", "anti_squat")) for name in plain.parameters)
        assert [load.joint for load in plain.kind.loads] == ["heave", "pitch", "roll"][
            : len(plain.kind.angles(plain.parameters)) + 1
        ]
        assert len(zero.kind.loads) == len(plain.kind.loads) + len(plain.kind.wheels)
        passive, time = designed(plain, "passive"), sample_times(plain, 0.7, 2e-3)
        both = [simulate([one], [passive], [road_of(HARD[kind], one)], time).response.values for one in (plain, zero)]
        np.testing.assert_array_equal(both[0], both[1])
        for name in ("A", "B", "Bw", "Br", "C", "D", "Cr"):
            np.testing.assert_array_equal(getattr(plain.linear_model, name), getattr(zero.linear_model, name))


def test_cars_with_other_axes_are_stepped_side_by_side():
    """In a batch, as campaigns draw roll centres, every car has its own hinges: it moves as it does alone."""
    cars = [linked("full_car", ALL["full_car"]).with_parameters(roll_centre_height_front=height) for height in (0.04, 0.2)]
    passive, time = designed(cars[0], "passive"), sample_times(cars[0], 0.5, 2e-3)
    roads = [road_of("flat + corner:g=0.3:start=0.0:rise=0.1", car) for car in cars]
    together = simulate(cars, [passive] * 2, roads, time).response.values
    for i in range(2):
        np.testing.assert_array_equal(together[i], simulate([cars[i]], [passive], [roads[i]], time).response.values[0])
    assert np.abs(together[0] - together[1]).max() > 1e-3


@pytest.mark.parametrize(
    ("kind", "lines", "words"),
    [
        ("full_car", "roll_centre_height_front = 0.1", ["roll_centre_height_rear is not", "give both, or none"]),
        ("full_car", f"{ON_THE_GROUND}\ncentre_height = 3.0", ["falls over as it rolls", "N m/rad", "stiffer", "roll centres"]),
        ("half_car", "pitch_centre_height = -2.0\ncentre_height = 30.0", ["falls over as it pitches", "pitch centre"]),
        ("half_car", ON_THE_GROUND, ["only heaves and pitches", "take a full_car"]),
        ("full_car", "anti_dive_front = 4.0", ["anti_dive_front = 4.0", "from -2 to 3"]),
        ("full_car", "wheel_centre_height_rear = -0.1", ["wheel_centre_height_rear", "from 0 to 3 m"]),
    ],
)
def test_refusals_say_why(kind, lines, words):
    """What is no car is refused in one line that says why."""
    with refused(*words):
        linked(kind, lines)


@pytest.mark.attack
def test_designs_weigh_banks_and_loads_on_wheels():
    """A car with roll centres is designed for: a bank acts by its height, beside the twist, and wheels' loads are weighed."""
    entry = '\n[controllers.held]\nmeasured = ["heave_velocity", "pitch_rate", "roll_rate"]\n'
    entry += "loads = { roll_load = 1000.0, wheel_load_front_left = 500.0 }\n"
    car = parse_vehicle(linked("full_car", ALL["full_car"]).text + entry)
    controller = Designer(car).design("held")
    assert controller.certificate.bound is not None
    assert controller.certificate.bound >= controller.certificate.norm.value
    (run,) = run_controllers(car, [controller], road_of(HARD["full_car"], car), sample_times(car, 0.6, 1e-3))
    assert run.passed
    assert "roll_acceleration" not in car.linear_model.measurable  # it has the road's height in it
    assert "the height of its pitch, roll, twist, of which 1 m counts as" in twist_lines(car)[0]


def test_a_body_leans_on_a_banked_road():
    """Where the whole road leans for ever the body leans over it by m_s g b / (K - m_s g b) of the bank, as axles share it."""
    car = linked("full_car", ALL["full_car"])
    p, model = car.parameters, car.linear_model
    height, (front, rear) = 0.01, stiffness(p)
    x = np.linalg.solve(model.A, -model.Br @ (height * np.array([1.0, -1.0, 1.0, -1.0])))
    axis = (0.04 * p["axle_distance_rear"] + 0.13 * p["axle_distance_front"]) / (
        p["axle_distance_front"] + p["axle_distance_rear"]
    )
    turning = p["sprung_mass"] * GRAVITY * (p["centre_height"] - axis)
    leans = turning / (front + rear - turning) * height  # m at a wheel, of the body over the road
    springs = p["suspension_stiffness_front"] * p["track"] ** 2 / 2 + p["anti_roll_stiffness_front"]
    assert x[model.states.index("suspension_deflection_front_left")] == pytest.approx(leans * front / springs, rel=1e-9)


@pytest.mark.attack
def test_commands_say_what_is_modelled(tmp_path, capsys):
    """A drive in a curve logs the loads on the wheels, its log is proved, and what is left out is said."""
    path, logs = tmp_path / "car.toml", tmp_path / "logs"
    path.write_text(linked("full_car", f"{ON_THE_GROUND}\n{WHEELS}").text)
    arguments = ["--vehicle", str(path), "--controller", "passive", "--load", "corner:g=0.3"]
    assert drive([*arguments, "--duration", "1", "--timestep", "4e-3", "--logs", str(logs), "-v"]) == 0
    said = prose(capsys.readouterr().out)
    assert "the moment of the body's own weight as it pitches is left out" in said
    (log,) = logs.glob("*.mcap")
    assert any(b"wheel_load_front_right" in schema.data for schema in contents(log).schemas)
    assert inspect([str(log)]) == 0
