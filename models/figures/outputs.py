"""The files and folders that a command's options name: proved before the work, and named when they are written."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from models.common.errors import InputError
from models.common.printed import Whole
from models.common.whole_file import STDOUT, check_file, check_folder, identity
from models.figures.picture import check_picture

OPTIONS = {"report": "out"}  # where an option is not called as what it writes
FOLDERS = ("logs", "figures")


def check_outputs(outputs: Mapping[str, Path | None], read: Sequence[Path | str] = (), json: bool = False) -> None:
    """Proves that everything can be written, each in a place of its own; nothing is left of the proof.

    Args:
        outputs: path by what it is, None for what is not wanted: csv, picture, report, logs or figures.
        read: files that the command reads, by whatever names they are read.
        json: whether standard output is for one JSON object.

    Raises:
        InputError: something cannot be written, two are one file, or one is a file that is read.
    """
    taken: dict[object, str] = {identity(Path(path)): "is what is read" for path in read}
    for what, path in outputs.items():
        option = OPTIONS.get(what, what)
        if path is None:
            continue
        if path == STDOUT and json:
            raise InputError(f"--{option} {path} and --json would print into one another; give --{option} a file")
        place = str(path) if path == STDOUT else identity(path)
        if place in taken:
            raise InputError(f"--{option} {path} {taken[place]}; give another file")
        taken[place] = f"is the file of --{option} too"
        if what == "picture":
            check_picture(path)
        elif what in FOLDERS:
            check_folder(path, what)
        else:
            check_file(path, what)


def written(outputs: Mapping[str, Path | None]) -> dict[str, str | None]:
    """What was written, as JSON has it."""
    return {name: str(path) if path is not None else None for name, path in outputs.items()}


def written_lines(outputs: Mapping[str, Path | None]) -> list[str]:
    """What was written, in lines for the terminal; none where nothing was."""
    lines = [line for name, path in outputs.items() if path is not None for line in (name, Whole(f"  {path}"))]
    return ["", *lines] if lines else []
