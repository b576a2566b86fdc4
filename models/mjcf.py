"""From a vehicle to an MjModel: the vehicle's parameters, written through MjSpec into the MJCF of its kind."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import mujoco

from models.errors import InputError
from models.kind import GRAVITY
from models.read_file import MIB, TEXT, open_plain
from models.reality import Limits
from models.vehicle import Vehicle

GIVE = "give the model of the kind of vehicle"


def build_spec(vehicle: Vehicle, timestep: float) -> mujoco.MjSpec:
    """The editable model of a vehicle.

    Args:
        vehicle: the vehicle.
        timestep: integration step [s].

    Raises:
        InputError: the kind's MJCF cannot be read, or is none.
    """
    open_plain(vehicle.kind.mjcf, "MJCF", GIVE).close()
    if vehicle.kind.mjcf.stat().st_size > TEXT:
        raise InputError(f"MJCF {vehicle.kind.mjcf}: is too large; at most {TEXT / MIB:g} MiB is read: {GIVE}")
    try:
        spec = mujoco.MjSpec.from_file(str(vehicle.kind.mjcf))
    except (ValueError, mujoco.FatalError) as error:
        raise _wrong(vehicle, error) from error
    spec.option.timestep = timestep
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
    vehicle.kind.write_mjcf(spec, vehicle.parameters)
    _write_limits(spec, vehicle.limits)
    return spec


def _wrong(vehicle: Vehicle, error: Exception) -> InputError:
    """What MuJoCo says of an MJCF that it does not take."""
    return InputError(f"MJCF {vehicle.kind.mjcf}: MuJoCo does not take it ({' '.join(str(error).split())}); mend that")


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
    try:
        model = build_spec(vehicle, timestep).compile()
    except (ValueError, mujoco.FatalError) as error:
        raise _wrong(vehicle, error) from error
    _check_names(vehicle, model)
    return model


def _check_names(vehicle: Vehicle, model: mujoco.MjModel) -> None:
    """Refuses a model without something that its equations name.

    Raises:
        InputError: it says what is missing.
    """
    kind, missing = vehicle.kind, []
    sensors = {model.sensor(i).name for i in range(model.nsensor)}
    parts = [part for name in vehicle.linear_model.outputs for part in kind.combined.get(name, {name: 1.0})]
    missing += [f"sensor {part!r}" for part in dict.fromkeys(parts) if part not in sensors]
    if model.nu != len(vehicle.linear_model.inputs):
        raise InputError(
            f"MJCF {kind.mjcf}: has {model.nu} actuator(s), and the equations {len(vehicle.linear_model.inputs)}; give as many"
        )
    mocap = {model.body(i).name for i in range(model.nbody) if model.body(i).mocapid[0] >= 0}
    missing += [f"mocap body {wheel.road_body!r}" for wheel in kind.wheels if wheel.road_body not in mocap]
    if missing:
        raise InputError(f"MJCF {kind.mjcf}: has no {', no '.join(missing)}, which the equations name; add what is missing")


def mjcf_text(vehicle: Vehicle, timestep: float) -> str:
    """The exact MJCF that `build_model` compiles, for the logs."""
    spec = build_spec(vehicle, timestep)
    spec.compiler.savecompiled = False  # every number exactly, not with the six digits of compiled values
    return spec.to_xml()


def mocap_indices(vehicle: Vehicle, model: mujoco.MjModel) -> list[int]:
    """Mocap index of every wheel's road."""
    return [int(model.body(wheel.road_body).mocapid[0]) for wheel in vehicle.kind.wheels]
