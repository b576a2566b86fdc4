"""Files that are written whole or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from models.errors import InputError


@contextmanager
def whole_file(path: Path, what: str) -> Iterator[Path]:
    """A place beside the file to write to, of the same kind; what is written there gets its name when it is whole.

    Args:
        path: the file.
        what: it is, for the message.

    Raises:
        InputError: it cannot be written.
    """
    beside = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        yield beside
        beside.replace(path)
    except OSError as error:
        raise InputError(f"{what} {path}: cannot be written ({error.strerror or error}); give another") from error
    finally:
        beside.unlink(missing_ok=True)
