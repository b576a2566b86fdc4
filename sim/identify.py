"""`python -m sim.identify`: a vehicle file from measured logs, with intervals."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.identify")

from functools import partial

from sim.command.study import main as of_study

main = partial(of_study, "identify")
