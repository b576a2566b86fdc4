"""`python -m sim.report.worker`: a process that does pieces of a report, as `sim.report.worker_processes` asks it to.

It reads a piece and what it is about, and writes its result; it ends where a piece fails, or where whoever asks has ended.
"""

import os
import pickle
import queue
import threading
from os import _exit as leave_at_once
from typing import BinaryIO

import sim.report.contents  # noqa: F401 - all that a piece needs, before the first is asked for
from models.common.interrupt import hide_numpy_warnings


def main() -> None:
    """Does pieces until there is no more to be done."""
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no answer
    pieces: queue.SimpleQueue = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(requests, pieces), daemon=True).start()
    while True:
        piece, scope = pieces.get()
        try:
            answer = pickle.dumps(piece(scope))
        except Exception:
            leave_at_once(1)
        answers.write(answer)
        answers.flush()


def _listen(requests: BinaryIO, pieces: queue.SimpleQueue) -> None:
    """Reads pieces; ends the process, whatever it is at, when nobody can ask for more."""
    try:
        while True:
            pieces.put(pickle.load(requests))
    finally:
        leave_at_once(0)


if __name__ == "__main__":
    hide_numpy_warnings()
    main()
