"""Faults that a change brings: `python -m tests.house` lists each with what to do, in ten seconds.

A change is what differs from the common ancestor of HEAD and `main`, together with files that are not committed. `--all` lists
the faults that were there before, too. Linters, ceilings, imports between rooms, prose, formats, tables of pages and lengths of
messages are checked.

exit code: 0 no faults; 1 faults; 2 no Git checkout
"""

import json
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from pathlib import Path

from docs import generate
from tests.house import ceilings, formats, prose, test_architecture
from tests.house.prose import LONG, Finding, Sentence, words
from tests.support.commands import ROOT
from tests.support.pages import GENERATED
from tests.support.sources import Source, read

WIDEST = 100  # columns of a table in a page
LONGEST_MESSAGE = 200  # characters of a message without its values


@dataclass(frozen=True)
class Tree:
    """Files of a checkout that a change touches, by their paths from its root."""

    root: Path
    names: tuple[str, ...]

    def text(self, name: str) -> str:
        """Returns the text of a file."""
        return (self.root / name).read_text(encoding="utf-8")

    @cached_property
    def code(self) -> dict[str, Source]:
        """The product's sources."""
        product = [name for name in self.names if name.endswith(".py") and name.startswith(("models/", "synth/", "sim/"))]
        return read([self.root / name for name in product], self.root)

    @cached_property
    def pages(self) -> dict[str, str]:
        """The texts of pages that are not generated."""
        pages = [name for name in self.names if name.endswith(".md") and not name.startswith(GENERATED)]
        return {name: self.text(name) for name in pages if name != prose.CHANGELOG}

    @cached_property
    def other_prose(self) -> list[Sentence]:
        """The sentences of the changelog and of vehicle files."""
        files = [name for name in self.names if any(Path(name).match(pattern) for pattern in prose.TEMPLATES)]
        changelog = [name for name in self.names if name == prose.CHANGELOG]
        found = prose.of_templates({name: self.text(name) for name in files if name.startswith("models/")})
        return [*found, *prose.of_pages({name: self.text(name) for name in changelog})]


def linters(tree: Tree) -> Iterator[Finding]:
    """Yields the findings of `ruff check` and `ruff format`."""
    files = [name for name in tree.names if name.endswith((".py", ".ipynb"))]
    if not files:
        return
    ruff = [sys.executable, "-m", "ruff"]
    checked = subprocess.run(
        [*ruff, "check", "-q", "--output-format=json", *files], cwd=tree.root, capture_output=True, text=True
    )
    for one in json.loads(checked.stdout or "[]"):
        do = "run ruff check --fix" if (one["fix"] or {}).get("applicability") == "safe" else f"see {one['url']}"
        name = Path(one["filename"]).relative_to(tree.root).as_posix()
        yield Finding(name, f"{one['code']} {one['message']}", do, line=one["location"]["row"])
    formatted = subprocess.run([*ruff, "format", "--check", *files], cwd=tree.root, capture_output=True, text=True)
    for name in re.findall(r"^(?:Would reformat: | *--> )(.+?)(?::[\d:]+)?$", formatted.stdout, re.M):
        yield Finding(name, "not formatted", f"run ruff format {name}")


def lines_of_capabilities(tree: Tree) -> Iterator[Finding]:
    """Yields the rows above their ceilings, and the files that are in no row or in two."""
    files, rows, table = ceilings.counted(tree.root), ceilings.rows(), "tests/house/ceilings.py"
    for row in rows:
        for many in row.too_many(files):
            yield Finding(
                table, f"{row.capability}: {many}", "remove as many, or raise the ceiling with the reason in the message"
            )
    for name in files:
        if (found := sum(row.has(name) for row in rows)) != 1:
            yield Finding(name, f"in {found or 'no'} rows of {table}", "list the file in one row")


def sentences(tree: Tree) -> Iterator[Finding]:
    """Yields sentences with a pattern that is read twice, and long sentences of docstrings, comments and pages."""
    found = [*prose.of_code(tree.code), *prose.of_pages(tree.pages)]
    yield from prose.read_twice([*found, *tree.other_prose])
    for file, kind, text in found:
        if kind != "text" and words(text) > LONG:
            yield Finding(file, f"{words(text)} words", "write two sentences", text)


