"""Road surfaces of ASAM OpenCRG, a grid of heights along and across a road, by PyOpenCRG."""

import math
import os
import re
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, first_few
from models.common.files import reading
from models.roads.profile import Profile, begun_at

AT_ONCE = 2**20  # heights that are worked out at once; PyOpenCRG takes some hundred bytes for each
TEXT_WIDTHS = {"LRFI": 10, "LDFI": 20}  # characters of a number, by format
LINE = 80  # characters of a line of numbers
FINEST, COARSEST = 1e-6, 1e3  # m between the lines of a grid
FURTHEST = 1e9  # m, and any other number of a header
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([ed][-+]?\d+)?|[-+]?inf", re.IGNORECASE)  # 2.000+e00 is read as 2: such files exist
ENTRY = re.compile(r"\s*(\w+)\s*=\s*([^\s!]+)")
GIVE = "give an OpenCRG file"


@dataclass(frozen=True, eq=False)
class Surface:
    """Heights of a road on a grid.

    Attributes:
        u: along the road [m], shape (P,).
        v: across it, to the left [m], ascending, shape (Q,).
        z: heights [m], shape (P, Q).
        source: the file.
    """

    u: Array
    v: Array
    z: Array
    source: str

    def begun_at(self, start: float) -> "Surface":
        """Returns the surface from a distance on [m].

        Raises:
            InputError: it does not reach there.
        """
        u, z = begun_at(start, self.u, self.z)
        return replace(self, u=u, z=z)

    def profile(self, track_width: float, speed: float) -> Profile:
        """Returns the profile under the wheels of a vehicle in the middle, straight between the grid's lines, as in OpenCRG.

        Args:
            track_width: from the right wheels to the left ones [m].
            speed: [m/s].

        Raises:
            InputError: the surface is too narrow, or has a hole.
        """
        middle, tracks = (self.v[0] + self.v[-1]) / 2, []
        for v in (middle + track_width / 2, middle - track_width / 2):
            if not self.v[0] <= v <= self.v[-1]:
                raise InputError(f"road file {self.source}: {self.v[-1] - self.v[0]:g} m wide, too narrow for {track_width:g} m")
            j = min(int(np.searchsorted(self.v, v, side="right")), len(self.v) - 1)
            share = (v - self.v[j - 1]) / (self.v[j] - self.v[j - 1])
            tracks.append(self.z[:, j - 1] + share * (self.z[:, j] - self.z[:, j - 1]))
        try:
            return Profile(self.u, np.stack(tracks, axis=-1), speed, self.source)
        except InputError as error:
            raise InputError(f"road file {self.source}: {error}") from error


