"""Room in memory, where a shell or a batch system limits the address space (`ulimit -v`)."""

import errno
from pathlib import Path

from models.common.errors import InputError

LEAST = 700_000_000  # bytes; with less, OpenBLAS gives up, asks the system for its buffers for ever, or reads where it has none
AMPLE = 2**32  # bytes, with which every command has room
SHORT = 2**27  # bytes of room; with less, any error may be due to lack of memory


def limit() -> float:
    """Returns the allowed size of the address space in bytes, infinite if there is no limit."""
    try:
        import resource
    except ImportError:  # on Windows
        return float("inf")
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return float("inf") if soft == resource.RLIM_INFINITY else soft


def room() -> float:
    """Returns what is left of the address space in bytes, infinite if there is no limit."""
    try:
        import resource

        return limit() - int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    except (ImportError, OSError):  # not every system tells the size that is in use
        return limit()


def words() -> str:
    """Returns the allowed size in words."""
    return f"the address space is limited to {limit() / 1e6:.0f} MB (ulimit -v)"


def check(least: float = LEAST, instead: str = "") -> None:
    """Checks that the limit leaves enough room, and reserves the memory that must not be missing later.

    Args:
        least: needed address space in bytes.
        instead: advice beside that to raise the limit, for the message.

    Raises:
        InputError: the limit leaves too little.
    """
    if limit() < least:
        raise InputError(f"{words()}, and at least {least / 1e6:.0f} MB are needed; raise the limit{instead}")
    if limit() < AMPLE:
        import scipy.linalg  # noqa: F401 - its OpenBLAS takes its buffer now, and would ask for ever where none is left


def is_short(error: BaseException) -> bool:
    """Returns True if an error is, or may be, due to lack of memory.

    A thread that cannot begin lacks the address space of its stack, if that is limited; Python and Rerun say it in words alone.
    """
    wants = isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM
    text = str(error).lower()
    if isinstance(error, (OSError, RuntimeError)) and "thread" in text and limit() < AMPLE:
        return True
    return wants or "allocate memory" in text or "failed to map segment" in text or room() < SHORT
