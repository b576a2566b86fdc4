"""Vehicle types with a seat: a person above a point of the body, on a spring and a damper in parallel.

The mass m_p of person and seat slides along the vertical axis of the body through the point (x, y). In equilibrium, the mass
m_p is at the height of the body's centre of mass. For small motions, the extension s of the seat's spring relative to
equilibrium is given by

    s' = z_p' - (z' - x theta' + y phi'),     m_p z_p'' = -(k_p s + c_p s'),

and the force k_p s + c_p s' of spring and damper lifts the body at the point (x, y). If links define a roll or pitch axis of
the body, a rotation about this axis also moves the seat horizontally. The seat then adds the inertia m_p b^2 and, per unit of
the angle, the weight moment m_p g b to the inertia and weight moment of the body (`rigid_body.py`). The weight of the seat is
part of every static load; `sprung_mass` is the mass of the body without the seat.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from models.common.errors import InputError
from models.common.schema import SI, keys, read
from models.kinds.kind import GRAVITY, HERE, Parameter, Parameters, VehicleKind
from models.kinds.linear_model import LinearModel
from models.kinds.seat import JOINT, Seat
from models.kinds.signals import (
    HEAVE_LOAD,
    HEAVE_VELOCITY,
    PITCH_LOAD,
    PITCH_RATE,
    ROLL_LOAD,
    ROLL_RATE,
    SEAT_ACCELERATION,
    SEAT_TRAVEL,
    SEAT_VELOCITY,
    SPRUNG_VELOCITY,
)

if TYPE_CHECKING:
    from models.kinds.motion import Motion

SIGNALS = (SEAT_TRAVEL, SEAT_VELOCITY, SEAT_ACCELERATION)
LOADS = (HEAVE_LOAD.name, PITCH_LOAD.name, ROLL_LOAD.name)
# Rates and accelerations of the body that belong to the loads in `LOADS`, in the same order
RATES = ((HEAVE_VELOCITY.name, SPRUNG_VELOCITY.name), (PITCH_RATE.name,), (ROLL_RATE.name,))
TURNS = {"x": ("pitch_inertia", "does not pitch"), "y": ("roll_inertia", "does not roll")}
POINT_INERTIA = 1e-12  # rotational inertia of the seat in the MJCF [kg m2]; MuJoCo requires a value above 0
# Half the edge lengths of the drawn cushion and of the drawn backrest [m]
CUSHION, BACK = (0.22, 0.22, 0.05), (0.04, 0.22, 0.14)
SPRING = (0.2, 0.36)  # heights at which the drawn spring ends, above the mounting point [m]
# Parts of the body that are drawn transparent, so that they do not hide the seat
GLASS = {"cabin": [0.55, 0.68, 0.78, 0.25], "roof": [0.16, 0.36, 0.62, 0.25]}
# Values of MuJoCo's constants mjGEOM_BOX, mjJNT_SLIDE, mjOBJ_SITE and mjOBJ_JOINT, because vehicle types do not import MuJoCo
BOX, SLIDE, SITE, OF_JOINT = 6, 2, 6, 3
# Values of MuJoCo's mjSENS_JOINTPOS, mjSENS_FRAMELINVEL and mjSENS_FRAMELINACC; type of the object; measured direction
SENSORS = {
    SEAT_TRAVEL.name: (9, OF_JOINT, [1.0]),
    SEAT_VELOCITY.name: (31, SITE, [0.0, 0.0, 1.0]),
    SEAT_ACCELERATION.name: (33, SITE, [0.0, 0.0, 1.0]),
}


def read_seat(section: Mapping[str, Any], kind: VehicleKind, parameters: Mapping[str, Any]) -> tuple[VehicleKind, dict[str, Any]]:
    """Reads `[seat]`.

    Returns:
        The vehicle type with a seat, and the parameters including the parameters of the seat.

    Raises:
        InputError: a key or value is not allowed, or the vehicle type cannot have a seat.
    """
    if kind.folder != HERE:
        raise InputError(
            f"[seat] applies only to built-in vehicle types; add the seat as a mass above the body in {kind.name}.py, "
            "or omit the section [seat]"
        )
    seat, type_with_seat = read("[seat]", Seat, section), seated_kind(kind)
    known = {one.name for one in type_with_seat.parameters}
    for key, (_, words) in TURNS.items():
        if getattr(seat, key) and f"seat_{key}" not in known:
            raise InputError(f"[seat] {key} has no effect, because this vehicle {words}; omit {key}")
    own = {f"seat_{key}": getattr(seat, key) for key in keys(Seat) if f"seat_{key}" in known}
    if twice := [name for name in own if name in parameters]:
        key = twice[0].removeprefix("seat_")
        raise InputError(f"[parameters] {twice[0]} is already given as {key} in [seat]; omit {twice[0]} in [parameters]")
    return type_with_seat, {**parameters, **own}


def seated_kind(kind: VehicleKind) -> VehicleKind:
    """Returns a built-in vehicle type with a seat.

    The names of the seat's parameters begin with `seat_`. Ride is evaluated at the person in the seat.
    """
    known = {one.name for one in kind.parameters}
    parameters = [
        Parameter(f"seat_{key}", one.unit, one.meaning, usual=0.0 if key in TURNS else None, smallest=one.low, largest=one.high)
        for key, one in keys(Seat).items()
        if isinstance(one, SI) and (key not in TURNS or TURNS[key][0] in known)
    ]
    return replace(
        kind,
        parameters=(*kind.parameters, *parameters),
        signals=(*kind.signals, *SIGNALS),
        linear_model=partial(_linear_model, kind.linear_model),
        write_mjcf=partial(_write_mjcf, kind.write_mjcf),
        motion=kind.motion and partial(_motion, kind.motion),
        people=(SEAT_ACCELERATION.name,),
        invariants=(),  # the vehicle type's invariants are valid only for vehicles without additional masses
    )


def _linear_model(of_car: Callable[[Parameters], LinearModel], p: Parameters) -> LinearModel:
    """Returns the linear model of a car with a seat; the last states are the seat's travel and velocity."""
    car, seat = of_car(p), Seat.of(p)
    point, lift, shown = np.zeros(len(car.A)), np.zeros(len(car.A)), np.zeros(len(car.C))
    for load, rates, arm in zip(LOADS, RATES, seat.arms, strict=True):
        if load in car.loads:
            i = car.loads.index(load)
            point[next(car.states.index(name) for name in rates if name in car.states)] = arm
            lift, shown = lift + arm * car.Bl[:, i], shown + arm * car.Dl[:, i]
    rates = np.zeros((2, len(point) + 2))
    rates[0] = [*-point, 0.0, 1.0]
    model = car.with_states((SEAT_TRAVEL.name, SEAT_VELOCITY.name), rates)
    travel = np.eye(len(model.A))[[-2]]
    pull, seen = np.append(lift, [0.0, -1.0 / seat.mass])[:, None], np.append(shown, [0.0, 0.0])[:, None]
    model = model.with_lines(travel, pull, seen, np.array([seat.stiffness]), np.array([seat.damping]))
    return model.with_rates({SEAT_ACCELERATION.name: SEAT_VELOCITY.name})


