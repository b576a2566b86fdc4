"""Springs, dampers, stops and actuators on an arm: the same car as one with these elements at its wheels."""

import itertools
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import root_scalar

from models.characteristics.curve import ForceCurve
from models.characteristics.ratio_table import RatioTable
from models.common.errors import InputError
from models.kinds.at_wheels import ratio_notes
from models.parts.lines import lines_at_rest
from models.parts.ratio import AtRatio
from models.parts.spring import SpringCurve
from models.roads.choice import choose_road
from models.roads.road import Bump, RoadInput
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.bump import main as bump
from sim.drive.actuators import Actuators
from sim.drive.sensor_readout import reads_out
from sim.linear.nonlinear_elements import at_rest
from sim.runs import by_name
from sim.runs.dampers import shortfalls
from sim.runs.run import Run, run_controllers, sample_times
from sim.studies.ride.expected import expect
from sim.studies.ride.metrics import Meter, measure
from synth.analysis.norm import hinf_norm
from synth.vehicle.designer import Designer, driver_of
from tests.support.analysed import simulate_inputs as simulate
from tests.support.commands import attacks, prose
from tests.support.mechanism import straight

CORNERS = {
    "quarter_car": ("",),
    "half_car": ("_front", "_rear"),
    "full_car": tuple(f"_{axle}_{side}" for axle in ("front", "rear") for side in ("left", "right")),
}
RATIOS = {"": 0.6, "_front": 0.6, "_rear": 0.75}  # the axles differ, so that none stands in for another
EXACT = 1e-12
SPRING = {"deflection": [-0.05, -0.02, 0.0, 0.02, 0.05], "force": [-3e3, -900.0, 0.0, 800.0, 2100.0]}
DAMPER = {"velocity": [-0.6, -0.1, 0.0, 0.1, 0.6], "force": [-900.0, -300.0, 0.0, 500.0, 1600.0]}
SOFT = {"velocity": [-0.5, -0.1, 0.0, 0.1, 0.5], "force": [-250.0, -60.0, 0.0, 90.0, 400.0]}
HARD = {"velocity": [-0.5, -0.1, 0.0, 0.1, 0.5], "force": [-2000.0, -600.0, 0.0, 900.0, 3000.0]}
STOP = {"bump": (4e4, 2e6, 3e8), "rebound": (2e5, 0.0, 0.0)}
LAWS = ("skyhook", "skyhook_linear", "hybrid", "pdd")
TABLE = {"deflection": [-0.09, -0.03, 0.02, 0.08], "ratio": [0.68, 0.62, 0.6, 0.55]}


def axle(corner: str) -> str:
    return re.sub("_(left|right)$", "", corner)


def table(points: dict[str, list[float]], r: float) -> str:
    """The table of an element with motion ratio r as one at the wheel: r F(r x)."""
    (name, x), (_, force) = points.items()
    return f"{{ {name} = {(np.array(x) / r).tolist()}, force = {(r * np.array(force)).tolist()} }}"


@cache
def car(kind: str, sort: str, on_arm: bool = True) -> Vehicle:
    """A car with its elements on arms, or by numbers that the test converts to the wheels."""
    text, corners = read_vehicle(kind).text.partition("[controllers")[0], CORNERS[kind]
    axles = dict.fromkeys(map(axle, corners))
    r = {corner: 1.0 if on_arm else RATIOS[axle(corner)] for corner in (*corners, *axles)}
    text = re.sub(r"^suspension_\w+ = .*\n", "", text, flags=re.M)
    numbers = "".join(f"motion_ratio{end} = {RATIOS[end]}\n" for end in axles if on_arm)
    if sort == "curves":
        given = (("stiffness", SPRING), ("damping", DAMPER))
        text += "[curves]\n" + "".join(f"suspension_{name}{end} = {table(one, r[end])}\n" for end in axles for name, one in given)
    else:
        rates = (("stiffness", 25e3), ("damping", 1800.0))
        numbers += "".join(f"suspension_{name}{end} = {rate * r[end] ** 2!r}\n" for end in axles for name, rate in rates)
    text = text.replace("[parameters]", f"[parameters]\n{numbers}", 1)
    for end in axles if sort != "linear" else ():
        laws = ", ".join(f"{side} = {[k * r[end] ** i for i, k in enumerate(ks, 2)]}" for side, ks in STOP.items())
        text += (
            f"[limits{end.replace('_', '.')}]\nsuspension_stroke = {{ bump = {0.02 / r[end]!r}, rebound = {0.03 / r[end]!r} }}\n"
        )
        text += f"stop_stiffness = {{ {laws} }}\n"
    for end in corners if sort in ("dampers", "measured") else ():
        low, high = (600.0 * r[end] ** 2, 4000.0 * r[end] ** 2)
        low, high = (low, high) if sort == "dampers" else (table(one, r[end]) for one in (SOFT, HARD))
        text += f'[actuators{end.replace("_", ".", 1)}]\nkind = "damper"\nc_min = {low}\nc_max = {high}\n'
        text += "bandwidth = 200.0\n" * (sort == "dampers")
    if sort in ("dampers", "measured"):
        text += "".join(f'[controllers.{name}]\nsemi_active = "{name}"\n' for name in LAWS)
    gain = np.diag([-1200.0 * r[end] for end in corners]).tolist()
    measured = str([f"sprung_velocity{end}" for end in corners]).replace("'", '"')
    return parse_vehicle(f"{text}[controllers.held]\nmeasured = {measured}\ngain = {gain}\n")


