"""Parallel work on several threads, with BLAS limited to a single thread.

The matrices of this project are small. On a busy machine, calculations with BLAS threads that wait for each other would take a
hundred times longer. In addition, the rounding errors of a design must not depend on the number of BLAS threads.
"""

import contextvars
import functools
import itertools
import os
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import TypeVar

from threadpoolctl import ThreadpoolController


@functools.cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


class _Limit:
    """Limits the process to one BLAS thread while at least one block that requests this limit is running."""

    def __init__(self) -> None:
        self._lock, self._within = threading.Lock(), 0

    def enter(self) -> None:
        with self._lock:
            if not self._within:
                self._set = _libraries().limit(limits=1, user_api="blas")
            self._within += 1

    def leave(self) -> None:
        with self._lock:
            self._within -= 1
            if not self._within:
                self._set.restore_original_limits()


_limit = _Limit()


@contextmanager
def one_thread() -> Iterator[None]:
    """Limits BLAS to one thread in a block or in a decorated function. Blocks and decorated functions may be nested at almost
    no cost.
    """
    _limit.enter()
    try:
        yield
    finally:
        _limit.leave()


AHEAD = 2  # number of pieces of work that are taken in advance for each thread: one piece runs, and one piece waits

Result = TypeVar("Result")
# A piece of work is called with a function that returns True if the work is to be abandoned
Piece = Callable[[Callable[[], bool]], Result]


def cores() -> int:
    """Returns the number of processors that this process may use, at least 1.

    A container or scheduler may limit the number of processors.
    """
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed is not None else os.cpu_count() or 1


def side_by_side(
    pieces: Iterable[Piece[Result]], threads: int, abandon: Callable[[], None] = lambda: None
) -> Generator[tuple[int, Result]]:
    """Yields the index and the result of every piece of work, in the order in which the pieces are completed.

    A thread takes the next piece of work when the thread becomes free. Each piece runs in the Python context (`contextvars`) of
    the first call of `next`. A caller that stops early must close the iterator, which abandons the running pieces and waits for
    them.

    Args:
        pieces: pieces of work. Long pieces of work should come first, so that all threads end at about the same time.
        threads: number of threads.
        abandon: function that is called if the work is abandoned; the function must end whatever the running pieces wait for.
    """
    stop, coming = threading.Event(), enumerate(pieces)
    with ThreadPoolExecutor(threads) as pool:
        running: dict[Future[Result], int] = {}
        try:
            while True:
                for number, piece in itertools.islice(coming, threads * AHEAD - len(running)):
                    running[pool.submit(contextvars.copy_context().run, piece, stop.is_set)] = number
                if not running:
                    return
                for done in wait(running, return_when=FIRST_COMPLETED).done:
                    yield running.pop(done), done.result()
        except BaseException:  # this branch is also used if the caller stops before the last result
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
            abandon()
            raise
