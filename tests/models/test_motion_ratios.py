"""Springs, dampers, stops and actuators on an arm: the same car as one with these elements at its wheels."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import quad

from models.common.errors import InputError
from models.roads.choice import choose_road
from models.roads.road import RoadInput
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.physics.sensor_readout import reads_out
from sim.physics.simulate import simulate
from sim.runs.run import Run, compare_runs, run_controllers, sample_times
from sim.studies.ride.expected import expect
from sim.studies.ride.metrics import Meter, measure
from synth.analysis.norm import hinf_norm
from synth.vehicle.designer import Designer

KINDS = ("quarter_car", "half_car", "full_car")
FORCES = {"quarter_car": 1, "half_car": 2, "full_car": 4}
EXACT = 1e-12
ENDINGS = {"": 0.6, "_front": 0.6, "_rear": 0.75}  # motion ratios; the axles differ, so that none stands in for another
SPRING = {"deflection": [-0.05, -0.02, 0.0, 0.02, 0.05], "force": [-3e3, -900.0, 0.0, 800.0, 2100.0]}
DAMPER = {"velocity": [-0.6, -0.1, 0.0, 0.1, 0.6], "force": [-900.0, -300.0, 0.0, 500.0, 1600.0]}
SOFT = {"velocity": [-0.5, -0.1, 0.0, 0.1, 0.5], "force": [-250.0, -60.0, 0.0, 90.0, 400.0]}
HARD = {"velocity": [-0.5, -0.1, 0.0, 0.1, 0.5], "force": [-2000.0, -600.0, 0.0, 900.0, 3000.0]}
STOP = {"bump": (4e4, 2e6, 3e8), "rebound": (2e5, 0.0, 0.0)}


def table(points: dict[str, list[float]], ratio: float) -> str:
    """A table of `[curves]` of the element at the wheel, which is r F(r x)."""
    over, force = ({name: np.array(values) for name, values in points.items()}[name] for name in points)
    name = next(iter(points))
    return f"{{ {name} = {(over / ratio).tolist()}, force = {(force * ratio).tolist()} }}"


def file_of(kind: str, ratios: dict[str, float], sort: str) -> str:
    """The text of a car's file: elements at their ratios, converted to the wheel by hand where these are not in the file."""
    text, at = read_vehicle(kind).text.partition("[controllers")[0], ratios or ENDINGS
    r = {ending: 1.0 if ratios else ratio for ending, ratio in at.items()}  # of what is written, over the element's own
    for ending in r:
        for name, square in (("stiffness", 25e3), ("damping", 1800.0)):
            text = re.sub(rf"^suspension_{name}{ending} = .*$", f"suspension_{name}{ending} = {square * r[ending] ** 2!r}",
                          text, flags=re.M)  # fmt: skip
    given = "".join(f"motion_ratio{ending} = {ratio}\n" for ending, ratio in ratios.items() if f"stiffness{ending} =" in text)
    text = text.replace("[parameters]", f"[parameters]\n{given}", 1) + "\n"
    ends = [ending for ending in ENDINGS if f"suspension_stiffness{ending} =" in text]
    stroke = {ending: f"{{ bump = {0.02 / r[ending]!r}, rebound = {0.03 / r[ending]!r} }}" for ending in ends}
    stop = {
        ending: "{ " + ", ".join(f"{side} = {[k * r[ending] ** (2 + i) for i, k in enumerate(ks)]}" for side, ks in STOP.items())
        + " }"
        for ending in ends
    }  # fmt: skip
    measured = ["sprung_velocity"] if kind == "quarter_car" else [f"sprung_velocity{ending}" for ending in ends]
    if kind == "full_car":
        measured = [f"sprung_velocity_{corner}" for corner in ("front_left", "front_right", "rear_left", "rear_right")]
    each = [r[f"_{name.split('_')[2]}"] if "_" in name.removeprefix("sprung_velocity") else r[""] for name in measured]
    gain = [[-1200.0 * r_i if i == j else 0.0 for j in range(len(each))] for i, r_i in enumerate(each)]
    law = f"\n[controllers.held]\nmeasured = {measured}\ngain = {gain}\n".replace("'", '"')
    for ending in ends if sort != "linear" else ():
        where = f".{ending[1:]}" if ending else ""
        text += f"[limits{where}]\nsuspension_stroke = {stroke[ending]}\nstop_stiffness = {stop[ending]}\n"
    if sort == "curves":
        for ending in ends:
            text = re.sub(rf"^suspension_(stiffness|damping){ending} = .*\n", "", text, flags=re.M)
        text += "[curves]\n" + "".join(
            f"suspension_{name}{ending} = {table(points, r[ending])}\n"
            for ending in ends
            for name, points in (("stiffness", SPRING), ("damping", DAMPER))
        )
    if sort in ("dampers", "measured"):
        corners = [name.removeprefix("sprung_velocity") for name in measured]
        for corner, r_i in zip(corners, each, strict=True):
            low, high = (600.0 * r_i**2, 4000.0 * r_i**2) if sort == "dampers" else (table(one, r_i) for one in (SOFT, HARD))
            text += f'[actuators{corner.replace("_", ".", 1)}]\nkind = "damper"\nc_min = {low}\nc_max = {high}\n'
            text += "bandwidth = 200.0\n" if sort == "dampers" else ""
        laws = ("skyhook", "skyhook_linear", "hybrid", "pdd")
        law += "".join(f'[controllers.{name}]\nsemi_active = "{name}"\n' for name in laws)
    return text + law