@cache
def over_travel(kind: str, sort: str = "springs", stroke: float = 0.02) -> Vehicle:
    """A car whose motion ratios change with travel, with progressive springs and digressive dampers on the arm.

    With other sorts it has bump stops, and actuators or semi-active dampers.
    """
    text = car(kind, "curves" if sort == "springs" else sort).text
    text = text.replace("bump = 0.02,", f"bump = {stroke},").replace("rebound = 0.03 ", f"rebound = {1.5 * stroke} ")
    text = text.partition("[limits")[0] if sort == "springs" else text
    names = re.findall(r"^motion_ratio\w*", text, flags=re.M)
    text = re.sub(r"^motion_ratio.*\n", "", text, flags=re.M)
    tables = "".join(f"{name} = {str(TABLE).replace(':', ' =').replace(chr(39), '')}\n" for name in names)
    text = text if "[curves]\n" in text else text + "[curves]\n"
    return parse_vehicle(text.replace("[curves]\n", f"[curves]\n{tables}"))


def driven(vehicle: Vehicle, name: str, road: str, duration: float = 0.4) -> Run:
    built = choose_road(road).build(vehicle, 12.5, 0, duration)
    return run_controllers(vehicle, [driver_of(vehicle, name)], built, sample_times(vehicle, duration, 1e-3))[0]


def test_linear_models_are_the_same():
    """Springs and dampers have k r^2 and c r^2 at the wheel, and actuators r u: to 1e-12. The norm is the same to rounding."""
    kind = "half_car"
    arm, wheel = car(kind, "linear"), car(kind, "linear", False)
    r, a, b = np.array([RATIOS[axle(end)] for end in CORNERS[kind]]), arm.linear_model, wheel.linear_model
    for name, factor in (("A", 1.0), ("Bw", 1.0), ("Bl", 1.0), ("C", 1.0), ("Dl", 1.0), ("B", r)):
        assert np.abs(getattr(a, name) - getattr(b, name) * factor).max() <= EXACT * np.abs(getattr(b, name)).max()
    own = np.isin(b.outputs, b.inputs)
    np.testing.assert_allclose(a.D[~own], b.D[~own] * r, rtol=EXACT)
    assert np.array_equal(a.D[own], np.eye(len(r)))  # a control force is the actuator's own
    lighter = {name: 0.0 if name in b.inputs else weight for name, weight in wheel.performance.items()}
    norms = [norm_of(replace(one, performance=lighter), "held") for one in (arm, wheel)]
    assert norms[0] == pytest.approx(norms[1], rel=EXACT)


def norm_of(vehicle: Vehicle, name: str) -> float:
    return hinf_norm(Designer(vehicle).design(name).loop(vehicle)).value


def test_a_design_reaches_the_same_norm():
    """At the same price of force at the wheel, the best state feedback over r is as good, to the solver's error."""
    arm, wheel = car("half_car", "linear"), car("half_car", "linear", False)
    priced = {
        name: w / RATIOS[axle(name.removeprefix("control_force"))] if "force" in name else w
        for name, w in wheel.performance.items()
    }
    assert norm_of(arm, "state") == pytest.approx(norm_of(replace(wheel, performance=priced), "state"), rel=1e-5)


