"""Suspension links: they define the axes about which a body rotates, and carry a share of the loads instead of the springs.

All heights in this file are measured from the ground. If a car has roll centres, the body rolls about the axis through the
front and rear roll centres. At the longitudinal position of the centre of mass, the roll axis has the height

    h_r = (h_front l_rear + h_rear l_front) / L,     b = h - h_r     (l: distances of the axles from the centre of mass, L:
    their sum).

The moment of inertia of the body about the roll axis is I_x + m_s b^2. At the roll angle phi, the centre of mass is displaced
by b phi to the side, so the weight has the moment m_s g b phi. In steady-state cornering, on rigid tyres or with roll centres
on the ground,

    phi = m_s a b / (K - m_s g b)

where K is the roll stiffness of springs, bars and tyres (T. D. Gillespie, Fundamentals of Vehicle Dynamics, ch. 6; W. F. and D.
L. Milliken, Race Car Vehicle Dynamics, ch. 18). If there is a pitch centre, the body pitches about an axis at the height of the
pitch centre. The roll axis and the pitch axis are assumed to be horizontal and do not move relative to the ground. Tyres are
assumed not to slip sideways, and to deflect only vertically. The links guide every wheel, so the deflection of a suspension is
z - x theta + y phi - z_u at any pitch and roll angle.

Links transmit a horizontal force F on the body to the tyres. The share s of a lateral force that an axle carries is the
distance of the other axle from the centre of mass, divided by the wheelbase L. Through the links, a lateral force F increases
the load on the outer wheel of the axle by s F h_axle / track. The height of the axle's roll centre is h_axle. A longitudinal
force F at the height h transfers the load F h / L between the axles. The parameter `anti_...` of an axle is the share of the
axle's load transfer that the links carry. The front axle has the share b_f of the braking force. Let beta be the slope angle,
in side view, of a line from the wheel to the instant centre. Then (Gillespie, ch. 7; Milliken, ch. 17), for a vehicle with
rear-wheel drive,

    anti_dive_front = b_f tan(beta) L / h
    anti_lift_rear = (1 - b_f) tan(beta) L / h
    anti_squat_rear = tan(beta) L / h

The line of slope beta begins at the tyre contact point if the links react the wheel torque. Examples in which the links react
the torque are brakes at the wheel and a driven solid axle. The line of slope beta begins at the wheel centre if the body reacts
the torque. Examples in which the body reacts the torque are inboard brakes and a driven wheel with independent suspension.
Vehicle files contain the shares of the load transfer themselves, so both positions of the line are possible.

A link that carries load pushes the body at its axle, and the wheels of this axle in the opposite direction. The inertial force
of the wheels does not act on the body. The inertial force of the wheels acts at the height of the wheel centres, so it exerts a
moment on the tyres. In cornering, the moment of the wheels' inertial force acts on the axle of these wheels; in braking, on
both axles together.

A half-car in the roll plane has a single axle. The body of a half-car in the roll plane rolls about its roll centre, and the
links carry the whole lateral force.
"""

from collections.abc import Collection, Sequence

from models.common.errors import InputError
from models.kinds.kind import BodyLoad, Parameter, Parameters
from models.kinds.signals import HEAVE_LOAD, PITCH_LOAD, ROLL_LOAD, WHEEL_LOAD

AXLES, SIDES = ("front", "rear"), ("left", "right")
# Allowed range of an axis height [m], which may lie below the ground; the share of the load that links carry has the same range
LOWEST, HIGHEST = -2.0, 3.0
UNDER = {"brakes": ("anti_dive_front", "anti_lift_rear"), "power": ("anti_lift_front", "anti_squat_rear")}


def _optional(name: str, unit: str, meaning: str, smallest: float = LOWEST) -> Parameter:
    return Parameter(name, unit, meaning, smallest=smallest, largest=HIGHEST, optional=True)


ROLL_CENTRES = tuple(
    _optional(f"roll_centre_height_{axle}", "m", f"{axle}, above the ground; the body rolls about the line through both")
    for axle in AXLES
)
ROLL_CENTRE = _optional("roll_centre_height", "m", "height above the ground of the point about which the body rolls")
WHEEL_CENTRE = _optional("wheel_centre_height", "m", "above the ground, where the wheels' inertia acts", smallest=0.0)
PITCH_CENTRE = _optional("pitch_centre_height", "m", "height above the ground of the axis about which the body pitches")
LENGTHWAYS = (
    PITCH_CENTRE,
    *(
        _optional(f"wheel_centre_height_{axle}", "m", f"{axle}, above the ground, where the wheel's inertia acts", smallest=0.0)
        for axle in AXLES
    ),
    *(
        _optional(name, "1", f"share of this axle's part of the moment m_s a h that the suspension links carry under {what}")
        for what, names in UNDER.items()
        for name in names
    ),
)


def arms(p: Parameters) -> tuple[float | None, float | None]:
    """Returns the heights of the centre of mass above the pitch axis and above the roll axis [m].

    A height is None if the vehicle file does not define the axis from which the height is measured.
    """
    pitch = p["centre_height"] - p[PITCH_CENTRE.name] if PITCH_CENTRE.name in p else None
    if ROLL_CENTRE.name in p:
        return pitch, p["centre_height"] - p[ROLL_CENTRE.name]
    if ROLL_CENTRES[0].name not in p:
        return pitch, None
    heights = [p[part.name] for part in ROLL_CENTRES]
    return pitch, p["centre_height"] - sum(share * height for share, height in zip(_shares(p), heights, strict=True))


