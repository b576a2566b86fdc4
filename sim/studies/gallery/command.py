"""The study of published results, which compares each published number with the number that Roadproof computes."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from models.common.command import Parser
from sim.studies.study import Progress, Study, StudyRequest

if TYPE_CHECKING:
    from models.document.document import Document
    from sim.studies.gallery.report import Result


class GalleryStudy(Study["list[Result]"]):
    """Study that compares the published numbers of gallery entries with the numbers that Roadproof computes."""

    description = "Compare published results on suspensions with the results of Roadproof."
    epilog = """
Each row contains the published number, the number from linear analysis and, if a run measures it, the number from MuJoCo. A
number is reproduced if our number rounds to all published digits. Otherwise the row gives the reason. A number marked grid is
taken at the samples of the published plot. `sim.report --gallery` writes these results as a page.

exit code: 0 every number is reproduced, or differs for a known reason; 1 a number differs; 2 invalid input; 130 interrupted

examples:
  roadproof gallery
  roadproof gallery mathworks --json
"""
    page = "docs/explanation/verification.md"
    takes = ""

    def add_options(self, parser: Parser) -> None:
        parser.add_argument("name", nargs="*", metavar="NAME", help="entry of the gallery, such as mathworks (default: all)")
        printed = parser.add_mutually_exclusive_group()
        printed.add_argument("--brief", action="store_true", help="print one line for each entry")
        printed.add_argument("--json", action="store_true", help="print one JSON object and nothing else")

    def run(self, request: StudyRequest, progress: Progress) -> "list[Result]":
        from sim.studies.gallery.entries import names, read_entry
        from sim.studies.gallery.numbers import compare_numbers

        results = []
        for entry in [read_entry(name) for name in dict.fromkeys(request.options.name or names())]:
            progress(entry.name)
            results.append((entry, compare_numbers(entry)))
        return results

    def describe(self, request: StudyRequest, result: "list[Result]") -> "Document":
        from models.document.document import Document
        from sim.studies.gallery.report import describe, summary

        return Document("", (*(describe(*each) for each in result), summary(result)))

    def record(self, request: StudyRequest, result: "list[Result]") -> dict[str, Any]:
        from sim.studies.gallery.report import record

        return record(result)

    def lines(self, request: StudyRequest, result: "list[Result]", files: Sequence[str]) -> list[str]:
        from models.document.text import text_lines

        return text_lines(self.describe(request, result), "brief" if request.options.brief else "normal")

    def holds(self, result: "list[Result]") -> bool:
        from sim.studies.gallery.report import summary

        return summary(result).state != "fails"
