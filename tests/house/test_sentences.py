"""Prose is read once: few patterns that are read twice (`tests/house/prose.py`), short sentences, and formats in one place."""

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


@pytest.mark.parametrize(
    ("kind", "text", "name"),
    [
        ("comment", "of the other end of a curve", "comment without noun"),
        ("comment", "They are kept for a while, as many runs share them.", "begins with a pronoun"),
        ("template", "A controller says which signals it measures.", "thing that says"),
        ("change", "The list of names in words is shorter.", "'in words'"),
        ("docstring", "A key beside the others.", "beside"),
        ("docstring", "The same for a controller with states.", "'of such'"),
        ("docstring", "None: if the road has no points, or if they end later.", "list of conditions"),
        ("page", "They are kept, because they are the same for all runs.", ""),
        ("docstring", "The key `beside` and the option --beside of the command.", ""),
    ],
)
def test_patterns(kind, text, name):
    """Each pattern finds its example in the kinds of prose that it is for."""
    assert [one.what for one in prose.read_twice([prose.Sentence("file", kind, text)])] == [name] * bool(name)


def test_comments_of_templates():
    """The sentences of a vehicle file are its comments, without keys that are commented out and without quoted texts."""
    lines = ["#:schema ./x.json", "# Each limit is", "# optional.", 'name = "# not a comment"  # name of the car itself']
    text = "\n".join([*lines, "# mass = 3.0  # mass of the whole car", ""])
    found = [one.text for one in prose.of_templates({"models/x.toml": text})]
    assert found == ["Each limit is optional.", "name of the car itself", "mass of the whole car"]


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
