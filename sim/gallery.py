"""`python -m sim.gallery`: compares published results with the results that Roadproof computes."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.gallery")

from functools import partial

from sim.command.study import main as of_study

main = partial(of_study, "gallery")
