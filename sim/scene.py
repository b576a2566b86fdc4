"""What a run looks like: solid shapes on moving bodies, for viewers that know nothing of MuJoCo."""

from collections.abc import Mapping
from dataclasses import dataclass

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
