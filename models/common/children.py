"""Child processes in Python that answer messages one after another.

Every wait for an answer has a time limit, and if a child ends, the wait for its answer raises an exception. A child can
therefore execute code that hangs or crashes.

Unlike children of `multiprocessing`, these children do not import the user's script again, so scripts do not need `if __name__
== "__main__"`. The standard input of a child is empty, and everything that a child prints goes to stderr. A child ignores
Ctrl-C, and ends when its parent ends, even in the middle of a call.
"""

import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
import traceback
import warnings
import weakref
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import IO, Any

Answers = Callable[[Iterator[Any]], Iterator[Any]]  # generator function of a module that yields one answer for each message
# Environment variables that limit BLAS to one thread, because additional threads would only wait
ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL")}
GRACE = 0.5  # time [s] that a child process has to finish after its parent has ended or has closed the pipe


class EndedError(Exception):
    """The child process has ended. The message contains the exit code, or the signal that ended the process."""


class Child:
    """Handle of a child process in its parent. The child process ends when this handle is deleted."""

    def __init__(self, answers: Answers) -> None:
        """Starts the process.

        Args:
            answers: generator function that runs in the child. The function receives an iterator of messages and yields an
                answer for each message. If the function yields or raises an exception, `receive` raises the same exception in
                the parent. If the function raises an exception instead of yielding an exception, the child also ends.
        """
        code = f"import sys; sys.path[:] = {sys.path!a}; from models.common.children import serve; serve()"
        process = subprocess.Popen(
            [sys.executable, "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # with this setting, Ctrl-C reaches only the parent process
            env=ONE_THREAD | os.environ,
        )
        _running_processes.add(process)
        self._process, self._answers = process, queue.SimpleQueue[Any]()
        self.end = weakref.finalize(self, _end, process)
        threading.Thread(target=_read, args=(process.stdout, self._answers), daemon=True, name="roadproof-child").start()
        self.send(answers)

    @property
    def ended(self) -> bool:
        """True if the child process has ended, by itself or because its parent ended it."""
        return self._process.poll() is not None

    def ask(self, message: Any, longest: float | None = None) -> Any:
        """Sends a message and returns the answer; see `receive`."""
        self.send(message)
        return self.receive(longest)

    def send(self, message: Any) -> None:
        """Sends a message, which must be picklable."""
        written = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
        assert self._process.stdin is not None, "it is a pipe"
        with suppress(OSError, ValueError):  # the child process has ended, which `receive` will notice
            self._process.stdin.write(written)
            self._process.stdin.flush()

    def receive(self, longest: float | None = None) -> Any:
        """Returns the next answer.

        Args:
            longest: time limit [s]; None for no limit.

        Raises:
            TimeoutError: the time limit has passed; the child is then terminated.
            EndedError: the child has ended.
            Exception: the child has answered with an exception, which is raised here.
        """
        try:
            # The remaining time may be negative, so it is limited to 0
            answer = self._answers.get(timeout=None if longest is None else max(0.0, longest))
        # Every exception ends the child, even KeyboardInterrupt. Otherwise, the pending answer would be taken for the answer to
        # the next message
        except BaseException as error:
            self.end()
            raise (TimeoutError if isinstance(error, queue.Empty) else error) from None
        if answer is EndedError:
            self._answers.put(answer)
            code = self._process.wait()
            raise EndedError(f"exit code {code}" if code >= 0 else f"signal {signal.Signals(-code).name}")
        if isinstance(answer, Exception):
            raise answer
        return answer


# Child processes that are running at present
_running_processes: "weakref.WeakSet[subprocess.Popen[bytes]]" = weakref.WeakSet()


def kill_children() -> None:
    """Terminates all child processes immediately, so that no code waits for an answer of a child."""
    for process in list(_running_processes):
        process.kill()


def _read(pipe: IO[bytes], answers: "queue.SimpleQueue[Any]") -> None:
    """Reads the answers of a child until the child ends."""
    with pipe, suppress(EOFError, OSError, pickle.UnpicklingError):
        while True:
            answers.put(pickle.load(pipe))
    answers.put(EndedError)


def _end(process: "subprocess.Popen[bytes]") -> None:
    """Ends a child by closing its input, and kills the child if it still runs after twice the time `GRACE`."""
    assert process.stdin is not None, "it is a pipe"
    with suppress(OSError):
        process.stdin.close()
    try:
        process.wait(2 * GRACE)
    except subprocess.TimeoutExpired:  # the code in the child process does not let the thread `_listen` run
        process.kill()
        process.wait()


def serve() -> None:
    """Answers the messages of the parent; this function runs in the child process. The first message is the function that
    answers all later messages.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    with open(os.devnull, "rb") as empty, suppress(OSError):  # an OSError is ignored, because stderr may be closed
        os.dup2(empty.fileno(), 0)
        os.dup2(2, 1)
    if not sys.warnoptions:
        warnings.simplefilter("ignore", RuntimeWarning)  # NumPy's warnings are ignored here, as in commands
    sys.stdout, messages = sys.stderr, queue.SimpleQueue[Any]()
    threading.Thread(target=_listen, args=(requests, messages), daemon=True).start()
    function: Answers = messages.get()
    try:
        for answer in function(iter(messages.get, _listen)):
            answers.write(pickle.dumps(answer, pickle.HIGHEST_PROTOCOL))
            answers.flush()
    except Exception as error:
        with suppress(OSError):  # the parent process has ended
            answers.write(pickle.dumps(error))
            answers.flush()


def _listen(requests: IO[bytes], messages: "queue.SimpleQueue[Any]") -> None:
    """Reads messages.

    If the parent has ended or closed the pipe, the iterator of messages ends, and the process ends after the time `GRACE`.
    """
    try:
        while True:
            messages.put(pickle.load(requests))
    except EOFError:
        pass
    except Exception:
        traceback.print_exc()
    messages.put(_listen)
    time.sleep(GRACE)
    os.kill(os.getpid(), signal.SIGTERM)
