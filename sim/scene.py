"""What a run looks like: solid shapes on moving bodies, for viewers that know nothing of MuJoCo."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from models.arrays import Array


@dataclass(frozen=True, eq=False)
class Shape:
    """A solid on a body.

    Attributes:
        name: unique within its body.
        body: the body that carries it.
        form: "box", "cylinder", "capsule" or "sphere".
        half_size: box: half edges; others: (radius, half length along z, 0) [m], shape (3,).
        position: centre in the body's frame [m], shape (3,).
        quaternion: orientation in the body's frame, (w, x, y, z).
        rgba: colour, 0 to 1, shape (4,).
    """

    name: str
    body: str
    form: str
    half_size: Array
    position: Array
    quaternion: Array
    rgba: Array

    @property
    def rotation(self) -> Array:
        """Its orientation in the body's frame as a matrix, shape (3, 3)."""
        return Rotation.from_quat(self.quaternion, scalar_first=True).as_matrix()

    @property
    def half_edges(self) -> Array:
        """Half edges [m] of the box around it, along its own axes, shape (3,)."""
        radius, half_length, _ = self.half_size
        match self.form:
            case "box":
                return self.half_size
            case "sphere":
                return np.full(3, radius)
            case "capsule":
                half_length = half_length + radius
        return np.array([radius, radius, half_length])


@dataclass(frozen=True, eq=False)
class Motion:
    """Where a body is: world positions [m], shape (F, 3), and orientations (w, x, y, z), shape (F, 4), per frame."""

    positions: Array
    quaternions: Array


@dataclass(frozen=True, eq=False)
class Scene:
    """A run to be drawn.

    Attributes:
        time: frame times [s], shape (F,).
        shapes: the solids.
        bodies: motion of every body that carries one.
        springs: end points of springs to draw as lines [m], shape (F, 2, 3), by name.
    """

    time: Array
    shapes: tuple[Shape, ...]
    bodies: Mapping[str, Motion]
    springs: Mapping[str, Array]

    def extent(self) -> tuple[Array, Array]:
        """Lowest and highest corner of everything solid over all frames [m]; orientations are those of the first frame."""
        corners = []
        for shape in self.shapes:
            motion = self.bodies[shape.body]
            positions = motion.positions[np.isfinite(motion.positions).all(1)]
            body = Rotation.from_quat(motion.quaternions[0], scalar_first=True).as_matrix()
            reach = np.abs(body @ shape.rotation) @ shape.half_edges
            centre = positions + body @ shape.position
            corners += [centre.min(0) - reach, centre.max(0) + reach]
        if not corners:
            return np.full(3, -1.0), np.full(3, 1.0)
        return np.min(corners, axis=0), np.max(corners, axis=0)
