"""From a vehicle to an MjModel: the vehicle's parameters, written through MjSpec into the MJCF of its kind."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import mujoco

from models.errors import InputError
from models.kind import GRAVITY
from models.reality import Limits
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
    _write_limits(spec, vehicle.limits)
    return spec


def _write_limits(spec: mujoco.MjSpec, limits: Limits) -> None:
    """Bump stops, largest force and lag, into every suspension and actuator.

    A bump stop is a second spring beside each tendon whose name begins with `suspension`, with a dead band of the stroke.

    Raises:
        InputError: the kind's MJCF has no suspension tendons.
    """
    if limits.suspension_stroke is not None and limits.stop_stiffness is not None:
        suspensions = [tendon for tendon in spec.tendons if tendon.name.startswith("suspension")]
        if not suspensions:
            raise InputError("[limits] suspension_stroke: this kind of vehicle has no suspension to stop; leave it out")
        at_rest = spec.copy().compile()
        for tendon in suspensions:
            rest = float(at_rest.tendon_length0[at_rest.tendon(tendon.name).id])
            stop = spec.add_tendon(name=f"stop_{tendon.name}")
            stop.stiffness[0] = limits.stop_stiffness
            stop.springlength = [rest - limits.suspension_stroke, rest + limits.suspension_stroke]
            for wrap in tendon.path:
                if wrap.type == mujoco.mjtWrap.mjWRAP_JOINT:
                    stop.wrap_joint(wrap.target.name, wrap.coef)
                else:
                    stop.wrap_site(wrap.target.name)
    for actuator in spec.actuators:
        if limits.actuator_force is not None:
            actuator.forcelimited = True
            actuator.forcerange = [-limits.actuator_force, limits.actuator_force]
        if limits.actuator_bandwidth is not None:
            # Integrated with the rest by RK4. `filterexact` is exact by itself, but reaches RK4's stages half a step late.
            actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTER
            actuator.dynprm[0] = 1 / limits.actuator_bandwidth


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
