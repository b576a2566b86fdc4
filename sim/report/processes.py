"""Processes that run the requests (computations of studies) of a page in parallel; a Python process uses only one core."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import TYPE_CHECKING, Any

from models.common.threads import cores

# imported only for type checks: at run time, it would import nearly everything before the child processes start
if TYPE_CHECKING:
    from sim.studies.study import Progress

# largest number of child processes; more processes would not save time, because the longest request alone takes as long
MOST = 3
Name = tuple[str, str]  # name of a request: the study that it belongs to, and its subject within this study


def processes(quick: bool) -> int:
    """Returns the best number of child processes: 0 on a single core, or for a quick report, which takes less time than the
    imports in child processes.
    """
    return 0 if quick else min(cores() - 1, MOST)


class Processes:
    """Pool of processes that run the requests of pages. Without child processes, the calling process runs the requests."""

    def __init__(self, count: int) -> None:
        """Starts `count` processes, which import the modules that most requests need."""
        self._pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _end_with_parent) if count else None
        if self._pool is not None:
            block = getattr(signal, "pthread_sigmask", lambda *_: None)  # this function does not exist on Windows
            # The signal is blocked, and child processes inherit the block, so that Ctrl-C reaches only this process
            block(signal.SIG_BLOCK, {signal.SIGINT})
            for _ in range(count):
                self._pool.submit(_prepare)
            block(signal.SIG_UNBLOCK, {signal.SIGINT})

    def __enter__(self) -> "Processes":
        return self

    def __exit__(self, kind: object, *error: object) -> None:
        if self._pool is None:
            return
        if kind is not None:  # after an error, the remaining results are not needed
            for child in multiprocessing.active_children():
                child.terminate()
        self._pool.shutdown(cancel_futures=True)

    def begin(self, requests: Mapping[Name, Any], progress: "Progress") -> Callable[[], dict[Name, Any]]:
        """Starts the requests in the order of the mapping `requests`.

        Args:
            requests: requests to run; the keys are their names.
            progress: callback that receives the name of the current study.

        Returns:
            Function that waits for all results and returns them by the name of the request. While this function waits, the
            calling process itself runs requests that no other process has started yet, beginning with the last request. If the
            pool of processes breaks, the calling process also runs all requests that have no result yet.
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
    """Runs a request of a study; returns the part of the result that the page needs."""
    from models.common.extensions import STUDIES

    one = STUDIES.load(name)(name)
    return one.for_page(one.run(request, progress))


def _prepare() -> None:
    """Imports the modules that most requests need."""
    from models.common.extensions import STUDIES

    STUDIES.load_all()


def _end_with_parent() -> None:
    """Ends this child process when its parent process ends, even if the parent is killed."""
    parent = multiprocessing.parent_process()
    assert parent is not None, "this is a child"
    threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()
