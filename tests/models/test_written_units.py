"""Numbers with units: in files, options, roads and loads, each converted to SI or refused by its dimension."""

import json
import math
import re
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy import constants

import models
import sim
from models import parse_vehicle
from models.common.errors import InputError
from models.common.units import quantity
from sim.campaign.file import parse_campaign
from sim.studies.validity.grid import read_axes
from tests.support.commands import main_of, refused

run: Any = sim.run  # with texts for numbers
KNOWN = [  # from the constants of scipy
    ("250 mV", "V", 0.25), ("1.83 N/cm/V", "N/m/V", 183.0), ("5 mA", "A", 5e-3),
    ("5 bar", "Pa", 5e5), ("0.5 MPa", "Pa", 5e5), ("2 psi", "Pa", 2 * constants.psi), ("1.2 litres", "m3", 1.2 * constants.liter),
    ("90 km/h", "m/s", 90 * constants.kmh), ("60mph", "m/s", 60 * constants.mph), ("100 kph", "m/s", 100 * constants.kmh),
    ("70 mm", "m", 70 * constants.milli), ("3 in", "m", 3 * constants.inch), ("2 ft", "m", 2 * constants.foot),
    ("8 Hz", "rad/s", 16 * math.pi), ("8 Hz", "Hz", 8), ("50 rad/s", "Hz", 50 / (2 * math.pi)), ("60 rpm", "Hz", 1),
    ("22 N/mm", "N/m", 22e3), ("120 lbf/in", "N/m", 120 * constants.lbf / constants.inch), ("400 N/cm3", "N/m3", 4e8),
    ("1.5 kN s/m", "N s/m", 1500), ("1.5Ns/mm", "N s/m", 1500), ("1500 N/(m/s)", "N s/m", 1500), ("2 kN*s/m", "N s/m", 2000),
    ("1500 N-s/m", "N s/m", 1500), ("7 lbf-s/in", "N s/m", 7 * constants.lbf / constants.inch), ("9 kg.m2", "kg m2", 9),
    ("300 lb", "kg", 300 * constants.lb), ("1.2 t", "kg", 1200), ("1222 kg·m²", "kg m2", 1222), ("1 kNm", "N m", 1000),
    ("2 deg", "rad", 2 * constants.degree), ("0.5 g", "m/s2", constants.g / 2), ("5 mg", "m/s2", 5e-3 * constants.g),
    ("5 ms", "s", 5e-3), ("2 min", "s", 120), ("5ms", "ms", 5), ("10 %", "1", 0.1), ("0.252 MN/m", "N/m", 252e3),
    ("5000 us", "s", 5e-3), ("5 \u00b5s", "s", 5e-6), ("5 \u03bcm", "m", 5e-6), ("3 dm", "m", 0.3),
    ("1 kHz", "Hz", 1000), ("2 mrad", "rad", 2e-3), ("-.6e2 mm", "m", -0.06), ("7", "m", 7),
]  # fmt: skip


@pytest.mark.parametrize(("text", "unit", "value"), KNOWN)
def test_sizes_of_units(text, unit, value):
    """A number with a unit has the size that scipy's constants give it, to the rounding of the latter's products."""
    assert quantity(text, unit) == pytest.approx(value, rel=4e-16)


@pytest.mark.parametrize(("text", "unit", "said"), [
    ("380 N", "kg", "key = '380 N' has the unit 'N', but a unit of kg is expected, as in \"1.5 kg\""),
    ("3 furlong", "m", "key = '3 furlong' has the unknown unit 'furlong', but a unit of m is expected, as in \"1.5 m\""),
    ("5 m", "1", "key = '5 m' has the unit 'm', but a pure number is expected; omit unit and quotes, as in 5"),
    ("heavy", "kg", "key = 'heavy' is not a number; give a number in kg, or a number with its unit"),
    ("3 m/s/s", "m/s", "key = '3 m/s/s' has the unit 'm/s/s', but a unit of m/s is expected, as in \"1.5 m/s\""),
    ("504,5 kg", "kg", "key = '504,5 kg' has a decimal comma; write a decimal point, as in \"1.5 kg\""),
    ("200 Hz", "s", "key = '200 Hz' has the unit 'Hz', but a unit of s is expected, as in \"1.5 s\""),
    ("114 lbs/in", "N/m", "key = '114 lbs/in' has the unit 'lbs/in', but a unit of N/m is expected, as in \"114 lbf/in\""),
    ("2 kg", "g", "key = '2 kg' has the unit 'kg', but a unit of g is expected, as in \"1.5 g\""),
])  # fmt: skip
def test_wrong_units(text, unit, said):
    """An unknown unit, or one of another dimension, is refused in a line with what was found, what is expected and an example."""
    with pytest.raises(InputError, match=f"^{re.escape(said)}$"):
        quantity(text, unit, "key")


