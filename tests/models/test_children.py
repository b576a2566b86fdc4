"""Child processes: answers in time, one exception for each way to fail, and none left behind."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest

from models.common.children import Child, EndedError, kill_children
from tests.support.commands import attacks, environment, in_the_suite


def answers(messages: Iterator[str]) -> Iterator[object]:
    """Does what each message says, and answers with its process."""
    for message in messages:
        exec(message, {"os": os, "sys": sys, "time": time})
        yield os.getpid()


def test_answers_come_in_order():
    """A child answers every message in its own process, and answers can be requested later than they are sent."""
    child = Child(answers)
    process = child.ask("pass", 10.0)
    assert process != os.getpid()
    for _ in range(3):
        child.send("pass")
    assert [child.receive(10.0) for _ in range(3)] == [process] * 3


@pytest.mark.parametrize(
    ("message", "error", "said"),
    [
        ("raise ValueError('of the child')", ValueError, "of the child"),
        ("time.sleep(1000)", TimeoutError, "^$"),
        *attacks([("while True: pass", TimeoutError, "^$")]),  # as a loop in a law, in test_python_laws.py
        ("os._exit(3)", EndedError, "exit code 3"),
        pytest.param(
            "os.kill(os.getpid(), 11)", EndedError, "signal SIGSEGV", marks=pytest.mark.skipif(os.name == "nt", reason="POSIX")
        ),
        ("input()", EOFError, "EOF when reading a line"),
    ],
)
def test_each_way_to_fail_is_an_exception(message, error, said):
    """An error of the child, a call that is too long, and a death are exceptions; the child does not answer any more."""
    child = Child(answers)
    child.ask("pass", 10.0)
    with pytest.raises(error, match=said):
        child.ask(message, 0.1 if error is TimeoutError else 10.0)
    with pytest.raises(EndedError):
        child.ask("pass", 10.0)


def test_children_that_hang_are_killed_at_once():
    """`kill_children` ends a call that does not return, for which another thread waits."""
    child, began = Child(answers), time.monotonic()
    child.ask("pass", 10.0)
    killer = threading.Timer(0.2, kill_children)
    killer.start()
    with pytest.raises(EndedError):
        child.ask("time.sleep(1000)", 30.0)
    assert time.monotonic() - began < 15.0


def test_a_child_that_waits_ends_as_a_script_does(tmp_path):
    """A child that waits for messages ends with its exit functions, so that nothing that it has unpacked is left behind."""
    child = Child(answers)
    child.ask(f"import atexit, pathlib; atexit.register(pathlib.Path({str(tmp_path / 'ended')!r}).touch)", 10.0)
    child.end()
    assert (tmp_path / "ended").exists()


SCRIPT = """
import os, signal, sys
from models.common.children import Child
from tests.models.test_children import answers
child = Child(answers)
print(child.ask("print('printed')", 10), flush=True)
child.send("while True: pass")
os.kill(os.getpid(), int(sys.argv[1])) if sys.argv[1:] else None
"""


@pytest.mark.parametrize("number", in_the_suite([[], ["9"]], [[], ["9"], ["15"]]))
@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_child_ends_with_its_parent(tmp_path, number):
    """A script without a guard of its main part starts a child, and no end of the script leaves the child behind."""
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "script.py", *number], cwd=tmp_path, env=environment(), capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (-int(number[0]) if number else 0, "printed\n")
    child = int(done.stdout)
    for _ in range(100):
        if _gone(child):
            return
        time.sleep(0.05)
    pytest.fail("the child is still there")


def _gone(process: int) -> bool:
    try:
        os.kill(process, 0)
        with open(f"/proc/{process}/stat", encoding="utf-8") as file:
            return file.read().rpartition(")")[2].split()[0] == "Z"  # ended, but no process has asked for its exit code
    except ProcessLookupError:
        return True
    except FileNotFoundError:
        return False
