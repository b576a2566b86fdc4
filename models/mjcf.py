"""From a vehicle to an MjModel: the vehicle's parameters, written through MjSpec into the MJCF of its kind."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import mujoco

from models.kind import GRAVITY
from models.vehicle import Vehicle


def build_spec(vehicle: Vehicle, timestep: float) -> mujoco.MjSpec:
    """The editable model of a vehicle.

    Args:
        vehicle: the vehicle.
        timestep: integration step [s].
    """
    spec = mujoco.MjSpec.from_file(str(vehicle.kind.mjcf))
    spec.option.timestep = timestep
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
    vehicle.kind.write_mjcf(spec, vehicle.parameters)
    return spec


def build_model(vehicle: Vehicle, timestep: float) -> mujoco.MjModel:
    """The compiled model of a vehicle. At qpos = 0 it is at rest: qacc is 0 to rounding.

    Args:
        vehicle: the vehicle.
        timestep: integration step [s].
    """
    return build_spec(vehicle, timestep).compile()


def mjcf_text(vehicle: Vehicle, timestep: float) -> str:
    """The exact MJCF that `build_model` compiles, for the logs."""
    spec = build_spec(vehicle, timestep)
    spec.compiler.savecompiled = False  # every number exactly, not with the six digits of compiled values
    return spec.to_xml()


def mocap_indices(vehicle: Vehicle, model: mujoco.MjModel) -> list[int]:
    """Mocap index of every wheel's road."""
    return [int(model.body(wheel.road_body).mocapid[0]) for wheel in vehicle.kind.wheels]
