"""Pieces of a report in processes beside this one, as Python runs one thing at a time in each."""

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from models.common import interrupt
from models.common.threads import cores
from models.kinds.kind import HERE
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:  # that imports nearly everything, which is to be begun in all processes at once
    from sim.report.scope import Scope

ROOT = Path(__file__).parent.parent.parent
MOST = 3  # processes: more of them would wait for the longest piece

Name = tuple[str, str]
Piece = Callable[["Scope"], Any]  # a function of a module, or a `partial` of one, as it is sent by its name


def processes(vehicle: Vehicle, quick: bool) -> int:
    """Returns the number of worthwhile processes: 0 in a library, on a single core, and if a user's own code is run.

    A quick report has one long piece only, so it has one process at most. A user's code may print, start processes or never end;
    only the main process can handle that.
    """
    own = vehicle.kind.folder != HERE or any(entry.python is not None for entry in vehicle.controllers.values())
    return 0 if own or interrupt.interrupt_pending() is None else min(cores() - 1, 1 if quick else MOST)


class Beside:
    """Processes that take pieces of work. They import while this one designs, and take no Ctrl-C: this one ends them."""

    def __init__(self, count: int) -> None:
        """Begins as many; with none, all of the work is done here."""
        known = os.environ.get("PYTHONPATH")
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *([known] if known else []), os.curdir])}
        command = [sys.executable, "-P", "-m", "sim.report.worker"]
        self._all = [
            subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, start_new_session=True, bufsize=-1
            )
            for _ in range(count)
        ]
        self._idle = list(self._all)
        self._threads = ThreadPoolExecutor(count) if count else None

    def __enter__(self) -> "Beside":
        return self

    def __exit__(self, *error: object) -> None:
        for process in self._all:
            process.kill()
            process.wait()
        if self._threads is not None:
            self._threads.shutdown(cancel_futures=True)
        for process in self._all:
            for pipe in (process.stdin, process.stdout):
                with suppress(OSError):
                    assert pipe is not None, "both are pipes"
                    pipe.close()

    def begin(self, scope: "Scope", pieces: dict[Name, Piece]) -> Callable[[], dict[Name, Any]]:
        """Begins pieces of work, by their stage and of what they are; long ones first, or one process ends alone.

        Returns:
            What gives all results, by name. It does here what no process has begun, from the last on, and waits for the others.
        """
        futures: dict[Name, Future[Any]] = {}
        if self._threads is not None:
            import cloudpickle  # kinds of vehicle have functions without names

            silent = replace(scope, progress=_silent)
            written = {name: cloudpickle.dumps((piece, silent)) for name, piece in pieces.items()}  # before anything changes
            futures = {name: self._threads.submit(self._elsewhere, piece) for name, piece in written.items()}

        def here(name: Name) -> Any:
            _show(scope, name)
            return pieces[name](scope)

        def elsewhere(name: Name) -> Any:
            _show(scope, name)
            try:
                return futures[name].result()
            except (OSError, EOFError, pickle.PickleError):
                return here(name)

        def results() -> dict[Name, Any]:
            answers = {name: here(name) for name in reversed(pieces) if name not in futures or futures[name].cancel()}
            return answers | {name: elsewhere(name) for name in reversed(pieces) if name not in answers}

        return results

    def _elsewhere(self, piece: bytes) -> Any:
        """Returns the result of a piece from a process."""
        if not self._idle:
            raise EOFError
        process = self._idle.pop()
        assert process.stdin is not None, "it is a pipe"
        assert process.stdout is not None, "it is a pipe"
        process.stdin.write(piece)
        process.stdin.flush()
        answer = pickle.load(process.stdout)
        self._idle.append(process)
        return answer


def _show(scope: "Scope", name: Name) -> None:
    """Says which piece is worked on, or waited for."""
    stage, what = name
    scope.progress(stage)
    if what:
        scope.progress(f"of {what}")


def _silent(text: str) -> None:
    """Ignores progress, which the main process shows."""
