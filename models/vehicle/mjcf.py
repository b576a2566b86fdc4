"""MuJoCo model of a vehicle, built by MjSpec from the MJCF of its type; and a test of whether the model is linear.

A quarter-car moves only vertically, so its model is linear for motions of any size within its limits. The motion of a body that
pitches or rolls is nonlinear, and so is the force of a spring that does not act along a joint. The test of linearity uses the
compiled model, so it works for any vehicle type.
"""

import contextlib
import functools
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, error_in, short_repr
from models.common.extensions import FEATURES
from models.common.files import read_text
from models.kinds.kind import GRAVITY, HERE, LOWEST_HUB
from models.kinds.strut_and_tyre import actuator_of
from models.vehicle.limits_and_implementation import Limits
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from models.parts.part import SuspensionPart

# pyright: reportAttributeAccessIssue=false
# MuJoCo's Python bindings do not have type stubs.


GIVE = "give the MuJoCo model of the vehicle type"
# Prefix of actuators that a vehicle file adds to the model. These actuators come after the actuators of the MJCF, which are the
# inputs
FITTED_PREFIX = "fitted_"
SAME = 1e-9  # relative rounding error of a parameter that a vehicle type's code has written
MUJOCO_SAYS = (ValueError, mujoco.FatalError)  # types of errors that MuJoCo raises for an invalid model
_quiet_lock, _quiet_users = threading.Lock(), [0]


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keeps MuJoCo from writing MUJOCO_LOG.TXT.

    The file is not needed, because other checks detect and report the problems that MuJoCo writes into the file.

    MuJoCo has one warning handler for all threads.
    """
    with _quiet_lock:
        _quiet_users[0] += 1
        mujoco.set_mju_user_warning(lambda text: None)
    try:
        yield
    finally:
        with _quiet_lock:
            _quiet_users[0] -= 1
            if not _quiet_users[0]:
                mujoco.set_mju_user_warning(None)


def build_spec(vehicle: Vehicle, timestep: float) -> mujoco.MjSpec:
    """Returns the editable MuJoCo model of a vehicle.

    Args:
        vehicle: vehicle whose model is built.
        timestep: integration step [s].

    Raises:
        InputError: the MJCF of the vehicle type cannot be read or is invalid.
    """
    read_text(vehicle.kind.mjcf, "MJCF", GIVE)
    spec = _read_model(vehicle)
    if taken := [actuator.name for actuator in spec.actuators if actuator.name.startswith(FITTED_PREFIX)]:
        raise InputError(
            f"MJCF {vehicle.kind.mjcf}: names that begin with {FITTED_PREFIX} are reserved; rename the actuator {taken[0]!r}"
        )
    spec.option.timestep = timestep
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
    vehicle.kind.write_mjcf(spec, vehicle.kind.at_wheels(vehicle.parameters))
    _write_limits(spec, vehicle)
    _write_parts(spec, vehicle)
    ratios = vehicle.motion_ratios
    for actuator in spec.actuators:
        if actuator.name in ratios:
            actuator.gear[0] *= ratios[actuator.name]
    return spec


def _read_model(vehicle: Vehicle) -> mujoco.MjSpec:
    """Reads the MJCF of a vehicle type, and deletes the sensors of signals that its vehicles do not have."""
    kind, unnamed = vehicle.kind, frozenset(vehicle.kind.unnamed)
    if kind.folder == HERE:
        return _read_shipped(kind.mjcf, unnamed).copy()
    try:
        return _read(kind.mjcf, unnamed)
    except MUJOCO_SAYS as error:
        raise InputError(f"MJCF {kind.mjcf}: MuJoCo rejects this file ({_error_text(error)}); correct the file") from error


def _read(path: Path, unnamed: frozenset[str]) -> mujoco.MjSpec:
    with quiet():
        spec = mujoco.MjSpec.from_file(str(path))
    for sensor in spec.sensors:
        if sensor.name in unnamed:
            spec.delete(sensor)
    return spec


# caching is possible, because the files of built-in vehicle types do not change
_read_shipped = functools.lru_cache(maxsize=16)(_read)


def _compile_model(vehicle: Vehicle, spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Returns the compiled MuJoCo model with the parameters of the vehicle."""
    try:
        with quiet():
            return spec.compile()
    except MUJOCO_SAYS as error:
        try:
            _read_model(vehicle).compile()
        except MUJOCO_SAYS:
            whose = f"MJCF {vehicle.kind.mjcf}: MuJoCo rejects this file"
        else:
            whose = f"vehicle type {vehicle.kind.mjcf.with_suffix('.py')}: MuJoCo rejects the MJCF with the changes of write_mjcf"
        raise InputError(f"{whose} ({_error_text(error)}); correct the file") from error


