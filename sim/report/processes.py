"""Processes for the requests of a page, because Python uses one core in each process."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import TYPE_CHECKING, Any

from models.common.threads import cores

if TYPE_CHECKING:  # it imports nearly everything, which children begin to import before this process does
    from sim.studies.study import Progress

MOST = 3  # processes: more of them would wait for the longest request
Name = tuple[str, str]  # of a request: its study, and its subject there


def processes(quick: bool) -> int:
    """Returns the number of worthwhile processes: 0 on one core, and for a quick report, which takes as long as their imports."""
    return 0 if quick else min(cores() - 1, MOST)


class Processes:
    """Pool of processes that run the requests of pages. Without a process, requests run here."""

    def __init__(self, count: int) -> None:
        """Starts as many processes, which import what requests need."""
        self._pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _end_with_parent) if count else None
        if self._pool is not None:
            block = getattr(signal, "pthread_sigmask", lambda *_: None)  # Windows has no such function
            block(signal.SIG_BLOCK, {signal.SIGINT})  # children inherit this: Ctrl-C is for this process
            for _ in range(count):
                self._pool.submit(_prepare)
            block(signal.SIG_UNBLOCK, {signal.SIGINT})

    def __enter__(self) -> "Processes":
        return self

    def __exit__(self, kind: object, *error: object) -> None:
        if self._pool is None:
            return
        if kind is not None:  # nobody waits for the results
            for child in multiprocessing.active_children():
                child.terminate()
        self._pool.shutdown(cancel_futures=True)

    def begin(self, requests: Mapping[Name, Any], progress: "Progress") -> Callable[[], dict[Name, Any]]:
        """Begins requests in their order.

        Returns:
            Function that returns all results by name. It runs here what no process has begun, from the last request on, and what
            a process did not complete.
        """
        futures: dict[Name, Future[Any]] = {}
        if self._pool is not None:
            futures = {name: self._pool.submit(_run, name[0], request) for name, request in requests.items()}

        def here(name: Name) -> Any:
            progress(name[0])
            return _run(name[0], requests[name], progress)

        def elsewhere(name: Name) -> Any:
            progress(name[0])
            try:
                return futures[name].result()
            except BrokenProcessPool:
                return here(name)

        def results() -> dict[Name, Any]:
            found = {name: here(name) for name in reversed([*requests]) if name not in futures or futures[name].cancel()}
            return found | {name: elsewhere(name) for name in reversed([*requests]) if name not in found}

        return results


def _run(name: str, request: Any, progress: "Progress" = lambda text: None) -> Any:
    """Returns the result of a request to a study, for a page."""
    from models.common.extensions import STUDIES

    one = STUDIES.load(name)(name)
    return one.for_page(one.run(request, progress))


def _prepare() -> None:
    """Imports what most requests need."""
    from models.common.extensions import STUDIES

    STUDIES.load_all()


def _end_with_parent() -> None:
    """Ends this child when its parent ends, even if the parent is killed."""
    parent = multiprocessing.parent_process()
    assert parent is not None, "this is a child"
    threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()
