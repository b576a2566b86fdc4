"""Sketches of vehicles: every type is drawn, with its parts, its parameters, and its limits and computer in words."""

from pathlib import Path
from xml.etree import ElementTree

import pytest

from models.document.sketch import sketch_svg
from models.vehicle.sketch import vehicle_sketch
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from tests.support.pages import ROOT, hopper

SVG = "{http://www.w3.org/2000/svg}"
HARDWARE = """
[limits]
suspension_stroke = 0.08
stop_stiffness = 1e5
[implementation]
sample_period = 0.005
delay = 1
noise = { sprung_velocity = 0.01 }
"""


def drawn(vehicle) -> tuple[str, list[str], int]:
    """The text alternative of a vehicle's sketch, the letters in it, and the number of wheels on the road."""
    root = ElementTree.fromstring(sketch_svg(vehicle_sketch(vehicle), alone=True))
    letters = ["".join(one.itertext()).replace("\u200b", "") for one in root.iter(f"{SVG}text")]
    return root.findtext(f"{SVG}desc") or "", letters, len(list(root.iter(f"{SVG}circle")))


@pytest.mark.parametrize(
    ("name", "letters", "wheels"),
    [
        ("quarter_car", {"ms": 1, "mu": 1, "ks": 1, "cs": 1, "kt": 1, "u": 1, "zs": 1, "zu": 1, "zr": 1}, 1),
        ("half_car", {"ms, Iy": 1, "mu": 2, "ks": 2, "cs": 2, "kt": 2, "u": 2, "front": 1, "rear": 1, "l": 2}, 2),
        ("full_car", {"ms, Iy": 1, "ms, Ix": 1, "mu": 4, "ks": 4, "kt": 4, "u": 4, "left": 1, "right": 1, "b": 1}, 4),
        ("quarter_car_semi_active", {"cs": 1, "ct": 1, "u": 1}, 1),
        ("models/gallery/one_mass/car.toml", {"m": 1, "k": 1, "u": 1, "zu": 0, "kt": 0}, 1),
        ("models/gallery/simulink_half_car/car.toml", {"m": 1, "k": 2, "c": 2, "u": 2, "zu": 0}, 2),
        ("hopper", {"m": 1, "k": 1, "u": 0, "zu": 0}, 1),
    ],
)
def test_every_type_of_vehicle_is_drawn(name, letters, wheels, tmp_path):
    """A sketch has each part with its symbol as often as the vehicle has it, and every parameter in words."""
    path = hopper(tmp_path) if name == "hopper" else ROOT / name if "/" in name else Path(name)
    vehicle = read_vehicle(path)
    text, there, places = drawn(vehicle)
    assert {symbol: there.count(symbol) for symbol in letters} == letters
    assert places == wheels
    units = {one.name: one.unit.replace(" ", "·").replace("m2", "m²") for one in vehicle.kind.parameters}
    for parameter, value in vehicle.parameters.items():
        assert f"{value:g} {units[parameter]}" in text or not value


def test_force_elements_are_drawn():
    """An element of `[parts]` is a box with its name on each of its suspensions, and its numbers are in words."""
    mount = '[parts.top_mount]\nkind = "maxwell"\nstiffness = "150 N/mm"\ndamping = 1500\nat = "{}"\n'
    inerter = '[parts.dual]\nkind = "inerter"\ninertance = 25\n'
    for name, place, where in (("half_car_roll", "left", "left"), ("full_car", "rear", "rear left, rear right")):
        text, letters, _ = drawn(parse_vehicle(f"{read_vehicle(name).text}\n{mount.format(place)}{inerter}"))
        assert f"top mount: maxwell, stiffness 150000 N/m, damping 1500 N·s/m, {where};" in text
        assert "dual: inerter, inertance 25 kg;" in text
        assert (letters.count("top_mount"), letters.count("dual")) == ((1, 2) if name == "half_car_roll" else (3, 4))


def test_strokes_sensors_and_computer_are_drawn():
    """Bump stops are drawn and in words; so are sample period, delay and noise, in SI and in milliseconds."""
    plain = read_vehicle("quarter_car")
    text, letters, _ = drawn(parse_vehicle(plain.text + HARDWARE))
    assert "strokes and limits: bump stops at ±0.08 m" in text
    assert "sensors y: suspension deflection, sprung velocity" in text
    assert "computer: a sample every 5 ms, forces that act 1 sample late, noise of 0.01 rms on sprung velocity" in text
    assert {"computer", "every 5 ms", "5 ms late", "noise"} <= {*letters}
    assert "ideal" in drawn(plain)[1]
    stop = "l-2 12h-6z"
    assert [stop in sketch_svg(vehicle_sketch(one)) for one in (plain, parse_vehicle(plain.text + HARDWARE))] == [False, True]
