"""`roadproof`, or `python -m sim`: the table of commands, with the purpose of each."""

import runpy
import sys
from collections.abc import Sequence
from typing import NoReturn

from models.common import interrupt
from models.common.command import Parser, run_command, versions
from models.common.errors import InputError, listing

COMMANDS = (  # name, its purpose, the options that one reaches for first
    ("sim.new", "write a commented vehicle file to start from", "--type"),
    ("synth", "design controllers and prove bounds on their norms", "--refine --save --check --front"),
    ("sim.bump", "drive over one bump and compare MuJoCo with linear analysis", "--height --speed --open"),
    ("sim.drive", "drive over any road and measure the ride", "--class --road --speed"),
    ("sim.sweep", "measure frequency responses and the H-infinity norm", "--amplitude --picture"),
    ("sim.margins", "find the gain, delay and sample-period margins", "--picture"),
    ("sim.envelope", "map the bumps over which linear analysis is valid", "--vary --picture --csv"),
    ("sim.campaign", "simulate thousands of roads and vehicles", "--best --results --verify"),
    ("sim.report", "write a one-page report about a vehicle file", "--out --quick --figures"),
    ("sim.gallery", "compare with published results", "NAME"),
    ("sim.inspect", "recompute a logged run and check its results", "--csv --kinds"),
)
EPILOG = """
Most commands take --vehicle FILE and --controller NAME. All take --json, and
--help lists their options with units and defaults. A number may have its own unit,
as in --speed 90km/h --height "60 mm", in vehicle files, too.
exit code: 0 success; 1 a failed claim; 2 invalid input; 130 interrupted

examples:
  roadproof new my_car.toml
  roadproof bump --controller I
  roadproof bump --help
"""
VERBS = {name.rpartition(".")[2]: name for name, _, _ in COMMANDS}  # as `roadproof` has them


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: any option but --help.
    """
    parser = Parser("sim", "\n".join(table()), EPILOG)
    parser.add_argument("--version", action="store_true", help="print the versions of Roadproof and of its packages")
    options = parser.parse_args(arguments)
    if options.version:
        own_first = sorted(versions().items(), key=lambda one: one[0] != "roadproof")
        print("\n".join(f"{name} {version}" for name, version in own_first))
        return 0
    print(parser.format_help(), end="")
    return 0


def table() -> list[str]:
    """Returns the table of commands: a line for the purpose of each, and one below it for its main options."""
    lines = ["Commands, each as `roadproof NAME`:", ""]
    for verb, (_, purpose, options) in zip(VERBS, COMMANDS, strict=True):
        lines += [f"  {verb:10}  {purpose}", f"  {'':10}  {options}"]
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