@pytest.mark.parametrize(
    ("sort", "turning"), [("dampers", False), ("measured", True), *attacks([("dampers", True), ("measured", False)])]
)
def test_a_damper_is_set_by_its_own_velocity(sort, turning):
    """The coefficient is the nearest one to c_s - u* / h(r v), with the numbers of the file."""
    text = (over_travel("quarter_car", sort) if turning else car("quarter_car", sort)).text.replace("bandwidth = 200.0", "")
    run = driven(parse_vehicle(text), "held", "bump:height=0.05")
    body, wheel, d = (run.physics[name] for name in ("sprung_velocity", "unsprung_velocity", "suspension_deflection"))
    v = (ratio_at(d) if turning else RATIOS[""]) * (body - wheel)
    shape, low, high = v, 600.0, 4000.0
    if sort == "measured":
        (soft, low), (hard, high) = (
            (straight(*one.values())(v), (one["force"][3] - one["force"][1]) / 0.2) for one in (SOFT, HARD)
        )
        shape = (hard - soft) / (high - low)
    moving = np.abs(v) > 1e-4
    expected = np.clip(1800.0 + 1200.0 * body[moving] / shape[moving], low, high)
    np.testing.assert_allclose(run.physics["damping"][moving], expected, rtol=1e-9)
    assert {low, high} < {*expected}


def test_work_and_contacts_are_those_at_the_wheel():
    """Metrics of actuators' work and of stops are those of the car with these elements at its wheel."""
    runs = [driven(car("quarter_car", "curves", on_arm), "held", "iso8608:class=E") for on_arm in (True, False)]
    ours, theirs = (measure(run.vehicle, run.physics, 0) for run in runs)
    own = [key for key in ours if "control_power" in key or "control_energy" in key or "at_stops" in key]
    assert len(own) > 2
    assert [ours[key] for key in own] == pytest.approx([theirs[key] for key in own], rel=1e-9, abs=1e-9)


def test_ratios_are_sampled_side_by_side():
    """Vehicles with unlike ratios have their own metrics, and run in two batches where dampers feel their own velocities."""
    cars = [car("quarter_car", "curves").with_parameters(motion_ratio=ratio) for ratio in (0.5, 0.7)]
    alone = [driven(one, "held", "bump:height=0.06", 0.3) for one in cars]
    inputs = [RoadInput(one, run.road, run.physics.time) for one, run in zip(cars, alone, strict=True)]
    together, meter = simulate([run.controller for run in alone], inputs).response, Meter(cars, 1e-3, 0)
    meter.update(np.moveaxis(together.values, 0, 2))
    for i, run in enumerate(alone):
        own = measure(run.vehicle, run.physics, 0)
        assert all(value[i] == pytest.approx(own[name], rel=EXACT) for name, value in meter.result().items())
    dampers = car("quarter_car", "measured")
    assert reads_out(dampers, 1e-3) != reads_out(dampers.with_parameters(motion_ratio=0.7), 1e-3)


def test_expected_values_follow():
    """Statistical linearisation, the work of actuators and payloads expect of an arm what they expect of the wheel."""
    arm, wheel = (car("quarter_car", "curves", on_arm) for on_arm in (True, False))
    road = choose_road("iso8608:class=C").build(arm, 20.0, 0, 10.0).spectrum
    assert road is not None
    found = [one and one.mean for one in (expect(each, Designer(each).design("held"), road, 1e-3, 10.0) for each in (arm, wheel))]
    assert found[0]
    assert found[1]
    for key, value in found[1].items():
        factor = 1 / 0.6 if key in ("control_force_rms", "control_force_peak") else 1.0
        assert found[0][key] == pytest.approx(factor * value, rel=1e-9), key
    laden = [parse_vehicle(car("quarter_car", "dampers", one).text + "\n[payload]\nmass = 12.0\n") for one in (True, False)]
    for side in ("bump", "rebound"):
        strokes = [one.parts.strokes["suspension_deflection"][side] for one in (*laden, arm)]
        assert strokes[0] == pytest.approx(strokes[1], rel=EXACT)
        assert strokes[0] != strokes[2]


def ratio_at(d):
    return np.interp(d, TABLE["deflection"], TABLE["ratio"])


