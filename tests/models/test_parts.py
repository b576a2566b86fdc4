"""Every part of a suspension, alone and in pairs, on all cars: a row for each, with its law from the numbers of the file.

A row has a part's sections of a vehicle file, and its law in the part's own travel. Through a motion ratio r over the travel d of
a wheel, with own travel D(d) and static load W, a law f pulls the wheel with r f(D, r v) - (r / r(0) - 1) W.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import dataclasses
import itertools
import pickle
import re
import tomllib
from collections.abc import Callable
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any, cast

import mujoco
import numpy as np
import pytest
from scipy.integrate import cumulative_simpson, cumulative_trapezoid, solve_ivp
from scipy.interpolate import CubicHermiteSpline

from models.characteristics import LEAVES
from models.characteristics.ratio_table import RatioTable
from models.common.errors import InputError
from models.common.extensions import PARTS
from models.parts.part import Line, Part, SettablePart, Stack, Straight
from models.parts.ratio import AtRatio, Constant
from models.roads.road import Bump, RoadInput
from models.vehicle.mjcf import build_model
from models.vehicle.suspension_forces import SuspensionForces
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.bump import main as bump
from sim.drive.regime import departures
from sim.inspect.__main__ import main as inspect
from sim.linear.prediction import predict_run
from sim.observers.recorder import Recording
from sim.runs.run import Run, compare_runs, run_controllers, sample_times, with_energy_balance
from sim.studies.frequency import worst_case_gain
from synth.controller.controller import AnyController
from synth.vehicle.designer import driver_of
from tests.support.analysed import Runs, energy
from tests.support.analysed import simulate_inputs as simulate
from tests.support.commands import attacks, in_the_suite, main_of, prose
from tests.support.mechanism import CORNERS, Mechanism, acting, axle, integrated, rk4, static_loads, straight
from tests.support.shared import made

EXACT, FAULT = 1e-12, 1.02
CURVED = {"spring": "stiffness", "damper": "damping"}
ELEMENTS = ("element", "mount", "inertia", "input")  # slots, in the order of the file
SPRING, DAMPER = 25e3, 1800.0  # N/m, N s/m of suspensions without curves
AXLES = {
    "": 1.0,
    "_front": 1.0,
    "_rear": 1.1,
    "_left": 1.0,
    "_right": 1.1,
}  # factors on forces and ratios, so that no axle stands in for another
TRAVEL, RATIO = [-0.05, -0.02, 0.015, 0.045], [0.82, 0.72, 0.68, 0.6]
RATIOS = ("at the wheel", "constant", "over travel")


def table(argument, x, force) -> str:
    return f"{{ {argument} = {list(x)}, force = {np.array(force).tolist()} }}"


@dataclasses.dataclass(frozen=True)
class Row:
    """A part that a vehicle file can have.

    Attributes:
        part: its name in `PARTS`.
        slot: spring, damper, stop, input, element or mount; of two rows with one slot a suspension has only one.
        file: (factor on its forces, fault of one number) -> its value or keys in the file.
        law: pull [N] by own extension, its rate and the input, (d, v, u) -> arrays; of a part with a state (d, v, z) -> arrays.
        d, v: knots of the law over extension and rate.
        line: extensions and rates within which it follows its line, either way; None if it bends everywhere, or at rest.
        known: forces from outside the project, as sections of the file and points (d, v, u, pull), or (d, v, u, pull, z) at which
            the state z stays.
        rate: z' of a part with a state, (d, v, z) -> arrays; z and z' have a last axis for several `states`.
        friction: True if the part's line leaves out its last state.
        volts: True if its input is a voltage, the last argument of its law and its rate.
    """

    part: str
    slot: str
    file: Callable[[float, float], str]
    law: Callable
    d: tuple[float, ...] = ()
    v: tuple[float, ...] = ()
    line: tuple[float, float] | None = None
    known: tuple = ()
    rate: Callable | None = None
    inertance: float = 0.0
    states: int = 1
    friction: bool = False
    volts: bool = False


# Values of the rows.
SPRING_X, SPRING_F = [-0.03, -0.012, 0.0, 0.01, 0.025], np.array([-1150.0, -340.0, 0.0, 220.0, 700.0])
DAMPER_V, DAMPER_F = [-0.5, -0.2, -0.06, 0.0, 0.08, 0.25, 0.5], np.array([-760.0, -320.0, -108.0, 0.0, 144.0, 390.0, 870.0])
SOFT_V, SOFT_F = [-0.4, -0.1, 0.0, 0.1, 0.4], np.array([-210.0, -60.0, 0.0, 90.0, 310.0])
HARD_V, HARD_F = [-0.3, -0.08, 0.0, 0.1, 0.4], np.array([-1200.0, -420.0, 0.0, 800.0, 2400.0])
SURFACE_V, SURFACE_D = [-0.4, -0.15, 0.0, 0.2, 0.45], [-0.02, -0.006, 0.005, 0.018]  # a soft zone near rest, as of a bypass
SURFACE_F = np.array(
    [[-900, -560, -540, -800], [-410, -240, -260, -370], [0, 0, 0, 0], [620, 360, 330, 520], [1300, 900, 950, 1200.0]]
)
BUMP_X, BUMP_F, REBOUND_X, REBOUND_F = [0.0, 0.006, 0.015], [0.0, 400.0, 1900.0], [0.0, 0.005, 0.012], [0.0, 300.0, 1100.0]
BUMP, REBOUND = 0.012, 0.01  # strokes [m]
COIL, VALVES = straight(SPRING_X, SPRING_F), straight(DAMPER_V, DAMPER_F)
RUBBER, STRAP = straight(BUMP_X, BUMP_F), straight(REBOUND_X, REBOUND_F)


def polynomial(d, v, u):
    x, y = np.maximum(-d - BUMP, 0.0), np.maximum(d - REBOUND, 0.0)
    return 2e5 * y - x * (4e4 + 2e6 * x + 3e8 * x**2)


def tables(d, v, u):
    x, y = np.maximum(-d - BUMP, 0.0), np.maximum(d - REBOUND, 0.0)
    return STRAP(y) - RUBBER(x)


def dead_band(d, v, u):
    x = np.sign(d) * np.maximum(np.abs(d) - REBOUND, 0.0)
    return x * (8e4 + 2e8 * x**2)


def hydraulic(d, v, u):
    return -np.maximum(-d - BUMP, 0.0) * (4e4 + 2e5 * np.maximum(-v, 0.0))


def surface(d, v, u):
    flat = [np.interp(d, SURFACE_D, row) for row in SURFACE_F]  # its ends stay flat over deflection
    i = np.clip(np.searchsorted(SURFACE_V, v) - 1, 0, len(SURFACE_V) - 2)
    low, high = np.choose(i, flat[:-1]), np.choose(i, flat[1:])
    at, to = np.array(SURFACE_V)[i], np.array(SURFACE_V)[i + 1]
    return low + (high - low) * (v - at) / (to - at)


def dashpot(d, v, z, volts=1.5):
    """Rates of y and z of the modified Bouc-Wen model, as in its row."""
    y, x = np.moveaxis(z, -1, 0)
    speed = ((5e3 + 2e4 * volts) * x + (200.0 + 100.0 * volts) * v + 2e3 * (d - y)) / (3200.0 + 1100.0 * volts)
    w = v - speed
    return np.stack([speed, 3 * w - 2e3 * np.abs(w) * np.abs(x) ** 0.7 * x - 1e3 * w * np.abs(x) ** 1.7], axis=-1)


SOFT, HARD, SLOPES = straight(SOFT_V, SOFT_F), straight(HARD_V, HARD_F), ((600.0 + 900.0) / 2, (5250.0 + 8000.0) / 2)


def setting(v):
    """h, by which the force of a damper with two curves changes per coefficient at rest."""
    return (HARD(v) - SOFT(v)) / (SLOPES[1] - SLOPES[0])


def limits(s, more) -> str:
    return f"suspension_stroke = {{ bump = {BUMP}, rebound = {REBOUND} }}\nstop_stiffness = {more}"


DYNA4 = [-1.056, -0.528, -0.396, -0.264, -0.132, -0.051, 0, 0.051, 0.132, 0.264, 0.396, 0.528, 1.056]
OF_DYNA4 = [-971, -744, -685, -636, -557, -286, 0, 227, 902, 1581, 1862, 2178, 4054]
ROWS = {
    "stops": Row(
        "stop", "stop",
        lambda s, e: limits(s, f"{{ bump = [{4e4 * s * e}, {2e6 * s}, {3e8 * s}], rebound = {2e5 * s} }}"),
        polynomial, (-BUMP, REBOUND), line=(REBOUND, 9.0),
        known=("[limits]\nsuspension_stroke = 0.05\nstop_stiffness = [4e4, 2e6, 3e8]", [(-0.06, 0, 0, -900), (0.06, 0, 0, 900)]),
    ),
    "equal stops": Row(
        "stop", "stop", lambda s, e: f"suspension_stroke = {REBOUND * e}\nstop_stiffness = [{8e4 * s}, 0.0, {2e8 * s}]",
        dead_band, (-REBOUND, REBOUND), line=(REBOUND, 9.0),
    ),
    "stops with tables": Row(
        "stop", "stop",
        lambda s, e: limits(
            s,
            f"{{ bump = {table('compression', BUMP_X, s * np.array(BUMP_F) * [1, e, 1])}, "
            f"rebound = {table('deflection', REBOUND_X, s * np.array(REBOUND_F))} }}",
        ),
        tables, (-BUMP - 0.006, -BUMP, REBOUND, REBOUND + 0.005), line=(REBOUND, 9.0),
        known=(  # the rear axle of an SUV in DYNA4's format, from a public repository
            "[limits]\nstop.bump = { compression = [0.017, 0.027, 0.037, 0.067, 0.077, 0.0905], "
            "force = [0, 250, 550, 2100, 4700, 30e3] }",
            [(-0.072, 0, 0, -3400.0), (-0.0905, 0, 0, -30e3), (0.09, 0, 0, 0.0)],
        ),
    ),
    "spring": Row(
        "spring", "spring", lambda s, e: table("deflection", SPRING_X, s * SPRING_F * [1, e, 1, 1, 1]),
        lambda d, v, u: COIL(d), (-0.012, 0.0, 0.01),
        known=(  # the rear spring of the same car
            "[curves]\nsuspension_stiffness = { compression = [-0.0745, 0, 0.0905], force = [1898, 4756, 9323] }",
            [(0.0745, 0, 0, 2858.0), (-0.0905, 0, 0, -4567.0)],
        ),
    ),
    "damper": Row(
        "damper", "damper", lambda s, e: table("velocity", DAMPER_V, s * DAMPER_F * [1, e, 1, 1, 1, 1, 1]),
        lambda d, v, u: VALVES(v), (), (-0.2, -0.06, 0.08, 0.25), line=(9.0, 0.06),
        known=(  # the front damper of a car in DYNA4's database
            f"[curves]\nsuspension_damping = {table('velocity', DYNA4, OF_DYNA4)}",
            [(0, v, 0, f) for v, f in zip(DYNA4, OF_DYNA4, strict=True)],
        ),
    ),
    "surface damper": Row(
        "surface damper", "damper",
        lambda s, e: f"{{ velocity = {SURFACE_V}, deflection = {SURFACE_D}, "
        f"force = {(s * SURFACE_F * np.array([[1, 1, 1, 1, e]]).T).tolist()} }}",
        surface, tuple(SURFACE_D), (-0.15, 0.0, 0.2),
        known=(  # (1 + 6 d) c v is bilinear
            "[curves]\nsuspension_damping = { velocity = [-1, 0, 1], deflection = [-0.05, 0.05], "
            "force = [[-700, -1300], [0, 0], [700, 1300]] }",
            [(0.025, 0.5, 0, 1150 * 0.5), (-0.04, -1.5, 0, -760 * 1.5), (0.2, 1.0, 0, 1300.0)],
        ),
    ),
    "adjustable damper": Row(
        "adjustable damper", "input", lambda s, e: f"c_min = {600.0 * s}\nc_max = {4000.0 * s * e}\nbandwidth = {90.0 * s}",
        lambda d, v, u: u * v, line=(9.0, 9.0),
        known=(  # c v, with 400 N s/m without a command
            '[actuators]\nkind = "damper"\nc_min = 100.0\nc_max = 4000.0',
            [(0, 0.3, 3600.0, 1200.0), (0, -2.0, -300.0, -200.0)],
        ),
    ),
    "adjustable damper with curves": Row(
        "adjustable damper", "input",
        lambda s, e: f"c_min = {table('velocity', SOFT_V, s * SOFT_F)}\n"
        f"c_max = {table('velocity', HARD_V, s * HARD_F * [e, 1, 1, 1, 1])}",
        lambda d, v, u: u * setting(v), (), (-0.4, -0.3, -0.1, -0.08, 0.0, 0.1),
    ),
    "hydraulic stop": Row(
        "hydraulic_stop", "element", lambda s, e: f"stroke = {BUMP}\nstiffness = {4e4 * s}\ndamping = {2e5 * s * e}",
        hydraulic, (-BUMP,), (0.0,), line=(BUMP, 9.0),
        known=(  # x (k + c w) as it closes, k x as it opens
            '[parts.own]\nkind = "hydraulic_stop"\nstroke = 0.05\nstiffness = 4e4\ndamping = 2e5',
            [(-0.06, -0.5, 0, -1400.0), (-0.06, 0.5, 0, -400.0), (0.2, -1.0, 0, 0.0)],
        ),
    ),
    "Maxwell element": Row(
        "maxwell", "mount", lambda s, e: f"stiffness = {6e4 * s * e}\ndamping = {1500.0 * s}",
        lambda d, v, z: 6e4 * z, rate=lambda d, v, z: v - 40.0 * z,
        known=(  # at a constant rate the damper alone, whatever the spring
            '[parts.own]\nkind = "maxwell"\nstiffness = 5e4\ndamping = 1250.0',
            [(0.1, 0.3, 0, 375.0, 7.5e-3), (0, -2.0, 0, -2500.0, -0.05)],
        ),
    ),
    "Bouc-Wen": Row(
        "bouc_wen", "element",
        lambda s, e: f"k0 = {9e3 * s}\nalpha = {2.1e4 * s}\nbeta = {60.0 * e}\ngamma = 40.0",
        lambda d, v, z: 9e3 * d + 2.1e4 * z, (), (0.0,),
        rate=lambda d, v, z: v - 60.0 * np.abs(v) * z - 40.0 * v * np.abs(z),
        known=(  # the largest hysteretic force, after Wen (1976)
            '[parts.own]\nkind = "bouc_wen"\nk0 = 2e3\nalpha = 8e3\nbeta = 60.0\ngamma = 40.0',
            [(0.1, 0.3, 0, 200 + 80.0, 0.01), (-0.1, -9.0, 0, -200 - 80.0, -0.01)],
        ),
    ),
    "gas spring": Row(
        "gas_spring", "element",
        lambda s, e: f"load = {900.0 * s}\narea = {1e-3 * s}\nvolume = {6e-4 * s}\nexponent = {1.3 * e}",
        lambda d, v, u: -(900.0 + 101.325) * ((1 + d / 0.6) ** -1.3 - 1),
        known=(  # Boyle's law: at half and at twice the volume of 6 bar in all
            '[parts.own]\nkind = "gas_spring"\npressure = 498675.0\narea = "20 cm2"\nvolume = "0.6 l"\nexponent = 1.0',
            [(-0.15, 0.0, 0, -1200.0), (0.3, 0.0, 0, 600.0), (0.0, 1.0, 0, 0.0)],
        ),
    ),
    "Bouc-Wen damper": Row(
        "bouc_wen", "element",
        lambda s, e: f"c0 = {200.0 * s}\nc0_per_volt = {100.0 * s}\nalpha = {5e3 * s}\nalpha_per_volt = {2e4 * s}\n"
        f"voltage = 1.5\nA = 3.0\nbeta = {2e3 * e}\ngamma = -400.0\nexponent = 1.7\nfriction = true",
        lambda d, v, z: 350.0 * v + 35e3 * z, (), (0.0,), friction=True,
        rate=lambda d, v, z: 3 * v - np.abs(z) ** 0.7 * (2e3 * np.abs(v) * z - 400.0 * v * np.abs(z)),
    ),
    "modified Bouc-Wen": Row(
        "modified_bouc_wen", "element",
        lambda s, e: f"c0 = {200.0 * s}\nc0_per_volt = {100.0 * s}\nc1 = {3e3 * s}\nc1_per_volt = {1e3 * s}\nk0 = {2e3 * s}\n"
        f"k1 = {500.0 * s}\nalpha = {5e3 * s}\nalpha_per_volt = {2e4 * s}\nvoltage = 1.5\n"
        f"A = 3.0\ngamma = {2e3 * e}\nbeta = 1e3\nexponent = 1.7",
        lambda d, v, z: 4500.0 * dashpot(d, v, z)[..., 0] + 500.0 * d, (), (0.0,), rate=lambda d, v, z: dashpot(d, v, z),
        states=2, friction=True,
        known=(  # with all at rest, the spring of the accumulator, with the values of Spencer and others (1997)
            '[parts.own]\nkind = "modified_bouc_wen"\nc0 = 2100.0\nc0_per_volt = 350.0\nc1 = 28300.0\nc1_per_volt = 295.0\n'
            "k0 = 4690.0\nk1 = 500.0\nalpha = 14e3\nalpha_per_volt = 69500.0\ngamma = 3.63e6\nbeta = 3.63e6\nA = 301.0",
            [(0.0, 0.0, 0, 0.0, (0.0, 0.0)), (0.1, 0.0, 0, 50.0, (0.1, 0.0))],
        ),
    ),
    "Dahl": Row(
        "dahl", "element",
        lambda s, e: f"damping = {300.0 * s}\ndamping_per_volt = {200.0 * s}\nforce = {100.0 * s}\n"
        f"force_per_volt = {60.0 * s * e}\nvoltage = 2.0\nrho = 300.0",
        lambda d, v, z: 700.0 * v + 220.0 * z, (), (0.0,), rate=lambda d, v, z: 300.0 * (v - np.abs(v) * z), friction=True,
        known=(  # Coulomb's friction and the damping at a steady velocity, with the values of labcontrol-data/mr-damper at 0 V
            '[parts.own]\nkind = "dahl"\ndamping = 768.2\nforce = 57.42\nrho = 27450.0',
            [(0.1, 0.05, 0, 38.41 + 57.42, 1.0), (-0.1, -0.5, 0, -384.1 - 57.42, -1.0)],
        ),
    ),
    "modified Bouc-Wen with a set voltage": Row(
        "modified_bouc_wen", "input",
        lambda s, e: f"c0 = {200.0 * s}\nc0_per_volt = {100.0 * s}\nc1 = {3e3 * s}\nc1_per_volt = {1e3 * s}\nk0 = {2e3 * s}\n"
        f"k1 = {500.0 * s}\nalpha = {5e3 * s}\nalpha_per_volt = {2e4 * s * e}\nvoltage = 0.5\nlargest_voltage = 2.5\n"
        f"bandwidth = {90.0 * s}\nA = 3.0\ngamma = 2e3\nbeta = 1e3\nexponent = 1.7",
        lambda d, v, z, u: (3500 + 1e3 * u) * dashpot(d, v, z, 0.5 + u)[..., 0] + 500.0 * d, (), (0.0,),
        rate=lambda d, v, z, u: dashpot(d, v, z, 0.5 + u), states=2, friction=True, volts=True,
    ),
    "Dahl with a set voltage": Row(
        "dahl", "input",
        lambda s, e: f"damping = {300.0 * s}\ndamping_per_volt = {200.0 * s}\nforce = {100.0 * s}\n"
        f"force_per_volt = {400.0 * s * e}\nlargest_voltage = 2.0\nrho = 300.0",
        lambda d, v, z, u: (300 + 200 * u) * v + (100 + 400 * u) * z, (), (0.0,),
        rate=lambda d, v, z, u: 300.0 * (v - np.abs(v) * z), friction=True, volts=True,
    ),
    "inerter": Row(
        "inerter", "inertia", lambda s, e: f"inertance = {30.0 * s * e}", lambda d, v, u: 0.0 * d, inertance=30.0,
        known=(  # b r r' v^2 on a rocker of 0.7 + d / (5 m)
            "[curves]\nmotion_ratio = { deflection = [-0.1, 0.1], ratio = [0.68, 0.72] }\n"
            '[parts.own]\nkind = "inerter"\ninertance = 200.0',
            [(0.02, 0.3, 0, 200 * 0.704 * 0.2 * 0.09), (-0.03, -2.0, 0, 200 * 0.694 * 0.2 * 4.0), (0.2, 2.0, 0, 0.0)],
        ),
    ),
    "actuator": Row(
        "actuator", "input", lambda s, e: "", lambda d, v, u: -u,
        known=(  # virtual work on a rocker of 0.7 + d / (5 m)
            "[curves]\nmotion_ratio = { deflection = [-0.1, 0.1], ratio = [0.68, 0.72] }",
            [(0.02, 0.3, 1000.0, -704.0), (-0.3, 0, -100.0, 68.0)],
        ),
    ),
}  # fmt: skip
FOR_ALL = [name for name in ROWS if name != "actuator"]
SINGLE = [((name,), ratio) for name in FOR_ALL for ratio in RATIOS] + [(("actuator",), "over travel")]


def fit(*names) -> bool:
    """True if one suspension can have all of these."""
    slots = [ROWS[name].slot for name in names]
    return len({*slots}) == len(slots) and not ("surface damper" in names and any("adjustable" in name for name in names))


PAIRS = [(pair, ratio) for pair in itertools.combinations(ROWS, 2) if fit(*pair) for ratio in RATIOS if "actuator" not in pair]
PAIRS += [((name, "actuator"), "over travel") for name in FOR_ALL if fit(name, "actuator")]
ALONE = [(kind, *case) for case in SINGLE for kind in CORNERS if kind != "half_car_roll" or case[1] == "over travel"]
ON_QUARTER = [case for case in ALONE if case[0] == "quarter_car"]
LARGER = [(("half_car", "full_car")[i % 2], (name,), RATIOS[i // 2 % 3]) for i, name in enumerate(FOR_ALL)]
LARGER += [("half_car_roll", *case) for case in SINGLE[2::12]] + [("full_car", *SINGLE[-1])]
BESIDE = [(kind, *pair) for kind, pair in zip(itertools.cycle(CORNERS), PAIRS, strict=False)]  # on one car each
TOGETHER = ("half_car", ("stops", "damper"), "over travel")
EVERY = ALONE + list(dict.fromkeys([*BESIDE[::3], TOGETHER]))  # a third of the pairs: each part is still in several


def label(one) -> str:
    return one if isinstance(one, str) else "+".join(one)


def in_suite(*some, of=EVERY):
    """Parametrises a test with all cases, of which some are in the suite and the others for the attacks alone."""
    return pytest.mark.parametrize(("kind", "names", "ratio"), in_the_suite(some, of), ids=label)


# All rows at all ratios, and each on a larger car, of which each has all ratios.
every = in_suite(*ON_QUARTER, *LARGER, *BESIDE[4::36])
OVER_TRAVEL = [case for case in ON_QUARTER if case[2] == "over travel"]
CONSTANT_RATIO = [("quarter_car", (name,), RATIOS[i % 2]) for i, name in enumerate(FOR_ALL)]
SORTS = {(row.slot, row.rate is None, row.states, row.volts): name for name, row in reversed(ROWS.items())}
# All rows over travel, native forms at a constant ratio, and a row of each sort, and a pair, on larger cars.
# A constant ratio has the forms of curves and stops, but no form of a part with states, and r = 1 is one.
NATIVE = [case for case in CONSTANT_RATIO if not ROWS[case[1][0]].rate]
ON_LARGER = [case for case in LARGER if case[1][0] in SORTS.values()]
steps = in_suite(*OVER_TRAVEL, *NATIVE[::2], *ON_LARGER[::2], TOGETHER)
stacks = in_suite(*OVER_TRAVEL, *CONSTANT_RATIO, *LARGER[::3], TOGETHER)
of_energy = in_suite(*OVER_TRAVEL, TOGETHER)
SIDE_BY_SIDE = {*OVER_TRAVEL, TOGETHER, ("full_car", ("surface damper",), "constant")}
# Whole runs of four cars are dear: each part at each ratio on the quarter-car and on a larger car, and a ninth of the pairs.
some_runs = in_suite(*SIDE_BY_SIDE, of=list(dict.fromkeys([*ON_QUARTER, *LARGER, *sorted(SIDE_BY_SIDE), *BESIDE[::9]])))


def ratios_at(ratio: str, end: str) -> tuple[list[float], list[float]]:
    """Deflections and motion ratios at a corner; beyond them the ratio stays."""
    r = {"at the wheel": [1.0], "constant": [0.7], "over travel": RATIO}[ratio]
    return TRAVEL if len(r) > 1 else [0.0], [one * AXLES[axle(end)] if ratio != "at the wheel" else one for one in r]


@cache
def car(kind: str, names: tuple[str, ...], ratio: str, size: float = 1.0, fault: float = 1.0) -> Vehicle:
    """A car with these rows in every suspension, whose forces have a factor, and one of whose numbers has a fault."""
    text = re.sub(r"(?m)^suspension_\w+ = .*\n", "", read_vehicle(kind).text.partition("[controllers")[0])
    ends, sections = list(dict.fromkeys(map(axle, CORNERS[kind]))), dict[str, list[str]]()
    by_slot = {ROWS[name].slot: ROWS[name] for name in names}
    for end in ends:
        s = size * AXLES[end]
        for slot, name, usual in (("spring", "stiffness", SPRING), ("damper", "damping", DAMPER)):
            value = by_slot[slot].file(s, fault) if slot in by_slot else repr(usual * s)
            section = "curves" if slot in by_slot else "parameters"
            sections.setdefault(section, []).append(f"suspension_{name}{end} = {value}")
        if "stop" in by_slot:
            sections[f"limits{end.replace('_', '.')}"] = [by_slot["stop"].file(s, fault)]
        for slot in [one for one in ELEMENTS if one in by_slot and (one != "input" or by_slot[one].volts)]:
            at = f'at = ["{end.removeprefix("_")}"]' * bool(end)
            own = by_slot[slot]
            sections[f"parts.{slot}{end}"] = [f'kind = "{own.part}"\n{own.file(s, fault)}\n{at}']
        x, r = ratios_at(ratio, end)
        if "actuator" in names:  # which has no number but its ratio, and its lag
            r[1] *= fault
            sections.setdefault("limits", []).append("actuator_bandwidth = 60.0" * (end == ends[0]))
        if ratio == "constant":
            sections.setdefault("parameters", []).append(f"motion_ratio{end} = {r[0]}")
        if ratio == "over travel":
            sections.setdefault("curves", []).append(f"motion_ratio{end} = {{ deflection = {x}, ratio = {r} }}")
    for end in CORNERS[kind]:
        if "input" in by_slot and by_slot["input"].part == "adjustable damper":
            own = by_slot["input"].file(size * AXLES[axle(end)], fault)
            sections[f"actuators{end.replace('_', '.', 1)}"] = [f'kind = "damper"\n{own}']
    own = "\n".join(sections.pop("parameters", []))
    text = text.replace("[parameters]", f"[parameters]\n{own}", 1)
    text += "".join(f"[{name}]\n" + "\n".join(lines) + "\n" for name, lines in sections.items())
    measured = str([f"sprung_velocity{end}" for end in CORNERS[kind]]).replace("'", '"')
    text += f"[controllers.held]\nmeasured = {measured}\ngain = {np.diag([-1200.0] * len(CORNERS[kind])).tolist()}\n"
    return parse_vehicle(text)


@cache
def with_states(names: tuple[str, ...]) -> list[tuple[Row, int | slice]]:
    """The rows with a state, in the order of the elements, and the places of their states."""
    rows = [ROWS[name] for slot in ELEMENTS for name in names if ROWS[name].slot == slot and ROWS[name].rate]
    ends = np.cumsum([0, *(row.states for row in rows)]).tolist()
    return [(row, at if row.states == 1 else slice(at, at + row.states)) for row, at in zip(rows, ends, strict=False)]


def own_law(names: tuple[str, ...], d, v, u, z, volts):
    """The pull of all in a suspension [N], in its own travel, and the shape of its input, for a factor of 1."""
    rows = {ROWS[name].slot: ROWS[name] for name in names}
    spring = rows["spring"].law(d, v, u) if "spring" in rows else SPRING * d
    damper = rows["damper"].law(d, v, u) if "damper" in rows else DAMPER * v
    if "adjustable damper with curves" in names:  # a curve in parallel adds what it has beyond its line
        nominal = SOFT(v) + (DAMPER - SLOPES[0]) * setting(v)
        damper = nominal + damper - DAMPER * v
    more = sum(rows[slot].law(d, v, u) for slot in ("stop", *ELEMENTS[:-1]) if slot in rows and rows[slot].rate is None)
    more = more + sum(row.law(d, v, z[..., i], *[volts] * row.volts) for row, i in with_states(names))
    if any(ROWS[name].volts for name in names):
        return spring + damper + more
    return spring + damper + more + (rows["input"].law(d, v, u) if "input" in rows else -u)


@dataclasses.dataclass(frozen=True, eq=False)
class Law:
    """The force of a suspension at its wheel, which carries a static load [N]."""

    kind: str
    names: tuple[str, ...]
    ratio: str
    end: str
    load: float
    size: float = 1.0

    @cached_property
    def ratios(self):
        """Deflections, the motion ratio at each, its slopes between these, and its integral up to each."""
        x, r = ratios_at(self.ratio, self.end)
        x, r = np.array([-9.0, *x, 9.0]), np.array([r[0], *r, r[-1]])
        return x, r, np.diff(r) / np.diff(x), cumulative_trapezoid(r, x, initial=0.0)

    @cached_property
    def at_rest(self):
        """Motion ratio at rest, and the integral up to there."""
        x, r, _, whole = self.ratios
        i, ratio = np.searchsorted(x, 0.0, "right") - 1, np.interp(0.0, x, r)
        return float(ratio), float(whole[i] - x[i] * (r[i] + ratio) / 2)

    def travel(self, d):
        """Motion ratios at deflections, and own travel."""
        x, r, _, whole = self.ratios
        i, ratio = x[1:-1].searchsorted(d), np.interp(d, x, r)
        return ratio, whole[i] + (d - x[i]) * (r[i] + ratio) / 2 - self.at_rest[1]

    def __call__(self, d, v, u: np.ndarray | float = 0.0, z: np.ndarray | None = None):
        """Pull [N] at deflections and their rates, with the actuator's force or the coefficient beyond the nominal one.

        Args:
            z: states, shape (..., n); None for 0.
        """
        z = np.zeros((*np.shape(d), sum(row.states for row, _ in with_states(self.names)))) if z is None else z
        (r, D), s = self.travel(d), self.size * AXLES[axle(self.end)]
        on = u / s  # forces have a factor, coefficients and actuators have not
        pull = s * r * own_law(self.names, D, r * v, on, z, u) - (r / self.at_rest[0] - 1) * self.load
        if not self.own_inertance:
            return pull
        x, _, slopes, _ = self.ratios
        return pull + self.inertance(d) * slopes[x[1:-1].searchsorted(d)] / r * np.square(v)

    def rates(self, d, v, z, u: np.ndarray | float = 0.0):
        """Rates of the states, shape (..., n)."""
        found, rows = np.zeros(np.shape(z)), with_states(self.names)
        r, D = self.travel(d) if rows else (1.0, 0.0)
        for row, i in rows:
            found[..., i] = cast(Callable, row.rate)(D, r * v, z[..., i], *[u] * row.volts)
        return found

    def inertance(self, d):
        """b of a further force b v' [kg] at deflections."""
        b = self.size * AXLES[axle(self.end)] * self.own_inertance
        return b * self.travel(d)[0] ** 2 if b else np.zeros(np.shape(d))

    @property
    def own_inertance(self):
        """b of the parts in their own travel, for a factor of 1 [kg]."""
        return sum(ROWS[name].inertance for name in self.names)


