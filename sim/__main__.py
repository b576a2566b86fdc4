"""`python -m sim`: which commands there are, and what question each answers."""

import runpy
import sys
from collections.abc import Sequence
from typing import NoReturn

from models.common import interrupt
from models.common.command import Parser, run_command
from models.common.errors import InputError, listing

COMMANDS = (  # name, the question it answers, the options that one reaches for first
    ("synth", "which gains, how good, and how far from the best possible?", "--refine --save --check --front"),
    ("sim.bump", "does MuJoCo do what the analysis says, over one bump?", "--height --speed --open"),
    ("sim.drive", "and over any other road; what is the ride like?", "--class --road --speed"),
    ("sim.sweep", "what are the frequency responses and the norm, measured?", "--amplitude --picture"),
    ("sim.margins", "how much gain, delay and sample period does the loop bear?", "--picture"),
    ("sim.envelope", "over which bumps may linear analysis be trusted?", "--vary --picture --csv"),
    ("sim.campaign", "what comes out over thousands of roads and vehicles?", "--best --results --verify"),
    ("sim.report", "all of it for one vehicle file, on one page?", "--out --quick --figures"),
    ("sim.gallery", "does it give the numbers that others printed?", "NAME"),
    ("sim.inspect", "does a log still prove what it claims?", "--csv --kinds"),
)
EPILOG = """
All but sim.campaign, sim.gallery and sim.inspect take --vehicle and
--controller; all take --json, and --help says the rest.
exit code: 0 done, agreed, proved; 1 not; 2 bad input;
130 interrupted, 143 by SIGTERM, 129 by the end of its terminal

examples:
  python -m sim.bump --controller I
  python -m sim.bump --help
  roadproof bump --controller I      the same as the first, once installed
"""
VERBS = {name.rpartition(".")[2]: name for name, _, _ in COMMANDS}  # as `roadproof` has them


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: any option but --help.
    """
    parser = Parser("sim", "\n".join(table()), EPILOG)
    parser.parse_args(arguments)
    print(parser.format_help(), end="")
    return 0


def table() -> list[str]:
    """The commands, a line each and one below it for the options."""
    lines = ["The commands, each as `python -m NAME`:", ""]
    for name, question, options in COMMANDS:
        lines += [f"  {name:12}  {question}", f"  {'':12}  {options}"]
    return lines


def roadproof() -> NoReturn:
    """Runs the installed `roadproof`: `roadproof bump ...` is `python -m sim.bump ...`, and without a verb `python -m sim`."""
    words = sys.argv[1:]
    sys.argv[0] = "-m"
    Parser.by_verb = True
    interrupt.quiet_start()
    if words and words[0] in VERBS:
        del sys.argv[1]
        runpy.run_module(VERBS[words[0]], run_name="__main__", alter_sys=True)
        sys.exit(0)
    if words and not words[0].startswith("-"):
        run_command(_unknown)
    run_command(main)


def _unknown() -> int:
    """Refuses a verb."""
    raise InputError(f"unknown command {sys.argv[1]!r}; roadproof has {listing(VERBS)}")


if __name__ == "__main__":
    run_command(main)
