"""The files and folders that a command's options name: proved before the work, and named when they are written."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from models.common.errors import InputError
from models.common.files import STDOUT, check_file, check_folder, identity
from models.common.printed import Whole

SUFFIXES = (".png", ".svg")  # of pictures
OPTIONS = {"report": "out"}  # where an option is not called as what it writes
FOLDERS = ("logs", "figures")
ENDINGS = {  # of names, and what is written there
    "picture": (SUFFIXES, "not a kind of picture that is drawn"),
    "report": ((".html", ".htm"), "a report is HTML"),
    "csv": ((".csv",), "a table is written as CSV"),
    "save": ((".toml",), "a vehicle file is TOML"),
}
TEXTS = ("csv", "save")  # these may be printed
OF_FIGURES = (*SUFFIXES, ".csv")


def check_outputs(outputs: Mapping[str, Path | None], read: Sequence[Path | str] = (), json: bool = False) -> None:
    """Proves that everything can be written, each in a place of its own; nothing is left of the proof.

    Args:
        outputs: path by what it is, None for what is not wanted: csv, picture, report, save, logs or figures.
        read: files that the command reads, by whatever names they are read.
        json: whether standard output is for one JSON object.

    Raises:
        InputError: something cannot be written, has a name that says that it is something else, two are one file, or one is a
            file that is read.
    """
    read_files = {identity(Path(path)) for path in read}
    taken: dict[object, str] = dict.fromkeys(read_files, "is what is read")
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
    for what, path in outputs.items():
        if path is None:
            continue
        if what in FOLDERS:
            check_folder(path, what)
        else:
            _check_ending(path, what)
            check_file(path, what)
        if what == "picture":
            from models.figures.picture import check_drawing

            check_drawing()
        elif what == "figures" and path.is_dir():
            for each in path.iterdir():  # their names are known only when they are drawn
                if each.suffix.lower() in OF_FIGURES and identity(each) in read_files:
                    raise InputError(f"--figures {path} holds {each.name}, which is read; give another folder")


def _check_ending(path: Path, what: str) -> None:
    """Whether a name says what is written there: a name decides, not what a link of that name leads to.

    Raises:
        InputError: it ends otherwise.
    """
    endings, why = ENDINGS[what]
    if path.suffix.lower() not in endings and not (path == STDOUT and what in TEXTS):
        raise InputError(f"{what} {path}: {why}; give a name that ends in {' or '.join(endings)}")


def written(outputs: Mapping[str, Path | None]) -> dict[str, str | None]:
    """What was written, as JSON has it."""
    return {name: str(path) if path is not None else None for name, path in outputs.items()}


def written_lines(outputs: Mapping[str, Path | None]) -> list[str]:
    """What was written, in lines for the terminal; none where nothing was."""
    lines = [line for name, path in outputs.items() if path is not None for line in (name, Whole(f"  {path}"))]
    return ["", *lines] if lines else []
