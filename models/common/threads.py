"""One BLAS thread: the matrices here are small, and threads that wait for each other cost a hundredfold on a busy machine.

Nor must the rounding of a design depend on how many threads there are.
"""

import functools
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import ThreadpoolController


@functools.cache
def _libraries() -> ThreadpoolController:
    return ThreadpoolController()


@contextmanager
def one_thread() -> Iterator[None]:
    """Within it, or in a function that it decorates, BLAS has one thread."""
    with _libraries().limit(limits=1, user_api="blas"):
        yield