def tables(tree: Tree) -> Iterator[Finding]:
    """Yields the rows of tables in pages that are too wide."""
    for name, text in tree.pages.items():
        for number, line in enumerate(text.splitlines(), start=1):
            if line.startswith("|") and len(line) > WIDEST:
                do = f"shorten to {WIDEST}, or write a list"
                yield Finding(name, f"a row of a table has {len(line)} columns", do, line, number)


def messages(tree: Tree) -> Iterator[Finding]:
    """Yields the messages of errors that are too long."""
    for name in tree.code:
        for function, text in generate.raised(tree.root / name):
            if len(text) > LONGEST_MESSAGE:
                do = f"shorten to {LONGEST_MESSAGE}: what was found, what is allowed, what to do"
                yield Finding(name, f"a message of {function} has {len(text)} characters", do, text)


def own_formats(tree: Tree) -> Iterator[Finding]:
    """Yields the numbers of digits that code chooses itself."""
    return formats.own_formats(tree.code)


def imports(tree: Tree) -> Iterator[Finding]:
    """Yields the imports that the rooms do not allow."""
    return test_architecture.wrong_imports(tree.code)


CHECKS: tuple[Callable[[Tree], Iterator[Finding]], ...] = (
    linters,
    lines_of_capabilities,
    imports,
    sentences,
    own_formats,
    tables,
    messages,
)


def findings(tree: Tree) -> list[Finding]:
    """Returns the findings of all checks."""
    return [*chain.from_iterable(check(tree) for check in CHECKS)]


def git(root: Path, *arguments: str) -> str:
    """Returns what Git prints."""
    return subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=True).stdout


def ancestor(root: Path) -> str:
    """Returns the common ancestor of HEAD and `main`; without such a branch, HEAD."""
    for branch in ("main", "origin/main"):
        found = subprocess.run(["git", "merge-base", "HEAD", branch], cwd=root, capture_output=True, text=True)
        if found.returncode == 0:
            return found.stdout.strip()
    return git(root, "rev-parse", "HEAD").strip()


def brought(root: Path) -> list[Finding]:
    """Returns the findings that a checkout has, and its common ancestor with `main` has not."""
    base, was = ancestor(root), dict[str, str]()  # names before the change, by their present ones
    changes = git(root, "diff", "--name-status", "-M", "--no-relative", base).splitlines()
    for status, *names in (line.split("\t") for line in changes):
        if status != "D":
            was[names[-1]] = names[0] if status != "A" else ""
    was |= dict.fromkeys(git(root, "ls-files", "--others", "--exclude-standard").splitlines(), "")
    before = sorted(filter(None, was.values()))
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(1) as other:
        old = Path(folder).resolve()
        tracked = git(root, "ls-tree", "--name-only", base).splitlines()
        archive = subprocess.run(["git", "archive", base, *tracked], cwd=root, capture_output=True, check=True).stdout
        subprocess.run(["tar", "-x", "-C", folder], input=archive, check=True)
        (old / "pyproject.toml").write_bytes((root / "pyproject.toml").read_bytes())
        known = other.submit(findings, Tree(old, tuple(before)))
        found = findings(Tree(root, tuple(sorted(name for name in was if (root / name).is_file()))))
        there = Counter((one.file, one.what, one.text) for one in known.result())
    new = []
    for one in found:
        key = was.get(one.file) or one.file, one.what, one.text
        if there[key] > 0:
            there[key] -= 1
        else:
            new.append(one)
    return new


def line_of(text: str, quote: str) -> int:
    """Returns the line on which a quoted sentence begins, 0 if the file writes the sentence otherwise."""
    written = max(re.split(r"<\w+>|\.\.\.|\bX\b", quote), key=len)  # between values that are inserted
    found = re.search(r"\W+(?:f\W+)?".join(re.findall(r"\w+", written)[:6]), text)
    return text[: found.start()].count("\n") + 1 if found else 0


def main(arguments: Sequence[str] = (), root: Path = ROOT) -> int:
    """Prints the findings and returns the exit code."""
    try:
        if "--all" in arguments:
            found = findings(Tree(root, tuple(name for name in git(root, "ls-files").splitlines() if (root / name).is_file())))
        else:
            found = brought(root)
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"{root} must be a Git checkout with the commit that it is compared with: {error}", file=sys.stderr)
        return 2
    for one in found:
        known = one.line or not (root / one.file).is_file()
        print(one if known else one._replace(line=line_of((root / one.file).read_text(encoding="utf-8"), one.text or one.what)))
    print(f"{len(found)} faults" if found else "no faults")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