def _motion(of_car: Callable[[Parameters], Any], p: Parameters) -> "Motion":
    from models.kinds.seated_motion import SeatedMotion

    return SeatedMotion(of_car(p), Seat.of(p))


def _write_mjcf(of_car: Callable[[Any, Parameters], None], spec: Any, p: Parameters) -> None:
    """Writes a car with a seat: the body `seat` on the body `sprung`, its joint with the preloaded spring, and sensors.

    The mass of seat and person is a point mass at the origin of the body `seat`. Cushion and backrest are drawn above the point
    mass.
    """
    of_car(spec, p)
    seat, sprung = Seat.of(p), spec.body("sprung")
    body = sprung.add_body(name=JOINT, pos=[seat.x, seat.y, 0.0], mass=seat.mass, explicitinertial=True)
    body.ipos, body.inertia = [0.0, 0.0, 0.0], [POINT_INERTIA] * 3
    joint = body.add_joint(name=JOINT, axis=[0.0, 0.0, 1.0], springref=seat.mass * GRAVITY / seat.stiffness)
    joint.type = SLIDE
    joint.stiffness[0], joint.damping[0] = seat.stiffness, seat.damping
    body.add_site(name=JOINT)
    sprung.add_site(name="seat_bottom", pos=[seat.x, seat.y, SPRING[0]])
    body.add_site(name="seat_top", pos=[0.0, 0.0, SPRING[1]])
    cushion, back = SPRING[1] + CUSHION[2], SPRING[1] + BACK[2]
    for name, size, pos in (("seat_cushion", CUSHION, [0.0, 0.0, cushion]), ("seat_back", BACK, [-CUSHION[0], 0.0, back])):
        geom = body.add_geom(name=name, size=size, pos=pos, rgba=[0.35, 0.25, 0.2, 1.0], contype=0, conaffinity=0, mass=0.0)
        geom.type = BOX
    for geom in sprung.geoms:
        geom.rgba = GLASS.get(geom.name, geom.rgba)
    for name, (kind, of, along) in SENSORS.items():
        sensor = spec.add_sensor(name=name, objname=JOINT)
        sensor.type, sensor.objtype, sensor.userdata = kind, of, along
