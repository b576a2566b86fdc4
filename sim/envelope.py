"""`python -m sim.envelope`: the map of validity, over one or two of a bump's height, length and the speed."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.envelope")

from functools import partial

from sim.command.study import main as of_study

main = partial(of_study, "envelope")
