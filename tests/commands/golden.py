"""The golden run of each command, made once in a session: different tests check text, JSON keys, files, log and inspection.

found = golden("sim.bump", "plain")
assert found.code == 0 and found.json["runs"]
assert golden("sim.bump", "plain", form="").out.endswith("energy balances\n")  # the same as text
"""

from dataclasses import replace

import numpy as np

from models.vehicle.vehicle import read_vehicle
from sim.studies.identification.experiment import Channel, Experiment
from sim.studies.identification.prediction import LogPrediction
from tests.support.pages import site
from tests.support.shared import Printed, printed

REALITY, *_ = site("Limits").blocks("toml")  # the README's example: limits, a sample period, a delay, noise and quantisation
# Of the paper's vehicle; the step divides the README's sample period, and a run takes less than half the time of one at 1 ms.
QUICK = ("--quick", "--timestep", "0.0025", "--out", "report.html")
CAMPAIGN = """
vehicles = ["quarter_car"]
controllers = ["passive", "I_printed"]
roads = ["iso8608:class=B", "bump:height=0.02"]
speeds = [10.0]
duration = 0.2
timestep = 5e-3
"""
VEHICLE = read_vehicle("quarter_car")
LOG = "time [s];sprung_acceleration [g]\n" + "".join(f"{0.01 * i:.2f};{i % 5}\n" for i in range(21))


def rig_log() -> str:
    """Returns a log of the vehicle over a chirp, with noise, for `sim.identify`."""
    time, random = 0.01 * np.arange(400), np.random.default_rng(0)
    road = 2e-3 * np.sin(2 * np.pi * time * (0.5 + 2 * time))
    vehicle = replace(VEHICLE, kind=VEHICLE.kind.naming({*VEHICLE.kind.possible}))
    empty = Experiment("rig", 0.01, road[:, None], np.zeros((400, 1)), (Channel("suspension_deflection", road),), from_rest=True)
    exact = LogPrediction(empty, lambda _: vehicle)({}, {}, None, [0.0], False).values[:, 0]
    rows = zip(time, road, exact + 2e-4 * random.standard_normal(400), strict=True)
    return "time [s];road_displacement [m];suspension_deflection [m]\n" + "".join(
        f"{t:.2f};{z:.7f};{d:.6f}\n" for t, z, d in rows
    )


FILES = {"log.csv": LOG, "rig.csv": rig_log(), "campaign.toml": CAMPAIGN, "quarter_car.toml": f"{VEHICLE.text}\n{REALITY}"}
LIMITS, DAMPER = ("--vehicle", "quarter_car.toml"), ("--vehicle", "quarter_car_semi_active", "--controller", "skyhook")
ONE, STEP = ("--controller", "I"), ("--timestep", "0.005")
PAIR = ("--controller", "passive", *ONE)
SHORT = (*STEP, "--duration", "0.2", "--no-logs")
LIFTS = ("--height", "0.3", "--speed", "25", *STEP, "--duration", "0.4", "--logs", "logs")  # with a log for `sim.inspect`
MAP = ("--vary", "height:0.02:0.3:2", *STEP)
CASES = {  # the cases of each command: their names and options
    "synth": {
        "plain": (),
        "limits": (*ONE, *LIMITS, "--certificates", "proofs"),
        "damper": (*ONE, *DAMPER[:2]),
        "fragility": (*ONE, "--fragility"),
        "rates": (*ONE, "--rates", "5"),
        "export": (*ONE, "--export", "ecu"),
        "check": ("--check", "quarter_car.toml"),
        "front": (*ONE, "--front", "ride:travel"),
        "goals": ("--vehicle", "quarter_car_goals"),
    },
    "sim.new": {"plain": ("car.toml", "--schema")},
    "sim.bump": {"plain": (*ONE, *LIFTS), "limits": (*ONE, *SHORT, *LIMITS), "damper": (*DAMPER, *SHORT)},
    "sim.drive": {
        "plain": (*ONE, *SHORT),
        "limits": (*ONE, *SHORT, *LIMITS),
        "damper": (*DAMPER, *SHORT),
        "measured": (*ONE, *SHORT, "--beside", "log.csv", "--beside-remove-offset"),
    },
    "sim.sweep": {"plain": (*ONE, *STEP), "limits": (*ONE, *STEP, *LIMITS)},
    "sim.margins": {"plain": (*ONE, *STEP), "limits": (*ONE, *STEP, *LIMITS)},
    "sim.envelope": {"plain": (*ONE, *MAP), "plane": (*ONE, *MAP, "--vary", "speed:10:20:2")},
    "sim.campaign": {"plain": ("campaign.toml",)},
    "sim.inspect": {"plain": ("LOG",)},
    "sim.gallery": {"plain": ("textbook",)},
    "sim.identify": {"plain": ("rig.csv", "--fix", "sprung_mass"), "columns": ("rig.csv", "--columns")},
    "sim recommend": {"plain": ("--quick", *STEP, "--save", "best.toml")},
    "sim.report": {"plain": QUICK, "limits": (*PAIR, *QUICK, *LIMITS)},
}


def golden(command: str, case: str, form: str = "--json") -> Printed:
    """Returns what a command prints and writes in one of its cases: JSON, or text in a form: `-v`, `--brief` or empty.

    `LOG` among the options is the log of the plain run of `sim.bump`.
    """
    options = list(CASES[command][case])
    files = {name: text for name, text in FILES.items() if name in options}
    if "LOG" in options:
        bump = golden("sim.bump", "plain")
        options[options.index("LOG")] = str(bump.folder / bump.json["logs"]["mcap"])
    return printed(command, *options, *filter(None, [form]), files=files)
