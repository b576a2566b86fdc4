"""`python -m sim`: which commands there are, and what question each answers."""

from collections.abc import Sequence

from models.common.command import Parser, run_command

COMMANDS = (  # name, the question it answers, the options that one reaches for first
    ("synth", "which gains, how good, and how far from the best possible?", "--refine --save --check --front"),
    ("sim.bump", "does MuJoCo do what the analysis says, over one bump?", "--height --speed --open"),
    ("sim.drive", "and over any other road; what is the ride like?", "--class --road --speed"),
    ("sim.sweep", "what are the frequency responses and the norm, measured?", "--amplitude --picture"),
    ("sim.margins", "how much gain, delay and sample period does the loop bear?", "--picture"),
    ("sim.envelope", "over which bumps may linear analysis be trusted?", "--vary --picture --csv"),
    ("sim.campaign", "what comes out over thousands of roads and vehicles?", "--results --verify"),
    ("sim.report", "all of it for one vehicle file, on one page?", "--out --quick --figures"),
    ("sim.inspect", "does a log still prove what it claims?", "--csv --kinds"),
)
EPILOG = """
All but sim.campaign and sim.inspect take --vehicle and --controller; all take
--json, and --help says the rest.
exit code: 0 done, agreed, proved; 1 not; 2 bad input;
130 interrupted, 143 by SIGTERM, 129 by the end of its terminal

examples:
  python -m sim.bump --controller I
  python -m sim.bump --help
"""


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


if __name__ == "__main__":
    run_command(main)
