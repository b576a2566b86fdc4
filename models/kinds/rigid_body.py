"""Rigid body on several corners: the equations that half-cars and full cars have in common. A half-car has no pitch mode or no
roll mode.

The axes are defined as in ISO 8855: x forward, y to the left, z up. Pitch is positive if the nose moves down, and roll is
positive if the right side moves down. The modes of the body are heave z, pitch theta and roll phi, q = (z, theta, phi), which
are assumed to be small. The height of the body above corner i is s_i = z - x_i theta + y_i phi, or s = S q. In the notation of
the paper's (28), with the suspension force f_i upward on the body,

    d = S q - z_u,     t = z_u - z_r,     f = -K_s d - C_s d' + u,
    M q'' = S' f + l,      m_u z_u'' = -f - K_u t,

where d and t are the deflections of suspensions and tyres, and l contains the loads on the body, a force and moments. The state
consists of relative displacements and velocities: x = (d, P t, q', z_u').

An anti-roll bar is a torsion spring between body and axle. The angle of the bar is the roll angle of the body relative to the
axle, a = (d_left - d_right) / track. The moment k a of the bar with stiffness k acts as a pair of forces at the two wheels.
Without anti-roll bars, the suspension stiffness matrix K_s is diagonal. Each bar adds k (e_l - e_r)(e_l - e_r)' / track^2 to
K_s, where e_l and e_r are the unit vectors of its two corners.

A rigid body cannot follow every motion of four wheels. Let n be the warp motion that a rigid body cannot follow (n' S = 0).
Then n' (d + t + z_r) = 0 at all times, so not only the velocity but also the displacement of the road's warp acts on the
vehicle. The state therefore contains only the modes P t of the tyre deflections that a rigid body can follow. The equations of
motion then contain additional terms for the warp of the road:

    t = E (P t) - N (d + z_r),     N = e n',     [E e] = [P; n]^-1.

If P n = 0, as for axles of equal track width, then the matrices of the warp terms are E = P+ and N = n n' / n'n.

Every wheel slides vertically. The struts are upright in equilibrium, and their upper ends are at the height of the centre of
mass. Because the struts are upright and end at the height of the centre of mass, the preloads have no effect in the linear
model. The MuJoCo model (MJCF) differs from the linear model by terms that are quadratic in the amplitude.

If suspension links define a roll or pitch axis (`links.py`), the body rotates about this axis, which is b below the centre of
mass. The rotation about an axis that is b below the centre of mass adds m_s b^2 to the mass matrix M. The rotation also adds a
moment W q of the weight, where the entry of W for each angle is m_s g b. The body's angles in q are relative to level ground: q
= S+ (d + t + z_r). On a banked road, the body leans. If links define an axis of rotation, the road height therefore also acts
on the vehicle. In the MJCF, the hinges lie on the axes that the links define, and the suspensions are fixed tendons. Vertical
struts instead of fixed tendons would lean when the body sways, and their preload would rotate the body further.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.kinds.kind import GRAVITY, BodyLoad, Parameter, Parameters, motion_ratio
from models.kinds.linear_model import LinearModel
from models.kinds.signals import (
    HEAVE_LOAD,
    PITCH_LOAD,
    ROAD_DISPLACEMENT,
    ROLL_LOAD,
    SUSPENSION_DEFLECTION,
    TYRE_DEFLECTION,
    Signal,
    names_of,
)
from models.kinds.strut_and_tyre import TYRE_DAMPING, write_strut, write_tyre

# External loads on the body: one for each mode, in the order of the modes in q. Each load acts along the MJCF joint of its
# mode.
LOADS = tuple(BodyLoad(load.name, joint) for load, joint in ((HEAVE_LOAD, "heave"), (PITCH_LOAD, "pitch"), (ROLL_LOAD, "roll")))
CENTRE_HEIGHT = Parameter(
    "centre_height",
    "m",
    "h, height of the centre of mass above the ground; braking and cornering apply the moment m_s a h",
    usual=0.55,
)
AXLES = ("front", "rear")
LONGEST = 50.0  # largest plausible distance between wheels [m]; a larger number is probably in mm


def per_axle(
    name: str,
    unit: str,
    meaning: str,
    positive: bool = True,
    places: Sequence[str] = AXLES,
    **options: Any,
) -> tuple[Parameter, ...]:
    """Returns one parameter for each place, such as an axle or a side; the default places are the two axles. `options` are
    further arguments of `Parameter`.
    """
    return tuple(Parameter(f"{name}_{place}", unit, f"{meaning}, {place}", positive, **options) for place in places)


def of_half_car(places: Sequence[str]) -> tuple[Parameter, ...]:
    """Returns the parameters of a half-car with one wheel at each of two axles or sides."""
    return (
        *per_axle("unsprung_mass", "kg", "m_u, mass of wheel, hub and brake", places=places),
        *per_axle("suspension_stiffness", "N/m", "k_s, spring stiffness; 0 for a purely active strut", False, places=places),
        *per_axle("suspension_damping", "N s/m", "c_s, damping coefficient", False, places=places),
        *per_axle("tyre_stiffness", "N/m", "k_t, called k_u in the paper", places=places),
        *per_axle("tyre_damping", "N s/m", f"c_t, {TYRE_DAMPING}", False, places=places, optional=True),
        *(motion_ratio(f"motion_ratio_{place}") for place in places),
    )


@dataclass(frozen=True)
class Corner:
    """Wheel of the vehicle with its suspension.

    Attributes:
        name: suffix of the names of signals and MJCF elements at the wheel's corner.
        x: forward position of the wheel relative to the centre of mass [m].
        y: position of the wheel to the left of the centre of mass [m].
        unsprung_mass: mass of wheel, hub and brake [kg].
        suspension_stiffness: stiffness of the spring [N/m].
        suspension_damping: damping coefficient of the damper [N s/m].
        tyre_stiffness: stiffness of the tyre [N/m].
        tyre_damping: damping coefficient of the tyre [N s/m].
    """

    name: str
    x: float
    y: float
    unsprung_mass: float
    suspension_stiffness: float
    suspension_damping: float
    tyre_stiffness: float
    tyre_damping: float = 0.0

    @classmethod
    def of(cls, p: Parameters, name: str, place: str, y: float) -> "Corner":
        """Returns a corner with the parameters of its axle, or of its side for a half-car in the roll plane.

        Args:
            p: parameters of the vehicle.
            name: name of the corner.
            place: axle or side whose parameters apply to the corner.
            y: position to the left of the centre of mass [m].
        """
        x = {"front": 1.0, "rear": -1.0}.get(place, 0.0) * p.get(f"axle_distance_{place}", 0.0)
        own = ("unsprung_mass", "suspension_stiffness", "suspension_damping", "tyre_stiffness")
        damping = p.get(f"tyre_damping_{place}", 0.0)
        return cls(name, x, y, *(p[f"{parameter}_{place}"] for parameter in own), tyre_damping=damping)


@dataclass(frozen=True)
class Bar:
    """Anti-roll bar of one axle.

    Attributes:
        name: suffix of the bar's tendon in the MJCF.
        left: index of the left corner.
        right: index of the right corner.
        stiffness: moment of the bar per roll angle of the body relative to the axle [N m/rad].
    """

    name: str
    left: int
    right: int
    stiffness: float


@dataclass(frozen=True, eq=False)
class RigidBody:
    """Rigid body on c corners.

    Attributes:
        corners: c wheels with their suspensions, in the same order as in the signals.
        mass: sprung mass [kg].
        pitch_inertia: moment of inertia about the lateral axis through the centre of mass [kg m2]; None for a body that does
            not pitch.
        roll_inertia: moment of inertia about the longitudinal axis [kg m2]; None for a body that does not roll.
        tyre_modes: matrix P, whose rows are the modes of the tyre deflections in the state, shape (p, c).
        twist: vector n, the warp motion with n' S = 0, shape (c,); zero if the body can follow every motion of the wheels.
        bars: anti-roll bars of the body.
        pitch_arm: height of the centre of mass above the pitch axis that links define [m]. The height is None if links do not
            define a pitch axis. The body then pitches about its centre of mass, and its weight has no moment.
        roll_arm: height of the centre of mass above the roll axis [m]; None if links do not define a roll axis.
        wheel_loads: loads on the wheels due to suspension links and wheel inertia.
        seat_mass: mass on a seat above the body, not included in `mass` [kg].
        seat_x: position of the seat forward of the centre of mass [m].
        seat_y: position of the seat to the left of the centre of mass [m].
    """

    corners: tuple[Corner, ...]
    mass: float
    pitch_inertia: float | None
    roll_inertia: float | None
    tyre_modes: Array
    twist: Array
    bars: tuple[Bar, ...] = ()
    pitch_arm: float | None = None
    roll_arm: float | None = None
    wheel_loads: tuple[BodyLoad, ...] = ()
    seat_mass: float = 0.0
    seat_x: float = 0.0
    seat_y: float = 0.0

    @cached_property
    def modes(self) -> tuple[int, ...]:
        """Indices of the body's k modes: 0 for heave, 1 for pitch, 2 for roll."""
        return (0, *([1] if self.pitch_inertia is not None else []), *([2] if self.roll_inertia is not None else []))

    @property
    def has_axis(self) -> bool:
        """True if suspension links define an axis of rotation and guide the wheels."""
        return self.pitch_arm is not None or self.roll_arm is not None

    @property
    def axis_offsets(self) -> Array:
        """Horizontal displacement of the centre of mass per unit of each mode [m/m, m/rad], shape (k,)."""
        return np.array([0.0, self.pitch_arm or 0.0, self.roll_arm or 0.0])[list(self.modes)]

    def arms(self, bar: Bar) -> Array:
        """Returns the angle of an anti-roll bar per deflection of each suspension [rad/m], shape (c,)."""
        arms = np.zeros(len(self.corners))
        arms[[bar.left, bar.right]] = np.array([1.0, -1.0]) / (self.corners[bar.left].y - self.corners[bar.right].y)
        return arms

    @property
    def stiffness(self) -> Array:
        """K_s: matrix of the force of each suspension (row) per deflection of each suspension (column) [N/m], shape (c, c)."""
        bars = [bar.stiffness * np.outer(self.arms(bar), self.arms(bar)) for bar in self.bars]
        return sum(bars, np.diag([corner.suspension_stiffness for corner in self.corners]))

    @property
    def shape(self) -> Array:
        """S: matrix of the height of the body above each corner (row) per mode (column), shape (c, k)."""
        x, y = np.array([[corner.x, corner.y] for corner in self.corners]).T
        columns = (np.ones(len(x)), -x, y)
        return np.stack(list(map(columns.__getitem__, self.modes)), axis=-1)

    @property
    def inertia(self) -> Array:
        """M: mass matrix of the body's modes, shape (k, k)."""
        about_centre = np.array([self.mass, self.pitch_inertia or 0.0, self.roll_inertia or 0.0])[list(self.modes)]
        return np.diag(about_centre + (self.mass + self.seat_mass) * self.axis_offsets**2)

    @property
    def weight(self) -> Array:
        """W: matrix of the moment of the weight per angle of the body, shape (k, k)."""
        return np.diag((self.mass + self.seat_mass) * GRAVITY * self.axis_offsets)

    def static_loads(self) -> Array:
        """Returns the load on each suspension in equilibrium [N], shape (c,): the least-squares loads that balance the weight."""
        weight = np.zeros(len(self.inertia))
        weight[0] = self.mass * GRAVITY
        weight += self.seat_mass * GRAVITY * np.array([1.0, -self.seat_x, self.seat_y])[list(self.modes)]
        return np.linalg.pinv(self.shape.T) @ weight

    def static_tyre_deflection(self) -> dict[str, float]:
        """Returns the compression of each tyre in equilibrium [m]; the keys are the tyre deflection signals."""
        loads = zip(self.corners, self.static_loads(), strict=True)
        return {
            f"tyre_deflection_{corner.name}": float(load + corner.unsprung_mass * GRAVITY) / corner.tyre_stiffness
            for corner, load in loads
        }