@cache
def both(kind: str, sort: str) -> tuple[Vehicle, Vehicle]:
    """A car with its elements on arms, and the same car by numbers at the wheels."""
    own = {ending: ratio for ending, ratio in ENDINGS.items() if bool(ending) == (kind != "quarter_car")}
    return parse_vehicle(file_of(kind, own, sort)), parse_vehicle(file_of(kind, {}, sort))


def driven(vehicle: Vehicle, name: str, road: str, duration: float = 0.4) -> Run:
    built, entry = choose_road(road).build(vehicle, 12.5, 0, duration), vehicle.controllers.get(name)
    driver = entry.driver() if entry and entry.semi_active else Designer(vehicle).design(name)
    return run_controllers(vehicle, [driver], built, sample_times(vehicle, duration, 1e-3))[0]


def ratios_of(vehicle: Vehicle) -> dict[str, float]:
    """The motion ratio at every corner, from the file's text."""
    found = {}
    for part in vehicle.kind.suspensions:
        axle = part.corner.partition("_")[0]
        found[part.ending] = vehicle.parameters["_".join(filter(None, ("motion_ratio", axle)))]
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_linear_models_are_the_same(kind):
    """Springs and dampers have k r^2 and c r^2 at the wheel, and actuators r u: to 1e-12."""
    arm, wheel = both(kind, "linear")
    r, a, b = np.array([*ratios_of(arm).values()]), arm.linear_model, wheel.linear_model
    for name, factor in (("A", 1.0), ("Bw", 1.0), ("Bl", 1.0), ("C", 1.0), ("Dl", 1.0), ("B", r)):
        assert np.abs(getattr(a, name) - getattr(b, name) * factor).max() <= EXACT * np.abs(getattr(b, name)).max()
    own = np.isin(b.outputs, b.inputs)
    np.testing.assert_allclose(a.D[~own], b.D[~own] * r, rtol=EXACT)
    assert np.array_equal(a.D[own], np.eye(len(r)))  # a control force is the actuator's own


@pytest.mark.parametrize("sort", ["curves", "dampers", "measured"])
@pytest.mark.parametrize("kind", KINDS)
def test_runs_are_the_same(kind, sort):
    """In MuJoCo, too, with curves, stops, actuators and semi-active dampers: every signal, the work, and the verdict."""
    arm, wheel = both(kind, sort)
    r = ratios_of(arm)
    for name in ("passive", *arm.controllers) if kind == "quarter_car" else ("held" if sort == "curves" else "hybrid",):
        one, other = (driven(vehicle, name, "iso8608:class=E") for vehicle in (arm, wheel))
        assert one.agrees, name
        assert one.energy, name
        assert one.energy.balances, name
        for signal in one.physics.names:
            power = next((power for start, power in (("control_force", -1), ("missing_force", -1), ("damping", -2))
                          if signal.startswith(start)), 0)  # fmt: skip
            ending = signal.removeprefix("control_force").removeprefix("missing_force").removeprefix("damping")
            expected = other.physics[signal] * (r[ending] ** power if power else 1.0)
            least = 1.0 if signal.startswith("missing_force") else 1e-9  # N; a law within the damper's range misses nothing
            apart = np.abs(one.physics[signal] - expected).max() / max(np.abs(expected).max(), least)
            assert apart < 1e-9, (name, signal)  # a chain of 800 steps that rounds otherwise; measured up to 4e-11
        works = [measure(run.vehicle, run.physics, 0) for run in (one, other)]
        for key in works[0]:
            if "control_power" in key or "control_energy" in key or "at_stops" in key:
                assert works[0][key] == pytest.approx(works[1][key], rel=1e-9, abs=1e-9), (name, key)


