"""Work shared out among threads; none of it goes on when nobody waits for it."""

import contextvars
import itertools
import threading
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import TypeVar

AHEAD = 2  # pieces in hand per thread: one runs, one waits

Result = TypeVar("Result")
Piece = Callable[[Callable[[], bool]], Result]  # given a function that says whether to give up


def side_by_side(pieces: Iterable[Piece[Result]], threads: int) -> Generator[tuple[int, Result]]:
    """The number and the result of every piece of work, in the order in which they are done.

    Pieces are taken from what they come from as threads become free, and run in the context of whoever asks for the first result.
    Whoever asks for no more, as after Ctrl-C, has to close the iterator: that waits for those at work, which are told to give up.

    Args:
        pieces: of work; long ones first, or one thread ends alone.
        threads: how many.
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
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)
