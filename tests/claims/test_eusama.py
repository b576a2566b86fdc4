"""EUSAMA's minimum load: in closed form, on the plate that MuJoCo moves, and as workshops measure it; disputed, and said so."""

import dataclasses
import math

import numpy as np
import pytest

from models.roads.rig import Rig
from models.roads.road import under_wheels
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.runs.run import run_controllers, sample_times
from sim.studies.frequency import worst_case_gain
from sim.studies.frequency.eusama import DISPUTED_LIMIT, RECORD, Plate, load_failures, minimum_loads
from sim.studies.frequency.report import workshop
from sim.studies.frequency.sweep import sweep
from synth.vehicle.designer import design

H = 1e-3  # s
PARAMETERS = {
    "sprung_mass": 380.0,
    "unsprung_mass": 38.0,
    "suspension_stiffness": 20e3,
    "suspension_damping": 1800.0,
    "tyre_stiffness": 180e3,
}


def car(extra: str = "", /, **changed: float) -> Vehicle:
    """A quarter-car that stays on its plate."""
    numbers = "".join(f"{name} = {value!r}\n" for name, value in {**PARAMETERS, **changed}.items())
    return parse_vehicle(
        f'type = "quarter_car"\n[parameters]\n{numbers}[performance]\nsprung_acceleration = 1.0\ncontrol_force = 1e-3\n'
        f'[controllers.I]\nmeasured = ["suspension_deflection", "sprung_velocity"]\n{extra}'
    )


def by_hand(p) -> float:
    """1 - 3 mm max |t / z_r| / t_0 of a passive quarter-car, from its transfer function."""
    s = 2j * np.pi * np.linspace(0.1, 25, 200_001)
    m_s, m_u, k, c, k_t = (p[name] for name in PARAMETERS)
    strut, body = c * s + k, m_s * s**2
    wheel = k_t / (m_u * s**2 + k_t + strut * body / (body + strut))  # z_u / z_r, the body behind its strut
    return 1 - 3e-3 * float(np.abs(wheel - 1).max()) / ((m_s + m_u) * 9.81 / k_t)


def test_a_plate_moves_one_wheel():
    """A plate moves its wheel of a full car from height zero, with the derivative as velocity; the others rest."""
    vehicle, time = read_vehicle("full_car"), np.linspace(-0.5, 2.0, 5001)
    plate = Plate(vehicle.kind.wheels[2].road_velocity, 40.0).scaled(2.0)
    heights, rates = (under_wheels(one, plate, vehicle, time) for one in (plate.displacement, plate.velocity))
    assert heights[:, 2] == pytest.approx(np.where(time > 0, 6e-3 * np.sin(40.0 * time), 0.0), abs=1e-15)
    assert not np.delete(heights, 2, axis=1).any()
    moving = time > 1e-3
    slopes = np.gradient(heights, time, axis=0)
    assert slopes[moving][1:-1] == pytest.approx(rates[moving][1:-1], abs=2e-5)  # (40 * 5e-4)^2 / 6 of 0.24 m/s


@pytest.mark.attack
def test_transfer_function():
    """The minimum load of a passive quarter-car is that of its transfer function, to the hold of the road over a step."""
    vehicle = car()
    ((load,),) = minimum_loads(vehicle, [design(vehicle, "passive")], H)
    assert load.ratio == pytest.approx(by_hand(vehicle.parameters), abs=3e-4)  # (omega h)^2 / 24 of 0.5, at 12 Hz
    ((finer,),) = minimum_loads(vehicle, [design(vehicle, "passive")], H / 4)
    assert finer.ratio == pytest.approx(by_hand(vehicle.parameters), abs=3e-5)  # a sixteenth
    assert 0.3 < load.ratio < 0.8
    assert 8 < load.omega / (2 * math.pi) < 16  # wheel hop


def on_rig(vehicle, end: float, step: float, angle) -> float:
    """Returns the least load in MuJoCo, over the static one, on a plate driven as a rig's drive file with a phase angle."""
    t = np.arange(round(end / step)) * step
    rig = Rig(t, 3e-3 * np.sin(angle(t))[:, None], ("road",))
    (run,) = run_controllers(vehicle, [design(vehicle, "passive")], rig, sample_times(vehicle, float(t[-1]), step))
    static = vehicle.kind.static_tyre_deflection(vehicle.parameters)["tyre_deflection"]
    return max(0.0, 1 - run.physics["tyre_deflection"].max() / static)


@pytest.mark.attack
def test_as_workshops_do():
    """A plate that slows down from 25 Hz, driven in MuJoCo as a rig's drive file, leaves the load that was predicted."""
    vehicle, end = car(), 30.0
    ((load,),) = minimum_loads(vehicle, [design(vehicle, "passive")], H)
    found = on_rig(vehicle, end, H, lambda t: 2 * math.pi * (25 * t - 12 * t**2 / end))  # from 25 Hz down to 1 Hz
    assert found == pytest.approx(load.ratio, abs=5e-3)  # it passes the resonance, and is sampled 80 times a period