def _error_text(error: Exception) -> str:
    return " ".join(str(error).split())


def _write_limits(spec: mujoco.MjSpec, vehicle: Vehicle) -> None:
    """Writes the largest force and the actuator lag in `[limits]` into every actuator of the model."""
    limits = vehicle.limits
    for actuator in spec.actuators:
        if actuator.name.startswith(FITTED_PREFIX):
            continue
        if limits.actuator_force is not None:
            actuator.forcelimited = True
            command, force = limits.largest
            actuator.forcerange = [-force, force]
            actuator.ctrlrange = [-command, command]  # without this setting, MuJoCo would replace forces above 1e10 N by 0
        if limits.actuator_bandwidth is not None:
            # RK4 integrates the state of MuJoCo's `filter` together with the other states. The alternative `filterexact` would
            # be exact by itself, but RK4's intermediate stages would receive its output half a step late.
            actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTER
            actuator.dynprm[0] = 1 / limits.actuator_bandwidth


def _write_parts(spec: mujoco.MjSpec, vehicle: Vehicle) -> None:
    """Adds the nonlinear parts of suspensions to the model, and sensors for those suspension velocities that are signals.

    A part that MuJoCo cannot represent with its own elements gets a motor on the tendon of its suspension.
    """
    names, sensed = {signal.name for signal in vehicle.kind.signals}, {sensor.name for sensor in spec.sensors}
    new, parts = names - sensed, [one for one in vehicle.parts if one.acts]
    pairs = [(part.velocity.name, part.deflection) for part in vehicle.kind.suspensions if part.velocity.name in new]
    if not (pairs or parts):
        return
    native = FEATURES.load("parts native to MuJoCo")
    with error_in(f"MJCF {vehicle.kind.mjcf}:"):
        tendons = {tendon.name: tendon for tendon in spec.tendons}
        for one in parts:
            if one.tendon not in tendons:
                raise InputError(
                    f"the model has no tendon {one.tendon!r}, but this suspension needs this tendon for "
                    f"{one.part.words}; add the tendon, or omit {one.part.words}"
                )
            _check_line(tendons[one.tendon], one)
        native.sense_velocities(spec, pairs)
        if not parts:
            return
        at_rest = _compile_model(vehicle, spec.copy())
        rest = {at_rest.tendon(i).name: float(at_rest.tendon_length0[i]) for i in range(at_rest.ntendon)}
        places = [(one, native.Tendon(spec, one.tendon, rest[one.tendon], FITTED_PREFIX)) for one in parts]
        for one, tendon in places:
            if one.native:
                one.part.write(tendon)
        for name in dict.fromkeys(one.tendon for one in parts if not one.native):
            native.Tendon(spec, name, rest[name], FITTED_PREFIX).add_motor()
        for one, tendon in places:
            one.part.write_input(tendon, not one.native)


def _check_line(tendon: Any, one: "SuspensionPart") -> None:
    """Refuses a tendon whose stiffness or damping differs from the parameter that a part replaces."""
    if not one.parameter:
        return
    line = one.part.line
    own, slope = (float((tendon.damping if one.damps else tendon.stiffness)[0]), line.damping if one.damps else line.stiffness)
    if not abs(own - slope) <= SAME * max(abs(own), abs(slope)):
        raise InputError(
            f"the tendon {one.tendon!r} has {one.parameter} = {own:g}, but the vehicle file gives {slope:g}. A curve "
            f"can replace the tendon's force only if both are equal; let write_mjcf write {one.parameter}, or omit the curve"
        )


def build_model(vehicle: Vehicle, timestep: float, drawn: bool = True) -> mujoco.MjModel:
    """Returns the compiled MuJoCo model of a vehicle.

    At qpos = 0, the model is in equilibrium: qacc is 0 except for rounding errors.

    Args:
        vehicle: vehicle whose model is built.
        timestep: integration step [s].
        drawn: False to omit visual parts. Without visual parts, a simulation step gives the same numbers, but takes about 5 %
            less time.

    Raises:
        InputError: `build_spec` raises this error, or the model does not match the equations of motion.
    """
    spec = build_spec(vehicle, timestep)
    spec.compiler.discardvisual = not drawn
    model = _compile_model(vehicle, spec)
    _check_names(vehicle, model)
    _check_numbers(vehicle, model)
    return model