def travel_at(d: float) -> float:
    """Travel of the element, by the trapezoidal rule from point to point, which is exact."""
    inner = sorted((x for x in TABLE["deflection"] if min(0.0, d) < x < max(0.0, d)), key=abs)
    x = np.array([0.0, *inner, d])
    return float(np.trapezoid(ratio_at(x), x))


@pytest.mark.parametrize(("kind", "lag"), [("quarter_car", "actuator_bandwidth = 60.0\n"), ("half_car", "")])
def test_actuators_over_travel(kind, lag):
    """Limits and lag are the actuator's own; over large roads steps, energy and the sampled response agree."""
    text, own = over_travel(kind, "curves").text, f"[limits]\nactuator_force = 150.0\n{lag}"
    at = "[limits]\n" if kind == "quarter_car" else "[limits.front]\n"
    vehicle = parse_vehicle(text.replace(at, own if kind == "quarter_car" else own + at))
    run = driven(vehicle, "held", "bump:height=0.05", 0.3)
    assert run.passed
    assert run.energy is not None
    assert run.energy.residual < 1e-5
    name = vehicle.linear_model.inputs[0]
    assert 149.0 < np.abs(run.physics[name]).max() <= 150.0 + 1e-9
    d, u = run.physics[vehicle.kind.deflection_of(name)], run.physics[name]
    mean = (u[1:] + u[:-1]) / 2 if lag else u[:-1]
    power = float((ratio_at(d[:-1]) * mean * np.diff(d)).sum() / run.physics.time[-1])
    assert measure(vehicle, run.physics, 0)[name.replace("force", "power")] == pytest.approx(power, rel=1e-12)


@pytest.mark.parametrize("sort", ["measured", *attacks(["dampers"])])
def test_semi_active_laws_over_travel(sort, monkeypatch):
    """Every law runs with a lagging valve and with curves; a damper's velocity that is 2 % off as it is measured is found."""
    vehicle = over_travel("quarter_car", sort)
    drivers = [driver_of(vehicle, name) for name in (*LAWS, "held")]
    road = choose_road("iso8608:class=E").build(vehicle, 12.5, 0, 0.1)
    assert all(run.passed for run in run_controllers(vehicle, drivers, road, sample_times(vehicle, 0.1, 1e-3)))
    right = Actuators.turn
    monkeypatch.setattr(Actuators, "turn", lambda own, closing, d: right(own, np.multiply(closing, 1.02, out=closing), d))
    assert not driven(vehicle, "held", "bump:height=0.08", 0.15).agrees


def test_a_force_beside_a_damper_over_travel():
    """An actuator that pushes beside a damper gives the requested force at every deflection, and the damper misses the rest."""
    dampers = "[actuators.front]\nkind = 'damper'\nc_min = 100.0\nc_max = 9e3\n"
    vehicle = parse_vehicle(over_travel("half_car", "linear").text + dampers)

    def constant(t, y):
        return np.array([300.0, 500.0])

    constant.measured = ("suspension_deflection_rear",)  # pyright: ignore[reportFunctionMemberAccess]
    [pushed] = by_name.run(vehicle, constant, Bump(height=0.05), duration=0.3)
    assert pushed.passed
    assert np.ptp(pushed.physics["suspension_deflection_rear"]) > 0.01
    assert np.abs(pushed.physics["control_force_rear"] - 500.0).max() < 1e-9
    missing = np.sqrt(np.mean(pushed.physics["missing_force_front"] ** 2))
    assert shortfalls(vehicle, pushed.physics)["control_force_front"].rms == pytest.approx(missing / 300.0, rel=1e-9)


def test_a_stop_over_travel():
    """It begins where the element has gone its stroke, D(d) = -stroke, and a stop beyond the table of the ratio is doubted."""
    text = over_travel("quarter_car").text + "\n[limits]\nsuspension_stroke = 0.03\nstop_stiffness = 1e5\n"
    vehicle = parse_vehicle(text)
    assert travel_at(-vehicle.parts.strokes["suspension_deflection"]["bump"]) == pytest.approx(-0.03, rel=1e-12)
    assert driven(vehicle, "passive", "bump:height=0.06").agrees
    assert not vehicle.warnings
    (far,) = parse_vehicle(text.replace("= 0.03\n", "= { bump = 0.05, rebound = 0.06 }\n")).warnings
    assert "ends at 0.08 m, but the rebound stop begins at 0.10" in far


