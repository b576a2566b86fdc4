"""Prose that a reader reads twice: patterns in docstrings, in texts of the code (messages, help, output) and in pages.

`python -m tests.house.prose` prints all findings. `--lower` writes their numbers into `MOST` of this file if they are smaller.
"""

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.support.commands import ROOT
from tests.support.pages import PAGES
from tests.support.sources import sources

MOST = {"docs": 9, "models": 4, "synth": 12, "sim": 45}  # findings in a folder: lower these, never raise them

# Name -> kinds of sentences (all if empty), pattern, and what to write instead.
PATTERNS = {
    "begins with 'Of'": ("", r"^(?:And |But )?Of (?!course)", "start with the subject"),
    "verb before subject": (
        "",
        r"^(?:Below|Beside|Behind|Above|First|Then|Under)\b[^,.]{0,60}? (?:stands?|comes?|lies?)\b",
        "X is below",
    ),
    "'how ... says X'": ("", r"^(?:How|What|Which|Where|Whether)\b[^.;:?!]{3,90} says? ", "X explains how"),
    "thing that says": (
        "",
        r"\bsays? (?:so|by|nothing|more|its|no|what|which|how|where|whether|when|why|who|if)\b|`-[^`]*` (?:has|says?|knows?)\b",
        "prints, lists, contains",
    ),
    "'stands' for 'is'": ("", r"\bstands? (?:in|beside|below|above|there|at|on|behind|with|as|first|before)\b", "is"),
    "'is no X'": ("", r"(?<![Tt]here )\b(?:is|are|was|were) no (?!longer|more|less|one\b|such|need|way)[a-z]+\b", "is not a X"),
    "'is none'": ("", r"\b(?:is none|None where|what is the case)\b", "there is no X; X is invalid"),
    "'as X has it'": ("", r"\bas (?:\S+ ){1,5}?(?:has|have) (?:it|them)\b", "as in X"),
    "'of which there'": ("", r"\bof (?:which|whom|those|these) (?:there|nothing|no)\b", "that has no"),
    "private word": (
        "",
        r"\b(?:anew|nobody|shall|mend (?:it|that|the)|doubts?|(?:is|are|was) (?:told|asked for)|told apart|whole numbers?"
        r"|leave (?:it|them|one) out|name (?:it|each) once|held against|by turns|squeeze[sd]|ran away|to the last bit|foretold"
        r"|in place of|as (?:it is |they are )?built|each by itself|goes? together|in the mean|brakes and curves)\b",
        "a term of the field, such as again, no user, must, warning, receives, integer, omit, alternately, instead of",
    ),
    "fragment": ("", r"^(?:Why|For whom|With every|Up to which|As of|That of|Those of)\b[^,?]*\.$", "add subject and verb"),
    "docstring begins with a fragment": ("first", r"^(?:What|Whether|Those|It|That|Where|How)\b", "start with a verb or noun"),
    "entry without noun": (
        "entry",
        r"^[\w*]+(?:, [\w*]+)*: (?:of|whose|that|from|with|beside|by|on|in|at|to|for|as|over|under|behind|along|since|until"
        r"|what|how|which|whether|where|when|why|it|its|they|called|told|asked)\b",
        "start with a noun",
    ),
    "wall of text": ("page", r"^(?:\S+\s+){80}", "split it, or use a list"),
}
ENTRY = re.compile(r"[\w*]+(?:, [\w*]+)*: ")
NO_PROSE = re.compile(
    r"^```.*?^```|^\$\$.*?^\$\$|^[ \t]*(?:Example|Args|Attributes|Returns|Raises):$|^ {4,}.*=.*$", re.DOTALL | re.MULTILINE
)


@dataclass(frozen=True)
class Sentence:
    """A sentence, or a page's paragraph.

    Attributes:
        file: path from the root.
        kind: "page", "docstring", "first" (of a docstring), "entry" (of its Args, Attributes or Raises), or "text" of the code.
        text: text on one line.
    """

    file: str
    kind: str
    text: str


def sentences(text: str) -> list[list[str]]:
    """Returns the sentences of every paragraph, list entry, table cell and entry of a docstring."""
    blocks = re.split(rf"\n\s*\n|\n\s*(?=[-*|#>]|\d+\. |{ENTRY.pattern})|\|", NO_PROSE.sub("\n\n", text))
    plain = (" ".join(re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", block).split()).lstrip("-*#> ") for block in blocks)
    return [re.split(r"(?<=[.!?])\s+(?=[A-Z(\"*\[`])", block) for block in plain if block]


def of_code() -> Iterator[Sentence]:
    """Yields the sentences of docstrings, and the texts of the code."""
    for file, source in sources().items():
        for text in source.docstrings:
            for i, block in enumerate(sentences(text)):
                for j, one in enumerate(block):
                    yield Sentence(file, "first" if i == j == 0 else "entry" if j == 0 and ENTRY.match(one) else "docstring", one)
        for text in source.texts:
            yield from (Sentence(file, "text", one) for block in sentences(text) for one in block)


def of_pages() -> Iterator[Sentence]:
    """Yields the sentences of pages."""
    for page in PAGES:
        for block in sentences((ROOT / page).read_text(encoding="utf-8")):
            yield from (Sentence(page, "page", one) for one in block)


def findings() -> dict[str, list[str]]:
    """Returns the findings in each folder, in words; pages count as docs."""
    found: dict[str, list[str]] = {folder: [] for folder in MOST}
    for one in (*of_code(), *of_pages()):
        for name, (kinds, pattern, instead) in PATTERNS.items():
            if (not kinds or one.kind in kinds) and re.search(pattern, one.text):
                folder = "docs" if one.kind == "page" else one.file.partition("/")[0]
                found[folder].append(f"{one.file}: {name} ({instead}): {one.text[:160]}")
    return found


def main() -> int:
    """Prints the findings, and lowers ceilings if asked to; returns 1 if a folder is above its ceiling."""
    found, path = findings(), Path(__file__)
    now = {folder: min(MOST[folder], len(some)) for folder, some in found.items()}
    if "--lower" in sys.argv:
        line = "MOST = {" + ", ".join(f'"{folder}": {most}' for folder, most in now.items()) + "}"
        text = re.sub(r"^MOST = \{.*?\}", line, path.read_text(encoding="utf-8"), flags=re.MULTILINE)
        path.write_text(text, encoding="utf-8", newline="\n")
    for folder, some in found.items():
        print(*some, f"{folder}: {len(some)} of at most {MOST[folder]}", sep="\n")
    return int(any(len(some) > MOST[folder] for folder, some in found.items()))


if __name__ == "__main__":
    sys.exit(main())
