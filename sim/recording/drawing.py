"""A run as a scene: MuJoCo's kinematics along recorded positions, in plain shapes that any viewer can draw."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import mujoco
import numpy as np

from models.common.arrays import Array
from models.mjcf import FITTED, build_model, mocap_indices
from models.roads.road import Road, delays, under_wheels
from models.vehicle import Vehicle
from sim.physics.blocks import DIVERGED
from sim.recording.scene import Motion, Scene, Shape, Track, Tyre
from sim.response.response import Response

FORMS = {
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
}

FRAMES = 60  # a second

BEHIND, AHEAD = 6.0, 12.0  # how much road is seen, from the last wheel at the start and from the first at the end [m]
SPACING, MOST = 0.05, 20_000  # of a profile's points [m], and how many there are beside those that wheels stand on


def scene_of(vehicle: Vehicle, road: Road, physics: Response, qpos: Array) -> Scene:
    """One run as a scene of 60 frames a second.

    The names in the MJCF say what is drawn: a spring from every site `NAME_bottom` to its `NAME_top`, the force of an actuator on
    the tendon NAME beside it, and a cylinder that has the name of a tendon as a tyre of that tendon's length.

    Args:
        vehicle: the vehicle.
        road: its road.
        physics: the response, at equidistant sample times from 0.
        qpos: generalized positions, shape (T, nq).
    """
    time = physics.time
    timestep = float(time[1] - time[0])
    model = build_model(vehicle, timestep)
    data = mujoco.MjData(model)
    frames = np.unique(np.round(np.arange(0, time[-1], 1 / FRAMES) / timestep).astype(int))
    frames = frames[np.all(np.abs(qpos[frames]) < DIVERGED, axis=-1)]
    heights = under_wheels(road.displacement, road, vehicle, time[frames])
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
        tracks=_tracks(vehicle, road, data.mocap_pos[mocap], time[frames], heights),
    )


def _tracks(vehicle: Vehicle, road: Road, places: Array, time: Array, heights: Array) -> tuple[Track, ...]:
    """The road's profiles, one for all wheels that run in each other's track; none of a rig, whose posts are bodies.

    Args:
        vehicle: the vehicle.
        road: its road.
        places: where its wheels stand, shape (r, 3) [m].
        time: of the frames [s], shape (F,).
        heights: of the road under the wheels at that time [m], shape (F, r).
    """
    if not len(time) or not road.laid:
        return ()
    # To the micrometre: where the drawing has its wheels elsewhere than the parameters do, each has a profile of its own.
    wheels: dict[tuple[str, float, float], list[int]] = {}
    later = np.array(delays(road, vehicle))
    for i, wheel in enumerate(vehicle.kind.wheels):
        start = places[i, 0] + road.speed * later[i]
        wheels.setdefault((wheel.side, round(start, 6), round(places[i, 1], 6)), []).append(i)

    first, last = -BEHIND / road.speed - later.max(), time[-1] + AHEAD / road.speed
    count = int(min(np.ceil((last - first) * road.speed / SPACING) + 1, MOST))
    even = np.linspace(first, last, count)  # of evenly spaced times a random road is computed at once
    tracks = []
    for (side, start, middle), members in wheels.items():
        # At every frame a wheel stands on a point.
        t, once = np.unique(np.concatenate([even, *(time - later[i] for i in members)]), return_index=True)
        height = np.concatenate([road.displacement(even, side), *heights[:, members].T])[once]
        bodies = tuple(vehicle.kind.wheels[i].road_body for i in members)
        tracks.append(Track(bodies[0], middle, start + road.speed * t, height, road.speed * time, bodies))
    return tuple(tracks)


def _actuators(model: mujoco.MjModel) -> dict[str, str]:
    """The signal of every actuator that pulls on a tendon, by tendon, in their order; what is fitted beside them has none."""
    on_tendon = int(mujoco.mjtTrn.mjTRN_TENDON)
    names = {i: model.actuator(i).name for i in range(model.nu) if int(model.actuator_trntype[i]) == on_tendon}
    asked = {i: name for i, name in names.items() if not name.startswith(FITTED)}
    return {model.tendon(int(model.actuator_trnid[i, 0])).name: name for i, name in asked.items()}


def _tyre(model: mujoco.MjModel, i: int, tendon: int, lengths: Array) -> Tyre:
    """The tyre that geom `i` stands for: squeezed by what its tendon, from the road to the hub, is shorter than when slack."""
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
