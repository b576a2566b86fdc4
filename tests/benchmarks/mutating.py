"""Mutants of a file: every small change of one line that its author could have made by mistake."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

COMPARED = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
OPERATED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Pow: ast.Mult}
CALLED = {"min": "max", "max": "min", "any": "all", "all": "any", "ceil": "floor", "floor": "ceil", "sin": "cos", "cos": "sin"}


@dataclass(frozen=True)
class Mutant:
    """One changed line.

    Attributes:
        file: relative to the project.
        line: its number, from 1.
        first: that of the statement's first line.
        old: the line.
        new: what stands there instead.
    """

    file: str
    line: int
    first: int
    old: str
    new: str

    @property
    def place(self) -> str:
        """File and line."""
        return f"{self.file}:{self.line}"

    def applied(self, text: str) -> str:
        """The file's text with the line changed."""
        lines = text.split("\n")
        assert lines[self.line - 1] == self.old, f"{self.place} is another line now"
        lines[self.line - 1] = self.new
        return "\n".join(lines)


def all_mutants(path: Path, root: Path) -> Iterator[Mutant]:
    """Every mutant of a file; annotations, decorators, text, and what only type checkers read are left as they are."""
    text = path.read_text(encoding="utf-8")
    lines = text.split("\n")
    for node, first in _expressions(ast.parse(text)):
        if node.lineno != node.end_lineno:
            continue
        old = lines[node.lineno - 1]
        raw = old.encode()
        for other in _changed(node):
            new = (raw[: node.col_offset] + f"({ast.unparse(other)})".encode() + raw[node.end_col_offset :]).decode()
            yield Mutant(path.relative_to(root).as_posix(), node.lineno, first, old, new)


def _expressions(tree: ast.Module) -> Iterator[tuple[ast.expr, int]]:
    """Every expression that is computed, and the first line of its statement."""
    ways: list[tuple[ast.AST, int]] = [(tree, 1)]
    while ways:
        node, first = ways.pop()
        first = node.lineno if isinstance(node, ast.stmt) else first
        if isinstance(node, ast.expr):
            yield node, first
        for name, value in ast.iter_fields(node):
            typing = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
            if name in ("annotation", "returns", "decorator_list") or isinstance(node, ast.JoinedStr) or typing:
                continue
            ways += [(child, first) for child in (value if isinstance(value, list) else [value]) if isinstance(child, ast.AST)]


def _changed(node: ast.expr) -> Iterator[ast.expr]:
    """Returns what could stand for an expression by mistake."""
    match node:
        case ast.Compare(left=left, ops=[one], comparators=[right]) if type(one) in COMPARED:
            yield ast.Compare(left, [COMPARED[type(one)]()], [right])
        case ast.BinOp(left=left, op=one, right=right) if type(one) in OPERATED and not isinstance(
            left, ast.Constant | ast.JoinedStr
        ):
            yield ast.BinOp(left, OPERATED[type(one)](), right)
        case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
            yield operand
        case ast.BoolOp(op=one, values=values):
            yield ast.BoolOp(ast.Or() if isinstance(one, ast.And) else ast.And(), values)
        case ast.IfExp(test=test, body=body, orelse=orelse):
            yield ast.IfExp(ast.UnaryOp(ast.Not(), test), body, orelse)
        case ast.Constant(value=bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(value=int() as value):
            yield ast.Constant(value + 1)
        case ast.Constant(value=float() as value):
            yield ast.Constant(1.25 * value or 1.0)
        case ast.Call(func=ast.Name(id=name) as called, args=args, keywords=keywords) if name in CALLED and len(args) > 1 - (
            name in ("any", "all")
        ):
            yield ast.Call(ast.Name(CALLED[called.id]), args, keywords)
        case ast.Call(func=ast.Attribute(value=of, attr=name), args=args, keywords=keywords) if name in CALLED:
            yield ast.Call(ast.Attribute(of, CALLED[name]), args, keywords)
