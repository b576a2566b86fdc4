"""Correct vehicles drawn at random, from 75 kg to 12.5 t a corner, with all options: no run is called wrong."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import Vehicle, parse_vehicle
from sim.linear.sampled_response import largest_timestep
from sim.runs.report import reasons, verdict
from sim.runs.run import Run, run_controllers, sample_times
from synth.vehicle.designer import driver_of
from tests.models.test_loads import road_of
from tests.models.test_vehicle_options import LINKS
from tests.support.commands import attacks
from tests.support.pairs import CORNERS, FILES, VELOCITIES

SAMPLES = 1500  # of a run, at most
SEMI_ACTIVE = ("skyhook", "skyhook_linear", "groundhook", "hybrid", "add", "pdd", "skyhook_add")
LAWS = ("passive", "gain", "states", "accelerometer", "pid", "lqr", "preview", "python")


class Drawing:
    """Random numbers of one vehicle, with four digits: uniform, or uniform in their logarithm."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng([seed, 48])

    def number(self, low: float, high: float) -> float:
        return float(f"{self.rng.uniform(low, high):.4g}")

    def scale(self, low: float, high: float) -> float:
        return float(f"{np.exp(self.rng.uniform(np.log(low), np.log(high))):.4g}")

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def one_of(self, *some: Any) -> Any:
        return some[int(self.rng.integers(len(some)))]

    def curve(self, over: str, far: float, slope: float, rising: tuple[float, float] = (0.4, 2.0)) -> str:
        """A characteristic of six pieces about equilibrium, each with another slope; that of a damper may have friction."""
        sides = [np.cumsum(self.rng.uniform(0.3, 1.2, 3)) * far for _ in range(2)]
        x = np.concatenate([-sides[0][::-1], [0.0], sides[1]])
        force = np.concatenate([[0.0], np.cumsum(slope * self.rng.uniform(*rising, 6) * np.diff(x))])
        friction = ""
        if over == "velocity" and rising[0] < 1 and self.chance(0.3):
            friction = f", friction = {self.number(0.05, 0.3) * far * slope:.4g}, friction_velocity = {self.number(0.02, 0.1)}"
        return f"{{ {over} = {np.round(x, 5).tolist()}, force = {np.round(force - force[3], 3).tolist()}{friction} }}"


