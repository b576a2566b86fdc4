"""`python -m sim.gallery`: published numbers next to ours."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.gallery")

from collections.abc import Sequence

from models.common.command import Parser, print_json
from models.common.printed import Stages, say

EPILOG = """
Each row contains the published number, the number from linear analysis and, if a run measures it, the number from MuJoCo. A
number is reproduced if our number rounds to all published digits. Otherwise the row gives the reason. Our number marked grid is
taken at the samples of the published plot. `sim.report --gallery` writes these results as a page.

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
    from models.document.document import Document
    from models.document.text import text_lines
    from sim.studies.gallery.entries import names, read_entry
    from sim.studies.gallery.numbers import compared
    from sim.studies.gallery.report import describe, gallery_object, summary

    entries = [read_entry(name) for name in dict.fromkeys(options.name or names())]
    stage, results = Stages(*(entry.name for entry in entries)), []
    for entry in entries:
        stage(entry.name)
        results.append((entry, compared(entry)))
    stage.end()
    whole = Document("", (*(describe(*each) for each in results), summary(results)))
    if options.json:
        print_json(gallery_object(results))
    else:
        say(text_lines(whole, "brief" if options.brief else "normal"))
    return 1 if whole.state == "fails" else 0
