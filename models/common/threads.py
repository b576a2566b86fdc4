"""One BLAS thread: the matrices here are small, and threads that wait for each other cost a hundredfold on a busy machine.

Nor must the rounding of a design depend on how many threads there are.
"""

import functools
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import ThreadpoolController


@functools.cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


class _Limit:
    """The one limit of the process: BLAS has one number of threads for all who are within, whichever was first or is last."""

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
    """Within it, or in a function that it decorates, BLAS has one thread. Within another it costs next to nothing."""
    _limit.enter()
    try:
        yield
    finally:
        _limit.leave()