def linear_model(
    body: RigidBody, states: Sequence[Signal], inputs: Sequence[Signal], disturbances: Sequence[Signal], outputs: Sequence[Signal]
) -> LinearModel:
    """Returns the linear model of a rigid body on corners.

    Args:
        body: body with c corners, k modes and p tyre modes.
        states: signals of the state (d, P t, q', z_u'), in total c + p + k + c signals.
        inputs: signals of the c control forces.
        disturbances: signals of the c road velocities.
        outputs: output signals. The first output signals are the states, the other tyre deflections, q'', and the velocities
            and accelerations of the body above each corner. The next output signals are the control forces and the wheel
            accelerations. The last output signals are the heights of the body, of its points above each corner, and of the
            wheels.
    """
    S, M, P = body.shape, body.inertia, body.tyre_modes
    c, k, p = len(S), len(M), len(P)
    n = 2 * c + p + k
    corner = {
        name: np.diag([getattr(corner, name) for corner in body.corners])
        for name in ("unsprung_mass", "suspension_damping", "tyre_stiffness", "tyre_damping")
    }
    # Each row of the identity matrix selects one state; the rows are split into the parts of the state vector.
    d, Pt, q_dot, z_u_dot = np.split(np.eye(n), [c, c + p, c + p + k])

    E, N = np.linalg.pinv(P), np.outer(body.twist, body.twist) / (float(body.twist @ body.twist) or 1.0)
    if (P @ body.twist).any():
        E, e = np.split(np.linalg.inv(np.vstack([P, body.twist])), [p], axis=1)
        N = e * body.twist
    t = E @ Pt - N @ d
    d_dot = S @ q_dot - z_u_dot
    f = -body.stiffness @ d - corner["suspension_damping"] @ d_dot  # suspension force without the actuator force u
    lift, push = np.linalg.solve(M, S.T), np.linalg.inv(corner["unsprung_mass"])
    over_ground = np.linalg.solve(M, body.weight @ np.linalg.pinv(S))  # acceleration of a leaning body due to its weight

    A = np.vstack([d_dot, P @ z_u_dot, lift @ f, -push @ (f + corner["tyre_stiffness"] @ t)])
    B = np.vstack([np.zeros((c + p, c)), lift, -push])
    Bw = np.vstack([np.zeros((c, c)), -P, np.zeros((k + c, c))])
    Bt = np.zeros((n, c))
    if corner["tyre_damping"].any():
        Bt[c + p + k :] = push @ corner["tyre_damping"]
        A[c + p + k :] -= push @ corner["tyre_damping"] @ z_u_dot
        Bw = Bw + Bt
    Br = np.vstack([np.zeros((c + p + k, c)), push @ corner["tyre_stiffness"] @ N])
    Bl = np.vstack([np.zeros((c + p, k)), np.linalg.inv(M), np.zeros((c, k))])
    if body.has_axis:
        A[c + p : c + p + k] += over_ground @ (d + t)
        Br[c + p : c + p + k] += over_ground @ (np.eye(c) - N)
    if body.wheel_loads:
        Bl = np.hstack([Bl, np.vstack([np.zeros((c + p + k, c)), push])])

    extra_t = t if p < c else t[:0]
    lengths, heights = n + len(extra_t), 2 * c + 1
    # Heights above the datum: q = S+ (d + t + z_r) for the body, d + t + z_r above the corners, and t + z_r at the wheels.
    q, held = np.linalg.pinv(S)[:1], np.eye(c) - N
    over_datum = np.vstack([q @ (d + t), d + t, t])
    # The outputs are sums of the states, and accelerations: rates of sums of the states.
    sums = np.vstack([np.eye(n), extra_t, np.zeros((k, n)), S @ q_dot, np.zeros((3 * c, n)), over_datum])
    silent = np.zeros((lengths, n)), np.zeros((c, n)), np.zeros((heights, n))
    rates_of = np.vstack([silent[0], q_dot, silent[1], S @ q_dot, silent[1], z_u_dot, silent[2]])
    C, D, Cr, Dl, Dw = (rates_of @ acting for acting in (A, B, Br, Bl, Bt))
    C = C + sums
    D[-heights - 2 * c : -heights - c] = np.eye(c)
    Cr[n:lengths] = -N[: len(extra_t)]
    Cr[-heights:] = np.vstack([q @ held, held, held])
    names = names_of(outputs)
    rate = np.sqrt(np.mean(np.diag(corner["tyre_stiffness"]) / np.diag(corner["unsprung_mass"])))
    return LinearModel(
        A=A,
        B=B,
        Bw=Bw,
        C=C,
        D=D,
        states=names_of(states),
        inputs=names_of(inputs),
        disturbances=names_of(disturbances),
        outputs=names,
        Br=Br,
        Cr=Cr,
        twist_rate=float(rate),
        loads=tuple(load.name for load in (*map(LOADS.__getitem__, body.modes), *body.wheel_loads)),
        Bl=Bl,
        Dl=Dl,
        Bt=Bt,
        Dw=Dw,
        heights=names[-heights:],
    )


