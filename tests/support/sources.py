"""What tests ask of the product's sources, found in one pass in a session: to parse them takes seconds."""

import ast
import functools
import gc
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.support.commands import ROOT
from tests.support.shared import made

DIGITS = re.compile(r":[^{}: ]*\.(\d+|\{[^{}]*\})[egf%]\}")  # the end of a format with a number of digits
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
        classes: its public classes.
        formats: specification of each number that it formats to some digits, except in fields of tables and errors.
    """

    imported: tuple[str, ...]
    names: frozenset[str]
    runs_text: bool
    docstrings: tuple[str, ...]
    texts: tuple[str, ...]
    classes: tuple[str, ...]
    formats: tuple[str, ...]


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
    nodes = [*ast.walk(tree)]
    documented = [node for node in nodes if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)]
    calls = [node.func.id for node in nodes if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
    named = {node.id for node in nodes if isinstance(node, ast.Name)}
    named |= {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    return Source(
        tuple(_imported(path, tree, nodes)),
        frozenset(named),
        not {"exec", "eval", "compile"}.isdisjoint(calls),
        tuple(text for node in documented if (text := ast.get_docstring(node))),
        tuple(_texts(nodes)),
        tuple(node.name for node in documented if isinstance(node, ast.ClassDef) and not node.name.startswith("_")),
        tuple(_formats(tree)) if IN_DIGITS.search(written) else (),
    )


def _texts(nodes: list[ast.AST]) -> Iterator[str]:
    whole = (ast.JoinedStr, ast.Expr)  # an expression alone is a docstring
    parts = {id(part) for node in nodes if isinstance(node, whole) for part in ast.iter_child_nodes(node)}
    for node in nodes:
        if id(node) not in parts and isinstance(node, ast.JoinedStr | ast.Constant) and len((text := _text(node)).split()) > 3:
            yield text


def _text(node: ast.AST) -> str:
    if isinstance(node, ast.JoinedStr):
        return "".join(map(_text, node.values))
    return (node.value if isinstance(node.value, str) else "") if isinstance(node, ast.Constant) else "X"


def _formats(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Call) and re.match(r"\w*(Column|Field|Error)\b", ast.unparse(node.func)):
        return
    spec = node.value if isinstance(node, ast.Constant) else None
    if isinstance(node, ast.FormattedValue) and node.format_spec:
        spec, node = ast.unparse(node.format_spec)[2:-1], node.value  # without f and the quotes
    if isinstance(spec, str) and DIGITS.search(f":{spec}}}"):
        yield spec
    for part in ast.iter_child_nodes(node):
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