def drawn(seed: int, folder: Path) -> tuple[Vehicle, str, str, float, float]:
    """A vehicle, the name of its controller, a road with loads as text, the speed over it [m/s], and a stable timestep [s]."""
    draw = Drawing(seed)
    kind = list(CORNERS)[seed % len(CORNERS)]
    corners, body = CORNERS[kind], VELOCITIES[kind][0]
    axles = list(dict.fromkeys(corner.removesuffix("_left").removesuffix("_right") for corner in corners))
    axles = corners if kind == "half_car_roll" else axles
    whole, step = draw.scale(75.0, 12500.0), draw.scale(1e-4, 1e-2)  # kg of a corner, s
    wheel = whole * draw.number(0.04, 0.25)
    mass = whole - wheel
    parameters, curves, limits = {"sprung_mass": mass * len(corners)}, {}, {}
    damps = draw.chance(0.35)
    k = mass * (2 * math.pi * draw.number(0.7, 2.5)) ** 2
    c = 2 * draw.number(0.05, 0.7) * math.sqrt(k * mass)
    for axle in axles:
        own = k * draw.number(0.8, 1.25)
        tyre = max(3 * own, wheel * (2 * math.pi * draw.scale(6, 30)) ** 2)
        parameters |= {f"unsprung_mass{axle}": wheel, f"tyre_stiffness{axle}": tyre}
        if draw.chance(0.4):
            parameters[f"tyre_damping{axle}"] = 2 * draw.scale(0.003, 0.1) * math.sqrt(tyre * wheel)
        for name, value, over, far in (("stiffness", own, "deflection", 0.04), ("damping", c, "velocity", 0.3)):
            if draw.chance(0.25) and not (damps and over == "velocity"):
                curves[f"suspension_{name}{axle}"] = draw.curve(over, far, value)
            else:
                parameters[f"suspension_{name}{axle}"] = value
    if kind in ("half_car", "full_car"):
        front, rear = (parameters.setdefault(f"axle_distance{axle}", draw.number(1.0, 2.5)) for axle in axles)
        parameters["pitch_inertia"] = parameters["sprung_mass"] * front * rear * draw.number(0.7, 1.2)
    if kind in ("half_car_roll", "full_car"):
        track = draw.number(1.2, 2.2)
        parameters |= {"track": track, "roll_inertia": parameters["sprung_mass"] * track**2 / 4 * draw.number(0.4, 1.0)}
    weight = 9.81 * mass
    if draw.chance(0.4):
        limits["suspension_stroke"] = draw.number(0.02, 0.1)
        limits["stop_stiffness"] = [draw.number(1, 10) * k, 0.0, draw.one_of(0.0, 1e3) * k]
    if draw.chance(0.3) and not damps:
        limits["actuator_force"] = draw.scale(0.01, 0.3) * weight
    if draw.chance(0.3) and not damps:
        limits["actuator_bandwidth"] = draw.scale(20, 200)
    law = draw.one_of(*SEMI_ACTIVE, "gain", "states", "python") if damps else draw.one_of(*LAWS)
    deflections = [f"suspension_deflection{corner}" for corner in corners]
    sky, measured = -draw.number(0.1, 1.0) * 2 * math.sqrt(k * mass), [body, *deflections]
    rows, nothing = [[sky]] * len(corners), [[0.0]] * len(corners)
    gain = [[sky, *row] for row in (draw.number(-0.1, 0.2) * k * np.eye(len(corners))).tolist()]
    acceleration = "sprung_acceleration" if kind == "quarter_car" else "heave_acceleration"
    sections = {
        "gain": f"measured = {measured}\ngain = {gain}",
        "states": f"measured = {measured}\nA = [[-2.0]]\nB = [[1.0{', 0.0' * len(corners)}]]\nC = {rows}\nD = {gain}",
        "accelerometer": f'measured = ["{acceleration}"]\nA = [[-1.0]]\nB = [[1.0]]\nC = {rows}\nD = {nothing}',
        "pid": f"measured = {deflections}\npid = {{ kp = {-0.1 * k}, ki = {-0.1 * k}, kd = {0.2 * sky}, filter = 0.05 }}",
        "lqr": 'design = "lqr"',
        "preview": f'design = "preview"\npreview = {draw.number(0.02, 0.2)}',
        "python": f'measured = {[*deflections, *VELOCITIES[kind]]}\nlaw = "law.py:step"',
    }
    section = sections.get(law, "" if law == "passive" else f'semi_active = "{law}"')
    if law in ("states", "accelerometer", "pid") and ("actuator_force" in limits or damps) and draw.chance(0.5):
        section += f"\nanti_windup = {draw.number(2, 40)}"
    steps = draw.one_of(1, 1, 2, 5, 10)
    delay = draw.one_of(0, 0, 1, 3, 1 / steps, 2 + 1 / steps)
    noisy = draw.one_of(body, *deflections[:1], acceleration)
    noise, resolution = ({noisy: draw.scale(1e-5, 1e-2)} if draw.chance(0.3) else {} for _ in range(2))
    text = f'type = "{kind}"\n[parameters]\n' + "".join(f"{name} = {value!r}\n" for name, value in parameters.items())
    text += LINKS[kind] if kind in LINKS and draw.chance(0.4) else ""
    text += f"\n[performance]\n{acceleration} = 1.0\n" + "".join(f"{name} = 0.1\n" for name in deflections)
    text += "".join(f"control_force{corner} = {1 / weight!r}\n" for corner in corners)
    text += "[curves]\n" + "".join(f"{name} = {table}\n" for name, table in curves.items()) if curves else ""
    text += "[limits]\n" + "".join(f"{name} = {value}\n" for name, value in limits.items())
    if damps and draw.chance(0.3):
        soft, firm = draw.curve("velocity", 0.3, 0.3 * c, (0.5, 0.9)), draw.curve("velocity", 0.3, 2.5 * c, (1.0, 2.0))
        text += f'[actuators]\nkind = "damper"\nc_min = {soft}\nc_max = {firm}\n'
    elif damps:
        text += f'[actuators]\nkind = "damper"\nc_min = {draw.number(0.1, 0.9) * c}\nc_max = {draw.number(1.1, 5) * c}\n'
    if damps and draw.chance(0.4):
        text += f"bandwidth = {draw.scale(20, 300)}\n"
    text += f"[controllers.mine]\n{section}\n" if section else ""
    (folder / "law.py").write_text(FILES["law.py"].replace("800.0", f"{0.05 * k}"), encoding="utf-8")
    vehicle = parse_vehicle(text, folder=folder)
    step = min(step, float(f"{0.95 * largest_timestep(vehicle):.3g}"))
    how = Implementation(steps * step if steps > 1 else None, delay, noise, resolution, seed)
    return replace(vehicle, implementation=how), "mine" if section else "passive", *road(draw, kind, whole), step