def test_designs_are_the_same():
    """The same force costs the same: with a gain over r the norm is the same to rounding, and a design reaches the same norm."""
    arm, wheel = both("half_car", "linear")
    wheel = replace(wheel, performance={name: w if "force" not in name else w / ENDINGS[f"_{name.rpartition('_')[2]}"]
                                        for name, w in wheel.performance.items()})  # fmt: skip
    held, designed = ([Designer(one).design(name) for one in (arm, wheel)] for name in ("held", "state"))
    assert norm_of(arm, held[0]) == pytest.approx(norm_of(wheel, held[1]), rel=EXACT)
    assert norm_of(arm, designed[0]) == pytest.approx(norm_of(wheel, designed[1]), rel=1e-5)  # of the solver


def norm_of(vehicle: Vehicle, controller) -> float:
    return hinf_norm(controller.loop(vehicle)).value


def integrated(vehicle: Vehicle, road: np.ndarray, h: float, spring, damper, stop, gain: float, over=None) -> np.ndarray:
    """Travel of every suspension from first principles, shape (T, c): forces of the elements on arms, in plain numpy with RK4.

    Args:
        road: heights under the wheels midway through every step [m], shape (T, c).
        spring, damper, stop: pull of the elements over their own travel [m] or its rate [m/s].
        over: ratio of the damper alone over travel [m], whose spring is at the wheel; None for constant ratios of all.
        gain: force of every actuator per upward velocity of the body above it, held over a step [N s/m].
    """
    p, ratios = vehicle.parameters, ratios_of(vehicle)
    r, corners = np.array([*ratios.values()]), [*ratios]
    axle = [corner.rpartition("_front" if "front" in corner else "_rear")[1] for corner in corners]
    S, M = np.ones((1, 1)), [p["sprung_mass"]]
    if len(r) > 1:
        x = [p["axle_distance_front"] if one == "_front" else -p["axle_distance_rear"] for one in axle]
        S, M = np.column_stack([np.ones(len(x)), -np.array(x)]), [*M, p["pitch_inertia"]]
    if len(r) > 2:
        S = np.column_stack([S, [p["track"] / 2 * (1 if "left" in corner else -1) for corner in corners]])
        M.append(p["roll_inertia"])
    m_u, k_t = (np.array([p[f"{name}{one}"] for one in axle]) for name in ("unsprung_mass", "tyre_stiffness"))
    k = len(M)

    def rate(y, z_r, u):
        q, z_u, dq, dz_u = np.split(y, [k, k + len(r), 2 * k + len(r)])
        d, v = S @ q - z_u, S @ dq - dz_u
        pull = r * (spring(r * d) + damper(r * v) + stop(r * d) - u)
        if over is not None:
            pull = spring(d) + over(d) * damper(over(d) * v)
        return np.concatenate([dq, dz_u, -(S.T @ pull) / M, (pull - k_t * (z_u - z_r)) / m_u])

    y, travels = np.zeros(2 * (k + len(r))), []
    for z_r in road:
        travels.append(S @ y[:k] - y[k : k + len(r)])
        u = gain * (S @ y[k + len(r) : 2 * k + len(r)])
        k1 = rate(y, z_r, u)
        k2 = rate(y + h / 2 * k1, z_r, u)
        k3 = rate(y + h / 2 * k2, z_r, u)
        y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(y + h * k3, z_r, u))
    return np.array(travels)


