"""The published semi-active car that ships: its numbers are its source's, and every command takes it."""

import json

from models.laws.semi_active import LAWS
from models.vehicle.vehicle import read_vehicle
from sim.bump import main as bump
from synth.__main__ import main as synth

VEHICLE = "quarter_car_semi_active"
# eFMI's test case M06, QuarterVehiclePlant: m_b, m_w, c_b, c_w, d_w; dMin and dMax.
SOURCE = {
    "sprung_mass": 250.0,
    "unsprung_mass": 30.0,
    "suspension_stiffness": 20e3,
    "tyre_stiffness": 250e3,
    "tyre_damping": 500.0,
}
LEAST, MOST = 200.0, 1000.0


def test_numbers_of_the_source():
    """Masses, stiffnesses, tyre damping and the damper's limits are the source's; the nominal damper is midway between these."""
    vehicle = read_vehicle(VEHICLE)
    assert {name: vehicle.parameters[name] for name in SOURCE} == SOURCE
    (damper,) = vehicle.dampers.values()
    assert (damper.c_min, damper.c_max) == (LEAST, MOST)
    assert vehicle.parameters["suspension_damping"] == (LEAST + MOST) / 2


def test_every_claim_holds(capsys):
    """Its controllers are designed and certified, the given one too, and they agree with physics over a bump."""
    assert synth(["--vehicle", VEHICLE, "--json"]) == 0
    capsys.readouterr()
    assert (
        bump(["--vehicle", VEHICLE, "--controller", "all", "--height", "0.02", "--duration", "0.25", "--no-logs", "--json"]) == 0
    )
    runs = json.loads(capsys.readouterr().out)["runs"]
    names = {run["controller"]["name"] for run in runs}
    assert names == {"passive", "state", "I", "sky", *LAWS} - {"skyhook_modal"}  # of cars
    assert all(run["agrees"] for run in runs)
