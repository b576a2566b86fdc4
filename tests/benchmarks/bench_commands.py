"""Speed of whole commands, as ratios of their time to that of importing what they need, by turns.

    python -m pytest tests/benchmarks/bench_commands.py

The imports take 0.85 s on the machine of the claims, so that 1.5 is 1.3 s there. Python keeps what it has compiled, as it does
for a user, also where the environment says otherwise.
"""

import os
import subprocess
import sys

import pytest

from tests.benchmarks.pairs import paired_ratio

NEEDED = "import numpy, scipy.linalg, mujoco, rerun, mcap"
COMMANDS = [  # what is run, over which imports, at most how many times as long, in how many rounds
    ("sim.bump --controller I", "import cvxpy, mujoco, rerun, mcap", 0.85, 7),
    ("sim.bump --controller I", NEEDED, 1.5, 7),
    ("sim.bump --controller I --no-logs", NEEDED, 0.94, 7),
    ("synth", NEEDED, 0.94, 7),
    ("sim.bump --vehicle full_car --controller I", NEEDED, 1.9, 5),
    ("sim.drive --controller I", NEEDED, 2.35, 5),
    ("sim.margins --controller II", NEEDED, 2.0, 3),
    ("sim.margins --controller II --vehicle half_car", NEEDED, 3.0, 1),
    ("sim.margins --controller II --vehicle full_car", NEEDED, 6.0, 1),
    ("sim.report --quick", NEEDED, 2.9, 3),
    ("sim.report", NEEDED, 17.6, 1),
]


@pytest.mark.goal
@pytest.mark.parametrize(("command", "imports", "claim", "rounds"), COMMANDS, ids=[f"{one[0]}, {one[2]}" for one in COMMANDS])
def test_command(benchmark, tmp_path, command, imports, claim, rounds):
    """A command takes at most so many times as long as the imports."""

    environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}

    def run(arguments: list[str]) -> None:
        subprocess.run([sys.executable, *arguments], cwd=tmp_path, check=True, capture_output=True, env=environment)

    paired_ratio(benchmark, lambda: run(["-m", *command.split()]), lambda: run(["-c", imports]), rounds, claim)
