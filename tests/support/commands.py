"""Commands as tests run them: in this process by their `main`, or in one of their own."""

import importlib
import itertools
import json
import math
import os
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from subprocess import Popen
from typing import Any, TypeVar

import pytest

from models.common.errors import InputError

T = TypeVar("T")
ROOT = Path(__file__).parents[2]


def main_of(command: str) -> Callable[[list[str]], int]:
    """The `main` of a command, which is a module, or a package whose `__main__` has it."""
    if command.startswith("sim "):  # a study without a module of its own
        return partial(importlib.import_module("sim.command.study").main, command.removeprefix("sim "))
    module = importlib.import_module(command)
    return (module if hasattr(module, "main") else importlib.import_module(f"{command}.__main__")).main


def prose(printed: str) -> str:
    """Returns what was printed with its lines joined, as a sentence that goes over several reads."""
    return " ".join(printed.split())


def answer(capsys: pytest.CaptureFixture[str], main: Callable[[list[str]], int], *arguments: str, code: int = 0) -> Any:
    """Returns what a command prints with `--json`, which is JSON without NaN and infinity."""
    capsys.readouterr()
    assert main([*arguments, "--json"]) == code
    return json.loads(capsys.readouterr().out, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


@contextmanager
def refused(*words: str, match: str | None = None) -> Iterator[None]:
    """Asserts that bad input is refused in one line, which has these words and fits the pattern."""
    with pytest.raises(InputError, match=match) as error:
        yield
    line = str(error.value)
    assert all(word in line for word in words), line
    assert len(line.splitlines()) == 1, line


def once(function: Callable[..., T]) -> Callable[..., T]:
    """Returns a function that computes at its first call alone: what a command prints in words and as `--json` is then of one."""
    found: list[T] = []

    def first(*arguments: object, **named: object) -> T:
        if not found:
            found.append(function(*arguments, **named))
        return found[0]

    return first


_all_attacks = [True]


def without_attacks() -> None:
    """Says that no attack will run, before tests are collected: one case then stands for all of `attacks`, as most take time."""
    _all_attacks[:] = [False]


def attacks(cases: Iterable[Any]) -> list[Any]:
    """Returns cases of a parametrised test, tuples where it has several arguments, for the attacks alone."""
    some = itertools.islice(cases, None if _all_attacks[0] else 1)
    return [pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.attack) for case in some]


def in_the_suite(some: Collection[Any], cases: Iterable[Any]) -> list[Any]:
    """Returns cases of which all but some are for the attacks alone."""
    cases = [*cases]
    if not _all_attacks[0]:
        return [*(case for case in cases if case in some), *attacks(case for case in cases if case not in some)]
    return [each for case in cases for each in ([case] if case in some else attacks([case]))]


def wait_for_processor_time(process: Popen, seconds: float) -> None:
    """Returns when a process has had so much of the processors [s], whatever else the machine does, or is over.

    Where the system does not tell what it has had, the clock does.
    """
    if not Path("/proc/self/stat").exists():
        time.sleep(seconds)
        return
    had = 0.0
    while had < seconds:
        fields = Path(f"/proc/{process.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        had = math.inf if fields[0] == "Z" else (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        time.sleep(0.01)


def environment() -> dict[str, str]:
    """Returns the environment of a process which runs this checkout's commands from any folder."""
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
