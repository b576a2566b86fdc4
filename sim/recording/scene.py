"""What a run looks like: solid shapes on moving bodies, for viewers that know nothing of MuJoCo."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from models.common.arrays import Array


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
class Tyre:
    """A tyre that the road squeezes flat where it touches, and that keeps its shape in the air.

    Attributes:
        name: unique within its body.
        body: the body that carries it, at whose origin its hub lies.
        radius: of the tyre in the air [m].
        half_width: [m].
        middle: of its width, in the body's frame along its axle y [m].
        height: of the hub above the road, per frame [m], shape (F,). Above `radius`, it is off the road.
        rgba: colour, 0 to 1, shape (4,).
    """

    name: str
    body: str
    radius: float
    half_width: float
    middle: float
    height: Array
    rgba: Array

    @property
    def lifted(self) -> Array:
        """Whether it is off the road, per frame, shape (F,)."""
        return self.height > self.radius


@dataclass(frozen=True, eq=False)
class Track:
    """A road's profile along one track of the vehicle, which comes towards it.

    Attributes:
        name: unique.
        middle: of its width [m], along y.
        position: where its points lie at time 0 [m], along x, ascending, shape (N,).
        height: of the points [m], shape (N,).
        travelled: how far the vehicle has come, and the points have moved back, per frame [m], shape (F,).
        bodies: what stands for it, a piece of road under every wheel, where no profile is drawn.
    """

    name: str
    middle: float
    position: Array
    height: Array
    travelled: Array
    bodies: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Scene:
    """A run to be drawn.

    Attributes:
        time: frame times [s], shape (F,).
        shapes: the solids.
        bodies: motion of every body that carries one.
        springs: end points of springs, with a damper inside [m], shape (F, 2, 3), by name; from the wheel to the body.
        tyres: those that give way.
        forces: what pushes the two ends of a spring apart [N], shape (F,), by the spring's name.
        tracks: the road.
    """

    time: Array
    shapes: tuple[Shape, ...]
    bodies: Mapping[str, Motion]
    springs: Mapping[str, Array]
    tyres: tuple[Tyre, ...] = ()
    forces: Mapping[str, Array] = field(default_factory=dict)
    tracks: tuple[Track, ...] = ()

    def finite(self) -> "Scene":
        """The frames in which everything is finite: where a run broke off, the car stays where it was last."""
        numbers = [part for motion in self.bodies.values() for part in (motion.positions, motion.quaternions)]
        numbers += [*self.springs.values(), *self.forces.values(), *(tyre.height for tyre in self.tyres)]
        kept = np.ones(len(self.time), dtype=bool)
        for array in numbers:
            kept &= np.isfinite(array).reshape(len(kept), -1).all(axis=1)
        return Scene(
            time=self.time[kept],
            shapes=self.shapes,
            bodies={name: Motion(motion.positions[kept], motion.quaternions[kept]) for name, motion in self.bodies.items()},
            springs={name: ends[kept] for name, ends in self.springs.items()},
            tyres=tuple(replace(tyre, height=tyre.height[kept]) for tyre in self.tyres),
            forces={name: force[kept] for name, force in self.forces.items()},
            tracks=tuple(replace(track, travelled=track.travelled[kept]) for track in self.tracks),
        )

    def extent(self) -> tuple[Array, Array]:
        """Lowest and highest corner of all solids and tyres over all frames [m]; orientations are those of the first frame."""
        corners = []
        for shape in self.shapes:
            motion = self.bodies[shape.body]
            positions = motion.positions[np.isfinite(motion.positions).all(1)]
            body = Rotation.from_quat(motion.quaternions[0], scalar_first=True).as_matrix()
            reach = np.abs(body @ shape.rotation) @ shape.half_edges
            centre = positions + body @ shape.position
            corners += [centre.min(0) - reach, centre.max(0) + reach]
        for tyre in self.tyres:
            reach = np.array([tyre.radius, tyre.half_width, tyre.radius])
            centre = self.bodies[tyre.body].positions + [0.0, tyre.middle, 0.0]
            centre = centre[np.isfinite(centre).all(1)]
            corners += [centre.min(0) - reach, centre.max(0) + reach]
        if not corners:
            return np.full(3, -1.0), np.full(3, 1.0)
        return np.min(corners, axis=0), np.max(corners, axis=0)
