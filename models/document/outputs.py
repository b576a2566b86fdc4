"""Output files and folders of a command. The paths of the outputs are checked before the work begins, and listed at the end."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.common.files import STDOUT, check_file, check_folder, identity
from models.common.printed import Whole

SUFFIXES = (".png", ".svg", ".pdf")  # suffixes of file names for pictures
OPTIONS = {"report": "out", "vehicle": "out"}  # options of commands whose name differs from the name of the output
FOLDERS = ("logs", "figures", "certificates")
ENDINGS = {  # suffixes that the file name of each output may have, and the reason
    "picture": (SUFFIXES, "this kind of picture cannot be written"),
    "report": ((".html", ".htm"), "a report is HTML"),
    "csv": ((".csv",), "a table is written as CSV"),
    "save": ((".toml",), "a vehicle file is TOML"),
    "vehicle": ((".toml",), "vehicle files and maps are TOML"),
}
CHECKED_BY = "# checked by: roadproof synth --check THIS_FILE"
CAMPAIGN_SUM = "# SHA-256 of the campaign and the files that it names: "
IDENTIFIED = "# 95 % intervals [SI] of roadproof identify"
# every saved vehicle file contains one of these texts; older files contain `python -m synth` instead of `roadproof synth`
SAVED_COMMENTS = (CHECKED_BY.partition("roadproof ")[2], CAMPAIGN_SUM, IDENTIFIED)
TEXTS = ("csv", "save")  # outputs that may be written to standard output
OF_FIGURES = (*SUFFIXES, ".csv")


def check_outputs(outputs: Mapping[str, Path | None], read: Sequence[Path | str] = (), json: bool = False) -> None:
    """Checks that all outputs can be written, each to a file of its own. The check leaves no files or folders behind.

    Args:
        outputs: paths by type of output (csv, picture, report, save, vehicle, logs or figures); None for outputs that are not
            requested.
        read: paths of the files that the command reads. An output may not replace an input file, even under a second name of
            the file or through a link.
        json: True if standard output is reserved for one JSON object.

    Raises:
        InputError: an output cannot be written, has the suffix of a different format, or is the same file as an input or as
            another output. The error is also raised if a vehicle file would replace a file that no command has saved.
    """
    read_files = {identity(Path(path)) for path in read}
    taken: dict[object, str] = dict.fromkeys(read_files, "is an input file")
    for what, path in outputs.items():
        option = OPTIONS.get(what, what)
        if path is None:
            continue
        if path == STDOUT and json:
            raise InputError(
                f"--{option} {path} and --json both write to standard output; give --{option} a file instead of standard output"
            )
        place = str(path) if path == STDOUT else identity(path)
        if place in taken:
            raise InputError(f"--{option} {path} {taken[place]}; give another file")
        taken[place] = f"is the file of --{option}, too"
    for what, path in outputs.items():
        if path is None:
            continue
        if what in FOLDERS:
            check_folder(path, what)
        else:
            _check_ending(path, what)
            check_file(path, what)
            if what in ("save", "vehicle") and not _is_own(path):
                option = f"--{OPTIONS.get(what, what)}"
                raise InputError(
                    f"{option} {path} already exists, but was not written by {option}; give another name, or remove the "
                    "existing file"
                )
        if what == "picture":
            FEATURES.load("pictures").check_drawing()
        elif what == "figures" and path.is_dir():
            for file in path.iterdir():  # the names of the figures are known only after the figures are drawn
                if file.suffix.lower() in OF_FIGURES and identity(file) in read_files:
                    raise InputError(
                        f"--figures {path} contains the input file {file.name}, which a figure could overwrite; give "
                        "another folder"
                    )


def _check_ending(path: Path, what: str) -> None:
    """Refuses a path whose suffix does not match the type of the output.

    For a link, the suffix of the link is checked, not the suffix of its target.
    """
    endings, why = ENDINGS[what]
    if path.suffix.lower() not in endings and not (path == STDOUT and what in TEXTS):
        raise InputError(f"{what} {path}: {why}; give a name that ends in {' or '.join(endings)}")


def _is_own(path: Path) -> bool:
    """Returns True if saving a vehicle file destroys no data: the file does not exist, is empty, or was saved by a command."""
    if not path.is_file() or not path.stat().st_size:
        return True
    with path.open("rb") as lines:
        return any(mark.encode() in line for line in lines for mark in SAVED_COMMENTS)


def output_paths(outputs: Mapping[str, Path | None]) -> dict[str, str | None]:
    """Returns the paths of the outputs for JSON."""
    return {name: str(path) if path is not None else None for name, path in outputs.items()}


def written_lines(outputs: Mapping[str, Path | None]) -> list[str]:
    """Returns the paths of the outputs as lines for the terminal; empty if there are no outputs."""
    lines = [line for name, path in outputs.items() if path is not None for line in (name, Whole(f"  {path}"))]
    return ["", *lines] if lines else []