def _check_names(vehicle: Vehicle, model: mujoco.MjModel) -> None:
    """Refuses a model that lacks the name of a sensor, a body or another object that the equations of motion use."""
    kind, missing = vehicle.kind, []
    sensors = {model.sensor(i).name for i in range(model.nsensor)}
    parts = [part for name in vehicle.sensed_signals for part in kind.combined.get(name, {name: 1.0})]
    missing += [f"sensor {part!r}" for part in dict.fromkeys(parts) if part not in sensors]
    actuators = len(_inputs(model))
    if actuators != len(vehicle.linear_model.inputs):
        raise InputError(
            f"MJCF {kind.mjcf}: the model has {actuators} actuators, but linear_model has "
            f"{len(vehicle.linear_model.inputs)} inputs; give one actuator for each input"
        )
    mocap = {model.body(i).name for i in range(model.nbody) if model.body(i).mocapid[0] >= 0}
    missing += [f"mocap body {wheel.road_body!r}" for wheel in kind.wheels if wheel.road_body not in mocap]
    joints = {model.joint(i).name for i in range(model.njnt)}
    missing += [f"joint {load.joint!r}" for load in kind.loads if load.joint not in joints]
    if missing:
        raise InputError(
            f"MJCF {kind.mjcf}: the model has no {', no '.join(missing)}, which the equations of motion need; add "
            "what is missing to the model"
        )


def _inputs(model: mujoco.MjModel) -> tuple[str, ...]:
    """Returns the names of a model's actuators, except those that a vehicle file has added."""
    names = [model.actuator(i).name for i in range(model.nu)]
    return tuple(name for name in names if not name.startswith(FITTED_PREFIX))


def _check_numbers(vehicle: Vehicle, model: mujoco.MjModel) -> None:
    """Refuses a model for which a run cannot start at qpos = 0, or whose sensors cannot be evaluated."""
    where = f"MJCF {vehicle.kind.mjcf}"
    actuators = _inputs(model)
    if actuators != vehicle.linear_model.inputs:
        raise InputError(
            f"{where}: the model has the actuators {', '.join(map(repr, actuators))}, but linear_model has the inputs "
            f"{', '.join(map(repr, vehicle.linear_model.inputs))}; use the same names in the same order"
        )
    if model.nq != model.nv:
        raise InputError(f"{where}: free and ball joints are not allowed; use slide and hinge joints")
    for name in vehicle.sensed_signals:
        for part in vehicle.kind.combined.get(name, {name: 1.0}):
            sensor = model.sensor(part)
            count = int(sensor.dim[0])
            along = sensor.user[:count]
            if len(along) < count or not np.all(np.isfinite(along)) or not along.any():
                raise InputError(
                    f"{where}: sensor {part!r} has {count} component(s), but user = {short_repr(along)} is not a direction "
                    f'with {count} component(s); give a direction, as in user="0 0 1", '
                    'and add <size nuser_sensor="3"/> to the file'
                )
    data = mujoco.MjData(model)
    with quiet():
        mujoco.mj_forward(model, data)
    for what, values in {"acceleration": data.qacc, "sensor": data.sensordata}.items():
        if not np.all(np.isfinite(values)):
            raise InputError(
                f"{where}: the {what}s at qpos = 0 are not finite; correct the MJCF file, or the function write_mjcf"
            )
    _check_hubs(vehicle, model)


def _check_hubs(vehicle: Vehicle, model: mujoco.MjModel) -> None:
    """Refuses a model whose tyres cannot be fully compressed.

    If the road rose above the hub, the tyre in MuJoCo would become longer again instead of shorter.
    """
    kind, data = vehicle.kind, mujoco.MjData(model)

    def read(tyre: str) -> float:
        with quiet():
            mujoco.mj_forward(model, data)
        total = 0.0
        for part, factor in kind.combined.get(tyre, {tyre: 1.0}).items():
            sensed = data.sensor(part).data
            total += factor * float(model.sensor(part).user[: len(sensed)] @ sensed)
        return total

    for wheel, mocap in zip(kind.wheels, mocap_indices(vehicle, model), strict=True):
        mujoco.mj_resetData(model, data)
        rest = read(wheel.tyre_deflection)
        data.mocap_pos[mocap, 2] += LOWEST_HUB
        moved = read(wheel.tyre_deflection) - rest
        if not abs(moved + LOWEST_HUB) < 1e-6:
            raise InputError(
                f"MJCF {kind.mjcf}: raising {wheel.road_body!r} by {LOWEST_HUB} m should change "
                f"{wheel.tyre_deflection!r} by -{LOWEST_HUB} m, not by {moved:.4g} m; if the hub "
                f"is too low, place the hub at least {LOWEST_HUB} m above the road"
            )