def read_surface(path: Path) -> Surface:
    """Reads the surface of an OpenCRG file.

    Raises:
        InputError: PyOpenCRG is not installed, or the file is no OpenCRG file, too large, or refers to another one.
    """
    with reading(path, "road file", GIVE), path.open("rb"):
        pass
    try:
        from pyopencrg import CrgRoad, io  # pyright: ignore[reportMissingImports] - an extra
    except ImportError as error:
        raise InputError(f"road file {path} needs PyOpenCRG; install it with: pip install -e '.[opencrg]'") from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what its checks find and a profile does not need
            head = io.read_ipl(path, meta_only=True)
            numbers = _check_header(head.struct, [*head.kd_ind, *head.kd_def])
            _check_end(path, head.fmt, len(head.kd_def))
            road = CrgRoad.read(path)
            u, v = np.asarray(road.u, dtype=float), np.asarray(road.v, dtype=float)
            z = np.empty((len(u), len(v)))
            _check_whole(numbers, head.kd_ind, u)
            rows = max(1, AT_ONCE // len(v))
            for i in range(0, len(u), rows):
                z[i : i + rows] = road.uv_to_z(u[i : i + rows, None], v[None, :])
    except InputError as error:
        raise InputError(f"road file {path}: {error}") from error
    except OSError as error:
        raise InputError(f"road file {path}: cannot be read ({error.strerror or error})") from error
    except Exception as error:  # a reader of somebody else's: whatever it says, the file is none
        raise InputError(f"road file {path}: no OpenCRG file ({_reason(error, path)}); {GIVE}") from error
    return Surface(u, v, z, str(path))


def _check_header(struct: Iterable[str], channels: Iterable[str]) -> dict[str, float]:
    """Checks that a header's numbers can be a road's; PyOpenCRG would accept others, or replace them.

    Returns:
        The numbers of the road, by keyword.
    """
    block, numbers = "", {}
    for line in struct:
        if line.startswith("$"):
            block = line.strip("$ ").split("!")[0].strip().upper()
        if block == "ROAD_CRG_FILE":
            raise InputError("its data are in another file, that it names; give that one")
        entry = ENTRY.match(line) if block == "ROAD_CRG" else None
        if entry is None:
            continue
        name, text = entry[1].lower(), entry[2]
        value = _number(text)
        if name.endswith("_increment") and not FINEST <= value <= COARSEST:
            raise InputError(f"{name} = {text} is not allowed; from {FINEST:g} to {COARSEST:g} m are")
        if not abs(value) <= FURTHEST:
            raise InputError(f"{name} = {text} is not allowed; numbers from {-FURTHEST:g} to {FURTHEST:g} are")
        numbers[name] = value
    for channel in channels:
        for text in re.split(r"[,=\s]+", channel):
            value = _number(text, 0.0)
            if not abs(value) <= FURTHEST:
                raise InputError(f"channel {channel!r}: {text} is not allowed; numbers from {-FURTHEST:g} to {FURTHEST:g} are")
    return numbers


def _check_whole(numbers: Mapping[str, float], defined: Iterable[str], u: Array) -> None:
    """Checks the number of cross-sections against the header; text that is cut between two of them looks whole.

    Args:
        defined: channels that are not data; one may be the distance: reference line u, m, start, increment.
        u: distance of each cross-section [m].
    """
    given = [channel.split(",") for channel in defined if channel.lower().startswith("reference line u,")]
    step = numbers.get("reference_line_increment") or next((_number(parts[3], 0.0) for parts in given if len(parts) > 3), 0.0)
    if not step or "reference_line_end_u" not in numbers:
        return  # then nothing says how many there were
    promised = round((numbers["reference_line_end_u"] - u[0]) / step) + 1
    if len(u) < promised:
        raise InputError(
            f"has {len(u)} cross-sections, and its header promises {promised}, up to {numbers['reference_line_end_u']:g} m in "
            f"steps of {step:g} m: it was cut; give the whole file"
        )


def _check_end(path: Path, form: str, channels: int) -> None:
    """Checks that text ends with a whole line; if numbers of fixed width are cut off, it may look whole."""
    if form not in TEXT_WIDTHS:
        return
    width = TEXT_WIDTHS[form]
    with path.open("rb") as file:
        file.seek(-min(os.fstat(file.fileno()).st_size, 4 * LINE), os.SEEK_END)
        last = file.read().rstrip(b"\r\n").rpartition(b"\n")[2]
    expected = ((channels - 1) % (LINE // width) + 1) * width
    if len(last) < expected:
        raise InputError(f"its last line has {len(last)} characters, and {expected} are due: it was cut; give the whole file")


def _number(text: str, otherwise: float = math.nan) -> float:
    match = NUMBER.match(text)
    return float(match[0].lower().replace("d", "e")) if match else otherwise


def _reason(error: Exception, path: Path) -> str:
    """Returns PyOpenCRG's message on one line; it may list many mistakes below a first line without any."""
    report = getattr(error, "report", None)
    if report is not None:
        return first_few([problem.removeprefix("(reading) ") for problem in report.errors or report.warnings])
    text = " ".join(str(error).removeprefix(f"{path}: ").split())
    return text or type(error).__name__