def road(draw: Drawing, kind: str, mass: float) -> tuple[str, float]:
    """A low or a high obstacle, or a rough road, with or without loads; and the speed over it [m/s]."""
    height, speed = draw.scale(0.001, 0.2), draw.number(3, 35)
    track = ":track=left" if kind in ("half_car_roll", "full_car") and draw.chance(0.5) else ""
    text = draw.one_of(
        f"bump:height={height}:length={draw.number(0.5, 10)}{track}",
        f"iso8608:class={draw.one_of(*'ABCDE')}",
        f"step:height={height}:edge={draw.one_of(0, 0.3)}:start=0.1",
        f"pothole:depth={height}:length=2{track}",
        f"sine:frequency={draw.number(1, 15)}",
        "flat",
    )
    loads = (
        f"payload:mass={draw.number(0.02, 0.3) * mass:.4g}:start=0.05",
        f"brake:g={draw.number(-0.3, 0.5)}:start=0.05",
        f"corner:g={draw.number(0.05, 0.4)}:start=0.05",
        f"gust:force={draw.number(0.05, 0.3) * 9.81 * mass:.4g}:start=0.05:rise=0.1:hold=0.1",
    )
    loads = (loads[0], *loads[2:]) if kind == "half_car_roll" else loads[: len(CORNERS[kind])]
    some = [one for one in loads if draw.chance(0.25 if text != "flat" else 0.7)]
    return " + ".join([text, *some]), speed


def driven(seed: int, folder: Path) -> Run:
    """The run of a drawn vehicle, for half a second or less."""
    vehicle, name, text, speed, step = drawn(seed, folder)
    time = sample_times(vehicle, min(0.6, SAMPLES * step), step)
    return run_controllers(vehicle, [driver_of(vehicle, name)], road_of(text, vehicle, speed), time)[0]


# Noisy runs with energy that RK4 loses on stops and in the air; a law in Python over a random road; a step that is too coarse.
FEW = (10, 39, 50, 109, 172, 224)


@pytest.mark.parametrize("seeds", [FEW, *attacks([range(60)])], ids=["few", "many"])
def test_no_correct_vehicle_is_called_wrong(seeds, tmp_path):
    """Every run of a correct vehicle passes. Of seeds 0 to 499, all do; CI draws the first 60."""
    runs = {seed: driven(seed, tmp_path) for seed in seeds}
    wrong = {seed: (verdict(run), reasons(run), run.energy) for seed, run in runs.items() if not run.passed}
    assert not wrong
    assert sum(bool(run.agreement.lift_off) for run in runs.values()) > len(runs) / 10
