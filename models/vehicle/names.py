"""Names of controllers, roads and loads in vehicle files and commands, as in `bump + brake:g=0.5`.

The module does not import the code that builds roads, because help pages use it and must be fast.
"""

import re
import unicodedata
from collections.abc import Collection, Iterable
from pathlib import Path

from models.common.errors import InputError, short_repr

WITHOUT = ("noise", "delay", "limits", "lag")  # parts of a vehicle that can be omitted in a run
PASSIVE = "passive"  # name of the controller without force, which every vehicle has
COPY = "_printed"  # suffix for the name of a copy of a controller, which has the gain published in a paper
LONGEST_NAME = 60  # largest length of a name [bytes]; a file name can contain the names of three controllers


def check_name(where: str, name: str, taken: Collection[str]) -> None:
    """Checks the name of a controller.

    Raises:
        InputError: the name is already used, is too long, or contains characters that are not allowed.
    """
    if name in taken or name == "all":
        raise InputError(
            f"{where} the name {name!r} is reserved (reserved names are passive, state and all); rename the controller"
        )
    if len(name.encode()) > LONGEST_NAME or not _is_name(name):
        raise InputError(
            f"{where} the controller's name {short_repr(name)} is not allowed; use letters, digits, '_' and '-', without '-' "
            f"at the beginning, and at most {LONGEST_NAME} bytes of UTF-8"
        )


def _is_name(name: str) -> bool:
    """Returns True if a name has only allowed characters. Vowel signs, as in Hindi and Thai, count as parts of letters, which
    are allowed.
    """
    kinds = ["L" if letter.isalnum() else "-" if letter in "_-" else unicodedata.category(letter) for letter in name]
    return "L" in kinds and {*kinds} <= {"L", "-", "Mn", "Mc"} and kinds[0] not in ("Mn", "Mc") and not name.startswith("-")


ROAD_KINDS = ("iso8608", "bump", "watts_hump", "step", "pothole", "sweep", "flat", "sine", "rig")
CLASSES = "ABCDEFGH"  # road classes of ISO 8608
# Height [m], length [m] and speed [m/s] of the bump in the reference paper, equation (62)
BUMP_HEIGHT, BUMP_LENGTH, BUMP_SPEED = 0.1, 5.0, 12.5
ROAD_SYNTAX = (
    f"give one of {', '.join(ROAD_KINDS)}, with numbers as :NAME=VALUE, such as pothole:depth=0.03:length=2, or a file (.csv, "
    ".txt, .xlsx, .mat, .erd, .rdf or .crg), such as road.csv:height_unit=mm, or the drive file of a rig, such as "
    "rig:file=drive.csv. Add loads with +, such as bump + brake:g=0.5"
)
SETTINGS = r"(?P<settings>(:\w+=[^:]*|:[^:\\/]*)*)"
FILE = re.compile(rf"(?P<path>.+\.(?P<suffix>csv|txt|crg|erd|rdf|mat|xlsx)){SETTINGS}", re.IGNORECASE | re.DOTALL)
RIG = re.compile(rf"rig:file=(?P<path>.+\.(?P<suffix>csv|txt)){SETTINGS}", re.IGNORECASE | re.DOTALL)


def named_file(text: str) -> tuple[str, str] | None:
    """Returns the path of the file in the text of a road, and the type of road that the text describes: "rig" or "profile".

    Returns None if the text does not contain a file.
    """
    if rig := RIG.fullmatch(text):
        return rig["path"], "rig"
    profile = FILE.fullmatch(text)
    return (profile["path"], "profile") if profile else None


LOAD_KINDS = ("brake", "corner", "payload", "lift", "gust")
PLUS = " + "  # this text separates the loads in a description
LOAD_SYNTAX = (
    f"give one of {', '.join(LOAD_KINDS)}, with numbers as :NAME=VALUE, such as brake:g=0.5:start=1:rise=0.2:hold=2 or "
    "payload:mass=100:x=-1.2, or a .csv file"
)
LOAD_SEPARATOR = rf"\s*\+\s*(?=(?:{'|'.join(LOAD_KINDS)})(?:[:+]|\s*$))"
FILE_SEPARATOR = r"\s+\+\s+(?=\S[^+]*\.csv\s*(?:$|\+))"
PART_SEPARATOR = re.compile(
    rf"{LOAD_SEPARATOR}|{FILE_SEPARATOR}", re.IGNORECASE
)  # this text separates a road from its loads, and each load from the next load


def split_off(text: str) -> tuple[str, list[str]]:
    """Splits a text such as `bump + brake:g=0.5 + push.csv` into the text of the road and the texts of the loads."""
    road, *loads = PART_SEPARATOR.split(text)
    return road, loads


def named_files(texts: Iterable[str | None]) -> list[Path]:
    """Returns the paths of the files to which the texts of roads and loads refer."""
    from models.common.files import path_from

    parts = (part.strip() for text in texts if text for road, loads in (split_off(text),) for part in (road, *loads))
    return [path_from(file[0]) for file in map(named_file, parts) if file]


def is_load_file(text: str) -> bool:
    """Returns True if the text of a load refers to a file."""
    return text.strip().lower().endswith(".csv")


def run_without(names: Iterable[str], part: str) -> list[str]:
    """Returns the controllers whose runs change if a part of the limits or implementation is omitted.

    The run of the passive vehicle changes only if the omitted part is `limits`.
    """
    return [name for name in names if name != PASSIVE or part == "limits"]


def variant(part: str) -> str:
    """Returns the suffix by which tables mark a run without a part of the limits or implementation; empty for a run with all
    parts.
    """
    return f", no {part}" if part else ""


def logged_variant(part: str) -> str:
    """Returns the suffix by which logs mark a run without a part of the limits or implementation; empty for a run with all
    parts.
    """
    return f"-no_{part}" if part else ""


def logged_part(name: str, controller: str) -> str:
    """Returns the part of the limits or implementation that a logged run omits, from the name of the run; empty if the run has
    all parts.
    """
    part = name.removeprefix(f"{controller}-no_") if name != controller else ""
    return part if part in WITHOUT else ""


def without_copies(names: Iterable[str]) -> list[str]:
    """Returns the names of controllers without copies that have a published gain, such as the copy `I_printed` of `I`."""
    every = list(names)
    return [name for name in every if name.removesuffix(COPY) not in every or not name.endswith(COPY)]
