"""Runs of laws in Python, in a process of their own: such a law can end that process at most, and no campaign.

`python -m sim.campaign.law_process` is that process. It reads the plan, then the first run of a batch and the one behind its
last, line by line, and writes the rows as JSON, with the batch: an answer to another batch is invalid, and ends the process. A
child that a law forks answers nothing. Its stdout is kept for the answers: all that a law prints goes to stderr. If the process
of a batch ends, every run of it is repeated alone, so that only the runs that end theirs are lost.
"""

import io
import json
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from os import _exit as leave_at_once
from pathlib import Path
from typing import Any, BinaryIO

import cloudpickle

from models.common.interrupt import hide_numpy_warnings
from models.laws.python_runtime import leave_by
from sim.campaign.batch import FAILED, Rows, run_batch
from sim.campaign.plan import Plan

ROOT = Path(__file__).parent.parent.parent
TICK = 0.1  # s between two looks whether to give up
LEFT = 3  # exit code of a process that was left because a call could not be ended
STRAY = "makes its process answer what it was not asked; mend that"


class EndedError(Exception):
    """The process has ended; the message says how.

    Attributes:
        named: whether it says which law did that.
    """

    def __init__(self, how: str, named: bool) -> None:
        super().__init__(how)
        self.named = named


class LawProcesses:
    """Processes that run batches of one plan, one to each thread that asks."""

    def __init__(self, plan: Plan) -> None:
        self.plan, self.payload = plan, cloudpickle.dumps(plan)
        self._own, self._all = threading.local(), list[_Process]()

    def __enter__(self) -> "LawProcesses":
        return self

    def __exit__(self, *error: object) -> None:
        for process in self._all:
            process.end()

    def rows(self, start: int, stop: int, stopped: Callable[[], bool] = lambda: False) -> Rows | None:
        """`run_batch`, elsewhere."""
        try:
            return self._process().rows(start, stop, stopped)
        except EndedError as ended:
            if stop - start == 1:
                inputs = self.plan.inputs(self.plan.key(start))
                said = str(ended) if ended.named else f"controller {inputs['controller']!r}, its law {ended}"
                return [{"run": start, **inputs, "reason": f"{FAILED}{said}"}]
        rows: Rows = []
        for run in range(start, stop):
            some = self.rows(run, run + 1, stopped)
            if some is None:
                return None
            rows += some
        return rows

    def _process(self) -> "_Process":
        """Returns the process of this thread."""
        process = getattr(self._own, "process", None)
        if process is None or process.ended:
            self._own.process = process = _Process(self.payload)
            self._all.append(process)
        return process


_of_worker: list[LawProcesses] = []


def of_worker(plan: Plan) -> LawProcesses:
    """Returns the processes of a cluster's worker, as long as it has batches of one plan."""
    processes = LawProcesses(plan)
    if not _of_worker or _of_worker[0].payload != processes.payload:
        for other in _of_worker:
            other.__exit__()
        _of_worker[:] = [processes]
    return _of_worker[0]


class _Process:
    """Process of laws, seen from outside."""

    def __init__(self, payload: bytes) -> None:
        known = os.environ.get("PYTHONPATH")
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *([known] if known else []), os.curdir])}
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "sim.campaign.law_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            start_new_session=True,  # Ctrl-C is for who has begun it
        )
        self.ended, self._said = False, queue.Queue[bytes]()
        threading.Thread(target=self._listen, daemon=True).start()
        self._tell(payload)

    def rows(self, start: int, stop: int, stopped: Callable[[], bool]) -> Rows | None:
        """Returns the rows of a batch, or None if stopped."""
        self._tell(f"{start} {stop}\n".encode())
        while not stopped():
            over = self._process.poll() is not None  # what it has said by then is heard within a tick
            try:
                line = self._said.get(timeout=TICK)
            except queue.Empty:
                if not over:
                    continue
                line = b""  # a child of it has its stdout, too, which so has no end
            if not line:
                how = self._how()
                self.end()
                raise EndedError(how, named=False)
            said = answer_to(line, start, stop)
            if "rows" in said:
                return said["rows"]
            self.end()
            if "left" in said:
                raise EndedError(said["left"], named=True)
            if "error" in said:
                raise RuntimeError(f"a batch failed, and not by its law: {said['error']}")
            raise EndedError(STRAY, named=False)
        self.end()
        return None

    def end(self) -> None:
        """Ends it, and what its laws have begun beside it."""
        if self.ended:
            return
        self.ended = True
        with suppress(OSError):
            if hasattr(os, "killpg"):
                os.killpg(self._process.pid, signal.SIGKILL)  # it leads a session of its own
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError):
                assert pipe is not None, "both are pipes"
                pipe.close()

    def _tell(self, what: bytes) -> None:
        assert self._process.stdin is not None, "it is a pipe"
        with suppress(OSError):  # it has ended; that it has is heard
            self._process.stdin.write(what)
            self._process.stdin.flush()

    def _listen(self) -> None:
        assert self._process.stdout is not None, "it is a pipe"
        with suppress(OSError, ValueError):  # closed by `end`
            for line in self._process.stdout:
                self._said.put(line)
        self._said.put(b"")

    def _how(self) -> str:
        code = self._process.wait()
        return f"ends its process ({f'signal {-code}' if code < 0 else f'exit code {code}'}); mend that"


def answer_to(line: bytes, start: int, stop: int) -> dict[str, Any]:
    """Returns the answer in a line for this batch; empty if it is no answer to it."""
    try:
        said = json.loads(line)
        same_batch, runs = said["batch"] == [start, stop], [row["run"] for row in said.get("rows", [])]
    except (ValueError, RecursionError, LookupError, TypeError, AttributeError):  # no JSON, or other
        return {}
    return said if same_batch and runs in ([], list(range(start, stop))) and said.get("rows") != [] else {}


def main() -> None:
    """The process: batches until there is no more to be done."""
    requests, answers = _kept(0, os.O_RDONLY), _kept(1, os.O_WRONLY)
    sys.stdin, sys.stdout = io.StringIO(), sys.stderr

    process, batch = os.getpid(), list[int]()

    def answer(said: dict[str, Any]) -> None:
        if os.getpid() != process:  # forked by what no call guards, as where an object of a law's goes
            leave_at_once(0)
        answers.write(json.dumps({"batch": batch, **said}, allow_nan=False).encode() + b"\n")
        answers.flush()

    def leave(said: str) -> None:
        answer({"left": said})
        leave_at_once(LEFT)

    leave_by(leave)
    plan: Plan = pickle.load(requests)
    for line in requests:
        batch[:] = start, stop = [int(number) for number in line.split()]
        try:
            rows = run_batch(plan, start, stop)
        except Exception as error:
            answer({"error": f"{type(error).__name__}: {error}"})
            raise
        answer({"rows": rows})
    leave_at_once(0)  # threads that a law has begun may go on for ever


def _kept(number: int, mode: int) -> BinaryIO:
    """Returns a private copy of a file descriptor; under its own number stdin then is empty, and stdout is stderr, for any
    code.
    """
    kept = os.fdopen(os.dup(number), "rb" if mode == os.O_RDONLY else "wb")
    other = os.open(os.devnull, mode) if mode == os.O_RDONLY else os.dup(2)
    os.dup2(other, number)
    os.close(other)
    return kept


if __name__ == "__main__":
    hide_numpy_warnings()
    main()
