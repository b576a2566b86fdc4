"""Springs, dampers and stops in another unit, or of the other sign, are asked about; public ones of real cars are not."""

import re

import numpy as np
import pytest

from models.vehicle.vehicle import parse_vehicle, read_vehicle, shipped
from tests.models.test_measured_dampers import PAIR
from tests.models.test_semi_active_dampers import QUARTER
from tests.support.curved import DIGRESSIVE, with_curves

CAR = """type = "quarter_car"
[parameters]
sprung_mass = {}
unsprung_mass = 50.0
{}tyre_stiffness = 250e3
[performance]
sprung_acceleration = 1.0
"""
DAMPERS = {  # velocity in extension [m/s], force [N], sprung mass [kg] and spring rate [N/m]
    "front of an SUV, DYNA4": (
        [-1.056, -0.528, -0.264, -0.132, -0.051, 0, 0.051, 0.132, 0.264, 0.528, 1.056],
        [-971, -744, -636, -557, -286, 0, 227, 902, 1581, 2178, 4054], 550, 28e3),
    "rear of an SUV, DYNA4": (
        [-0.832, -0.416, -0.208, -0.104, -0.04, 0, 0.04, 0.104, 0.208, 0.416, 0.832],
        [-1751, -1224, -1020, -895, -415, 0, 276, 658, 961, 1507, 2652], 500, 30e3),
    "CarSim": (
        [-1.16, -0.76, -0.39, -0.2, -0.09, -0.02, 0.02, 0.09, 0.21, 0.39, 0.72, 1.41],
        [-2560, -1796, -1100, -784, -596, -228, 228, 1008, 1792, 2324, 3436, 5008], 450, 27e3),
    "military truck, Chrono": (
        [-5, -0.33, -0.22, -0.13, -0.05, -0.02, 0, 0.02, 0.05, 0.13, 0.22, 0.33, 5],
        [-93494, -10335, -8376, -5789, -2672, -654, 0, 652, 1649, 2975, 4718, 7496, 62719], 1400, 120e3),
    "HMMWV, Chrono": ([-0.6667, -0.333, 0, 0.333, 0.6667], [-8347, -4173, 0, 7486, 14973], 550, 83e3),
    "HMMWV near its ends, Chrono": ([-0.6667, -0.333, 0, 0.333, 0.6667], [-3931, -1965, 0, 20022, 40045], 550, 83e3),
}  # fmt: skip
SPRINGS = {"rear of an SUV, DYNA4": ([-0.0745, 0, 0.0905], [1898, 4756, 9323], 484.8)}  # over compression, and its mass
STOPS = {  # compression [m], force [N], sprung mass [kg]
    "bump, DYNA4": ([0.0243, 0.0298, 0.0398, 0.0498, 0.0578, 0.0646], [0, 250, 800, 2200, 8500, 35e3], 550),
    "rebound, DYNA4": ([-0.0697, -0.0681, 0], [-25e3, 0, 0], 550),
    "both, Chrono": ([0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.11], [0, 1000, 2500, 4500, 7500, 12500, 125e3], 1400),
    "bump, TruckSim": ([0.05, 0.06, 0.061], [0, 0, 7000], 340),
}
UNITS = {"kN as N": (1, 1e-3), "N as kN": (1, 1e3), "m as mm": (1e-3, 1), "in as m": (39.37, 1)}


def with_damper(v, force, mass, rate):
    """A corner with a damper's table."""
    text = CAR.format(mass, f"suspension_stiffness = {rate}\n")
    return parse_vehicle(f"{text}[curves]\nsuspension_damping = {{ velocity = {list(v)}, force = {list(force)} }}")


def with_spring(x, force, mass):
    """A corner with a spring's table."""
    text = CAR.format(mass, "suspension_damping = 1500.0\n")
    return parse_vehicle(f"{text}[curves]\nsuspension_stiffness = {{ compression = {list(x)}, force = {list(force)} }}")


def with_stop(x, force, mass):
    """A corner with a stop's table."""
    text = CAR.format(mass, "suspension_stiffness = 25e3\nsuspension_damping = 1500.0\n")
    return parse_vehicle(f"{text}[limits]\nstop = {{ compression = {list(x)}, force = {list(force)} }}")


KINDS = ((with_damper, DAMPERS), (with_spring, SPRINGS), (with_stop, STOPS))
CASES = [(make, *table) for make, tables in KINDS for table in tables.items()]


@pytest.mark.parametrize(("make", "name", "table"), CASES, ids=[f"{make.__name__}-{name}" for make, name, _ in CASES])
def test_a_table_in_another_unit_is_asked_about(make, name, table):
    """A public table has no remark. In a unit that is 30 times another it has one about that unit, or is refused."""
    x, force, *car = table
    assert make(x, force, *car).doubts == []
    for unit, (along, across) in UNITS.items():
        if unit == "in as m" and (max(x) > 1.2 or name.endswith("ends, Chrono")):
            continue  # refused as beyond 50 m/s; as firm as 40 kN are, a fortieth of them is usual
        changed = make((along * np.array(x)).tolist(), (across * np.array(force)).tolist(), *car)
        remarks = [one for one in changed.doubts if "preload" not in one]
        assert len(remarks) == 1 or make is with_spring, unit  # two of a natural frequency that is too high
        assert any(re.search(r"(in|and) (N|m|N/m|m/s)$", one.rstrip("?")) for one in remarks), remarks


def test_a_damper_of_the_other_sign_is_asked_about():
    """A damper that resists compression far more than extension is asked about with both forces at the largest common speed."""
    v, force, *car = DAMPERS["CarSim"]
    (question,) = with_damper([-x for x in v[::-1]], [-f for f in force[::-1]], *car).doubts
    assert question.startswith("suspension_damping: the force at 1.16 m/s is 4438 N in compression and 2560 N in extension")
    assert with_curves(suspension_damping=DIGRESSIVE).doubts == []


def test_both_curves_of_a_semi_active_damper_count():
    """The firm setting of an adjustable damper may not be far too soft, nor the soft one far too firm."""
    assert parse_vehicle(QUARTER + PAIR).doubts == []
    bent = "{{ velocity = [-1, -0.5, 0, 0.5, 1], force = [-{0}, -{1}, 0, {1}, {0}] }}"
    for soft, nominal, hard, ratio in ((20, 25, 40, "0.0093"), (6e4, 8e4, 9e4, "11.6696")):
        pair = "".join(f"{name} = {bent.format(c, 0.6 * c)}\n" for name, c in (("c_min", soft), ("c_max", hard)))
        text = QUARTER.replace("suspension_damping = 1000.0", f"suspension_damping = {nominal}")
        question = parse_vehicle(f'{text}[actuators]\nkind = "damper"\n{pair}').doubts[-1]
        assert question.startswith(f"[actuators]: the damping ratio is about {ratio}; check that")

    assert not any(read_vehicle(name).doubts for name in shipped())
