"""Springs, dampers and stops in another unit, or of the other sign, are asked about; usual ones are not."""

import re

import numpy as np
import pytest

from models.vehicle.vehicle import parse_vehicle, read_vehicle, shipped_vehicles
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
    "front of an SUV, as in test_curves": (
        [-1.056, -0.528, -0.264, -0.132, -0.051, 0, 0.051, 0.132, 0.264, 0.528, 1.056],
        [-971, -744, -636, -557, -286, 0, 227, 902, 1581, 2178, 4054], 550, 28e3),
    "rear of an SUV, as in test_curves": (
        [-0.832, -0.416, -0.208, -0.104, -0.04, 0, 0.04, 0.104, 0.208, 0.416, 0.832],
        [-1751, -1224, -1020, -895, -415, 0, 276, 658, 961, 1507, 2652], 500, 30e3),
    "heavy truck": ([-0.5, -0.1, 0, 0.1, 0.5], [-1800, -800, 0, 3000, 12000], 2500, 250e3),
    "extrapolated, firmer in compression": ([-5, -0.3, -0.1, 0, 0.1, 0.3, 5], [-9e4, -1e4, -4e3, 0, 3e3, 7e3, 6e4], 1400, 12e4),
    "racing car": ([-0.25, -0.1, -0.05, 0, 0.05, 0.1, 0.25], [-300, -180, -130, 0, 150, 220, 380], 60, 22e3),
}  # fmt: skip
SPRINGS = {"rear of an SUV, as in test_spring_tables": ([-0.0745, 0, 0.0905], [1898, 4756, 9323], 484.8)}  # over compression
STOPS = {  # compression [m], force [N], sprung mass [kg]
    "rubber of an SUV": ([0.017, 0.027, 0.037, 0.067, 0.077, 0.0905], [0, 250, 550, 2100, 4700, 30e3], 484.8),
    "steep in rebound": ([-0.07, -0.068, 0], [-2e4, 0, 0], 550),
    "rubber of a truck": ([0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.11], [0, 1000, 2400, 4400, 7600, 13e3, 13e4], 1400),
    "steel": ([0.05, 0.06, 0.062], [0, 0, 8000], 340),
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


@pytest.mark.parametrize(
    ("make", "table"), [(make, table) for make, _, table in CASES], ids=[f"{make.__name__}-{name}" for make, name, _ in CASES]
)
def test_a_table_in_another_unit_is_asked_about(make, table):
    """A usual table has no remark. In a unit that is 30 times another it has one about that unit, or is refused."""
    x, force, *car = table
    assert make(x, force, *car).warnings == []
    for unit, (along, across) in UNITS.items():
        if unit == "in as m" and max(x) > 1.2:
            continue  # refused as beyond 50 m/s
        changed = make((along * np.array(x)).tolist(), (across * np.array(force)).tolist(), *car)
        remarks = [one for one in changed.warnings if "preload" not in one]
        assert len(remarks) == 1 or make is with_spring, unit  # two of a natural frequency that is too high
        assert any(re.search(r"(in|and) (N|m|N/m|m/s)$", one.rstrip("?")) for one in remarks), remarks


def test_a_damper_of_the_other_sign_is_asked_about():
    """A damper that resists compression far more than extension is asked about with both forces at the largest common speed."""
    v, force, *car = DAMPERS["heavy truck"]
    (question,) = with_damper([-x for x in v[::-1]], [-f for f in force[::-1]], *car).warnings
    assert question.startswith("suspension_damping: the force at 0.5 m/s is 12000 N in compression and 1800 N in extension")
    assert with_curves(suspension_damping=DIGRESSIVE).warnings == []


def test_both_curves_of_a_semi_active_damper_count():
    """The firm setting of an adjustable damper may not be far too soft, nor the soft one far too firm."""
    assert parse_vehicle(QUARTER + PAIR).warnings == []
    bent = "{{ velocity = [-1, -0.5, 0, 0.5, 1], force = [-{0}, -{1}, 0, {1}, {0}] }}"
    for soft, nominal, hard, ratio in ((20, 25, 40, "0.0093"), (6e4, 8e4, 9e4, "11.6696")):
        pair = "".join(f"{name} = {bent.format(c, 0.6 * c)}\n" for name, c in (("c_min", soft), ("c_max", hard)))
        text = QUARTER.replace("suspension_damping = 1000.0", f"suspension_damping = {nominal}")
        question = parse_vehicle(f'{text}[actuators]\nkind = "damper"\n{pair}').warnings[-1]
        assert question.startswith(f"[actuators]: the damping ratio is about {ratio}; check that")

    assert not any(read_vehicle(name).warnings for name in shipped_vehicles())
