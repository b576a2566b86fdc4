"""What a scene's springs, dampers, tyres and forces look like: their lines, surfaces and colours, for any viewer."""

from collections.abc import Iterable

import numpy as np

from models.common.arrays import Array
from sim.recording.scene import Scene, Track, Tyre

TURNS, POINTS = 6, 49  # of a coil
SECTORS = 40  # of a tyre

# Of the lines of a strut, in order: radius [m] and colour.
LINES = ((0.011, (235, 175, 45)), (0.012, (165, 170, 178)), (0.03, (95, 100, 110)))

LIFTED = (214, 39, 40)  # colour of a tyre off the road
FORCE, LONGEST = (190, 60, 200), 0.3  # colour of a force's arrow, and length of the largest [m]
BESIDE = np.array([0.0, 0.16, 0.0])  # where it stands, from the middle of its spring [m]

ROAD, THICK = 0.2, 0.12  # half width and thickness of a track [m]
ASPHALT, SIDE, PROFILE = (
    ((104, 107, 113), (124, 127, 133)),
    (70, 72, 78),
    (250, 250, 245),
)  # colours of a track; see `road_surface`


def largest_force(scenes: Iterable[Scene]) -> float:
    """The largest control force of all scenes [N]: arrows of runs side by side have one scale."""
    forces = [np.abs(force).max() for scene in scenes for force in scene.finite().forces.values() if len(force)]
    return float(max(forces, default=0.0))


def strut_lines(ends: Array) -> tuple[Array, Array, Array]:
    """A spring and its damper: the coil, the rod and the tube, each shape (F, points, 3), from end points [m], shape (F, 2, 3).

    The tube hangs from the body and is half as long as the strut was in the first frame, so that the rod is seen to move.
    """
    start, axis = ends[:, 0], ends[:, 1] - ends[:, 0]
    if not len(ends):
        return np.zeros((0, POINTS, 3)), np.zeros((0, 2, 3)), np.zeros((0, 2, 3))
    length = np.linalg.norm(axis, axis=1, keepdims=True)
    sideways = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis[0]))])
    sideways /= np.linalg.norm(sideways, axis=1, keepdims=True)
    third = np.cross(axis, sideways) / length

    along = np.linspace(0.0, 1.0, POINTS)
    radius = 0.14 * length[0] * np.clip(10 * np.minimum(along, 1 - along), 0, 1)
    angle = 2 * np.pi * TURNS * along
    across = np.cos(angle)[:, None] * sideways[:, None] + np.sin(angle)[:, None] * third[:, None]
    coil = start[:, None] + along[:, None] * axis[:, None] + radius[:, None] * across
    tube = np.stack([ends[:, 1] - axis / length * length[0] / 2, ends[:, 1]], axis=1)
    return coil, ends, tube


def tyre_surface(tyre: Tyre) -> tuple[Array, Array]:
    """A tyre, flat where it stands on the road.

    Returns:
        Its vertices in the frame of its body [m], shape (F, 2 SECTORS + 2, 3), and its triangles as their indices, shape
        (4 SECTORS, 3).
    """
    angle = 2 * np.pi * np.arange(SECTORS) / SECTORS
    x, z = tyre.radius * np.sin(angle), -tyre.radius * np.cos(angle)
    vertices = np.zeros((len(tyre.height), 2 * SECTORS + 2, 3))
    for side, start in ((1, 0), (-1, SECTORS)):
        ring = vertices[:, start : start + SECTORS]
        ring[..., 0] = x
        ring[..., 1] = tyre.middle + side * tyre.half_width
        ring[..., 2] = np.maximum(z, -tyre.height[:, None])
    vertices[:, 2 * SECTORS :, 1] = tyre.middle + np.array([1, -1]) * tyre.half_width

    here = np.arange(SECTORS)
    after = (here + 1) % SECTORS
    left, right = np.full(SECTORS, 2 * SECTORS), np.full(SECTORS, 2 * SECTORS + 1)
    faces = ((here, here + SECTORS, after), (after, here + SECTORS, after + SECTORS))
    walls = ((left, here, after), (right, after + SECTORS, here + SECTORS))
    return vertices, np.concatenate([np.stack(corners, axis=1) for corners in (*faces, *walls)])


def road_surface(track: Track) -> tuple[Array, Array, Array]:
    """A track as a slab: from above, two shades of grey that take turns every metre, so that it is seen to move.

    Returns:
        Its vertices at time 0 [m], shape (6 N, 3), their colours, shape (6 N, 3), and its triangles, shape (6 (N - 1), 3).
    """
    count = len(track.position)
    left, right, under = track.middle + ROAD, track.middle - ROAD, track.height - THICK
    edges = (
        (left, track.height),
        (right, track.height),
        (left, track.height),
        (left, under),
        (right, under),
        (right, track.height),
    )
    vertices = np.concatenate([np.column_stack([track.position, np.full(count, y), z]) for y, z in edges])
    above = np.array(ASPHALT)[np.floor(track.position).astype(int) % 2]
    colours = np.concatenate([above, above, np.broadcast_to(SIDE, (4 * count, 3))])

    here = np.arange(count - 1)
    quads = []
    for one, other in ((0, 1), (2, 3), (4, 5)):  # the top and both sides
        a, b = here + one * count, here + other * count
        quads += [np.stack([a, b, a + 1], axis=1), np.stack([a + 1, b, b + 1], axis=1)]
    return vertices, colours, np.concatenate(quads)
