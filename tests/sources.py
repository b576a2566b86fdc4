"""What tests ask of the product's sources, found in one pass in a session: to parse them takes seconds."""

import ast
import functools
import gc
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.commands import ROOT
from tests.shared import made

ONE_SYSTEM = {"fcntl", "termios", "pwd", "grp", "resource", "pty", "tty", "syslog", "msvcrt", "winreg", "winsound", "_winapi"}
# What os and signal have on some systems only. Where it is worth having all the same, getattr asks for it.
SOME_OS = {"O_BINARY", "O_CLOEXEC", "O_DIRECTORY", "O_NONBLOCK", "WIFEXITED", "chown", "chroot", "fchmod", "fchown"}
SOME_OS |= {"fork", "forkpty", "geteuid", "getgid", "getloadavg", "getpgid", "getsid", "getuid", "killpg"}
SOME_OS |= {"mkfifo", "nice", "openpty", "sched_getaffinity", "sched_setaffinity", "setpgid", "setsid", "statvfs", "sysconf"}
SOME_OS |= {"uname", "wait", "wait3", "wait4"}
SOME_SIGNALS = {"SIGKILL", "SIGHUP", "SIGALRM", "SIGPIPE", "SIGUSR1", "SIGUSR2", "SIGCHLD", "SIGSTOP", "SIGCONT", "SIGQUIT"}
SOME_SIGNALS |= {"alarm", "setitimer", "pause", "sigwait", "pthread_kill", "pthread_sigmask", "CTRL_C_EVENT", "CTRL_BREAK_EVENT"}
ROOTED = ("/dev/", "/proc/", "/tmp", "/var/", "/etc/", "/usr/", "C:\\")


@dataclass(frozen=True)
class Source:
    """What a file says.

    Attributes:
        imported: every module that it imports, anywhere in it, with what it takes from it behind a dot. The public names of a
            package are none of them: they are imported when they are first used, by whoever is outside.
        names: every name and attribute in it.
        runs_text: True if it makes code of text.
        docstrings: of its module, classes and functions.
        classes: its public classes.
        of_one_system: what only one system has.
    """

    imported: tuple[str, ...]
    names: frozenset[str]
    runs_text: bool
    docstrings: tuple[str, ...]
    classes: tuple[str, ...]
    of_one_system: tuple[str, ...]


@functools.cache
def sources() -> Mapping[str, Source]:
    """Returns every source of the product, by its path from the root."""
    return made(_read)


def _read() -> dict[str, Source]:
    paths = sorted(path for floor in ("models", "synth", "sim") for path in (ROOT / floor).rglob("*.py"))
    collecting = gc.isenabled()
    gc.disable()  # nodes are many, and have no circles
    try:
        return {path.relative_to(ROOT).as_posix(): _source(path) for path in paths}
    finally:
        if collecting:
            gc.enable()


def _source(path: Path) -> Source:
    tree = ast.parse(path.read_text(encoding="utf-8"))
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
        tuple(node.name for node in documented if isinstance(node, ast.ClassDef) and not node.name.startswith("_")),
        tuple(of_one_system(nodes)),
    )


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


def of_one_system(nodes: list[ast.AST]) -> Iterator[str]:
    """Yields what only one system has, in a source of these nodes."""
    docstrings = set()
    for node in nodes:
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and node.body and isinstance(node.body[0], ast.Expr):
            docstrings.add(id(node.body[0].value))
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (f"import {alias.name}" for alias in node.names if alias.name.split(".")[0] in ONE_SYSTEM)
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            yield from [f"import {module}"] if module.split(".")[0] in ONE_SYSTEM else []
            some = {"os": SOME_OS, "signal": SOME_SIGNALS}.get(module, set())
            yield from (f"{module}.{alias.name}" for alias in node.names if alias.name in some)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if node.attr in {"os": SOME_OS, "signal": SOME_SIGNALS}.get(node.value.id, set()):
                yield f"{node.value.id}.{node.attr}"
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield from [node.value] if node.value.startswith(ROOTED) else []
        elif isinstance(node, ast.Call):
            yield from _text_without_encoding(node)


def _text_without_encoding(call: ast.Call) -> Iterator[str]:
    """Text files whose encoding, or whose line ends, the system would choose."""
    name = call.func.attr if isinstance(call.func, ast.Attribute) else call.func.id if isinstance(call.func, ast.Name) else ""
    keywords = {keyword.arg for keyword in call.keywords}
    texts = [argument.value for argument in call.args if isinstance(argument, ast.Constant) and isinstance(argument.value, str)]
    if name == "write_text" and not {"encoding", "newline"} <= keywords:
        yield f"line {call.lineno}: write_text without encoding or newline"
    if name == "open" and any(text in ("w", "a", "r", "x") for text in texts) and not {"encoding", "newline"} <= keywords:
        yield f"line {call.lineno}: open without encoding or newline"
