"""`python -m sim.identify`: identifies the parameters of a vehicle from measured logs and writes a vehicle file."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.identify")

from functools import partial

from sim.command.study import main as of_study

main = partial(of_study, "identify")