@pytest.mark.parametrize(("kind", "height"), [("quarter_car", 0.06), ("half_car", 1e-6), ("full_car", 1e-6)])
def test_an_own_integration_has_the_same_travel(kind, height):
    """To 1e-9 of its peak; cars that turn over a road so low that their geometry is linear, and curves with it."""
    sort = "curves" if kind == "quarter_car" else "linear"
    vehicle, _ = both(kind, sort)
    run = driven(vehicle, "held", f"bump:height={height}")
    spring, damper = (lambda x: 25e3 * x), (lambda v: 1800.0 * v)
    if sort == "curves":
        spring, damper = straight(SPRING), straight(DAMPER)

    def stop(e):
        squeezed, stretched = np.maximum(-e - 0.02, 0.0), np.maximum(e - 0.03, 0.0)
        return sum(
            k * stretched ** (1 + i) - b * squeezed ** (1 + i) for i, (b, k) in enumerate(zip(*STOP.values(), strict=True))
        )

    travels = integrated(vehicle, run.prediction.input.midway, 1e-3, spring, damper, stop, -1200.0)
    for part, own in zip(vehicle.kind.suspensions, travels.T, strict=True):
        assert np.abs(own - run.physics[part.deflection]).max() < 1e-9 * np.abs(own).max() or kind != "quarter_car"
        assert np.abs(own - run.physics[part.deflection]).max() < 1e-6 * np.abs(own).max()


def straight(points):
    """Force between the points of a table, and beyond them as between the last two."""
    x, y = (np.array(values) for values in points.values())
    first, last = (y[1] - y[0]) / (x[1] - x[0]), (y[-1] - y[-2]) / (x[-1] - x[-2])
    return lambda at: np.interp(at, x, y) + first * np.minimum(at - x[0], 0.0) + last * np.maximum(at - x[-1], 0.0)


@pytest.mark.parametrize(
    ("kind", "sort", "name"), [("quarter_car", "curves", "held"), ("full_car", "measured", "skyhook_linear")]
)
def test_a_ratio_that_is_off_by_two_percent_is_found(kind, sort, name):
    """Physics with another motion ratio at one axle does not agree with the equations of the file."""
    vehicle, _ = both(kind, sort)
    clean = driven(vehicle, name, "iso8608:class=C", 0.3)
    for ratio in [one for one in vehicle.parameters if one.startswith("motion_ratio")]:
        other = vehicle.with_parameters(**{ratio: 1.02 * vehicle.parameters[ratio]})
        made = simulate([clean.controller], [RoadInput(other, clean.road, clean.physics.time)])
        assert clean.agrees
        assert not compare_runs([clean.prediction], made)[0].agrees


def test_ratios_are_sampled_side_by_side():
    """Vehicles with unlike ratios run in one batch as each does alone, and in two where dampers feel their own velocities."""
    cars = [both("quarter_car", "curves")[0].with_parameters(motion_ratio=ratio) for ratio in (0.5, 0.7)]
    alone = [driven(car, "held", "bump:height=0.06", 0.3) for car in cars]
    inputs = [RoadInput(car, run.road, run.physics.time) for car, run in zip(cars, alone, strict=True)]
    together, meter = simulate([run.controller for run in alone], inputs).response, Meter(cars, 1e-3, 0)
    meter.update(np.moveaxis(together.values, 0, 2))
    for i, run in enumerate(alone):
        assert np.array_equal(together.run(i).values, run.physics.values)
        own = measure(run.vehicle, run.physics, 0)
        assert all(value[i] == pytest.approx(own[name], rel=EXACT) for name, value in meter.result().items())
    dampers, _ = both("quarter_car", "measured")
    assert reads_out(dampers, 1e-3) != reads_out(dampers.with_parameters(motion_ratio=0.7), 1e-3)