def test_rates_at_the_wheel_are_printed():
    """Those of 0.6 and of a ratio over travel, whose spring's rate contains its preload."""

    def notes(vehicle):
        return ratio_notes(vehicle.kind, vehicle.parameters)

    k, c, r = 39403.55, 1302.95, 0.6  # N/m, N s/m
    text = read_vehicle("quarter_car").text.partition("[controllers")[0]
    text = re.sub("^suspension_stiffness = .*", f"suspension_stiffness = {k}", text, flags=re.M)
    text = re.sub("^suspension_damping = .*", f"suspension_damping = {c}", text, flags=re.M)
    fixed = parse_vehicle(text.replace("[parameters]", f"[parameters]\nmotion_ratio = {r}", 1))
    assert notes(fixed) == [f"motion_ratio 0.6: {k * r**2:g} N/m and {c * r**2:g} N s/m at the wheel"]
    assert notes(fixed)[0] in prose(repr(fixed))
    assert not notes(parse_vehicle(text))
    turning = parse_vehicle(text + "\n[curves]\nmotion_ratio = { deflection = [-0.1, 0.0, 0.1], ratio = [0.7, 0.6, 0.5] }\n")
    preload = turning.parameters["sprung_mass"] * 9.81 / r
    assert notes(turning) == [f"motion_ratio 0.6 at equilibrium: {k * r**2 + preload:g} N/m and {c * r**2:g} N s/m at the wheel"]


def test_controllers_run_over_travel(tmp_path, capsys):
    """With `all`, commands run every controller of a car whose ratio changes with travel."""
    file = tmp_path / "car.toml"
    file.write_text(over_travel("quarter_car", "curves").text)
    assert bump(["--vehicle", str(file), "--controller", "all", "--no-logs", "--duration", "0.2"]) == 0
    printed = capsys.readouterr()
    assert "left out" not in printed.err
    assert all(name in printed.out for name in ("passive", "state", "held"))


def test_headings_decide_the_sign(tmp_path):
    """A table of a file over bump travel has its rows over extension."""
    (tmp_path / "ratio.csv").write_text("bump [mm],motion ratio\n-80,0.55\n-20,0.6\n30,0.62\n90,0.68\n")
    more = '\n[curves]\nmotion_ratio = { file = "ratio.csv" }\n'
    (tmp_path / "car.toml").write_text(read_vehicle("quarter_car").text + more)
    table = read_vehicle(tmp_path / "car.toml").kind.ratios["motion_ratio"]
    assert {"deflection": table.x.tolist(), "ratio": table.ratio.tolist()} == TABLE


@pytest.mark.parametrize("kind", ["quarter_car", *attacks(["full_car"])])
def test_a_payload_over_travel(kind):
    """It sinks to where r (N - k D) is the laden load; ratio, wheel rate and strokes are those of that travel."""
    text = over_travel(kind, "dampers").text
    empty, mass = parse_vehicle(text), {"quarter_car": 12.0, "half_car": 30.0, "full_car": 80.0}[kind]
    laden = parse_vehicle(f"{text}\n[payload]\nmass = {mass}\n")
    before, after = (one.kind.static_loads(one.parameters) for one in (empty, laden))
    for part in empty.kind.suspensions:

        def carried(d, k=empty.parameters[part.stiffness], load=before[part.deflection]):
            return ratio_at(d) * (load / ratio_at(0.0) - k * travel_at(d))

        load = after[part.deflection]
        rest = float(root_scalar(lambda d: carried(d) - load, bracket=(-0.08, 0.08), xtol=1e-15).root)  # noqa: B023
        assert -0.03 < rest < -5e-3
        assert laden.parameters[part.ratio] == pytest.approx(ratio_at(rest), rel=1e-9)
        rate = (carried(rest - 1e-6) - carried(rest + 1e-6)) / 2e-6
        assert laden.kind.at_wheels(laden.parameters)[part.stiffness] == pytest.approx(rate, rel=1e-6)  # of the difference
        bump, other = (one.parts.strokes[part.deflection]["bump"] for one in (laden, empty))
        assert bump == pytest.approx(other + rest, rel=1e-9)
    assert driven(laden, "hybrid", "bump:height=0.05", 0.2).passed


