"""Springs, dampers, stops and actuators on an arm: the same car as one with these elements at its wheels."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from models.common.errors import InputError
from models.roads.choice import choose_road
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.runs.run import Run, run_controllers, sample_times
from sim.studies.ride.metrics import measure
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
            f"suspension_stiffness{ending} = {table(SPRING, r[ending])}\nsuspension_damping{ending} = {table(DAMPER, r[ending])}\n"
            for ending in ends
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


def driven(vehicle: Vehicle, name: str, road: str, duration: float = 0.8) -> Run:
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
    for name in ("passive", *arm.controllers):
        one, other = (driven(vehicle, name, "iso8608:class=E") for vehicle in (arm, wheel))
        assert one.agrees and one.energy and one.energy.balances, name
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
