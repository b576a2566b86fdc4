"""Road surfaces of ASAM OpenCRG, a grid of heights along and across a road, by PyOpenCRG."""

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.arrays import Array
from models.errors import InputError
from models.read_file import open_plain
from sim.profile import Profile


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

    def profile(self, track_width: float, speed: float) -> Profile:
        """What the wheels of a vehicle in its middle meet; between the grid's lines, straight across.

        Args:
            track_width: from the right wheels to the left ones [m].
            speed: [m/s].

        Raises:
            InputError: the surface is narrower than that, or there is a hole in it.
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
    """The surface of an OpenCRG file.

    Raises:
        InputError: PyOpenCRG is not installed, or the file is none.
    """
    try:
        from pyopencrg import CrgRoad  # pyright: ignore[reportMissingImports] - an extra
    except ImportError as error:
        raise InputError(f"road file {path} needs PyOpenCRG; install it with: pip install -e '.[opencrg]'") from error
    open_plain(path, "road file", "give an OpenCRG file").close()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what its checks find and a profile does not need
            road = CrgRoad.read(path)
            u, v = np.asarray(road.u, dtype=float), np.asarray(road.v, dtype=float)
            z = np.asarray(road.uv_to_z(u[:, None], v[None, :]), dtype=float)
    except OSError as error:
        raise InputError(f"road file {path}: cannot be read ({error.strerror or error})") from error
    except Exception as error:  # a reader of somebody else's: whatever it says, the file is none
        raise InputError(
            f"road file {path}: no OpenCRG file ({str(error).splitlines()[0] if str(error) else error!r})"
        ) from error
    return Surface(u, v, z, str(path))
