"""`python -m sim.margins`: computes gain, phase, delay and sample-period margins of a loop, and checks them in MuJoCo."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.margins")

from functools import partial

from sim.command.study import main as of_study

main = partial(of_study, "margins")