def wheel_loads(p: Parameters, corners: Sequence[str]) -> tuple[BodyLoad, ...]:
    """Returns the loads on the wheels at `corners`; empty if the vehicle file describes neither links nor wheel centres."""
    carrying = any(part.name in p for part in (ROLL_CENTRE, WHEEL_CENTRE, *ROLL_CENTRES, *LENGTHWAYS) if part is not PITCH_CENTRE)
    return tuple(BodyLoad(f"{WHEEL_LOAD.name}_{corner}", f"unsprung_{corner}") for corner in corners) if carrying else ()


def carried_loads(p: Parameters, corners: Sequence[str], way: str, force: float, acceleration: float) -> dict[str, float]:
    """Returns the loads [N, N m], by name of the load, that links and wheel inertia cause in addition to the moment of a force
    on the body.

    Args:
        p: parameters of the vehicle.
        corners: names of the corners, such as "front" or "front_left".
        way: direction of the force: `roll_load` for a force to the right, `pitch_load` for a forward force.
        force: force on the body at its centre of mass [N], for example an inertial force or wind.
        acceleration: acceleration [m/s2] that causes the inertial force on the wheels, in the direction of `force`; 0 for wind.
    """
    if not wheel_loads(p, corners):
        return {}
    if corners == SIDES:
        return _across(p, force, acceleration)
    own = [p[f"unsprung_mass_{axle}"] * acceleration * p.get(f"wheel_centre_height_{axle}", 0.0) for axle in AXLES]
    if way == ROLL_LOAD.name:
        past = [share * force * p.get(part.name, 0.0) for share, part in zip(_shares(p), ROLL_CENTRES, strict=True)]
        gained = {
            axle: (link + 2 * wheel) / p.get(f"track_{axle}", p.get("track", 0.0))
            for axle, link, wheel in zip(AXLES, past, own, strict=True)
        }
        on_wheels = {name: gained[name.split("_")[0]] * (1.0 if name.endswith("left") else -1.0) for name in corners}
        on_body = {ROLL_LOAD.name: -sum(past)}
    else:
        front, rear = (p.get(name, 0.0) for name in UNDER["brakes" if force > 0 else "power"])
        length, wheels = sum(_distances(p)), len(corners) // 2
        exchanged, by_wheels = force * p["centre_height"] / length, sum(own) / length
        pushes = {"front": -front * exchanged / wheels - by_wheels, "rear": rear * exchanged / wheels + by_wheels}
        on_wheels = {name: pushes[name.split("_")[0]] for name in corners}
        moment = exchanged * (front * p["axle_distance_front"] + rear * p["axle_distance_rear"])
        on_body = {HEAVE_LOAD.name: (front - rear) * exchanged, PITCH_LOAD.name: -moment}
    return on_body | {f"{WHEEL_LOAD.name}_{name}": value for name, value in on_wheels.items()}


def _across(p: Parameters, force: float, acceleration: float) -> dict[str, float]:
    """Returns the same loads as `carried_loads`, for two wheels in one cross-section of the vehicle, whose links carry the
    whole force.
    """
    moment = force * p.get(ROLL_CENTRE.name, 0.0)
    own = sum(p[f"unsprung_mass_{side}"] for side in SIDES) * acceleration * p.get(WHEEL_CENTRE.name, 0.0)
    gained = (moment + own) / track("", p)
    return {ROLL_LOAD.name: -moment, f"{WHEEL_LOAD.name}_left": gained, f"{WHEEL_LOAD.name}_right": -gained}


def track(axle: str, p: Parameters) -> float:
    """Returns the track width of an axle [m], from `track_AXLE` or, if `track_AXLE` is not given, from `track`.

    Raises:
        InputError: neither `track_AXLE` nor `track` is given.
    """
    if (own := p.get(f"track_{axle}", p.get("track"))) is None:
        raise InputError(f"the distance between left and right wheels is missing; give track or track_{axle}, in m")
    return own


def left_out(p: Parameters, angles: Collection[str]) -> str:
    """Returns a sentence that describes moments of the body's weight that the model neglects; empty if the model neglects no
    moments.

    Args:
        p: parameters of the vehicle.
        angles: names of the angles of the body.
    """
    axes = (("rolls", "roll_angle", (ROLL_CENTRES[0], ROLL_CENTRE)), ("pitches", "pitch_angle", (PITCH_CENTRE,)))
    turning = [turns for turns, angle, parts in axes if angle in angles and not any(part.name in p for part in parts)]
    how = " and ".join(turning)
    return f"the model neglects the moment that the body's own weight causes when the body {how}" if turning else ""


def check_links(p: Parameters) -> None:
    """Raises an InputError if one axle has a roll centre and the other does not."""
    given = [part.name for part in ROLL_CENTRES if part.name in p]
    if len(given) == 1:
        other = next(part.name for part in ROLL_CENTRES if part.name not in p)
        raise InputError(
            f"{given[0]} is given without {other}, but the roll axis runs through both roll centres; give both "
            "heights, or neither"
        )


def _distances(p: Parameters) -> list[float]:
    return [p[f"axle_distance_{axle}"] for axle in AXLES]


def _shares(p: Parameters) -> list[float]:
    """Returns the share that each axle carries of a lateral force at the centre of mass."""
    front, rear = _distances(p)
    return [rear / (front + rear), front / (front + rear)]