CAR = """type = "quarter_car"
[parameters]
sprung_mass = <380 kg = 380.0>
unsprung_mass = <0.042 t = 42.0>
suspension_stiffness = <22 N/mm = 22000.0>
suspension_damping = <1.5 kN s/m = 1500.0>
tyre_stiffness = <200 kN/m = 200000.0>
[performance]
sprung_acceleration = 1.0
[limits]
suspension_stroke = { bump = <70 mm = 0.07>, rebound = <8 cm = 0.08> }
stop_stiffness = [<100 N/mm = 1e5>, 0.0, <400 N/cm3 = 4e8>]
"""
PUSHED = """actuator_force = <3 kN = 3000.0>
actuator_bandwidth = <8 Hz = 50.26548245743669>
[implementation]
sample_period = <5 ms = 0.005>
delay = <7.5 ms = 1.5>
noise = { suspension_deflection = <0.5 mm = 0.0005> }
quantisation = { sprung_acceleration = <10 mg = 0.0980665> }
[controllers.a]
measured = ["suspension_deflection", "sprung_velocity"]
tolerance = { force = <10 % = 0.1> }
minimise = { band = [<4 Hz = 4.0>, <480 rpm = 8.0>] }
bounds = [
    { peak = "tyre_deflection", at_most = <12 mm = 0.012>, road = "bump", speed = <36 km/h = 10.0> },
    { decay = <0.5 Hz = 3.141592653589793> },
]
[controllers.b]
measured = ["sprung_velocity"]
loads = { heave_load = <1 kN = 1000.0> }
[controllers.c]
measured = ["suspension_deflection"]
pid = { kp = -9000.0, ki = -900.0, kd = -900.0, filter = <10 ms = 0.01> }
anti_windup = <2 Hz = 12.566370614359172>
[controllers.e]
measured = ["suspension_deflection"]
order = "full"
fastest_pole = <80 Hz = 502.6548245743669>
[payload]
mass = <0.15 t = 150.0>
"""
DAMPED = """[curves.suspension_stiffness]
deflection = [<-50 mm = -0.05>, 0.0, <50 mm = 0.05>]
force = [<-1 kN = -1000.0>, 0.0, <1.2 kN = 1200.0>]
[actuators]
kind = "damper"
c_min = <0.4 kN s/m = 400.0>
c_max = <4 kN s/m = 4000.0>
bandwidth = <8 Hz = 50.26548245743669>
[controllers.d]
semi_active = "skyhook_add"
crossover = <2 Hz = 12.566370614359172>
"""
PAIR = re.compile(r"<([^<>]*) = ([^<>]*)>")


def fields(text: str) -> str:
    """What a vehicle file says, but its text."""
    vehicle = parse_vehicle(text)
    entries = [{**vars(entry), "source": (type(entry.source), entry.source.record)} for entry in vehicle.controllers.values()]
    curves = [(curve.x.tolist(), curve.force.tolist()) for curve in vehicle.curves.values()]
    return repr((vehicle.parameters, vehicle.limits, vehicle.implementation, entries, curves, vehicle.dampers))


@pytest.mark.parametrize(("make", "written", "values"), [
    (models.Bump, {"height": "60 mm", "length": "16.4 ft", "speed": "36 km/h"}, (0.06, 4.99872, 10)),
    (partial(models.Profile, np.arange(4.0), np.zeros((4, 2))), {"speed": "90 km/h"}, (25,)),
    (partial(models.LinearLaw, *np.ones((4, 1, 1))), {"sample_period": "5 ms"}, (0.005,)),
])  # fmt: skip
def test_python(make, written, values):
    """A road, a load and a law in Python take texts with units as files do."""
    made = make(**written)
    assert [getattr(made, name) for name in written] == pytest.approx(values, rel=1e-15)
    with pytest.raises(
        InputError, match=rf"{next(iter(written))} = '3' has no unit, but only a number with a unit may be in quotes; add"
    ):
        make(**{next(iter(written)): "3"})