def laws(kind, names, ratio, size=1.0) -> list[Law]:
    loads = static_loads(read_vehicle(kind))
    return [Law(kind, names, ratio, end, load, size) for end, load in zip(CORNERS[kind], loads, strict=True)]


def motions(count: int = 400):
    """Random deflections, rates and inputs, shapes (count,): most in the tables, some far beyond."""
    rng = np.random.default_rng(1)
    d, v = (far * rng.standard_normal(count) * rng.choice([1, 1, 1, 6], count) for far in (0.02, 0.3))
    return d, v, rng.uniform(-1e3, 1e3, count)


def of_states(parts: list[Part], count: int = 400) -> list[np.ndarray]:
    """Random states of each part, shapes (count, n)."""
    rng = np.random.default_rng(5)
    return [0.01 * rng.standard_normal((count, len(part.states))) for part in parts]


def without_part(vehicle: Vehicle, place, r, d, v, u):
    """The pull of what a suspension has in its linear model alone."""
    own, s = [one for one in vehicle.parts if one.place is place], AXLES[axle(place.ending)]
    total = 0.0 if any(one.place.stiffness == one.parameter for one in own) else r**2 * SPRING * s * d
    if not any(place.damping == one.parameter for one in own):
        total = total + r**2 * DAMPER * s * v
    return total - (0.0 if any(one.part.inputs for one in own) else r * u)