def angles(body: RigidBody) -> dict[str, dict[str, float]]:
    """Returns the body's angles [rad] as sums of signals, computed from the heights above the corners: q = S+ (d + t + z_r)."""
    q, names = np.linalg.pinv(body.shape), [corner.name for corner in body.corners]
    turns = [("", "pitch_angle", "roll_angle")[i] for i in body.modes[1:]]
    parts = [signal.name for signal in (SUSPENSION_DEFLECTION, TYRE_DEFLECTION, ROAD_DISPLACEMENT)]
    return {
        angle: {f"{part}_{name}": float(share) for part in parts for name, share in zip(names, row, strict=True)}
        for angle, row in zip(turns, q[1:], strict=True)
    }


def wheelbase(p: Parameters) -> float:
    """Returns the distance between front and rear axle [m]."""
    return p["axle_distance_front"] + p["axle_distance_rear"]


def check_inertia(name: str, inertia: float, mass: float, size: float, of: str) -> None:
    """Raises an InputError if the radius of gyration that follows from a moment of inertia is larger than the body.

    Args:
        name: name of the parameter that contains the moment of inertia.
        inertia: moment of inertia [kg m2].
        mass: mass of the body [kg].
        size: length of the body that limits the radius of gyration [m].
        of: name of the length `size` for the message, such as "wheelbase".
    """
    radius = float(np.sqrt(inertia / mass))
    if radius > size:
        raise InputError(
            f"{name} = {inertia:g} kg m2 is too large for a body of {mass:g} kg: its radius of gyration would be "
            f"{radius:.3g} m, more than the {of} of {size:g} m; give at most {mass * size**2:.4g} kg m2"
        )