def test_python_functions():
    """Parameters and the numbers of public functions take units, too, and the file's line for a wrong one."""
    vehicle = models.read_vehicle("quarter_car").with_parameters(sprung_mass="0.45 t", suspension_stiffness="22 N/mm")
    assert (vehicle.parameters["sprung_mass"], vehicle.parameters["suspension_stiffness"]) == (450.0, 22e3)
    [one] = run(vehicle, "passive", models.Bump(height=0.05), duration="100 ms", timestep="5 ms")
    assert one.physics.time[[1, -1]].tolist() == [0.005, 0.1]


@pytest.mark.parametrize("text", [CAR + PUSHED, CAR.replace("suspension_stiffness = <22 N/mm = 22000.0>\n", "") + DAMPED])
def test_vehicle_file(text):
    """Every key of a vehicle file takes its number with a unit, in tables and lists too, and reads it as the number in SI."""
    assert fields(PAIR.sub(lambda pair: f'"{pair[1]}"', text)) == fields(PAIR.sub(lambda pair: pair[2], text))
    for pair in PAIR.finditer(text):
        wrong = f'{text[: pair.start()]}"3 kg2"{text[pair.end() :]}'
        with pytest.raises(
            InputError, match=r"^\[.*\] .*\w+(\[\d\])? = '3 kg2' has the unit 'kg2', but a (unit of .*|pure number) is expected"
        ):
            parse_vehicle(PAIR.sub(lambda other: other[2], wrong))


def test_options(capsys):
    """Options, roads, loads and axes take numbers with units, as what they are in SI units."""
    road = "pothole:depth=60mm:length=1.5 m + payload:mass=0.1t:rise=200 ms"
    arguments = ["--controller", "I", "--duration", "500 ms", "--no-logs", "--json"]
    written = main_of("sim.drive")([*arguments, "--road", road, "--speed", "36km/h"]), capsys.readouterr().out
    plain = "pothole:depth=0.06:length=1.5 + payload:mass=100:rise=0.2"
    assert written[0] == main_of("sim.drive")([*arguments, "--road", plain, "--speed", "10"])
    first, second = json.loads(written[1]), json.loads(capsys.readouterr().out)
    assert first["runs"] == second["runs"]
    with refused(match=r"argument --speed: '5 kg' has the unit 'kg', but a unit of m/s is expected, as in \"1.5 m/s\"; see"):
        main_of("sim.drive")([*arguments, "--speed", "5 kg"])
    with refused(match="--vary height = '20 kg' has the unit 'kg', but a unit of m is expected"):
        read_axes(["height:20 kg:0.3:5"])
    assert read_axes(["height:20mm:0.3:5", "speed:36 km/h:30:3"]) == read_axes(["height:0.02:0.3:5", "speed:10:30:3"])


def test_campaign(tmp_path):
    """A campaign file takes units for roads, speeds, times and samples; a road may be a table, too."""
    text = 'vehicles = ["quarter_car"]\ncontrollers = ["I"]\nroads = ["bump:height=50 mm"]\n'
    text += 'speeds = ["36 km/h", 20.0]\nduration = "2000 ms"\n[samples]\ncount = 2\n'
    text += '[samples.parameters]\nsprung_mass = { uniform = ["0.4 t", 600.0] }\n'
    campaign = parse_campaign(text, tmp_path / "campaign.toml")
    table = text.replace('"bump:height=50 mm"', '{ type = "bump", height = "50 mm" }')
    for one in (campaign, parse_campaign(table, tmp_path / "campaign.toml")):
        assert one.roads[0].road == models.Bump(height=0.05)
    assert campaign.speeds == (10.0, 20.0)
    assert campaign.duration == 2.0
    assert all(400 <= sample["sprung_mass"] <= 600 for sample in campaign.samples["quarter_car"])
