"""Prose that is read twice: patterns in docstrings, comments, messages, help, output, pages, vehicle files and the changelog.

`python -m tests.house.prose` prints all findings. `--lower` writes their numbers into `MOST` of this file if they are smaller.
`--set` writes all numbers: use it only after a change of the patterns. Patterns do not find every fault, so
`python -m tests.house.sample SEED` draws sentences for readers to rate.
"""

import re
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from tests.support.commands import ROOT
from tests.support.pages import PAGES
from tests.support.sources import Source, comments, sources

MOST = {  # findings in a folder: lower these, never raise them
    "changelog": 1,
    "models/roads": 2,
    "sim/linear": 3,
    "synth/analysis": 2,
    "synth/controller": 1,
    "synth/plant": 1,
}

WORDS = (
    r"anew|nobody|shall|mend (?:it|that|the)|doubts?|(?:is|are|was) (?:told|asked for)|told apart|whole numbers?|held against"
    r"|leave (?:it|them|one) out|name (?:it|each) once|by turns|squeeze[sd]|ran away|to the last bit|in place of"
    r"|as (?:it is |they are )?built|each by itself|goes? together|in the mean|brakes and curves"
)
NO_NOUN = (
    "of|whose|that|from|with|beside|by|on|in|at|to|for|as|over|under|behind|along|since|until|what|how|which|whether|where|when|why"
    "|it|its|they|called|told|asked"
)
CONDITIONS = (
    r"[:;] (?:if|where|without|when|unless)\b[^.;:]*\b(?:and|or|else|otherwise),? (?:if|where|without|when|unless|else)\b"
)
PATTERNS = {  # name: pattern in a sentence, and what to write instead
    "begins with 'Of'": (r"^(?:And |But )?Of (?!course)", "start with the subject"),
    "verb before subject": (r"^(?:Below|Beside|Behind|Above|First|Then)\b[^,.]{0,60}? (?:stands?|comes?|lies?)\b", "X is below"),
    "'how ... says X'": (r"^(?:How|What|Which|Where|Whether)\b[^.;:?!]{3,90} says? ", "X explains how"),
    "thing that says": (r"(?<![-`])\bsays?\b(?! \")|`-[^`]*` (?:has|knows?)\b", "prints, contains, lists"),
    "'stands' for 'is'": (r"\bstands? (?:in|beside|below|above|there|at|on|behind|with|as|first|before)\b", "is"),
    "'is no X'": (r"(?<![Tt]here )\b(?:is|are|was|were) no (?!longer|more|less|one\b|such|need|way)[a-z]+\b", "is not a X"),
    "'is none'": (r"\b(?:is none|None where|what is the case)\b", "there is no X; X is invalid"),
    "'as X has it'": (r"\bas (?:\S+ ){1,5}?(?:has|have) (?:it|them)\b", "as in X"),
    "'of which there'": (r"\bof (?:which|whom|those|these) (?:there|nothing|no)\b", "that has no"),
    "beside": (r"(?<![-`\"_.])\bbeside\b(?![-`\"_])", "next to, with, in addition to"),
    "'in words'": (r"\bin words\b", "text, sentence, description"),
    "'of such'": (r"\bof such\b|(?<!is )(?<!are )(?<!be )\b[Tt]he same (?:for|of)\b|\blikewise\b", "repeat the noun"),
    "begins with a pronoun": (r"^(?:It|They|That|Those)\b", "repeat the noun"),
    "list of conditions": (CONDITIONS, "a sentence for each condition"),
    "comment without noun": (r"^(?:of|by|that|whose|with which|what)\b", "name the thing, then its condition"),
    "private word": (rf"\b(?:{WORDS})\b", "a term of the field: again, must, receives, integer, omit, alternately, instead of"),
    "fragment": (r"^(?:Why|For whom|With every|Up to which|As of|That of|Those of)\b[^,?]*\.$", "add subject and verb"),
    "first words": (r"^(?:What|Whether|Those|It|That|Where|How)\b", "start with a verb or a noun"),
    "entry without noun": (rf"^[\w*]+(?:, [\w*]+)*: (?:{NO_NOUN})\b", "start with a noun"),
    "wall of text": (r"^(?:\S+\s+){80}", "split it, or use a list"),
}
CODE_KINDS = "first", "docstring", "entry", "comment"  # a page may refer to the sentence before
ONLY = {  # patterns for some kinds of sentences
    "first words": ("first",),
    "entry without noun": ("entry",),
    "wall of text": ("page",),
    "begins with a pronoun": CODE_KINDS,
    "comment without noun": ("comment",),
}
CHANGELOG, TEMPLATES = "CHANGELOG.md", ("models/*.toml", "models/templates/*.toml")
COMMENTED_KEY = re.compile(r"^\s*[\w.\"\[\]]+\s*=[^#]*(?:#\s*)?|^\[[\w.]+\]\s*")  # in a template, before the comment itself
LONG, LONGEST = 25, 35  # words of a sentence: few have more than the first, none of a page more than the second
CODE = re.compile(r"`[^`]*`")  # code counts as one word
ENTRY = r"[\w*]+(?:, [\w*]+)*: "
NO_PROSE = rf"(?s:^```.*?^```|^\$\$.*?^\$\$)|^[ \t]*(?:Example|Args|Attributes|Returns|Raises):$|^ {{4,}}(?!{ENTRY}).*=.*$"


class Sentence(NamedTuple):
    """A sentence of a file.

    Attributes:
        file: path of the file.
        kind: "page", "change" (changelog), "template" (comment of a vehicle file), "comment" (of the code), "first" (first
            sentence of a docstring), "entry" (of its Args), "docstring" (other sentence of it), "text" (message, help, output).
        text: the sentence.
    """

    file: str
    kind: str
    text: str


