"""Prose is read once: no patterns that are read twice (`tests/house/prose.py`), short sentences, and formats in one place."""

from collections import defaultdict

import pytest

from tests.house import formats, prose
from tests.house.prose import LONG, LONGEST, words
from tests.support.sources import sources

MOST_LONG = 0.025  # of all sentences; most that remain contain a formula or a source


@pytest.mark.parametrize("of", [prose, formats])
def test_ceilings(of):
    """No folder has more sentences to rewrite, or more formats of results, than its ceiling: `--lower` lowers it."""
    above = prose.above(of.MOST, of.findings())
    assert not above, "\n".join([of.__doc__, *above])


def test_sentences_are_short():
    """Few sentences of docstrings and pages have more than 25 words, and none of a page more than 35."""
    of_code = [one.text for one in prose.of_code(sources()) if one.kind != "text"]
    of_pages = [one.text for one in prose.of_pages(prose.pages())]
    assert [each for each in of_pages if words(each) > LONGEST] == []
    for some in (of_code, of_pages):
        long = [each for each in some if words(each) > LONG]
        assert len(long) <= MOST_LONG * len(some), "\n".join(long)


@pytest.mark.parametrize("package", ["models", "synth", "sim"])
def test_a_name_is_one_class(package):
    """No two public classes of a package share a name."""
    places: dict[str, list[str]] = defaultdict(list)
    for file, source in sources().items():
        for name in source.classes if file.startswith(f"{package}/") else ():
            places[name].append(file)
    assert {name: where for name, where in places.items() if len(where) > 1} == {}