def test_every_part_has_a_row():
    """Each part of the registry is in a row, and some row of each has numbers from outside the project."""
    assert {row.part for row in ROWS.values()} == {*PARTS}
    assert {row.part for row in ROWS.values() if row.known} == {*PARTS}


def bare(part: Part) -> Part:
    """The part without its motion ratio, and the element whose voltage is set."""
    return bare(part.part) if isinstance(part, AtRatio) else getattr(part, "element", part)


@pytest.mark.parametrize("name", [name for name, row in ROWS.items() if row.known])
def test_numbers_from_outside_the_project(name):
    """A part has the forces of public tables, of closed forms and of its printed coefficients."""
    sections, points = ROWS[name].known
    text = read_vehicle("quarter_car").text
    for curve in re.findall(r"(?m)^(suspension_stiffness|suspension_damping) =", sections):
        text = re.sub(rf"(?m)^{curve} = .*\n", "", text)
    parts = [one.part for one in parse_vehicle(f"{text}\n{sections}\n").parts]
    (part,) = (one for one in parts if isinstance(bare(one), PARTS.load(ROWS[name].part)))
    z = np.array([np.ravel(own) for *_, own in points]) if len(points[0]) > 4 else np.zeros((len(points), 0))
    d, v, u, pull = np.array([point[:4] for point in points], dtype=float).T
    np.testing.assert_allclose(part.pull(d, v, z, u), pull, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(part.rate(d, v, z, u), 0.0, atol=1e-12)


@every
def test_the_force_is_the_law(kind, names, ratio):
    """The sum of a suspension's parts is the law from the numbers of the file, also far beyond its tables."""
    vehicle = car(kind, names, ratio)
    d, v, u = motions()
    for law, place in zip(laws(kind, names, ratio), vehicle.kind.suspensions, strict=True):
        parts = [one.part for one in vehicle.parts if one.place is place]
        z = of_states(parts)
        every = np.concatenate(z, axis=1) if z else None
        expected = law(d, v, u, every)
        found = sum(part.pull(d, v, own, u if part.inputs else 0.0) for part, own in zip(parts, z, strict=True))
        rates = [part.rate(d, v, own) for part, own in zip(parts, z, strict=True)]
        assert every is None or np.abs(np.concatenate(rates, axis=1) - law.rates(d, v, every)).max(initial=0.0) < EXACT
        found = found + without_part(vehicle, place, law.travel(0.0)[0], d, v, u)
        assert np.abs(found - expected).max() < EXACT * np.abs(expected).max()
        b = sum(part.inertance_at(d) for part in parts)
        np.testing.assert_allclose(b * np.ones_like(d), law.inertance(d), rtol=EXACT)
        np.testing.assert_allclose(sum(part.line.inertance for part in parts), law.inertance(0.0), rtol=EXACT)


def slope(f, h=1e-5):
    """The mean of the slopes of both sides of 0, of a function that is a polynomial on each."""
    near, far = ((f(e) - f(-e)) / (2 * e) for e in (h, 2 * h))
    return 2 * near - far


def moved(part: Part, i: int, x: float):
    """The pull and the rates of the states with x as the extension, its rate, the input or a state, and the others 0."""
    d, v, u, *z = x * np.eye(3 + len(part.states))[i]
    return np.array([part.pull(d, v, np.array(z), u), *part.rate(d, v, np.array(z), u)])


def from_rest(rows, s):
    """The pull per extension of exp(s t) from rest, of gains from extension, its rate, input and states to pull and rates."""
    C, A = rows[0, 3:], rows[1:, 3:]
    return rows[0, 0] + s * rows[0, 1] + C @ np.linalg.solve(s * np.eye(len(A)) - A, rows[1:, 0] + s * rows[1:, 1])


@every
def test_the_line_at_rest_is_the_derivative(kind, names, ratio):
    """A part's line is its derivative at rest, and the vehicle's rates are those of the laws; beyond is the rest of the pull.

    With states, the response from rest is that of the derivative, without the last state of a friction.
    """
    vehicle, at = car(kind, names, ratio), np.zeros(1)
    d, v, u = motions()
    for one in vehicle.parts:
        part, line, own, (z,) = one.part, one.part.line, u if one.part.inputs else 0.0, of_states([one.part])
        found = np.array([[line.stiffness, line.damping, line.gain, *(() if line.of_states is None else line.of_states)]])
        if line.rates is not None:  # over (z, d, v, u)
            found = np.vstack([found, np.roll(line.rates, 3, axis=1)])
        expected = np.stack([slope(partial(moved, part, i)) for i in range(3 + len(part.states))], axis=-1)
        if any(ROWS[name].friction and isinstance(bare(part), PARTS.load(ROWS[name].part)) for name in names):
            expected = expected[:-1, :-1]  # without the last state
        np.testing.assert_allclose(found[0, :3], expected[0, :3], rtol=1e-7, atol=1e-6)
        assert np.array_equal(found[0, :3] == 0, np.abs(expected[0, :3]) < 1e-6), "exactly 0"
        for s in 1j * np.array([0.3, 3.0, 30.0, 300.0]):
            np.testing.assert_allclose(from_rest(found, s), from_rest(expected, s), rtol=1e-7)
        assert line.rates is None or np.linalg.eigvals(line.rates[:, : len(part.states)]).real.max() < 0, "a stable mode"
        pull, beyond = part.pull(d, v, z, own), part.beyond(d, v, z, own)
        assert np.abs(beyond - (pull - line(d, v, own, z))).max() <= EXACT * np.abs(pull).max()
        if part.states:
            rates, apart = part.rate(d, v, z), part.rate_beyond(d, v, z)
            assert np.abs(apart - (rates - line.rate(d, v, z))).max() <= EXACT * np.abs(rates).max()
        rows = [ROWS[name] for name in names]
        rows = [row for row in rows if isinstance(bare(part), PARTS.load(row.part)) or (part.inputs and row.slot == "damper")]
        ends = [row.line for row in rows if row.line is not None]
        if rows and len(ends) == len(rows) and ratio != "over travel":
            ends = np.min(ends, axis=0)
            within = (np.abs(d) < ends[0] / one.ratio) & (np.abs(v) < ends[1] / one.ratio)
            assert within.any()
            assert not part.beyond(d[within], v[within], z[within]).any(), "exactly 0"
    rates = vehicle.kind.at_wheels(vehicle.parameters)
    for law, place in zip(laws(kind, names, ratio), vehicle.kind.suspensions, strict=True):
        lines = [one.part.line for one in vehicle.parts if one.place is place and not one.parameter]
        stiffness, damping = (sum(getattr(line, name) for line in lines) for name in ("stiffness", "damping"))
        assert rates[place.stiffness] + stiffness == pytest.approx(float(slope(partial(law, v=at))[0]), rel=1e-7)
        assert rates[place.damping] + damping == pytest.approx(float(slope(partial(law, at))[0]), rel=1e-7)


def followed(part: Part, d, v, h: float, u: np.ndarray | float = 0.0):
    """The states of a part from rest along a path, shape (T, ..., n), by steps of RK4 over two samples, and Hermite's cubics."""
    z, (d, v) = np.zeros((len(d), *np.shape(u), len(part.states))), part.own_motion(d, v)
    part = part.part if isinstance(part, AtRatio) else part
    for k in range(0, len(d) - 2, 2 if part.states else len(d)):
        at = [partial(part.rate, d[k + i], v[k + i], u=u) for i in range(3)]
        first = at[0](z[k])
        second = at[1](z[k] + h * first)
        third = at[1](z[k] + h * second)
        z[k + 2] = z[k] + h / 3 * (first + 2 * second + 2 * third + at[2](z[k] + 2 * h * third))
        z[k + 1] = (z[k] + z[k + 2]) / 2 + h / 4 * (first - at[2](z[k + 2]))
    return z


def without_place(part: Part) -> Part:
    """The part without the names of the force and the suspension that its input belongs to."""
    if isinstance(part, AtRatio):
        return dataclasses.replace(part, part=without_place(part.part))
    if not isinstance(part, SettablePart):
        return part
    changed = {"damper": dataclasses.replace(part.damper, name="")} if hasattr(part.damper, "name") else {}
    return dataclasses.replace(part, force="", ending="", **changed)


def check_energy(part: Part) -> None:
    """Asserts that the energy which a part stores is the integral of its pull, and that the rest is lost."""
    own: Any = bare(part)
    count = 20001 if not part.states else 10001 if own.settable else 5001  # RK4 takes each step of a state in Python
    t = np.linspace(0.0, 2 * np.pi, count)
    x, rng = np.linspace(-0.08, 0.08, 16001), np.random.default_rng(2)
    (a, b), low = rng.normal(0, [[0.03], [0.01]], (2, 4)), np.array([1, 2, 3, 5])
    d = a @ np.sin(np.outer(low, t)) + b @ np.cos(np.outer(low, t))
    v = 5.0 * (a @ (low[:, None] * np.cos(np.outer(low, t))) - b @ (low[:, None] * np.sin(np.outer(low, t))))
    settings = np.array([0.0, *((own.settable or (own.low, own.high)) if part.inputs else ())])
    for u, z in zip(settings, np.moveaxis(followed(part, d, v, t[1] / 5.0, settings), 1, 0), strict=True):
        force = part.pull(d, v, z, np.full_like(d, u)) - part.centrifugal(d, v)  # whose work is kinetic energy
        supplied = cumulative_simpson(force * v, x=t / 5.0, initial=0.0)
        stored = own.stored(part.own_motion(d, v)[0], z, u) if own.settable else part.stored(d, z)
        lost = supplied - (stored - stored[0])
        if own.settable:
            storing = cumulative_simpson(own.storing(*part.own_motion(d, v), z, u), x=t / 5.0, initial=0.0)
            assert np.abs(storing - stored + stored[0]).max() < 1e-4 * np.abs(stored).max()
        scale = np.abs(supplied).max() + 1e-9
        assert np.diff(lost).min() > -1e-5 * scale
        assert (abs(lost[-1]) < 1e-5 * scale) == part.stores
    if part.stores:
        energy = cumulative_simpson(part.pull(x, np.zeros_like(x)), x=x, initial=0.0)
        energy -= energy[len(x) // 2]
        assert np.abs(part.stored(x) - energy).max() <= 1e-7 * np.abs(energy).max()
        beyond = part.stored(x) - part.line.stiffness * x**2 / 2
        assert np.abs(part.stored_beyond(x) - beyond).max() <= EXACT * np.abs(energy).max()


@of_energy
def test_energy_is_stored_or_lost(kind, names, ratio):
    """The energy that a part stores is the integral of its pull; what it does not store it loses on every closed path."""
    vehicle = car(kind, names, ratio)
    for part in [one.part for one in pickle.loads(pickle.dumps(vehicle)).parts]:  # as in another process
        if vehicle.dampers or not part.inputs:  # an actuator gives and takes
            made(check_energy, without_place(part))  # equal parts of several corners and cars are checked once


@stacks
def test_different_vehicles_are_stacked(kind, names, ratio):
    """The forces of vehicles that differ in parameters, and in tables, are those of each alone; a parameter scales its curve."""
    first, other = car(kind, names, ratio), car(kind, names, ratio, 1.3)
    name = next(name for name in first.parameters if name.startswith(("suspension", "motion", "sprung")))
    cars = [first, first.with_parameters(**{name: 1.02 * first.parameters[name]}), other, first]
    c, rng = len(CORNERS[kind]), np.random.default_rng(3)
    d, v, u = (np.repeat(far * rng.standard_normal((50, 1, c)), len(cars), axis=1) for far in (0.03, 0.4, 900.0))
    z = np.repeat(0.01 * rng.standard_normal((50, 1, SuspensionForces(cars).states)), len(cars), axis=1)
    for whole in (True, False):
        forces = SuspensionForces(cars, whole=whole)
        found, rates, b = forces(d, v, u, z), forces.rates(d, v, u, z), forces.inertance(d)
        for i, one in enumerate(cars):
            own, single = slice(i, i + 1), SuspensionForces([one], whole=whole)
            alone, of_alone = (
                single(d[:, own], v[:, own], u[:, own], z[:, own]),
                single.rates(d[:, own], v[:, own], u[:, own], z[:, own]),
            )
            assert np.abs(found[:, own] - alone).max() <= EXACT * np.abs(alone).max()
            assert np.abs(rates[:, own] - of_alone).max(initial=0.0) <= EXACT * np.abs(of_alone).max(initial=0.0)
            np.testing.assert_allclose(b[:, own], single.inertance(d[:, own]), rtol=EXACT, atol=1e-12)
            own_laws = laws(kind, names, ratio, 1.3 if one is other else 1.0)
            inertances = np.stack([law.inertance(d[:, i, k]) for k, law in enumerate(own_laws)], axis=-1)
            changed = name.startswith("motion") and i == 1
            assert changed or not whole or np.allclose(b[:, i], inertances, rtol=EXACT)
    found = SuspensionForces(cars)(d, v, u, z)
    if {ROWS[name].part for name in names} <= {"spring", "damper", "surface damper"}:
        scaled = {name: 1.3 * value for name, value in first.parameters.items() if name.startswith("suspension_")}
        alone = SuspensionForces([first.with_parameters(**scaled)])(d[:, :1], v[:, :1], u[:, :1])
        assert np.abs(found[:, 2:3] - alone).max() <= EXACT * np.abs(alone).max()


def by_stages(vehicle: Vehicle) -> Vehicle:
    """The vehicle whose parts have no form native to MuJoCo."""
    other = dataclasses.replace(vehicle)
    vars(other)["parts"] = tuple(dataclasses.replace(one, part=AtRatio(one.part, Constant())) for one in vehicle.parts)
    return other


@stacks
def test_native_forms_are_the_stages(kind, names, ratio):
    """At random states MuJoCo's accelerations are those of a model in which a motor pulls with what is beyond the lines."""
    vehicle, rng, c = car(kind, names, ratio), np.random.default_rng(4), len(CORNERS[kind])
    cars = (vehicle, by_stages(vehicle))
    models = [build_model(one, 1e-3, drawn=False) for one in cars]
    by_motors = [SuspensionForces([one], by_motor=True) for one in cars]
    driving = list[list[list[int]]]()  # by model and suspension, actuators that its input sets
    pulling = list[list[tuple[int, int]]]()  # by model, suspensions and the motors that pull with what is beyond the lines
    for model in models:
        at = {model.actuator(i).name: i for i in range(model.nu)}
        own = [re.compile(rf"(fitted_)?{place.force}(_\d+)?") for place in vehicle.kind.suspensions]  # several may be one damper
        driving.append([[i for name, i in at.items() if one.fullmatch(name)] for one in own])
        motors = [f"fitted_part_{place.tendon}" for place in vehicle.kind.suspensions]
        pulling.append([(k, at[name]) for k, name in enumerate(motors) if name in at])
    datas = [mujoco.MjData(model) for model in models]
    tendons = [[model.tendon(place.tendon).id for place in vehicle.kind.suspensions] for model in models]
    worst = most = 0.0
    for _ in range(40):
        q, rates, u = 0.03 * rng.standard_normal(models[0].nq), 0.4 * rng.standard_normal(models[0].nv), rng.uniform(-1e3, 1e3, c)
        found, z = [], 0.01 * rng.standard_normal((1, by_motors[0].states))
        for k, (forces, model, data) in enumerate(zip(by_motors, models, datas, strict=True)):
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = q, rates
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            d, v = (data.ten_length - model.tendon_length0)[tendons[k]], data.ten_velocity[tendons[k]]
            pulls = forces(d[None], v[None], u[None], z)[0]
            for of_input, value in zip(driving[k], u, strict=True):
                for j in of_input:
                    data.ctrl[j] = value
                    data.act[model.actuator_actadr[j] : model.actuator_actadr[j] + model.actuator_actnum[j]] = value
            for suspension, j in pulling[k]:
                data.ctrl[j] = pulls[suspension]
            mujoco.mj_forward(model, data)
            found.append(np.array(data.qacc))
        worst, most = max(worst, np.abs(found[0] - found[1]).max()), max(most, np.abs(found[0]).max())
    assert worst < EXACT * most


H, ROAD = 2.5e-3, Bump(0.1, 3.0, 12.5)
ROADS = {"quarter_car": ROAD.scaled(0.7), "half_car": ROAD, "half_car_roll": dataclasses.replace(ROAD, track="left")}
ROADS |= {"full_car": ROADS["half_car_roll"]}


@cache
def held(kind: str) -> AnyController:
    """A law that drives actuators and adjustable dampers of all cars of a type; one, for its certificate takes time."""
    return driver_of(car(kind, (), "at the wheel"), "held")


def driven(kind, names, ratio, h=H, whole=False) -> tuple[list[RoadInput], list[Recording]]:
    """MuJoCo's runs over a bump side by side: of the car, one with a fault, other tables, other parameters; or of the car.

    There are all four for `whole`, and for each case whose runs several tests share.
    """
    return _driven(kind, names, ratio, h, h == H and (whole or (kind, names, ratio) in SIDE_BY_SIDE))


@cache
def _driven(kind, names, ratio, h, whole) -> tuple[list[RoadInput], list[Recording]]:
    cars, long = [car(kind, names, ratio)], h == H or any(ROWS[name].slot == "stop" for name in names)
    if whole:
        scaled = {name: 1.02 * one for name, one in cars[0].parameters.items() if name.startswith(("suspension_", "motion_"))}
        cars += [car(kind, names, ratio, fault=FAULT), car(kind, names, ratio, 1.01), cars[0].with_parameters(**scaled)]
    inputs = [RoadInput(one, ROADS[kind], sample_times(one, 0.3 if long else 0.15, h)) for one in cars]
    return inputs, list(simulate([held(kind)] * len(cars), inputs).recordings)


@steps
def test_a_step_is_a_step_of_the_equations(kind, names, ratio):
    """Each step of MuJoCo is one RK4 step of masses, lengths and the written laws, over a bump that reaches all of a law."""
    (on, *_), (physics, *_) = driven(kind, names, ratio)
    own, model = laws(kind, names, ratio), build_model(on.vehicle, H, drawn=False)
    joints = [model.joint(i).name for i in range(model.njnt)]
    body = [name for name in ("sprung", "heave", "pitch", "roll") if name in joints]
    order = [joints.index(name) for name in (*body, *(f"unsprung{end}" for end in CORNERS[kind]))]
    (u, commands, lag), reached = acting(on, physics.response), {name: (set[int](), set[int]()) for name in names}
    own_states = [signal.name for signal in on.vehicle.kind.of_parts]
    z = np.stack([physics.response[name] for name in own_states], axis=-1) if own_states else np.zeros((len(u), 0))
    x, n = np.concatenate([physics.qpos[:, order], physics.qvel[:, order], z, u], axis=1), 2 * len(order)
    m, c = n + z.shape[1], len(own)

    def forces(d, v, u, z):
        for law, one, rate in zip(own, d.T, v.T, strict=True):
            r, D = law.travel(one)
            for name, cells in reached.items():
                for knots, at, found in zip((ROWS[name].d, ROWS[name].v), (D, r * rate), cells, strict=True):
                    found.update(np.searchsorted(sorted(knots), at).tolist())
        rates[:] = [law.rates(*at) for law, *at in zip(own, d.T, v.T, z, u.T, strict=True)]
        return np.stack([law(*at) for law, *at in zip(own, d.T, v.T, u.T, z, strict=True)], axis=-1)

    rates = list[np.ndarray]()

    def inertance(d):
        return np.stack([law.inertance(one) for law, one in zip(own, d.T, strict=True)], axis=-1)

    def rate(at):
        x, z, u = at[:, :n], np.moveaxis(at[:, n:m].reshape(len(at), c, (m - n) // c), 1, 0), at[:, m:]
        of_inertance = inertance if any(ROWS[name].inertance for name in names) else None
        moved = Mechanism(on.vehicle, partial(forces, z=z), of_inertance).rate(x, on.midway[:-1], u)
        return np.concatenate([moved, *rates, lag * (commands - u)], axis=1)

    assert (np.abs(rk4(rate, x[:-1], H) - x[1:])[:, :m].max(axis=0) < EXACT * np.abs(x[:, :m]).max(axis=0)).all()
    for name, cells in reached.items():
        assert cells == tuple({*range(len(knots) + 1)} for knots in (ROWS[name].d, ROWS[name].v)), "every regime is reached"


# One with a set voltage is in test_set_voltages.py.
HARDEST = [case for case in SINGLE if case[1] == "over travel" and case[0][0] in SORTS.values() and not ROWS[case[0][0]].volts]


@pytest.mark.parametrize(("names", "ratio"), [*HARDEST, *attacks(case for case in SINGLE if case not in HARDEST)], ids=label)
def test_a_run_is_an_independent_integration(names, ratio):
    """A quarter-car moves as its laws by an integration to 1e-11, but for RK4's error: h^4, h^2 where a law has a knot, or h.

    The force of an inertial part jumps with the slope of the motion ratio.
    """
    (law,), errors = laws("quarter_car", names, ratio), []
    knots = [lambda d, v, k=k: law.travel(d)[1] - k for name in names for k in ROWS[name].d]
    knots += [lambda d, v, k=k: law.travel(d)[0] * v - k for name in names for k in ROWS[name].v]
    knots += [lambda d, v, k=k: d - k for k in TRAVEL if ratio == "over travel"]
    for h in (4e-3, 2e-3):
        (on, *_), (physics, *_) = driven("quarter_car", names, ratio, h)
        run = physics.response
        expected = integrated(on, law, knots, *acting(on, run), law.inertance)
        found = np.stack([run["suspension_deflection"], run["tyre_deflection"]], axis=-1)
        errors.append(float((np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)).max()))
    assert errors[0] < 2e-3
    assert errors[1] < 2e-3 / (2 if law.inertance(0.0) else 4)
    assert ratio == "over travel" or ROWS[names[0]].d or ROWS[names[0]].v or errors[1] < errors[0] / 15, "no knot: order 4"


def judged(on: RoadInput, physics: Recording) -> Run:
    """The verdict on a run of MuJoCo by the prediction for a vehicle."""
    return compare_runs([predict_run(held(on.vehicle.kind.name), on, physics.commands)], [physics])[0]


@some_runs
def test_the_verdict_passes_and_a_fault_is_found(kind, names, ratio):
    """A run agrees and its energy balances; a number that is 2 % off in the physics alone, or in the equations, is found."""
    (on, wrong, *_), (physics, faulty, *_) = driven(kind, names, ratio, whole=True)
    assert with_energy_balance([judged(on, physics)], [physics])[0].passed
    assert not judged(on, faulty).agrees
    assert not judged(wrong, physics).agrees
    if not any(ROWS[name].slot == "input" or ROWS[name].rate for name in names):
        without = RoadInput(car(kind, (), ratio), ROADS[kind], on.time)
        assert not energy(without.vehicle, Runs([physics]), 0, on.road).balances, "the energy finds a part that nobody wrote down"


BENT = [case for case in SINGLE if ROWS[case[0][0]].slot in CURVED and case[1] != "over travel"]
BOUNDED = BENT + [case for case in SINGLE if ROWS[case[0][0]].slot == "stop"]


@pytest.mark.parametrize(("names", "ratio"), BOUNDED, ids=label)
def test_the_linear_regime_ends_where_a_part_leaves_its_line(names, ratio):
    """It ends at the sample where a stop's stroke is used up, or a curve is a tenth of its largest force off its line."""
    (on, *_), (physics, *_) = driven("quarter_car", names, ratio)
    (law,), row, run = laws("quarter_car", names, ratio), ROWS[names[0]], judged(on, physics)
    r, D = law.travel(run.physics["suspension_deflection"])
    v, ends = r * (run.physics["sprung_velocity"] - run.physics["unsprung_velocity"]), run.agreement.end_times
    if row.slot == "stop":
        off = (max(x for x in row.d if x < 0) >= D) | (min(x for x in row.d if x > 0) <= D)
        assert ends["bump stop"] == on.time[off.argmax()] > 0
        return
    over, way = (D, [[1.0], [0.0]]) if row.slot == "spring" else (v, [[0.0], [1.0]])
    line = slope(lambda far: row.law(*np.array(way) * far, 0))
    off = np.abs(row.law(D, v, 0) - line * over) / np.abs(tomllib.loads(f"x = {row.file(1.0, 1.0)}")["x"]["force"]).max()
    assert departures(on.vehicle, run.physics) == pytest.approx({f"suspension_{CURVED[row.slot]}": off.max()}, rel=1e-6)
    assert ends["curve"] == on.time[(off >= LEAVES).argmax()] > 0


SLOTS = {slot: [name for name, row in ROWS.items() if row.slot == slot] for slot in ("stop", "spring", "damper", *ELEMENTS)}
MOST = max(map(len, SLOTS.values()))
SHARES = {slot: len(some) / MOST if slot == "damper" else 1 for slot, some in SLOTS.items()}  # the first damper fits all others
WHOLE = [tuple(some[min(int(i * SHARES[slot]), len(some) - 1)] for slot, some in SLOTS.items()) for i in range(MOST)]


@pytest.mark.slow
def test_a_log_proves_every_part(tmp_path, capsys):
    """Suspensions with a part in each slot, at a ratio over travel, agree, and their logs prove them without their files."""
    files = [tmp_path / f"{i}.toml" for i in range(MOST)]
    assert {name for names in WHOLE for name in names} == {*ROWS}
    for file, names in zip(files, WHOLE, strict=True):
        file.write_text(car("quarter_car", names, "over travel").text, encoding="utf-8")
    given = [part for file in files for part in ("--vehicle", str(file))]
    assert (
        bump([*given, "--controller", "held", "--duration", "0.05", "--timestep", "2e-3", "--logs", str(tmp_path), "--json"]) == 0
    )
    for file in files:
        file.unlink()
    capsys.readouterr()
    assert inspect([str(log) for log in tmp_path.rglob("*.mcap")]) == 0
    assert "6 of 6 logs still prove what they claim" in capsys.readouterr().out


@some_runs
def test_runs_side_by_side_are_those_alone(kind, names, ratio):
    """Vehicles that differ in tables, and in parameters, run in one batch as each does alone, to the last bit."""
    inputs, together = driven(kind, names, ratio, whole=True)
    for on, one in zip(inputs[2:], together[2:], strict=True):
        alone = simulate([held(kind)], [RoadInput(on.vehicle, ROADS[kind], H * np.arange(40))]).response.values[0]
        assert np.array_equal(one.response.values[:39, : alone.shape[-1]], alone[:39])
    assert not np.array_equal(together[0].response.values, together[2].response.values)


def test_the_poles_of_a_quarter_car_with_a_maxwell_element():
    """Poles are the roots of the determinant of the equations of motion, with the complex stiffness written out here."""
    p, k, c = read_vehicle("quarter_car").parameters, 6e4, 1500.0
    m_s, m_u, k_s, c_s, k_t = (
        p[name] for name in ("sprung_mass", "unsprung_mass", "suspension_stiffness", "suspension_damping", "tyre_stiffness")
    )
    text = f'{read_vehicle("quarter_car").text}\n[parts.mount]\nkind = "maxwell"\nstiffness = {k}\ndamping = {c}\n'
    s = np.polynomial.Polynomial([0.0, 1.0])
    strut = (k_s + c_s * s) * (k + c * s) + k * c * s  # times k + c s, as all else
    determinant = (m_s * m_u * s**4 + k_t * m_s * s**2) * (k + c * s) + strut * ((m_s + m_u) * s**2 + k_t)
    poles = np.linalg.eigvals(parse_vehicle(text).linear_model.A)
    for root in determinant.roots():
        assert np.abs(poles - root).min() < 1e-9 * np.abs(root)
    assert len(poles) == 5
    assert parse_vehicle(text).linear_model.states[-1] == "mount_extension", "which state feedback measures"


@pytest.mark.slow
def test_own_states_are_measured():
    """A law that names the state of an element measures it in MuJoCo; the run agrees."""
    text = read_vehicle("quarter_car").text + '\n[parts.mount]\nkind = "maxwell"\nstiffness = 6e4\ndamping = 1500.0\n'
    text += '[controllers.mount]\nmeasured = ["sprung_velocity", "mount_extension"]\ngain = [[-1000.0, 20000.0]]\n'
    vehicle = parse_vehicle(text)
    (run,) = run_controllers(vehicle, [driver_of(vehicle, "mount")], Bump(), sample_times(vehicle, 0.3, 2e-3))
    assert run.passed
    assert "mount_extension" in run.agreement.signals


def element(section: str) -> Any:
    """The element of a section of `[parts]` in a vehicle file."""
    return parse_vehicle(f"{read_vehicle('quarter_car').text}\n[parts.own]\n{section}\n").elements[0].part


# at 0.88 V, of labcontrol-data/mr-damper, data_simulation_4.4_MRdamper.mat
MR = 'kind = "dahl"\nforce = 209.66748768\ndamping = 1314.08146\nrho = 20430.80277\n'


def test_dahl_friction_is_that_of_its_owners_simulink_model():
    """By Euler's steps and backward differences, as in the owner's run, the force is that of the run, to the printed digits."""
    part, h = element(MR), 1e-3
    d = 11.75e-3 * np.sin(5.32473565 * h * np.arange(3000) + 1.1)
    v, w, force = np.diff(d, prepend=d[0]) / h, np.zeros(1), []
    for one in v:
        force.append(part.pull(0.0, one, w))
        w = w + h * part.rate(0.0, one, w)
    published = {
        2: 157.638774,
        5: 237.871197,
        20: 239.165133,
        300: -283.811714,
        1300: -209.514111,
        2459: 90.737577,
        2990: -230.840423,
    }
    np.testing.assert_allclose([force[k] for k in published], [*published.values()], rtol=1e-6)


def test_a_measured_loop():
    """Dahl friction with its owner's values fits a measured loop of a magnetorheological damper with 89 %, peaks within 3 %."""
    d, v, force = np.loadtxt(Path(__file__).with_name("mr_damper_loop.csv"), delimiter=",", skiprows=3).T
    along, t = CubicHermiteSpline(0.01 * np.arange(len(d)), d / 1e3, v / 1e3), 4e-4 * np.arange(25 * len(d) - 23)
    part, d, v = element(MR), along(t), along(t, 1)
    apart = (force - part.pull(d, v, followed(part, d, v, 4e-4))[:-1:25])[60:]
    assert 1 - np.linalg.norm(apart) / np.linalg.norm(force[60:] - force[60:].mean()) == pytest.approx(0.893, abs=2e-3)
    assert np.ptp(force[60:] - apart) == pytest.approx(np.ptp(force[60:]), rel=0.03)


def test_the_published_magnetorheological_damper():
    """The modified model has the force of the equations of Spencer and others (1997), written in their units: N, cm, s, V."""
    u, times = 1.5, np.linspace(0.0, 0.04, 4001)
    alpha, c0, c1, k0, k1 = 140 + 695 * u, 21.0 + 3.5 * u, 283 + 2.95 * u, 46.9, 5.0
    section = f"""kind = "modified_bouc_wen"\nalpha = 14e3\nalpha_per_volt = 69.5e3\nc0 = 2100.0\nc0_per_volt = 350.0
c1 = 28300.0\nc1_per_volt = 295.0\nk0 = 4690.0\nk1 = 500.0\ngamma = 3.63e6\nbeta = 3.63e6\nA = 301.0\nvoltage = {u}"""

    def path(t):
        return 0.01 * (1 - np.cos(20 * t)) - 2e-3 * np.sin(50 * t) ** 2, 0.2 * np.sin(20 * t) - 0.1 * np.sin(100 * t)

    def speed(t, y, z):
        x, rate = (100 * one for one in path(t))
        return (alpha * z + c0 * rate + k0 * (x - y)) / (c0 + c1)

    def rates(t, state):
        y, z = state
        slip = 100 * path(t)[1] - speed(t, y, z)
        return [speed(t, y, z), -363 * abs(slip) * z * abs(z) - 363 * slip * abs(z) ** 2 + 301 * slip]

    y, z = solve_ivp(rates, (0.0, 0.04), [0.0, 0.0], "Radau", times, rtol=1e-9, atol=1e-11).y
    force = c1 * speed(times, y, z) + k1 * 100 * path(times)[0]
    part = element(section)
    found = part.pull(*path(times), followed(part, *path(times), times[1]))
    assert np.abs(found - force).max() < 1e-6 * np.abs(force).max()


def test_the_energy_of_a_loop_of_bouc_and_wen():
    """A loop with n = 1 and beta = gamma loses 2 F (2 X - 2.5 L), L = 1 / (2 beta): its branches are a line and an exponential.

    The returned energy of each branch is its integral, also where beta and gamma differ and n is no integer.
    """
    part, X, L = element('kind = "bouc_wen"\nalpha = 2e4\nbeta = 500.0\ngamma = 500.0'), 0.02, 1e-3
    t = np.linspace(0.0, 4 * np.pi, 8001)
    d, v = X * np.sin(t), X * np.cos(t)
    lost = cumulative_simpson(part.pull(d, v, followed(part, d, v, t[1])) * v, x=t, initial=0.0)
    assert lost[-1] - lost[4000] == pytest.approx(2 * 2e4 * L * (2 * X - 2.5 * L), rel=1e-6)
    part = element('kind = "bouc_wen"\nalpha = 2e4\nA = 4.0\nbeta = 6e3\ngamma = 9e3\nexponent = 1.7')
    x = np.linspace(0.0, 0.99 * part.z_max, 4001)
    energy = cumulative_simpson(2e4 * x / (4 - 3e3 * x**1.7), x=x, initial=0.0)
    np.testing.assert_allclose(part.stored(0 * x, -x[:, None]), energy, rtol=1e-6, atol=1e-9)


def test_the_state_of_a_friction_is_no_error_of_the_line():
    """The linearisation, which leaves a friction out, is judged by the vehicle's signals, not by the state of the friction."""
    (on, *_), (physics, *_) = driven("quarter_car", ("Dahl",), "at the wheel")
    run = judged(on, physics)
    assert "element_friction" in run.agreement.signals
    assert run.line_errors.keys() == {*run.agreement.signals} - {"element_friction"}


def test_a_state_that_is_too_fast_for_the_timestep():
    """A stiff mount or friction, whose state is faster than RK4 bears, is refused in a line with its section, before the run."""
    with pytest.raises(
        InputError, match=r"because a state of \[parts.own\] changes at a rate of 4.086e\+04 1/s at 2 m/s; give a smaller"
    ):
        sample_times(parse_vehicle(f"{read_vehicle('quarter_car').text}\n[parts.own]\n{MR}"), 1.0, 1e-3)
    text = read_vehicle("quarter_car").text + '\n[parts.mount]\nkind = "maxwell"\nstiffness = 1e6\ndamping = 100.0\n'
    with pytest.raises(InputError, match=r"because a state of \[parts.mount\] changes at a rate of 1e\+04 1/s; give a smaller"):
        sample_times(parse_vehicle(text), 1.0, 1e-3)


def test_the_name_of_a_state_is_free():
    """An element whose state would have the name of another signal is refused."""
    text = read_vehicle("quarter_car").text + '\n[parts.suspension]\nkind = "bouc_wen"\nalpha = 1e4\n'
    assert parse_vehicle(text + "beta = 1.0\ngamma = 1.0\n").kind.of_parts[0].name == "suspension_hysteresis"
    kind = read_vehicle("quarter_car").kind
    with pytest.raises(InputError, match=re.escape("would be called 'suspension_deflection', which is already the name")):
        kind.with_states((kind.signal("suspension_deflection"),))


@dataclasses.dataclass(frozen=True)
class Bent(Part):
    """A damper with one rate in bump and another in rebound, a friction, or a cubic growth, with the line of `damping`."""

    bump: float = 0.0
    rebound: float = 0.0
    friction: float = 0.0
    cubic: float = 0.0
    damping: float = 0.0

    def pull(self, d, v, z=None, u=0.0):
        return v * np.where(v > 0, self.rebound, self.bump) + self.friction * np.tanh(v / 0.01) + self.cubic * v**3

    @property
    def line(self) -> Line:  # pyright: ignore[reportIncompatibleVariableOverride]
        return Line(damping=self.damping)


@dataclasses.dataclass(frozen=True)
class Ruled(Bent):
    """The damper with two rates, of which that of rebound is the larger one."""

    def __post_init__(self):
        if self.bump > self.rebound:
            raise InputError("bump is larger than rebound")


def test_a_rule_between_numbers_is_for_each_part():
    """Parts whose rule between numbers reads single numbers are stacked, as in a campaign; each force is that of its part."""
    rows = [Ruled(500.0, 1500.0), Ruled(400.0, 1600.0)]
    v = np.array([[0.3], [-0.2]])
    assert Stack([[one] for one in rows]).beyond(0 * v, v).tolist() == [[450.0], [-80.0]]
    with pytest.raises(InputError):
        Ruled(2.0, 1.0)


def test_a_kink_at_rest_is_found():
    """A part is kinked at rest if its line is not the limit of small motions, also by a ratio over travel and a load."""
    assert Bent(500.0, 1500.0, damping=1000.0).kinked_at_rest
    assert Bent(500.0, 500.0, friction=80.0, damping=500.0).kinked_at_rest, "a line without the friction"
    assert not Bent(500.0, 500.0, cubic=3e3, damping=500.0).kinked_at_rest
    straight_one, bends, even = Straight(Line(2e4)), [0.8, 0.7, 0.65], [0.8, 0.7, 0.6]
    for ratio, load, kinked in ((bends, 4e3, True), (bends, 0.0, False), (even, 4e3, False)):
        table = RatioTable(np.array([-0.1, 0.0, 0.1]), np.array(ratio))
        assert AtRatio(straight_one, table, load=load).kinked_at_rest == kinked


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ('[parts.x]\nkind = "hydraulic_stop"\natt = "front"', "[parts.x] unknown key 'att'; known keys: at"),
        (
            '[parts.x]\nkind = "hydraulic_stop"\nat = "fornt"',
            "at = 'fornt' is not a suspension or an axle of this vehicle; it has",
        ),
        (
            '[parts.sprung_mass]\nkind = "hydraulic_stop"',
            "[parts.sprung_mass] has the same name as a parameter of the vehicle; give",
        ),
        ('[parts.x]\nkind = "hydraulic"', "[parts.x] kind = 'hydraulic' is unknown; give one of "),
        (
            '[parts.x]\nkind = "bouc_wen"\nalpha = 1e4\nbeta = 3.0\ngamma = -3.0',
            "[parts.x] beta + gamma = 0 is not allowed, because the force would be unbounded; give a sum above 0",
        ),
        ("[parts]\nx = 3", "[parts] x is not a section; write [parts.NAME] with kind"),
    ],
)
def test_an_element_that_is_none(section, said):
    """A wrong section of `[parts]` is refused in a line with section and key, what was found and what is allowed."""
    text = f"{read_vehicle('half_car').text}\n{section}\n" + "stroke = 0.1\nstiffness = 1e4\ndamping = 1.0\n" * (
        "[parts.x]" in section and "bouc_wen" not in section
    )
    with pytest.raises(InputError, match=re.escape(said)):
        parse_vehicle(text)


@pytest.mark.parametrize("command", ["sim.bump", pytest.param("sim.sweep", marks=pytest.mark.slow), "synth"])
def test_a_car_that_stands_on_gas(command, tmp_path, monkeypatch, capsys):
    """With nearly no steel spring, no unit is doubted; responses agree over a road that is low enough for the gas's own curve."""
    monkeypatch.setattr(worst_case_gain, "DURATION", 2.0)  # of runs whose gains stay below the norm
    car = re.sub(r"suspension_stiffness = \S+", "suspension_stiffness = 100.0", read_vehicle("quarter_car").text)
    (tmp_path / "car.toml").write_text(f'{car}\n[parts.air]\nkind = "gas_spring"\n{ROWS["gas spring"].file(1.0, 1.0)}\n')
    less = {"sim.bump": ["--no-logs", "--duration", "0.5"], "sim.sweep": ["--timestep", "0.008"]}.get(command, [])
    assert main_of(command)(["--vehicle", str(tmp_path / "car.toml"), "--controller", "passive", *less]) == 0
    out, doubts = capsys.readouterr()
    assert "check that" not in doubts
    assert ("Over a lower road" in out) == (command == "sim.sweep")


def test_why_an_expected_ride_is_missing(tmp_path, capsys):
    """An element with a state has no expected ride, and `synth` names the element."""
    text = f'{read_vehicle("quarter_car").text}\n[parts.own]\nkind = "bouc_wen"\nalpha = 9000\nbeta = 900\ngamma = 300\n'
    (tmp_path / "car.toml").write_text(text)
    assert main_of("synth")(["--vehicle", str(tmp_path / "car.toml"), "--controller", "II_printed"]) == 0
    assert "unlike own of [parts]" in prose(capsys.readouterr().out)
