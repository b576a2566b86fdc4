"""The commands that drive one controller, with as little to do as they take."""

import pytest

from sim import bump, envelope, margins, sweep
from sim.drive import __main__ as drive

MAP = ["--vary", "height:0.02:0.03:2", "--vary", "speed:10:20:2", "--timestep", "0.002"]

EVERY_DRIVE = pytest.mark.parametrize(
    ("main", "options"),
    [
        (bump.main, ["--no-logs", "--duration", "0.2"]),
        (drive.main, ["--no-logs", "--duration", "0.3"]),
        (envelope.main, MAP),
        pytest.param(sweep.main, ["--timestep", "0.004"], marks=pytest.mark.attack),
        pytest.param(margins.main, ["--timestep", "0.008"], marks=pytest.mark.attack),
    ],
    ids=["bump", "drive", "envelope", "sweep", "margins"],
)