@pytest.mark.parametrize(
    ("extra", "controller"),
    [
        pytest.param("", "I", marks=pytest.mark.attack),
        ("[implementation]\nsample_period = 0.005\ndelay = 1\n", "I"),
        pytest.param("[limits]\nactuator_bandwidth = 60.0\n", "I", marks=pytest.mark.attack),
        ("[implementation]\nsample_period = 0.005\n", "passive"),
    ],
    ids=["every step", "a slow computer", "lag", "passive beside a slow computer"],
)
def test_as_built(extra, controller):
    """MuJoCo has the predicted load on the plate whatever the loop is: to RK4's own error, 1e-5 of the load."""
    vehicle = car(extra)
    ((load,),) = minimum_loads(vehicle, [design(vehicle, controller)], H)
    assert load.ended == ()
    assert load.measured == pytest.approx(load.driven, abs=1e-5)
    assert load_failures([load]) == []
    wrong = dataclasses.replace(load, measured=load.driven - 2 * load.allowed)
    assert "is predicted" in load_failures([wrong])[0]
    assert load_failures([dataclasses.replace(load, measured=math.nan)])


@pytest.mark.attack
@pytest.mark.parametrize("name", ["full_car"])
def test_every_wheel(name):
    """Every wheel of a car has its own plate, and left and right the same load."""
    vehicle = read_vehicle(name)
    (loads,) = minimum_loads(vehicle, [design(vehicle, "passive")], H)
    assert [one.tyre for one in loads] == [wheel.tyre_deflection for wheel in vehicle.kind.wheels]
    assert load_failures(loads) == []
    for one in loads:
        assert one.measured == pytest.approx(one.driven, abs=2e-5)  # the body turns a little
        beside = next(other for other in loads if other.tyre == one.tyre.replace("left", "right"))
        assert one.ratio == pytest.approx(beside.ratio, rel=1e-9)


def test_why_it_is_disputed():
    """Half a car on the same tyre loses a third of its grade, though its damper is as strong for its masses as before."""
    half = {name: value / 2 for name, value in PARAMETERS.items() if name != "tyre_stiffness"}
    sound, light = car(), car(**half)
    loads = [minimum_loads(one, [design(one, "passive")], H)[0][0] for one in (sound, light)]
    assert loads[0].ratio > 0.6 > 0.4 > loads[1].ratio


@pytest.mark.attack
def test_outside_the_linear_regime():
    """If a bump stop is touched MuJoCo's own least load is given, as on a plate driven like a rig, and is no failure."""
    vehicle, h = car("[limits]\nsuspension_stroke = 1e-3\nstop_stiffness = 1e5\n"), 5e-4
    ((load,),) = minimum_loads(vehicle, [design(vehicle, "passive")], h)
    assert load.ended == ("bump stop",)
    assert load_failures([load]) == []
    assert load.measured == pytest.approx(on_rig(vehicle, 8.0, h, lambda t: load.omega * t), abs=5e-3)
    assert load.measured != pytest.approx(load.driven, abs=5e-3)


def test_curve():
    """If a damper has a curve MuJoCo's least load is the curve's, held to no line of it, and a digressive one leaves less."""
    curve = "[curves]\nsuspension_damping = { velocity = [-1.0, -0.2, 0, 0.2, 1.0], force = [-700, -360, 0, 360, 700] }\n"
    text = car().text.replace("suspension_damping = 1800.0\n", "") + curve
    straight, curved = (minimum_loads(one, [design(one, "passive")], H)[0][0] for one in (car(), parse_vehicle(text)))
    assert straight.ratio == pytest.approx(curved.ratio, abs=1e-9)
    assert curved.measured < straight.measured - 0.02
    assert load_failures([curved]) == []
    assert RECORD([curved])["tyres"]["tyre_deflection"]["allowed"] is None


def test_the_document_names_the_end_and_the_dispute(monkeypatch):
    """The paper's car lifts off its plate and another car does not, as the table shows; the text says that this is disputed."""
    monkeypatch.setattr(worst_case_gain, "DURATION", 2.0)  # of runs that have no part in this
    for vehicle, ended in ((car(), "-"), (read_vehicle("quarter_car"), "lift-off")):
        (found,) = sweep(vehicle, [design(vehicle, "passive")], 1e-4, 4e-3, 12.5)
        document = workshop(vehicle, [found])
        ((controller, tyre, _, _, _, end),) = document.tables[0].rows
        assert (controller, tyre, end) == ("passive", "tyre deflection", ended)
        assert (found.loads[0].ratio == 0) == (ended != "-")
        assert DISPUTED_LIMIT in document.statements[0].text
