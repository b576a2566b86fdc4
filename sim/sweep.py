"""`python -m sim.sweep`: measures frequency responses and the H-infinity norm in MuJoCo (Fig. 3 of the paper)."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.sweep")

from functools import partial

from sim.command.study import main as of_study

main = partial(of_study, "sweep")
