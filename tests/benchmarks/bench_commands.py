"""Speed of whole commands: ratios of their processor time to that of importing what they need, measured alternately.

    python -m pytest tests/benchmarks/bench_commands.py

The imports take 0.85 s on an idle machine, so 1.5 is 1.3 s. Python keeps compiled files, as it does for a user, even if the
environment says otherwise.
"""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmarks.pairs import paired_ratio

NEEDED = "import numpy, scipy.linalg, mujoco, rerun, mcap"
CARS = Path(__file__).parent / "cars"
MOTORWAY = "--class C --speed 25"
SEMI_ACTIVE = f"sim.drive --vehicle {CARS / 'semi_active_corner.toml'} {MOTORWAY} --controller"
ACTIVE = f"--vehicle {CARS / 'active_corner.toml'} --controller leaky"
COMMANDS = [  # what is run, over which imports, at most how many times as long, in how many rounds
    ("sim.bump --controller I", "import cvxpy, mujoco, rerun, mcap", 0.85, 7),
    ("sim.bump --controller I", NEEDED, 1.5, 7),
    ("sim.bump --controller I --no-logs", NEEDED, 0.94, 7),
    ("synth", NEEDED, 0.94, 7),
    ("sim.bump --vehicle full_car --controller I", NEEDED, 1.9, 5),
    ("sim.drive --controller I", NEEDED, 2.35, 5),
    (f"{SEMI_ACTIVE} sky", NEEDED, 4.5, 5),
    (f"{SEMI_ACTIVE} all", NEEDED, 9, 3),
    (f"sim.bump {ACTIVE}", NEEDED, 1.9, 5),
    (f"sim.drive {ACTIVE} {MOTORWAY}", NEEDED, 4.5, 5),
    ("sim.margins --controller II", NEEDED, 2.0, 3),
    ("sim.margins --controller II --vehicle half_car", NEEDED, 3.0, 1),
    ("sim.margins --controller II --vehicle full_car", NEEDED, 6.0, 1),
    ("sim.report --quick", NEEDED, 2.9, 3),
    ("sim.report", NEEDED, 17.6, 1),
]


@pytest.mark.goal
@pytest.mark.parametrize(
    ("command", "imports", "claim", "rounds"), COMMANDS, ids=[f"{one[0].replace(f'{CARS}/', '')}, {one[2]}" for one in COMMANDS]
)
def test_command(benchmark, tmp_path, command, imports, claim, rounds):
    """A command takes at most so many times the processor time of the imports."""

    environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}

    def run(arguments: list[str]) -> None:
        subprocess.run([sys.executable, *arguments], cwd=tmp_path, check=True, capture_output=True, env=environment)

    paired_ratio(benchmark, lambda: run(["-m", *command.split()]), lambda: run(["-c", imports]), rounds, claim, spent)


def spent() -> float:
    """Returns the processor time of all processes that were waited for [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