def mjcf_text(vehicle: Vehicle, timestep: float) -> str:
    """Returns the MJCF text of the model that `build_model` compiles, with exact numbers, for logs."""
    spec = build_spec(vehicle, timestep)
    spec.compiler.savecompiled = False  # MuJoCo would round the compiled values to six digits
    return spec.to_xml()


def pushed_dofs(vehicle: Vehicle, model: mujoco.MjModel) -> list[int]:
    """Returns the index of the degree of freedom on which each load of the vehicle type acts."""
    return [int(model.joint(load.joint).dofadr[0]) for load in vehicle.kind.loads]


def damped_tyres(vehicle: Vehicle, model: mujoco.MjModel) -> tuple[list[int], list[int]]:
    """Returns the wheels whose tyres have damping, and the actuator of each of these wheels. The control input of each actuator
    is the road velocity under the actuator's wheel.

    Returns:
        Indices of the wheels whose tyres have damping, and the index of each wheel's actuator.
    """
    if not vehicle.linear_model.tyres_damp:
        return [], []
    actuators = {model.actuator(i).name: i for i in range(model.nu)}
    names = [actuator_of(wheel.tyre_deflection) for wheel in vehicle.kind.wheels]
    some = [i for i, name in enumerate(names) if name in actuators]
    return some, [actuators[names[i]] for i in some]


def mocap_indices(vehicle: Vehicle, model: mujoco.MjModel) -> list[int]:
    """Returns the mocap index of the road body under every wheel."""
    return [int(model.body(wheel.road_body).mocapid[0]) for wheel in vehicle.kind.wheels]


# Amplitude of the test motion [m, rad], which is less than the hub height. The cosine of an angle of this size differs from 1
# by 5e-5
LARGEST_MOVE = 1e-2
# Smallest change that is noticed, relative to the largest entry of a matrix or to the sensor value; the rounding error is 1e-15
CHANGE = 1e-9
TRIALS = 3


@functools.lru_cache(maxsize=16)
def has_geometry(vehicle: Vehicle) -> bool:
    """Returns True if the model is linear for small motions only, whatever the values of its parameters are.

    The model is nonlinear for one of three reasons. First, masses, weights, or lever arms of tendons and actuators may change
    with the position. Second, the force of a spring or damper may be a polynomial. Third, a sensor may measure more than a sum
    of positions, velocities and accelerations, such as the velocity of a point on a rotating body. For a nonlinear sensor, half
    of a motion does not give half of the measurement. The test prescribes the motion, and ignores the forces that the motion
    would need.
    """
    model = build_model(replace(vehicle, limits=Limits()), 1e-3, drawn=False)
    if any(map(np.any, (model.jnt_stiffnesspoly, model.dof_dampingpoly, model.tendon_stiffnesspoly, model.tendon_dampingpoly))):
        return True
    data, rng, combined = mujoco.MjData(model), np.random.default_rng(0), vehicle.kind.combined
    names = list(dict.fromkeys(part for name in vehicle.sensed_signals for part in combined.get(name, {name: 1.0})))

    def read(motion: Array) -> tuple[list[Array], Array]:
        """Returns the model's matrices and the sensor values for a motion: positions, velocities and accelerations, shape (3,
        n).
        """
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = motion[0], motion[1]
        mujoco.mj_forward(model, data)
        matrices = [np.array(each) for each in (data.M, data.qfrc_bias, data.ten_J, data.actuator_moment)]
        data.qacc[:] = motion[2]
        mujoco.mj_rnePostConstraint(model, data)
        mujoco.mj_sensorAcc(model, data)
        sensed = {name: data.sensor(name).data for name in names}
        return matrices, np.array([model.sensor(name).user[: len(sensed[name])] @ sensed[name] for name in names])

    matrices, still = read(np.zeros((3, model.nv)))
    for _ in range(TRIALS):
        motion = rng.uniform(-1.0, 1.0, (3, model.nv)) * np.array([[LARGEST_MOVE], [1.0], [1.0]])
        (moved, whole), (_, half) = read(motion), read(motion / 2)
        bent = np.abs(whole - 2 * half + still) > CHANGE * np.maximum(np.abs(whole - still), LARGEST_MOVE)
        pairs = zip(matrices, moved, strict=True)
        changed = (np.abs(there - here).max(initial=0.0) > CHANGE * np.abs(here).max(initial=0.0) for here, there in pairs)
        if bent.any() or any(changed):
            return True
    return False