class Finding(NamedTuple):
    """What is wrong in a file, what to do, and the words that are wrong or their line (0: unknown)."""

    file: str
    what: str
    do: str
    text: str = ""
    line: int = 0

    def __str__(self) -> str:
        where = f"{self.file}:{self.line}" if self.line else self.file
        return f"{where}: {self.what}{f': {self.text[:160]}' if self.text else ''}; {self.do}"


def blocks(text: str) -> Iterator[list[str]]:
    """Yields the sentences of each paragraph, list item, table cell and entry."""
    for block in re.split(rf"\n\s*\n|\n\s*(?=[-*|#>]|\d+\. |{ENTRY})|\s\|\s", re.sub(NO_PROSE, "\n\n", text, flags=re.MULTILINE)):
        if plain := re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", " ".join(block.split())).lstrip("-*#> "):
            yield re.split(r"(?<=[.!?])\s+(?=[A-Z(\"*\[`])", plain)


def words(sentence: str) -> int:
    """Returns the number of words of a sentence, without the symbols and numbers of a formula."""
    return sum(bool(re.search(r"[a-zA-Z]{2}", word)) for word in CODE.sub("code", sentence).split())


def of_code(code: Mapping[str, Source]) -> Iterator[Sentence]:
    """Yields the sentences of docstrings, comments, and texts of the code."""
    for file, source in code.items():
        for text in source.docstrings:
            for i, block in enumerate(blocks(text)):
                kind = "entry" if re.match(ENTRY, block[0]) else "docstring" if i else "first"
                yield from (Sentence(file, "docstring" if j else kind, one) for j, one in enumerate(block))
        for text in source.texts:
            yield from (Sentence(file, "text", one) for block in blocks(text) for one in block)
        for text in source.comments:
            yield from (Sentence(file, "comment", one) for block in blocks(text) for one in block)


def of_templates(texts: Mapping[str, str]) -> Iterator[Sentence]:
    """Yields the sentences of the comments in vehicle files."""
    for file, text in texts.items():
        plain = (COMMENTED_KEY.sub("", comment) for comment in comments(text))
        yield from (Sentence(file, "template", one) for comment in plain for block in blocks(comment) for one in block)


def of_pages(texts: Mapping[str, str]) -> Iterator[Sentence]:
    """Yields the sentences of pages and of the changelog."""
    for page, text in texts.items():
        kind = "change" if page == CHANGELOG else "page"
        yield from (Sentence(page, kind, one) for block in blocks(text) for one in block)


def pages() -> dict[str, str]:
    """Returns the texts of all pages."""
    return {page: (ROOT / page).read_text(encoding="utf-8") for page in PAGES}


def templates() -> dict[str, str]:
    """Returns the texts of the built-in vehicle files and of the templates of `roadproof new`."""
    files = sorted(path for pattern in TEMPLATES for path in ROOT.glob(pattern))
    return {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in files}


def changelog() -> dict[str, str]:
    """Returns the text of the changelog."""
    return {CHANGELOG: (ROOT / CHANGELOG).read_text(encoding="utf-8")}


def sentences() -> list[Sentence]:
    """Returns all sentences of the repository that users and developers read."""
    return [*of_code(sources()), *of_templates(templates()), *of_pages(pages() | changelog())]


def read_twice(sentences: Iterable[Sentence]) -> Iterator[Finding]:
    """Yields a finding for each pattern in each sentence."""
    for file, kind, text in sentences:
        for name, (pattern, instead) in PATTERNS.items():
            if kind in ONLY.get(name, (kind,)) and re.search(pattern, text):
                yield Finding(file, name, f"write instead: {instead}", text)


def by_folder(findings: Iterable[Finding], depth: int = 1) -> dict[str, list[Finding]]:
    """Returns the findings in each folder; pages count as docs, vehicle files as templates."""
    found: dict[str, list[Finding]] = defaultdict(list)
    for one in findings:
        folder = "docs" if one.file.endswith(".md") else "/".join(one.file.split("/")[:depth]).removesuffix(".py")
        folder = "changelog" if one.file == CHANGELOG else "templates" if one.file.endswith(".toml") else folder
        found[folder].append(one)
    return found


def findings() -> dict[str, list[Finding]]:
    """Returns the findings in each folder."""
    return by_folder(read_twice(sentences()), depth=2)


def report(file: str, most: dict[str, int], found: dict[str, list[Finding]]) -> int:
    """Prints findings, and lowers the ceilings `MOST` of a file if asked to; returns 1 if a folder is above its ceiling."""
    path = Path(file)
    if "--lower" in sys.argv or "--set" in sys.argv:
        now = {folder: len(found[folder]) for folder in sorted(found)}
        if "--lower" in sys.argv:
            now = {folder: min(most[folder], now.get(folder, 0)) for folder in most}
        lines = "".join(f'    "{folder}": {count},\n' for folder, count in now.items() if count)
        text = re.sub(r"^(MOST = \{.*\n)(?:    .*\n)*", rf"\1{lines}", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
        path.write_text(text, encoding="utf-8", newline="\n")
    for folder, some in found.items():
        print(*some, f"{folder}: {len(some)} of at most {most.get(folder, 0)}", sep="\n")
    return int(bool(above(most, found)))


def above(most: dict[str, int], found: dict[str, list[Finding]]) -> list[str]:
    """Returns the findings in folders that are above their ceilings."""
    return [str(one) for folder, some in found.items() if len(some) > most.get(folder, 0) for one in some]


if __name__ == "__main__":
    sys.exit(report(__file__, MOST, findings()))
