"""Road surfaces in ASAM OpenCRG files, read by PyOpenCRG: a grid of heights along and across the road."""

import re
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, first_few
from models.common.files import reading
from models.roads.profile import Profile, begun_at

AT_ONCE = 2**20  # number of heights that are computed at once; PyOpenCRG needs several hundred bytes per height
TEXT_WIDTHS = {"LRFI": 10, "LDFI": 20}  # number of characters that one number has in each format
LINE = 80  # number of characters in a line that contains numbers
NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)"
GIVE = "give an OpenCRG file"


@dataclass(frozen=True, eq=False)
class Surface:
    """Heights of a road on a grid.

    Attributes:
        u: distances along the road [m], shape (P,).
        v: lateral positions, positive to the left [m], ascending, shape (Q,).
        z: heights [m], shape (P, Q).
        source: name of the file.
    """

    u: Array
    v: Array
    z: Array
    source: str

    def begun_at(self, start: float) -> "Surface":
        """Returns the part of the surface after a given distance.

        Args:
            start: distance at which the road starts [m].

        Raises:
            InputError: the surface does not contain the distance `start`.
        """
        u, z = begun_at(start, self.u, self.z)
        return replace(self, u=u, z=z)

    def profile(self, track_width: float, speed: float) -> Profile:
        """Returns the profile under the wheels of a vehicle in the middle of the road.

        Heights are interpolated linearly between the lines of the grid, as in OpenCRG.

        Args:
            track_width: lateral distance between right and left wheels [m].
            speed: vehicle speed [m/s].

        Raises:
            InputError: the surface is too narrow, or has missing heights.
        """
        middle, tracks = (self.v[0] + self.v[-1]) / 2, []
        for v in (middle + track_width / 2, middle - track_width / 2):
            if not self.v[0] <= v <= self.v[-1]:
                raise InputError(
                    f"road file {self.source}: the width of {np.ptp(self.v):g} m is less than the vehicle's track width "
                    f"of {track_width:g} m; give a wider road"
                )
            j = min(int(np.searchsorted(self.v, v, side="right")), len(self.v) - 1)
            share = (v - self.v[j - 1]) / (self.v[j] - self.v[j - 1])
            tracks.append(self.z[:, j - 1] + share * (self.z[:, j] - self.z[:, j - 1]))
        try:
            return Profile(self.u, np.stack(tracks, axis=-1), speed, self.source)
        except InputError as error:
            raise InputError(f"road file {self.source}: {error}") from error


def read_surface(path: Path) -> Surface:
    """Reads the surface of an OpenCRG file. The OpenCRG file may refer to a second file, which contains the heights.

    Raises:
        InputError: PyOpenCRG is not installed, the file is not an OpenCRG file, or the file is incomplete.
    """
    with reading(path, "road file", GIVE):
        path.open("rb").close()
        try:
            from pyopencrg import CrgRoad, io  # pyright: ignore[reportMissingImports] - an extra
        except ImportError as error:
            raise InputError("OpenCRG files need PyOpenCRG; install this package with pip install -e '.[opencrg]'") from error
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # most of PyOpenCRG's warnings do not matter for a profile
                head, road = io.read_ipl(path, meta_only=True), CrgRoad.read(path)
            u, v = np.asarray(road.u, dtype=float), np.asarray(road.v, dtype=float)
            rows = range(0, len(u), max(1, AT_ONCE // len(v)))
            z = np.concatenate([road.uv_to_z(u[i : i + rows.step, None], v[None, :]) for i in rows])
        except Exception as error:
            raise InputError(f"this is not an OpenCRG file ({_reason(error, path)}); {GIVE}") from error
        if not any("ROAD_CRG_FILE" in line for line in head.struct):
            last = path.read_bytes().rstrip(b"\r\n").rpartition(b"\n")[2]
            _check_whole("\n".join([*head.struct, *head.kd_ind]), u, TEXT_WIDTHS.get(head.fmt, 0), len(head.kd_def), len(last))
        return Surface(u, v, z, str(path))


def _check_whole(header: str, u: Array, width: int, channels: int, last: int) -> None:
    """Raises InputError if the OpenCRG file is incomplete. PyOpenCRG may read an incomplete file as a shorter or stretched
    road.

    Args:
        header: text of the file's header, with entries and with definitions of channels whose values are not in the data.
        u: distance of each cross-section [m].
        width: number of characters per number; 0 for binary files.
        channels: number of values per cross-section.
        last: number of characters in the last line of the file.
    """
    if last < (expected := ((channels - 1) % (LINE // max(width, 1)) + 1) * width):
        raise InputError(
            f"the file is incomplete, because its last line has {last} characters instead of {expected}; give the whole file"
        )
    end = re.search(rf"reference_line_end_u\s*=\s*{NUMBER}", header, re.IGNORECASE)
    step = re.search(rf"reference_line_increment\s*=\s*{NUMBER}|reference line u,[^,]*,[^,]*,\s*{NUMBER}", header, re.IGNORECASE)
    if end and step and len(u) < (promised := round((float(end[1]) - u[0]) / float(step[1] or step[2])) + 1):
        raise InputError(f"the file has {len(u)} cross-sections, but its header specifies {promised}; give the whole file")


def _reason(error: Exception, path: Path) -> str:
    """Returns the message of PyOpenCRG on one line.

    The first line of PyOpenCRG's message may be empty, and a list of errors may follow.
    """
    report = getattr(error, "report", None)
    if report is not None:
        return first_few([problem.removeprefix("(reading) ") for problem in report.errors or report.warnings])
    text = " ".join(str(error).removeprefix(f"{path}: ").split())
    return text or type(error).__name__