def test_expected_values_follow():
    """Statistical linearisation, the work of actuators and payloads expect of an arm what they expect of the wheel."""
    arm, wheel = both("quarter_car", "curves")
    road = choose_road("iso8608:class=C").build(arm, 20.0, 0, 10.0).spectrum
    found = [expect(one, Designer(one).design("held"), road, 1e-3, 10.0) for one in (arm, wheel)]
    for key, value in found[1].mean.items():
        factor = 1 / 0.6 if key in ("control_force_rms", "control_force_peak") else 1.0
        assert found[0].mean[key] == pytest.approx(factor * value, rel=1e-9), key
    load = "\n[payload]\nmass = 12.0\n"
    laden = [parse_vehicle(one.text + load) for one in both("quarter_car", "dampers")]
    for side in ("bump", "rebound"):
        one, other = (getattr(car.stops["suspension_deflection"], side) for car in laden)
        assert one.stroke == pytest.approx(other.stroke, rel=EXACT) != getattr(arm.stops["suspension_deflection"], side).stroke


def test_ratios_that_are_not_allowed_are_refused():
    """One line: what was found, what is allowed."""
    for kind, line, words in (
        ("quarter_car", "motion_ratio = 60.0", "motion_ratio = 60"),
        ("half_car", "motion_ratio = 0.6", "unknown parameter 'motion_ratio'; a half_car has"),
    ):
        with pytest.raises(InputError, match=re.escape(words)) as refused:
            parse_vehicle(read_vehicle(kind).text.replace("[parameters]", f"[parameters]\n{line}", 1))
        assert "\n" not in str(refused.value)


TABLE = {"deflection": [-0.09, -0.03, 0.02, 0.08], "ratio": [0.68, 0.62, 0.6, 0.55]}


@cache
def over_travel(kind: str) -> Vehicle:
    """A car whose motion ratios change with travel, with progressive springs and digressive dampers on the arm."""
    arm, _ = both(kind, "curves")
    text = arm.text.partition("[controllers")[0]
    for name in [name for name in arm.parameters if name.startswith("motion_ratio")]:
        text = re.sub(rf"^{name} = .*\n", "", text, flags=re.M)
        text += f"{name} = {{ deflection = {TABLE['deflection']}, ratio = {TABLE['ratio']} }}\n"
    return parse_vehicle(re.sub(r"^(\[limits|suspension_stroke|stop_stiffness).*\n", "", text, flags=re.M))


def ratio_at(d):
    return np.interp(d, TABLE["deflection"], TABLE["ratio"])


def travel_at(d: float) -> float:
    """Travel of the element, by quadrature."""
    inner = [x for x in TABLE["deflection"] if min(0.0, d) < x < max(0.0, d)]
    return quad(ratio_at, 0.0, d, points=inner or None, epsabs=1e-14, epsrel=1e-13)[0]


@pytest.mark.parametrize("kind", KINDS)
def test_a_ratio_over_travel_turns_the_preload(kind):
    """The wheel rate at rest is r^2 k - r' N, of the preload N = W / r that carries the weight; the damper has r^2 c."""
    vehicle = over_travel(kind)
    p, r, turn = vehicle.parameters, ratio_at(0.0), (0.6 - 0.62) / 0.05
    k, c = (SPRING["force"][3] - SPRING["force"][1]) / 0.04, (DAMPER["force"][3] - DAMPER["force"][1]) / 0.2
    rates, lengths = vehicle.kind.at_wheels(p), (p.get("axle_distance_front", 1.0), p.get("axle_distance_rear", 1.0))
    for part in vehicle.kind.suspensions:
        own = lengths["front" in part.corner] / sum(lengths) * (2 if kind == "quarter_car" else 1)
        load = p["sprung_mass"] * 9.81 * own / (2 if kind == "full_car" else 1)
        assert rates[part.stiffness] == pytest.approx(r**2 * k - turn * load / r, rel=EXACT)
        assert rates[part.damping] == pytest.approx(r**2 * c, rel=EXACT)


