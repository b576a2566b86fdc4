"""A run as a scene: MuJoCo's kinematics along recorded positions, in plain shapes that any viewer can draw."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import mujoco
import numpy as np

from models.arrays import Array
from models.mjcf import build_model, mocap_indices
from models.vehicle import Vehicle
from sim.physics import DIVERGED
from sim.road import Road, under_wheels
from sim.scene import Motion, Scene, Shape

FORMS = {
    int(mujoco.mjtGeom.mjGEOM_BOX): "box",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "cylinder",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
}


def draw(vehicle: Vehicle, road: Road, time: Array, qpos: Array) -> Scene:
    """One run as a scene of 60 frames a second. Springs are drawn from every site `NAME_bottom` to its `NAME_top`.

    Args:
        vehicle: the vehicle.
        road: its road.
        time: equidistant sample times [s], shape (T,), from 0.
        qpos: generalized positions, shape (T, nq).
    """
    timestep = float(time[1] - time[0])
    model = build_model(vehicle, timestep)
    data = mujoco.MjData(model)
    frames = np.unique(np.round(np.arange(0, time[-1], 1 / 60) / timestep).astype(int))
    frames = frames[np.all(np.abs(qpos[frames]) < DIVERGED, axis=-1)]
    heights = under_wheels(road.displacement, road, vehicle, time[frames])
    mocap = mocap_indices(vehicle, model)
    sites = [model.site(i).name for i in range(model.nsite)]
    springs = [name.removesuffix("_bottom") for name in sites if name.endswith("_bottom")]
    ends = np.array([[model.site(f"{name}_{end}").id for end in ("bottom", "top")] for name in springs], dtype=int).reshape(-1, 2)

    positions, quaternions = np.empty((len(frames), model.nbody, 3)), np.empty((len(frames), model.nbody, 4))
    coils = np.empty((len(frames), len(springs), 2, 3))
    for f, frame in enumerate(frames):
        data.qpos[:] = qpos[frame]
        data.mocap_pos[mocap, 2] = heights[f]
        mujoco.mj_kinematics(model, data)
        positions[f], quaternions[f], coils[f] = data.xpos, data.xquat, data.site_xpos[ends]
    return Scene(
        time=time[frames],
        shapes=tuple(_shape(model, i) for i in range(model.ngeom) if int(model.geom_type[i]) in FORMS),
        bodies={model.body(i).name: Motion(positions[:, i], quaternions[:, i]) for i in range(1, model.nbody)},
        springs={name: coils[:, i] for i, name in enumerate(springs)},
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
