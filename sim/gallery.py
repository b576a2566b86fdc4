"""`python -m sim.gallery`: numbers that others printed, beside what comes out here."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.gallery")

import json
from collections.abc import Sequence

from models.common.command import Parser
from models.common.printed import Stages, say

EPILOG = """
Each row contains the published number, the number from linear analysis and, if a run measures it, the number from MuJoCo. A
number is reproduced if ours rounds to all published digits. Otherwise the row gives the reason. The number marked grid is ours at
the samples of the published plot. `sim.report --gallery` writes these results as a page.

exit code: 0 every number is reproduced, or differs for a known reason; 1 a number differs; 2 invalid input; 130 interrupted

examples:
  python -m sim.gallery
  python -m sim.gallery mathworks --json
"""


def parser() -> Parser:
    """Returns the command-line parser."""
    parser = Parser("sim.gallery", "Compare published results on suspensions with the results of Roadproof.", EPILOG)
    parser.add_argument("name", nargs="*", metavar="NAME", help="entry of the gallery, such as mathworks (default: all)")
    printed = parser.add_mutually_exclusive_group()
    printed.add_argument("--brief", action="store_true", help="print one line for each entry")
    printed.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: an entry is unknown.
    """
    options = parser().parse_args(arguments)
    from sim.studies.gallery.entries import names, read_entry
    from sim.studies.gallery.numbers import compared
    from sim.studies.gallery.summary import brief_lines, entry_lines, entry_object, last_lines, sources_object

    entries = [read_entry(name) for name in dict.fromkeys(options.name or names())]
    stage, results = Stages(*(entry.name for entry in entries)), []
    for entry in entries:
        stage(entry.name)
        results.append((entry, compared(entry)))
    stage.end()
    if options.json:
        print(json.dumps({"entries": [entry_object(*each) for each in results], **sources_object(entries)}, allow_nan=False))
    elif options.brief:
        say([*brief_lines(results), "", *last_lines(results)])
    else:
        say([*(line for each in results for line in entry_lines(*each)), *last_lines(results)])
    return 1 if any(one.wrong for _, numbers in results for one in numbers) else 0
