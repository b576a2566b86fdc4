"""Prose is read once: docstrings begin with what something is or does, and sentences are short."""

import re
from collections import defaultdict
from pathlib import Path

import pytest

from tests.house.test_architecture import FILES, ROOT
from tests.support import pages
from tests.support.sources import sources

# Words that begin a sentence without a subject.
FRAGMENTS = frozenset(("What", "Whether", "Of", "Those", "It", "That", "Where", "How"))
RIDDLES = re.compile(r"\b(is none|there is none|None where|what is the case|that is asked for)\b")  # absence, and validity
PAGES = [ROOT / name for name in pages.PAGES]
LONG, LONGEST = 25, 35  # words of a sentence: few have more than the first, none of a page more than the second
MOST_FRAGMENTS = {"models": 0.03, "synth": 0.03, "sim": 0.03}  # of a package's docstrings
MOST_LONG = 0.025  # of all sentences; most that remain hold a formula or a source


def docstrings(path: Path) -> tuple[str, ...]:
    """Returns the docstrings of a file."""
    return sources()[path.relative_to(ROOT).as_posix()].docstrings


def sentences(text: str) -> list[str]:
    """Returns the sentences of paragraphs, list entries and table cells; what stands in backticks is one word."""
    text = re.sub(r"```.*?```|^(Example|Args|Attributes|Returns|Raises):$|^ {4,}.*=.*$", "\n\n", text, flags=re.S | re.M)
    found = []
    for block in re.split(r"\n\s*\n|\n\s*(?=[-*|#]|\d+\. |\w+: )|\|", text):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", re.sub(r"`[^`]*`", "code", " ".join(block.split())))
        found += re.split(r"(?<=[.!?])\s+(?=[A-Z(\"*\[]|code)", plain)
    return [each for each in found if each.strip()]


def words(sentence: str) -> int:
    """Returns how many words a sentence has; symbols and numbers of a formula are none."""
    return sum(bool(re.search(r"[a-zA-Z]{2}", word)) for word in sentence.split())


@pytest.mark.parametrize("package", MOST_FRAGMENTS)
def test_docstrings_begin_with_what_something_is_or_does(package):
    """Hardly a docstring begins with a fragment, and none says by a riddle that something is absent or invalid."""
    texts = [(path, text) for path in FILES if path.is_relative_to(ROOT / package) for text in docstrings(path)]
    begun = [f"{path}: {text.splitlines()[0]}" for path, text in texts if re.split(r"\W", text)[0] in FRAGMENTS]
    assert len(begun) <= MOST_FRAGMENTS[package] * len(texts), "\n".join(begun)
    riddles = [f"{path}: {text}" for path, text in texts if RIDDLES.search(text)]
    assert not riddles, "\n".join(riddles)


def test_sentences_are_short():
    """Few sentences of docstrings and pages have more than 25 words, and none of a page more than 35."""
    of_code = [each for path in FILES for text in docstrings(path) for each in sentences(text)]
    of_pages = [each for path in PAGES for each in sentences(path.read_text(encoding="utf-8"))]
    assert [each for each in of_pages if words(each) > LONGEST] == []
    for some in (of_code, of_pages):
        long = [each for each in some if words(each) > LONG]
        assert len(long) <= MOST_LONG * len(some), "\n".join(long)


@pytest.mark.parametrize("package", MOST_FRAGMENTS)
def test_a_name_is_one_class(package):
    """No two public classes of a package share a name."""
    places: dict[str, list[str]] = defaultdict(list)
    for path in FILES:
        if path.is_relative_to(ROOT / package):
            for name in sources()[path.relative_to(ROOT).as_posix()].classes:
                places[name].append(str(path))
    assert {name: where for name, where in places.items() if len(where) > 1} == {}