@pytest.mark.parametrize(("kind", "height"), [("quarter_car", 0.06), ("half_car", 0.05), ("full_car", 0.05)])
def test_a_ratio_over_travel_in_physics(kind, height):
    """Runs agree with the equations, and springs at the wheel are r(d) (F(D(d)) - N) + W, within the error they state."""
    vehicle = over_travel(kind)
    run = driven(vehicle, "passive", f"bump:height={height}")
    assert run.agrees
    assert run.energy is not None
    assert run.energy.balances
    spring, damper, p = straight(SPRING), straight(DAMPER), vehicle.parameters
    for fitted in vehicle.fitted:
        if not fitted.damps:
            load = vehicle.kind.static_loads(p)[fitted.deflection]
            d = np.linspace(-0.12, 0.12, 49)
            own = ratio_at(d) * (spring(np.array([travel_at(x) for x in d])) - load / ratio_at(0.0)) + load
            stated = float(re.search(r"within (\S+) %", fitted.curve.words)[1]) / 100
            assert np.abs(fitted.curve(d) - own).max() <= stated * np.abs(own).max() < 2e-3 * np.abs(own).max()
    if kind == "quarter_car":
        by = {fitted.over.name: fitted.curve for fitted in vehicle.fitted}
        own = integrated(vehicle, run.prediction.input.midway, 1e-3, by["deflection"], damper, lambda d: 0.0 * d, 0.0, ratio_at)
        apart = np.abs(own[:, 0] - run.physics["suspension_deflection"]).max()
        assert apart < 1e-9 * np.abs(own).max()


def test_numbers_of_a_ratio_over_travel_count():
    """A point that is 2 % off is found, by dampers and springs; and a campaign scales the table by its value at rest."""
    vehicle = over_travel("quarter_car")
    clean = driven(vehicle, "passive", "bump:height=0.06")
    for point in TABLE["ratio"][1:3]:
        other = parse_vehicle(vehicle.text.replace(f"{point},", f"{1.02 * point},").replace(f" {point}]", f" {1.02 * point}]"))
        made = simulate([clean.controller], [RoadInput(other, clean.road, clean.physics.time)])
        assert not compare_runs([clean.prediction], made)[0].agrees
    scaled = vehicle.with_parameters(motion_ratio=1.1 * vehicle.parameters["motion_ratio"])
    for one, other in zip(scaled.fitted, vehicle.fitted, strict=True):
        if one.surface is not None and other.surface is not None:
            np.testing.assert_allclose(one.surface.ratio, 1.1 * other.surface.ratio, rtol=EXACT)
    assert scaled.parameters["motion_ratio"] == pytest.approx(1.1 * 0.608)


def test_a_stop_keeps_the_ratio_at_which_it_begins():
    """It begins where the element has gone its stroke, D(d) = -stroke, and is scaled by r there."""
    vehicle = over_travel("quarter_car")
    vehicle = parse_vehicle(f"{vehicle.text}\n[limits]\nsuspension_stroke = 0.03\nstop_stiffness = 1e5\n")
    bump = vehicle.stops["suspension_deflection"].bump
    assert travel_at(-bump.stroke) == pytest.approx(-0.03, rel=1e-12)
    assert bump.stiffness[0] == pytest.approx(1e5 * ratio_at(-bump.stroke) ** 2, rel=1e-12)
    assert driven(vehicle, "passive", "bump:height=0.06").agrees


def test_a_ratio_over_travel_from_a_file(tmp_path):
    """Headings decide the sign; what cannot be exact is refused in a line."""
    (tmp_path / "ratio.csv").write_text("bump [mm],motion ratio\n-80,0.55\n-20,0.6\n30,0.62\n90,0.68\n")
    text = read_vehicle("quarter_car").text + "\n[curves]\nmotion_ratio = "
    (tmp_path / "car.toml").write_text(text + '{ file = "ratio.csv" }\n')
    table = read_vehicle(tmp_path / "car.toml").kind.ratios["motion_ratio"]
    assert (table.x.tolist(), table.ratio.tolist()) == (TABLE["deflection"], TABLE["ratio"])
    vehicle = parse_vehicle(f"{text}{{ deflection = [-0.1, 0.1], ratio = [0.7, 0.5] }}\n")
    with pytest.raises(InputError, match="controller 'state' pushes through motion_ratio"):
        driven(vehicle, "state", "bump")
    for more, words in (
        ('[actuators]\nkind = "damper"\nc_min = 1.0\nc_max = 5e3\n', "need a constant motion ratio"),
        ("[payload]\nmass = 50.0\n", "motion_ratio is about its rest"),
    ):
        with pytest.raises(InputError, match=words):
            parse_vehicle(f"{vehicle.text}\n{more}")
    with pytest.raises(InputError, match="turns the preload so much"):
        parse_vehicle(f"{text}{{ deflection = [-0.1, 0.1], ratio = [0.3, 2.9] }}\n")
