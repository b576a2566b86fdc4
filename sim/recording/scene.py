"""Drawing of a run for viewers without MuJoCo, made from the MuJoCo model: solids on moving bodies, springs, dampers, tyres and
forces.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from models.common.arrays import Array
from models.roads.road import Road, RoadInput, delays
from models.vehicle.mjcf import FITTED_PREFIX, build_model, mocap_indices
from models.vehicle.vehicle import Vehicle
from sim.drive.loop import DIVERGENCE_LIMIT
from sim.drive.response import Response

# pyright: reportAttributeAccessIssue=false
# MuJoCo's Python bindings have no type stubs.

FORMS = {
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
}

FRAMES = 60  # frames of the recorded motion per second

BEHIND, AHEAD = 6.0, 12.0  # m, drawn road behind the last wheel at the start, and ahead of the first wheel at the end
# spacing of the points of a road profile [m], and largest number of its points, without the points under wheels
SPACING, MOST = 0.05, 20_000


def rotation_matrix(quaternion: Array) -> Array:
    """Returns the rotation matrix of a quaternion (w, x, y, z), shape (3, 3). The quaternion need not be normalised."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion / np.linalg.norm(quaternion))
    return matrix.reshape(3, 3)


@dataclass(frozen=True, eq=False)
class Shape:
    """Solid that is fixed to a body of the vehicle.

    Attributes:
        name: name of the solid, unique within its body.
        body: name of the body to which the solid is fixed.
        form: "box", "cylinder", "capsule" or "sphere".
        half_size: half edges of a box, or (radius, half length along z, 0) of other forms [m], shape (3,).
        position: centre of the solid in the body's frame [m], shape (3,).
        quaternion: orientation of the solid in the body's frame, (w, x, y, z).
        rgba: colour and opacity, from 0 to 1, shape (4,).
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
        """Orientation of the solid in the frame of the body, as a matrix, shape (3, 3)."""
        return rotation_matrix(self.quaternion)

    @property
    def half_edges(self) -> Array:
        """Half edges of the solid's bounding box, along the axes of the box [m], shape (3,)."""
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
    """Motion of a body in F frames: its positions in the world [m], shape (F, 3), and its orientations (w, x, y, z), shape (F,
    4).
    """

    positions: Array
    quaternions: Array


