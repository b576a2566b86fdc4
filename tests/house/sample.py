"""A random sample of prose for readers to rate: `python -m tests.house.sample SEED`.

The sample has 60 sentences of pages, 60 of docstrings, 40 messages and printed texts, and 40 comments of code and vehicle files.
A reader who does not know the project marks each sentence: 1 reads at once, 2 read twice, 3 not understood. Comments are printed
with their line of code. The same seed draws the same sample from the same files. Use a new seed for each reading, because texts
that were sampled before are already corrected.
"""

import ast
import random
import re
import sys
from collections.abc import Iterator

from docs import generate
from tests.house import prose
from tests.house.__main__ import line_of
from tests.support.commands import ROOT
from tests.support.sources import sources

FEWEST_WORDS = 4  # shorter sentences say too little to be rated
PRINTS = re.compile(r"_(?:lines?|words|text|statements?)$|^describe")  # functions whose texts are printed
DRAWN = {"pages": 60, "docstrings": 60, "messages": 25, "printed texts": 15, "comments": 40}
Pool = set[tuple[str, str]]  # file and text


def pools() -> dict[str, list[tuple[str, str]]]:
    """Returns all texts of each kind with their files, sorted."""
    found: dict[str, Pool] = {name: set() for name in DRAWN}
    kinds = {"page": "pages", "first": "docstrings", "docstring": "docstrings", "entry": "docstrings", "comment": "comments"}
    for file, kind, text in prose.sentences():
        if kind in kinds or kind == "template":
            found[kinds.get(kind, "comments")].add((file, text))
    for file in sources():
        found["messages"] |= {(file, text) for _, text in generate.raised(ROOT / file)}
        found["printed texts"] |= {(file, text) for text in printed(ast.parse((ROOT / file).read_text(encoding="utf-8")))}
    return {name: sorted(one for one in some if prose.words(one[1]) >= FEWEST_WORDS) for name, some in found.items()}


def printed(tree: ast.Module) -> Iterator[str]:
    """Yields the texts of statements, help texts, and texts in functions whose result is printed; <x> replaces a value."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Statement" and node.args:
            yield generate.told(node.args[0])
        elif isinstance(node, ast.keyword) and node.arg == "help":
            yield generate.told(node.value)
        elif isinstance(node, ast.FunctionDef) and PRINTS.search(node.name):
            yield from _texts_in(node)


def _texts_in(function: ast.FunctionDef) -> Iterator[str]:
    nodes = [one for statement in function.body if not isinstance(statement, ast.Expr) for one in ast.walk(statement)]
    parts = {id(part) for one in nodes if isinstance(one, ast.JoinedStr) for part in one.values}
    for node in nodes:
        if isinstance(node, ast.JoinedStr | ast.Constant) and id(node) not in parts:
            yield generate.told(node)


def sample(seed: int) -> dict[str, list[tuple[str, str]]]:
    """Returns the texts that a seed draws from each pool, with their files."""
    chosen = random.Random(seed)
    return {name: chosen.sample(some, DRAWN[name]) for name, some in pools().items()}


def main(seed: str) -> None:
    """Prints a sample."""
    for name, some in sample(int(seed)).items():
        print(f"\n{name}")
        for number, (file, text) in enumerate(some, start=1):
            whole = (ROOT / file).read_text(encoding="utf-8")
            line = line_of(whole, text)
            code = f"   [{whole.splitlines()[line - 1].strip()}]" if name == "comments" and line else ""
            print(f"{number:2} {file}:{line or '?'}: {text}{code}")


if __name__ == "__main__":
    main(*sys.argv[1:])