def check_stands(body: RigidBody) -> None:
    """Raises an InputError if springs, bars and tyres cannot hold the body against the moment of its own weight."""
    if not body.has_axis:
        return
    tyres, stiffness = np.diag([corner.tyre_stiffness for corner in body.corners]), body.stiffness
    in_series = stiffness - stiffness @ np.linalg.solve(stiffness + tyres, stiffness)
    try:
        # Angle that a moment causes if all other modes are free to move
        freed = np.linalg.inv(body.shape.T @ in_series @ body.shape)
    except np.linalg.LinAlgError:
        raise InputError(
            "the body falls over, because no spring holds it; add springs, or omit the roll and pitch centres"
        ) from None
    for i, mode in enumerate(body.modes[1:], start=1):
        turns, centres = ("pitches", "pitch centre") if mode == 1 else ("rolls", "roll centres")
        holding, turning = 1 / freed[i, i], body.weight[i, i]
        if holding <= turning:
            raise InputError(
                f"the body falls over when it {turns}: its weight turns it further with {turning:.4g} N m/rad, but "
                f"springs, anti-roll bars and tyres resist with only {holding:.4g} N m/rad; stiffen them, or raise "
                f"the {centres}"
            )


def write_mjcf(spec: Any, body: RigidBody) -> None:
    """Writes a body on corners into the MjSpec of its vehicle type: masses, positions, springs and preloads.

    The elements of each corner NAME are the bodies `road_NAME` and `unsprung_NAME`, the sites `suspension_NAME_bottom` and
    `suspension_NAME_top`, and the tendons `suspension_NAME` and `tyre_NAME`. At qpos = 0, which is the static equilibrium, the
    preloads carry the weight. An anti-roll bar is a fixed tendon `anti_roll_bar_NAME` whose length is the angle of the joint
    `roll` relative to the axle. If links guide the wheels, the tendons `suspension_NAME` are fixed tendons, too.
    """
    sprung = spec.body("sprung")
    sprung.mass = body.mass
    inertias = [own for own in (body.roll_inertia, body.pitch_inertia) if own is not None]
    sprung.inertia = [inertias[0], inertias[-1], max(inertias)]
    # The body cannot yaw, so its third moment of inertia (yaw) matters only if it pitches and rolls simultaneously. The effect
    # of this inertia is quadratic in the amplitude, and zero in the linear model. Vehicle files do not contain this moment of
    # inertia. For a car, the larger of the other two moments is a good estimate. A rigid body can have any value between the
    # difference and the sum of the other two moments. Over a bump of 0.1 m under the left wheels, values in this range change
    # the full car's pitch acceleration by at most 5e-4 of its peak.

    if body.has_axis:
        for mode, arm in zip(body.modes[1:], body.axis_offsets[1:].tolist(), strict=True):
            spec.joint(LOADS[mode].joint).pos = [0.0, 0.0, -arm]
    squeezes = body.static_tyre_deflection().values()
    for corner, load, squeeze in zip(body.corners, body.static_loads(), squeezes, strict=True):
        unsprung, road = spec.body(f"unsprung_{corner.name}"), spec.body(f"road_{corner.name}")
        unsprung.mass = corner.unsprung_mass
        unsprung.pos[:2] = road.pos[:2] = [corner.x, corner.y]
        spec.site(f"suspension_{corner.name}_top").pos[:2] = [corner.x, corner.y]

        name = f"suspension_{corner.name}"
        suspension = _tendon_name(spec, body, corner, name) if body.has_axis else spec.tendon(name)
        length = 0.0 if body.has_axis else sprung.pos[2] + spec.site(f"{name}_top").pos[2] - unsprung.pos[2]
        write_strut(spec, suspension, corner.suspension_stiffness, corner.suspension_damping, load, length)
        rest = unsprung.pos[2] - road.pos[2] + squeeze
        write_tyre(spec, f"tyre_{corner.name}", corner.tyre_stiffness, corner.tyre_damping, rest)
    for bar in body.bars:
        if bar.stiffness > 0:
            torsion = spec.add_tendon(name=f"anti_roll_bar_{bar.name}", springlength=[0.0, 0.0])
            torsion.stiffness[0] = bar.stiffness
            torsion.wrap_joint("roll", 1.0)
            for corner, arm in zip(body.corners, body.arms(bar), strict=True):
                if arm:
                    torsion.wrap_joint(f"unsprung_{corner.name}", -arm)


def _tendon_name(spec: Any, body: RigidBody, corner: Corner, name: str) -> Any:
    """Replaces a strut by a fixed tendon whose length is the deflection of a guided wheel, and returns this tendon."""
    spec.delete(spec.tendon(name))
    tendon = spec.add_tendon(name=name)
    row = body.shape[body.corners.index(corner)]
    for mode, share in zip(body.modes, row.tolist(), strict=True):
        tendon.wrap_joint(LOADS[mode].joint, share)
    tendon.wrap_joint(f"unsprung_{corner.name}", -1.0)
    return tendon
