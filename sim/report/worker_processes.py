"""Child processes for pieces of a report, because Python uses one core in each process."""

import pickle
import queue
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from models.common.children import Child
from models.common.threads import cores

if TYPE_CHECKING:  # it imports nearly everything, which children begin to import before this process does
    from sim.report.contents import Name, Piece
    from sim.report.scope import Subject

MOST = 3  # processes: more of them would wait for the longest piece


def processes(quick: bool) -> int:
    """Returns the number of worthwhile processes: 0 on one core, and for a quick report, which takes as long as their imports."""
    return 0 if quick else min(cores() - 1, MOST)


class WorkerPool:
    """Child processes that compute pieces of a report while this process computes others."""

    def __init__(self, count: int) -> None:
        """Starts as many processes. Without any, all pieces are computed here."""
        self._children, self._idle = [Child(_computed) for _ in range(count)], queue.SimpleQueue[Child]()
        for child in self._children:
            self._idle.put(child)
        self._threads = ThreadPoolExecutor(count) if count else None

    def __enter__(self) -> "WorkerPool":
        return self

    def __exit__(self, *error: object) -> None:
        for child in self._children:
            child.end()
        if self._threads is not None:
            self._threads.shutdown(cancel_futures=True)

    def begin(self, scope: "Subject", pieces: "dict[Name, Piece]") -> "Callable[[], dict[Name, Any]]":
        """Begins pieces of work, given by stage and subject. Long pieces come first, so that all processes end together.

        Returns:
            Function that returns all results by name. It computes here what no process has begun, from the last piece on, and
            what a process did not complete.
        """
        futures: dict[Name, Future[Any]] = {}
        if self._threads is not None:
            silent = replace(scope, progress=_silent)
            written = {name: pickle.dumps((piece, silent)) for name, piece in pieces.items()}  # before `scope` caches results
            futures = {name: self._threads.submit(self._elsewhere, piece) for name, piece in written.items()}

        def here(name: "Name") -> Any:
            _show(scope, name)
            return pieces[name](scope)

        def elsewhere(name: "Name") -> Any:
            _show(scope, name)
            try:
                return futures[name].result()
            except Exception:  # raised again here, where its traceback shows its cause
                return here(name)

        def results() -> "dict[Name, Any]":
            answers = {name: here(name) for name in reversed(pieces) if name not in futures or futures[name].cancel()}
            return answers | {name: elsewhere(name) for name in reversed(pieces) if name not in answers}

        return results

    def _elsewhere(self, piece: bytes) -> Any:
        """Returns the result of a piece from a child."""
        child = self._idle.get()
        try:
            return child.ask(piece)
        finally:
            self._idle.put(child)


def _computed(pieces: Iterator[bytes]) -> Iterator[Any]:
    """Computes pieces in a child."""
    import sim.report.contents  # noqa: F401 - all that a piece needs, before the first is requested

    for written in pieces:
        piece, scope = pickle.loads(written)
        yield piece(scope)


def _show(scope: "Subject", name: "Name") -> None:
    """Shows which piece is computed, or waited for."""
    stage, subject = name
    scope.progress(stage)
    if subject:
        scope.progress(f"of {subject}")


def _silent(text: str) -> None:
    """Ignores progress, which the main process shows."""
