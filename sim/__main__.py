"""`roadproof`, or `python -m sim`: prints the table of commands and their purposes."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.__main__")

import re
import sys
from collections.abc import Sequence
from typing import NoReturn

from models.common.command import Parser, versions
from models.common.errors import InputError, list_names
from models.common.extensions import STUDIES
from sim.studies.command_name import command_of

OWN = {name: texts for name, texts in STUDIES.texts.items() if texts}
COMMANDS = (  # each row: module name after `python -m`, purpose of the command, and its most important options
    ("sim.new", "write a commented vehicle file to start from", "--type"),
    ("synth", "design controllers and prove bounds on their norms", "--refine --save --check --front"),
    ("sim.bump", "drive over one bump and compare MuJoCo with linear analysis", "--height --speed --open"),
    ("sim.drive", "drive over any road and measure the ride", "--class --road --speed"),
    *((command_of(name), *texts) for name, texts in OWN.items()),
    ("sim.campaign", "simulate thousands of roads and vehicles", "--best --results --verify"),
    ("sim.report", "write a one-page report about a vehicle file", "--out --quick --figures"),
    ("sim.inspect", "recompute a logged run and check its results", "--csv --kinds"),
)
EPILOG = """
Most commands take --vehicle FILE and --controller NAME, and all take --json. `roadproof NAME --help` lists the options of a
command with units and defaults. Numbers may have units, as in --speed 90km/h --height "60 mm"; vehicle files accept units, too.
exit code: 0 success; 1 a failed claim or design; 2 invalid input; 130 interrupted

examples:
  roadproof new my_car.toml
  roadproof bump --controller I
  roadproof bump --help
"""
# commands that are packages; all other commands are modules
PACKAGES = ("synth", "sim.drive", "sim.campaign", "sim.report", "sim.inspect")
VERBS = {re.split("[. ]", name)[-1]: name for name, _, _ in COMMANDS}  # maps each subcommand of `roadproof` to its module name


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code. `python -m sim bump` does the same as `roadproof bump`.

    Raises:
        InputError: the command or an option is unknown.
    """
    words = sys.argv[1:] if arguments is None else arguments
    if arguments is None and words and words[0] in VERBS:
        roadproof()
    if words and " " in VERBS.get(words[0], ""):  # the subcommand is a study without a module of its own
        from sim.command import study

        return study.main(words[0], words[1:])
    if words and not words[0].startswith("-"):
        raise InputError(f"unknown command {words[0]!r}; the commands are {list_names(VERBS)}")
    parser = Parser("sim", "\n".join(table()), EPILOG, "docs/which-command.md")
    parser.add_argument("--version", action="store_true", help="print the versions of Roadproof and its packages")
    options = parser.parse_args(arguments)
    if options.version:
        own_first = sorted(versions().items(), key=lambda one: one[0] != "roadproof")
        print("\n".join(f"{name} {version}" for name, version in own_first))
        return 0
    print(parser.format_help(), end="")
    return 0


def table() -> list[str]:
    """Returns the table of commands. Each command has two lines: one for its purpose and one for its main options."""
    lines = ["Commands, each as `roadproof NAME`:", ""]
    for verb, (_, purpose, options) in zip(VERBS, COMMANDS, strict=True):
        lines += [f"  {verb:10}  {purpose}", f"  {'':10}  {options}"]
    return lines


def roadproof() -> NoReturn:
    """Runs the installed program `roadproof`.

    `roadproof bump ...` runs `python -m sim.bump ...`. Without a subcommand, `roadproof` runs `python -m sim`.
    """
    from models.common.cli import run

    Parser.by_verb = True
    if len(sys.argv) > 1 and sys.argv[1] in VERBS:
        command = VERBS[verb := sys.argv.pop(1)]
        if verb in OWN and " " in command:
            run("sim.command.study", verb)
        run(f"{command}.__main__" if command in PACKAGES else command)
    run("sim.__main__")