def test_other_vehicles_over_travel():
    """At the corners of a box of masses and tyres MuJoCo agrees over a bump, and its readout is the same."""
    vehicle = over_travel("quarter_car", "dampers").with_ideal_actuators
    values = {name: vehicle.parameters[name] for name in ("sprung_mass", "tyre_stiffness")}
    corners = [
        at_rest(vehicle.with_parameters(**{name: factor * values[name] for name, factor in zip(values, factors, strict=True)}))
        for factors in itertools.product((0.7, 1.4), (0.75, 1.25))
    ]
    assert len({reads_out(one, 4e-3) for one in corners}) == 1
    for one in corners:
        (run,) = run_controllers(one, [Designer(vehicle).design("held")], Bump(height=2e-2), sample_times(one, 0.3, 4e-3))
        assert run.agreement.agrees


def test_springs_of_one_parameter_over_travel():
    """Springs that share a parameter but not their load, and a spring of unknown load, are refused: their wheel rates differ."""
    vehicle = over_travel("half_car")
    front, rear = vehicle.kind.suspensions
    shared = replace(rear, stiffness=front.stiffness, ratio=front.ratio)
    unknown = replace(vehicle.kind, static_loads=lambda p: {front.deflection: 1.0})
    for kind, words in ((replace(vehicle.kind, suspended=(front, shared)), "different static loads"), (unknown, "add this load")):
        with pytest.raises(InputError, match=words):
            kind.check(dict(vehicle.parameters))
    for name in ("suspension_stiffness_front", "suspension_stiffness_rear"):  # the spring's own rate, as in [parameters]
        assert f"{name} {float(f'{vehicle.parameters[name]:.4g}'):g} N/m (slope of the whole curve:" in lines_at_rest(
            vehicle.parts.with_curve
        )


def test_published_ride_frequencies():
    """A Formula Student car's spring by its linkage ratio (3.2 Hz at 386.4 in/s2), and a spring of 50 N/mm at 0.75: 1.43 Hz."""
    pound, per_inch = 0.45359237, 0.45359237 * 386.4  # kg; N/m per lb/in, with its gravity
    wheel = 4 * np.pi**2 * 3.2**2 * 143.0 / 386.4  # lb/in, in series with the tyre of 857 lb/in
    wheel *= 857.0 / (857.0 - wheel)
    vehicle = read_vehicle("quarter_car").with_parameters(
        sprung_mass=143.0 * pound,
        unsprung_mass=13.09 * pound,
        suspension_stiffness=wheel / 0.72**2 * per_inch,
        suspension_damping=0.0,
        tyre_stiffness=857.0 * per_inch,
        motion_ratio=0.72,
    )
    assert vehicle.parameters["suspension_stiffness"] / per_inch == pytest.approx(349.635, abs=1e-3)  # "ideal front spring"
    assert min(abs(np.linalg.eigvals(vehicle.linear_model.A))) / (2 * np.pi) == pytest.approx(3.2, rel=2e-3)  # massless wheels
    other = vehicle.with_parameters(sprung_mass=350.0, suspension_stiffness=50e3, motion_ratio=0.75)
    rate = other.kind.at_wheels(other.parameters)["suspension_stiffness"]
    assert (rate, round(np.sqrt(rate / 350.0) / (2 * np.pi), 2)) == (28125.0, 1.43)


def test_slopes_over_travel():
    """The slopes of a spring's force at the wheel stay within r^2 k - r' (N - k D), also where points of its tables coincide."""
    x, r, k, load = np.array([-0.1, -0.05, 0.0, 0.05, 0.1]), np.array([0.9, 0.85, 0.8, 0.7, 0.65]), 12e3, 3924.0
    ratios = RatioTable(x, r)
    own = ForceCurve(ratios.travel(x), k * ratios.travel(x), k, "a line")
    low, high = (np.diff(r) / np.diff(x) * (k * ratios.travel(x[i:][:4]) - load / 0.8) + k * r[i:][:4] ** 2 for i in (0, 1))
    curve = AtRatio(SpringCurve(own), ratios, load=load).curve
    assert curve is not None
    slopes = curve.slope_range
    assert slopes == pytest.approx((np.minimum(low, high).min(), np.maximum(low, high).max()), rel=1e-3)  # 1e-3: FINE points
