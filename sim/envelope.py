"""`python -m sim.envelope`: finds where linear analysis is valid, as a function of one or two of bump height, bump length and
speed.
"""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.envelope")

from functools import partial

from sim.command.study import main as of_study

main = partial(of_study, "envelope")