@dataclass(frozen=True, eq=False)
class Tyre:
    """Tyre with a flat contact patch. In the air, the tyre is drawn undeformed.

    Attributes:
        name: name of the tyre, unique within its body.
        body: name of the body that carries the tyre. The hub is at the origin of the body that carries the tyre.
        radius: undeformed radius [m].
        half_width: half the width of the tyre [m].
        middle: y coordinate (along the axle) of the tyre's middle, in the frame of the body [m].
        height: height of the hub above the road in each frame [m], shape (F,). If the hub is higher than `radius`, the tyre is
            off the ground.
        rgba: colour and opacity, from 0 to 1, shape (4,).
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
        """True for the frames in which the tyre is off the ground, shape (F,)."""
        return self.height > self.radius


@dataclass(frozen=True, eq=False)
class Track:
    """Profile of a road along one track. In the drawing, the profile moves towards the vehicle.

    Attributes:
        middle: y coordinate of the middle of the track, in world coordinates [m].
        position: x coordinates of the profile's points at time 0, ascending [m], shape (N,).
        height: heights of the profile's points [m], shape (N,).
        travelled_distance: distance by which the profile's points have moved backwards in each frame [m], shape (F,).
        bodies: names of the pieces of road under the wheels, which viewers other than Rerun show instead of the profile.
    """

    middle: float
    position: Array
    height: Array
    travelled_distance: Array
    bodies: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Scene:
    """Drawing of a run over time.

    Attributes:
        time: times of the frames [s], shape (F,).
        shapes: solids that are fixed to the bodies of the vehicle.
        bodies: motion of every body that carries a solid, by name.
        springs: ends of each spring and its damper, at the wheel and at the body [m], shape (F, 2, 3), by name of the spring.
        tyres: tyres, drawn with their deformation.
        forces: control forces [N], shape (F,), by name of the spring; a positive force pushes the ends of the spring apart.
        tracks: profiles of the road, one for each track of the vehicle.
    """

    time: Array
    shapes: tuple[Shape, ...]
    bodies: Mapping[str, Motion]
    springs: Mapping[str, Array]
    tyres: tuple[Tyre, ...] = ()
    forces: Mapping[str, Array] = field(default_factory=dict)
    tracks: tuple[Track, ...] = ()

    def finite(self) -> "Scene":
        """Returns the scene with only the frames in which all numbers are finite.

        The drawn car therefore stops when a run becomes invalid.
        """
        numbers = [part for motion in self.bodies.values() for part in (motion.positions, motion.quaternions)]
        numbers += [*self.springs.values(), *self.forces.values(), *(tyre.height for tyre in self.tyres)]
        mask = np.ones(len(self.time), dtype=bool)
        for array in numbers:
            mask &= np.isfinite(array).reshape(len(mask), -1).all(axis=1)
        return replace(
            self,
            time=self.time[mask],
            bodies={name: Motion(motion.positions[mask], motion.quaternions[mask]) for name, motion in self.bodies.items()},
            springs={name: ends[mask] for name, ends in self.springs.items()},
            tyres=tuple(replace(tyre, height=tyre.height[mask]) for tyre in self.tyres),
            forces={name: force[mask] for name, force in self.forces.items()},
            tracks=tuple(replace(track, travelled_distance=track.travelled_distance[mask]) for track in self.tracks),
        )

    @property
    def flat(self) -> bool:
        """True if the scene is wider than it is long, as for a vehicle in the roll plane.

        Viewers show a wide scene from behind instead of from the left.
        """
        low, high = self.finite().extent()
        return bool(np.ptp([low, high], axis=0)[1] > np.ptp([low, high], axis=0)[0])

    def extent(self) -> tuple[Array, Array]:
        """Returns two opposite corners of a box around all solids and tyres in all frames [m]; solids keep the orientation of
        the first frame.
        """
        corners = []
        for shape in self.shapes:
            motion = self.bodies[shape.body]
            positions = motion.positions[np.isfinite(motion.positions).all(1)]
            body = rotation_matrix(motion.quaternions[0])
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


def scene_of(road_input: RoadInput, physics: Response, qpos: Array) -> Scene:
    """Converts a run to a scene with 60 frames per second.

    The names of the elements in the MuJoCo model determine what is drawn. A spring is drawn from every site `NAME_bottom` to
    the site `NAME_top`, with the force of the actuator on the tendon NAME. A cylinder that has the name of a tendon is drawn as
    a tyre; the length of the tendon is the height of the hub above the road.

    Args:
        road_input: vehicle and road, at the samples of the response.
        physics: simulated response at equidistant sample times, which begin at 0.
        qpos: MuJoCo's generalised positions, shape (T, nq).
    """
    vehicle, time, timestep = road_input.vehicle, physics.time, road_input.timestep
    model = build_model(vehicle, timestep)
    data = mujoco.MjData(model)
    frames = np.unique(np.round(np.arange(0, time[-1], 1 / FRAMES) / timestep).astype(int))
    frames = frames[np.all(np.abs(qpos[frames]) < DIVERGENCE_LIMIT, axis=-1)]
    # The stored road heights are used, because a random road is slow to compute at uneven times
    heights = road_input.heights[frames]
    mocap = mocap_indices(vehicle, model)
    sites = [model.site(i).name for i in range(model.nsite)]
    springs = [name.removesuffix("_bottom") for name in sites if name.endswith("_bottom")]
    ends = np.array([[model.site(f"{name}_{end}").id for end in ("bottom", "top")] for name in springs], dtype=int).reshape(-1, 2)

    positions, quaternions = np.empty((len(frames), model.nbody, 3)), np.empty((len(frames), model.nbody, 4))
    coils, lengths = np.empty((len(frames), len(springs), 2, 3)), np.empty((len(frames), model.ntendon))
    for f, frame in enumerate(frames):
        data.qpos[:] = qpos[frame]
        data.mocap_pos[mocap, 2] = heights[f]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        positions[f], quaternions[f], coils[f], lengths[f] = data.xpos, data.xquat, data.site_xpos[ends], data.ten_length

    tendons = {model.tendon(i).name: i for i in range(model.ntendon)}
    drawn = [i for i in range(model.ngeom) if int(model.geom_type[i]) in FORMS]
    rubber = [i for i in drawn if model.geom(i).name in tendons and FORMS[int(model.geom_type[i])] == "cylinder"]
    return Scene(
        time=time[frames],
        shapes=tuple(_shape(model, i) for i in drawn if i not in rubber),
        bodies={model.body(i).name: Motion(positions[:, i], quaternions[:, i]) for i in range(1, model.nbody)},
        springs={name: coils[:, i] for i, name in enumerate(springs)},
        tyres=tuple(_tyre(model, i, tendons[model.geom(i).name], lengths) for i in rubber),
        forces={name: physics[signal][frames] for name, signal in _actuators(model).items() if name in springs},
        tracks=_tracks(vehicle, road_input.relative_road, data.mocap_pos[mocap], time[frames], heights),
    )


def _tracks(vehicle: Vehicle, road: Road, places: Array, time: Array, heights: Array) -> tuple[Track, ...]:
    """Returns the road profiles, one for each track; a test rig has none, because its posts are bodies.

    Args:
        places: positions of the wheels in the world [m], shape (r, 3).
        time: times of the frames [s], shape (F,).
        heights: road heights under the wheels at the times of the frames [m], shape (F, r).
    """
    if not len(time) or not road.laid:
        return ()
    # Wheel positions in the drawing and in the parameters are compared with a tolerance of a micrometre. Wheels whose positions
    # differ get their own road profiles.
    wheels: dict[tuple[str, float, float], list[int]] = {}
    later = np.array(delays(road, vehicle))
    for i, wheel in enumerate(vehicle.kind.wheels):
        start = places[i, 0] + road.speed * later[i]
        wheels.setdefault((wheel.side, round(start, 6), round(places[i, 1], 6)), []).append(i)

    first, last = -BEHIND / road.speed - later.max(), time[-1] + AHEAD / road.speed
    count = int(min(np.ceil((last - first) * road.speed / SPACING) + 1, MOST))
    even = np.linspace(first, last, count)  # evenly spaced times, at which a random road can be computed quickly
    tracks = []
    for (side, start, middle), members in wheels.items():
        # The road profile has a point under every wheel in every frame.
        t, once = np.unique(np.concatenate([even, *(time - later[i] for i in members)]), return_index=True)
        height = np.concatenate([road.displacement(even, side), *heights[:, members].T])[once]
        bodies = tuple(vehicle.kind.wheels[i].road_body for i in members)
        tracks.append(Track(middle, start + road.speed * t, height, road.speed * time, bodies))
    return tuple(tracks)


def _actuators(model: mujoco.MjModel) -> dict[str, str]:
    """Returns the signal of every actuator that acts on a tendon; the keys are the names of the tendons. Actuators that
    represent characteristics are omitted.
    """
    on_tendon = int(mujoco.mjtTrn.mjTRN_TENDON)
    names = {i: model.actuator(i).name for i in range(model.nu) if int(model.actuator_trntype[i]) == on_tendon}
    controls = {i: name for i, name in names.items() if not name.startswith(FITTED_PREFIX)}
    return {model.tendon(int(model.actuator_trnid[i, 0])).name: name for i, name in controls.items()}


def _tyre(model: mujoco.MjModel, i: int, tendon: int, lengths: Array) -> Tyre:
    """Returns the drawn tyre that represents the MuJoCo geom `i`.

    The tendon of the tyre runs from the road to the hub, and is slack above the radius of the tyre.
    """
    shape = _shape(model, i)
    return Tyre(
        name=shape.name,
        body=shape.body,
        radius=float(model.tendon_lengthspring[tendon, 0]),
        half_width=float(shape.half_size[1]),
        middle=float(shape.position[1]),
        height=lengths[:, tendon],
        rgba=shape.rgba,
    )


def _shape(model: mujoco.MjModel, i: int) -> Shape:
    geom = model.geom(i)
    form = FORMS[int(model.geom_type[i])]
    material = int(model.geom_matid[i])
    return Shape(
        name=geom.name,
        body=model.body(int(geom.bodyid[0])).name,
        form=form,
        half_size=geom.size.copy(),
        position=geom.pos.copy(),
        quaternion=geom.quat.copy(),
        rgba=(model.mat_rgba[material] if material >= 0 else geom.rgba).copy(),
    )


TURNS, POINTS = 6, 49  # number of turns of a drawn coil spring, and number of points of the line that draws it
SECTORS = 40  # number of sectors of a drawn tyre

# Radius [m] and colour of the lines that draw a strut: coil spring, rod and tube.
LINES = ((0.011, (235, 175, 45)), (0.012, (165, 170, 178)), (0.03, (95, 100, 110)))

LIFTED_COLOUR = (214, 39, 40)  # colour of a tyre that is off the ground
FORCE, LONGEST = (190, 60, 200), 0.3  # colour of an arrow that shows a force, and length of the longest arrow [m]
BESIDE = np.array([0.0, 0.16, 0.0])  # position of an arrow relative to the middle of its spring [m]

ROAD, THICK = 0.2, 0.12  # half width and thickness of a drawn wheel track [m]
ASPHALT, SIDE, PROFILE = ((104, 107, 113), (124, 127, 133)), (70, 72, 78), (250, 250, 245)  # colours of a drawn wheel track


def largest_force(scenes: Iterable[Scene]) -> float:
    """Returns the largest control force in all scenes [N], which defines a common scale for the arrows."""
    forces = [np.abs(force).max() for scene in scenes for force in scene.finite().forces.values() if len(force)]
    return float(max(forces, default=0.0))


def arrows(scene: Scene, largest: float) -> dict[str, tuple[Array, Array]]:
    """Returns the tail and the vector [m] of each control-force arrow, shapes (F, 3), by name of the spring.

    Args:
        scene: drawing of a run, which contains the springs and their control forces.
        largest: force for which the arrow has its full length [N].
    """
    drawn = {}
    for name, force in scene.forces.items():
        ends = scene.springs[name]
        axis = ends[:, 1] - ends[:, 0]
        axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
        drawn[name] = ends.mean(axis=1) + BESIDE, axis * (LONGEST / (largest or 1.0) * force)[:, None]
    return drawn


def strut_lines(ends: Array) -> tuple[Array, Array, Array]:
    """Returns the lines that draw the coil, rod and tube of a strut, shapes (F, points, 3), for the strut's ends [m], shape (F,
    2, 3).

    The tube of the strut is fixed to the body. The tube is half as long as the strut in the first frame, so that the motion of
    the rod in the tube is visible.
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
    """Returns the drawn surface of a tyre with its contact patch.

    Returns:
        The vertices of the surface in the frame of the body [m], shape (F, 2 SECTORS + 2, 3), and the vertex indices of the
        triangles, shape (4 SECTORS, 3).
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
    """Returns the drawn surface of a road along one track, as a slab. The shade of grey alternates every metre, so that the
    motion of the road is visible.

    Returns:
        The vertices of the surface at time 0 [m], shape (6 N, 3), their colours, shape (6 N, 3), and the triangles, shape (6 (N
        - 1), 3).
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
    for one, other in ((0, 1), (2, 3), (4, 5)):  # the top and both sides of the slab
        a, b = here + one * count, here + other * count
        quads += [np.stack([a, b, a + 1], axis=1), np.stack([a + 1, b, b + 1], axis=1)]
    return vertices, colours, np.concatenate(quads)
