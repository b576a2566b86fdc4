"""What tests ask of the product's sources, found in one pass in a session: to parse them takes seconds."""

import ast
import functools
import gc
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.support.commands import ROOT
from tests.support.shared import made

DIGITS = re.compile(r":[^{}: ]*\.(\d+|\{[^{}]*\})[egf%]\}")  # the end of a format with a number of digits
STRING_OR_COMMENT = re.compile(r"(?s:(\"{3}|'{3})(?:\\.|.)*?\1)|\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*'|(?P<comment>#[^\n]*)")
TOOLS = re.compile(r"#\s*(?:pyright|type|noqa|ruff|fmt|pragma|:schema)\b")  # comments for tools
LEAVES = {int, str, type(None), ast.Load, ast.Store, ast.Del}  # most of what nodes have
IN_DIGITS = re.compile(r"\.(\d+|\{[^{}]*\})[egf%]")  # in the text of each file that has one


@dataclass(frozen=True)
class Source:
    """What a file says.

    Attributes:
        imported: every module that it imports, anywhere in it, with what it takes from it behind a dot. The public names of a
            package are none of them: they are imported when they are first used, by whoever is outside.
        names: every name and attribute in it.
        runs_text: True if it makes code of text.
        docstrings: docstrings of its module, classes and functions.
        texts: other texts in it of at least four words: messages, help and output; X replaces what an f-string inserts.
        comments: comments of at least four words, without those for tools; lines of one comment are joined.
        classes: its public classes.
        formats: specification of each number that it formats to some digits, except in fields of tables and errors.
        code_lines: number of its lines without docstrings, comments and blank lines.
    """

    imported: tuple[str, ...]
    names: frozenset[str]
    runs_text: bool
    docstrings: tuple[str, ...]
    texts: tuple[str, ...]
    comments: tuple[str, ...]
    classes: tuple[str, ...]
    formats: tuple[str, ...]
    code_lines: int


@functools.cache
def sources() -> Mapping[str, Source]:
    """Returns every source of the product, by its path from the root."""
    return made(_read)


def _read() -> dict[str, Source]:
    return read(sorted(path for floor in ("models", "synth", "sim") for path in (ROOT / floor).rglob("*.py")))


def read(paths: Iterable[Path], root: Path = ROOT) -> dict[str, Source]:
    """Returns the sources of some files, by their paths from a root."""
    collecting = gc.isenabled()
    gc.disable()  # nodes are many, and have no circles
    try:
        return {path.relative_to(root).as_posix(): _source(path) for path in paths}
    finally:
        if collecting:
            gc.enable()


def _source(path: Path) -> Source:
    written = path.read_text(encoding="utf-8")
    tree = ast.parse(written)
    nodes = _nodes(tree)
    documented = [*nodes[ast.Module], *nodes[ast.ClassDef], *nodes[ast.FunctionDef]]
    calls = [node.func.id for node in nodes[ast.Call] if isinstance(node.func, ast.Name)]
    named = {node.id for node in nodes[ast.Name]} | {node.attr for node in nodes[ast.Attribute]}
    return Source(
        tuple(_imported(path, tree, [*nodes[ast.Import], *nodes[ast.ImportFrom]])),
        frozenset(named),
        not {"exec", "eval", "compile"}.isdisjoint(calls),
        tuple(text for node in documented if (text := ast.get_docstring(node))),
        tuple(_texts(nodes)),
        tuple(comments(written)),
        tuple(node.name for node in nodes[ast.ClassDef] if not node.name.startswith("_")),
        tuple(_formats(tree)) if IN_DIGITS.search(written) else (),
        _code_lines(written, documented),
    )


def _code_lines(written: str, documented: Iterable[Any]) -> int:
    texts = [node.body[0] for node in documented if ast.get_docstring(node, clean=False) is not None]
    within_texts = {line for text in texts for line in range(text.lineno, text.end_lineno + 1)}
    return sum(
        bool(line.strip()) and not line.lstrip().startswith("#") and number not in within_texts
        for number, line in enumerate(written.splitlines(), 1)
    )


def _nodes(tree: ast.AST) -> Mapping[type, list[Any]]:
    """Returns the nodes by their class, without the contexts of names: one pass in place of several."""
    nodes, by_class = [tree], defaultdict[type, list[Any]](list)
    for node in nodes:
        by_class[type(node)].append(node)
        nodes += _children(node)
    return by_class


def _children(node: ast.AST) -> Iterator[Any]:
    """Yields what `ast.iter_child_nodes` does, without the contexts of names, in half the time."""
    for value in vars(node).values():
        if type(value) is list:
            yield from (one for one in value if isinstance(one, ast.AST))
        elif type(value) not in LEAVES and isinstance(value, ast.AST):
            yield value


def comments(written: str) -> Iterator[str]:
    """Yields the comments of a file in Python or TOML; lines below each other that contain nothing else are one comment."""
    parts, last = list[str](), -1
    for found in STRING_OR_COMMENT.finditer(written):
        if not (text := found["comment"]) or TOOLS.match(text):
            continue
        begin = written.rfind("\n", 0, found.start()) + 1
        alone = not written[begin : found.start()].strip()
        if parts and not (alone and last == begin):
            yield from _long(parts)
            parts = []
        parts.append(text.lstrip("#!: "))
        last = found.end() + 1 if alone else -1
    yield from _long(parts)


def _long(parts: list[str]) -> Iterator[str]:
    if len((text := " ".join(parts)).split()) > 3:
        yield text


def _texts(nodes: Mapping[type, list[Any]]) -> Iterator[str]:
    whole = [*nodes[ast.JoinedStr], *nodes[ast.Expr]]  # an expression alone is a docstring
    parts = {id(part) for node in whole for part in ast.iter_child_nodes(node)}
    for node in (*nodes[ast.JoinedStr], *nodes[ast.Constant]):
        if id(node) not in parts and len((text := _text(node)).split()) > 3:
            yield text


def _text(node: ast.AST) -> str:
    if isinstance(node, ast.JoinedStr):
        return "".join(map(_text, node.values))
    return (node.value if isinstance(node.value, str) else "") if isinstance(node, ast.Constant) else "X"


def _first_name(node: ast.AST) -> str:
    """Returns the name that an expression begins with: `Column` of `Column.of(x)`."""
    while isinstance(node, (ast.Attribute, ast.Call, ast.Subscript)):
        node = node.func if isinstance(node, ast.Call) else node.value
    return node.id if isinstance(node, ast.Name) else ""


def _formats(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Call) and _first_name(node.func).endswith(("Column", "Field", "Error")):
        return
    spec = node.value if isinstance(node, ast.Constant) else None
    if isinstance(node, ast.FormattedValue) and node.format_spec:
        spec, node = ast.unparse(node.format_spec)[2:-1], node.value  # without f and the quotes
    if isinstance(spec, str) and DIGITS.search(f":{spec}}}"):
        yield spec
    for part in _children(node):
        if not (isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant)):  # a docstring
            yield from _formats(part)


def _imported(path: Path, tree: ast.Module, nodes: list[ast.AST]) -> Iterator[str]:
    lazy = [one for one in tree.body if isinstance(one, ast.If)] if path.name == "__init__.py" else []
    public = {id(node) for one in lazy for node in ast.walk(one)}
    for node in nodes:
        if id(node) in public:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
