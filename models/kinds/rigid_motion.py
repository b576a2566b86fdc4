"""Exact equations of motion of a rigid body on struts, for large pitch and roll angles.

The linear equations of motion are in the module `rigid_body`.

The body moves vertically by z, then rotates by theta about the lateral axis, then by phi about its own longitudinal axis: the
rotation matrix is R = R_y R_x. Strut i connects its hub with the point R (x_i, y_i, 0) of the body. The hub slides vertically
at (x_i, y_i). If r_i is the vector from hub to body, L_i the length of this vector, and q = (z, theta, phi),

    d_i = L_i - L_0,     J_i = dL_i / dq,     e_i = r_i z / L_i,     p_i = p_0i - k_i d_i - c_i d_i' - (pulls) + u_i,

the strut pushes the body with J_i' p_i, and the hub downward with e_i p_i. The tyre pushes the hub upward with the force k_u
(static - t) + c_u (w - z_u'), where w is the road velocity, or with 0 if this force is negative. With I = I_y cos^2 phi + I_z
sin^2 phi, Lagrange's equations are

    m z'' = Q_z - m g,     I theta'' = Q_theta - I' phi' theta',     I_x phi'' = Q_phi + I' theta'^2 / 2.

If links define a pitch axis at c below the centre of mass, and a roll axis at b below it, the centre of mass is at

    (s sin theta, -b sin phi, z - c + s cos theta),     s = c - b (1 - cos phi).

With j = m s^2 + I, the kinetic energy of the body is

    (m z'^2 + j theta'^2 + (I_x + m b^2) phi'^2) / 2 - m (s sin theta theta' + b sin phi cos theta phi') z',

and the resulting Lagrange's equations are

    m (z'' + g) - m s sin theta theta'' - m b sin phi cos theta phi'' = Q_z + (terms with products of rates),
    j theta'' - m s sin theta (z'' + g) = Q_theta - j' phi' theta',
    (I_x + m b^2) phi'' - m b sin phi cos theta (z'' + g) = Q_phi + j' theta'^2 / 2.

Because the links guide every wheel, the deflection is d_i = z - x_i theta + y_i phi - z_u, and does not depend on the length of
a strut.

A point (x, y) of the body has the height z - x sin theta + y sin phi cos theta. The time derivatives of the point's height are
its velocity and acceleration. Angular accelerations are measured about axes that are fixed to the road: theta'', and phi'' cos
theta - phi' theta' sin theta.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.kinds.kind import GRAVITY
from models.kinds.rigid_body import LOADS, RigidBody
from models.kinds.signals import Signal

if TYPE_CHECKING:
    from models.kinds.motion import Pulls

STRUT = 0.44  # length of every strut in the equilibrium position of the MJCF [m]; the linear model does not use this length
SHORTEST = 0.1  # the equations are valid only if every strut has at least this length [m]
MOST_TURNED, LEAST_UPRIGHT = 0.5, 0.5  # largest angle of the body [rad], and smallest cosine of the inclination of a strut
CLOSEST = 1e-15  # the search for the position of the body ends when its step is below this size [m, rad]
# Largest number of iterations in the search for the position of the body; each iteration multiplies the error by about the size
# of the angles
MOST_TRIALS = 60


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """Equations of motion of a body on c struts; the body has k of the modes heave, pitch and roll.

    The states are the modes q, the hub heights z_u, and their rates.

    Attributes:
        body: masses, geometry and elements of the body.
        shape: matrix S of the `RigidBody`, shape (c, k).
        yaw_inertia: moment of inertia I_z [kg m2]; it has an effect only if a body pitches and rolls simultaneously.
        names: names of the signals: deflections of suspensions and tyres, then the rates of body and hubs.
        further: names of signals that are not in `names`. The first names in `further` are those of the k accelerations of the
            body. The next names are those of the velocities and accelerations of the body's c points above the hubs, and of the
            accelerations of the hubs. The last names are those of the heights of the centre of mass, of the body's c points
            above the hubs, and of the hubs. For a body that only moves vertically, `further` contains the names of the
            acceleration and height of the body and of its hub.
    """

    body: RigidBody
    shape: Array
    yaw_inertia: float
    names: tuple[str, ...]
    further: tuple[str, ...]

    @np.errstate(all="ignore")
    def state(self, signals: Mapping[str, Array], heights: Array) -> Array:
        """See `Motion`.

        A search finds the position of the body for the supplied deflections; the result is NaN if no position has these
        deflections.
        """
        c = len(self.shape)
        columns = np.stack([signals[name] for name in self.names], axis=-1)
        deflections, hubs = columns[:, :c], columns[:, c : 2 * c] + heights
        inverse = np.linalg.pinv(self.shape).T
        q = (deflections + hubs) @ inverse
        still = np.zeros_like(q)
        for _ in range(MOST_TRIALS if self.shape.shape[1] > 1 else 0):
            far = (deflections - self._struts(q, hubs, still, still[:, :1])[0]) @ inverse
            q = q + far
            if np.abs(far).max(initial=0.0) < CLOSEST:
                break
        return np.concatenate([q, hubs, columns[:, 2 * c :]], axis=1)

    def usable(self, state: Array) -> Array:
        """See `Motion`.

        If the body has turned over, or if the length of a strut is 0, the struts do not determine the position.
        """
        q, hubs, rates, hub_rates = self.split(state)
        with np.errstate(all="ignore"):
            d, _, _, up = self._struts(q, hubs, rates, hub_rates)
            turned, shortest = np.abs(q[:, 1:]).max(axis=1, initial=0.0), STRUT + d.min(axis=1)
            upright = (turned < MOST_TURNED) & (up.min(axis=1) > LEAST_UPRIGHT)
            return np.asarray(upright & ((shortest > SHORTEST) | (q.shape[1] == 1) | self.body.has_axis))

    def read(self, state: Array, heights: Array) -> Array:
        q, hubs, rates, hub_rates = self.split(state)
        return np.concatenate([self._struts(q, hubs, rates, hub_rates)[0], hubs - heights, rates, hub_rates], axis=1)

    def rate(self, state: Array, heights: Array, inputs: Array, pulls: "Pulls", loads: Array) -> Array:
        q, hubs, rates, hub_rates = self.split(state)
        spring, damper, tyre, rubber, unsprung, resting = self._corners
        d, v, J, up = self._struts(q, hubs, rates, hub_rates)
        push = resting - spring * d - damper * v - pulls(d, v) + inputs
        under = resting + unsprung * GRAVITY - tyre * (hubs - heights)
        if rubber.any():
            loads, velocities = np.split(loads, [loads.shape[1] - len(rubber)], axis=1)
            under = under + rubber * (velocities - hub_rates)
        tyres = np.maximum(0.0, under)
        on_hubs = tyres - up * push
        on_body = (J * push[:, :, None]).sum(axis=1)
        if loads.shape[1]:
            on_body, on_hubs = (
                on_body + loads[:, : q.shape[1]],
                on_hubs + (loads[:, q.shape[1] :] if self.body.wheel_loads else 0),
            )
        for bar in self.body.bars:
            arms = self.body.arms(bar)
            moment = bar.stiffness * (q[:, -1] - hubs @ arms)  # the last mode is roll
            on_body[:, -1] -= moment
            on_hubs = on_hubs + moment[:, None] * arms
        return np.concatenate([rates, hub_rates, self._turned(q, rates, on_body), on_hubs / unsprung - GRAVITY], axis=1)

    def outputs(self, state: Array, heights: Array, inputs: Array, pulls: "Pulls", loads: Array) -> Mapping[str, Array]:
        return self.outputs_at(state, self.rate(state, heights, inputs, pulls, loads))

    def outputs_at(self, state: Array, rate: Array) -> Mapping[str, Array]:
        """Returns the signals of `outputs` for states and their rates, both of shape (T, n)."""
        k = self.shape.shape[1]
        q, hubs, rates, _ = self.split(state)
        _, _, second, hub_second = self.split(rate)
        turning = second.copy()
        columns, heights_now = [turning, hub_second], [q[:, :1], hubs]
        if k > 1:
            # Heights of the centre of mass and of the mounting points above the hubs: z - c - x sin theta + (y sin phi + s) cos
            # theta.
            x, y = (np.array([0.0, *(getattr(corner, axis) for corner in self.body.corners)]) for axis in "xy")
            sin, cos, side, turned, s = (np.reshape(one, (-1, 1)) for one in self.tilt(q))
            b, over = self.body.roll_arm or 0.0, side * y + s
            sway, bend = turned * y - b * side, -side * y - b * turned
            by_each = (np.ones_like(over), -x * cos - over * sin, sway * cos)
            by_q = np.stack([by_each[i] for i in self.body.modes], axis=-1)
            pitch_rate, roll_rate = (np.reshape(one, (-1, 1)) for one in self.turns(rates))
            bent = pitch_rate**2 * (x * sin - over * cos) + roll_rate**2 * bend * cos - 2 * pitch_rate * roll_rate * sway * sin
            velocity, acceleration = ((by_q * column[:, None]).sum(axis=-1) for column in (rates, second))
            acceleration = acceleration + bent
            over_datum = q[:, :1] - (self.body.pitch_arm or 0.0) - x * sin + over * cos
            heights_now = [over_datum, hubs]
            turning[:, :1] = acceleration[:, :1]
            columns[1:1] = [velocity[:, 1:], acceleration[:, 1:]]
            if k > 2:
                turning[:, 2:] = turning[:, 2:] * cos - roll_rate * pitch_rate * sin
        return dict(zip(self.further, np.concatenate([*columns, *heights_now], axis=1).T, strict=True))

    @property
    def joints(self) -> tuple[str, ...]:
        k = self.shape.shape[1]
        modes = [LOADS[mode].joint for mode in self.body.modes] if k > 1 else ["sprung"]
        return (*modes, *(f"unsprung_{corner.name}".removesuffix("_") for corner in self.body.corners))

    def energy(self, state: Array, heights: Array) -> Array:
        """See `StoredEnergy`.

        The potential energy is that of the weights and of the linear springs of suspensions, tyres and anti-roll bars.
        """
        q, hubs, rates, hub_rates = self.split(state)
        spring, _, tyre, _, unsprung, resting = self._corners
        d, lifted = self._struts(q, hubs, rates, hub_rates)[0], q[:, 0]
        under = np.maximum(0.0, resting + unsprung * GRAVITY - tyre * (hubs - heights))
        potential = (spring * d**2 / 2 - resting * d + under**2 / (2 * tyre) + unsprung * GRAVITY * hubs).sum(axis=1)
        for bar in self.body.bars:
            potential += bar.stiffness * (q[:, -1] - hubs @ self.body.arms(bar)) ** 2 / 2
        kinetic = self.body.mass * rates[:, 0] ** 2 + (unsprung * hub_rates**2).sum(axis=1)
        if q.shape[1] > 1:
            sin, cos, side, _, s = self.tilt(q)
            lifted = lifted - (self.body.pitch_arm or 0.0) + s * cos
            for own, entry, rate in zip(*self._masses(sin, cos, side, s), rates[:, 1:].T, strict=True):
                kinetic += (own * rate + 2 * entry * rates[:, 0]) * rate
        return np.stack([potential + self.body.mass * GRAVITY * lifted, kinetic / 2], axis=-1)

    @cached_property
    def _corners(self) -> tuple[Array, ...]:
        """Arrays of shape (c,): stiffness and damping of the suspensions, stiffness and damping of the tyres, unsprung masses,
        and static loads.
        """
        names = ("suspension_stiffness", "suspension_damping", "tyre_stiffness", "tyre_damping", "unsprung_mass")
        numbers = (np.array([getattr(corner, name) for corner in self.body.corners]) for name in names)
        return (*numbers, self.body.static_loads())

    def masses(self, q: Array) -> Array:
        """Returns the mass matrix of the body for the positions q, shape (T, k, k)."""
        M = np.zeros((*q.shape, q.shape[1]), dtype=q.dtype)
        M[:, 0, 0] = self.body.mass
        if q.shape[1] > 1:
            sin, cos, side, _, s = self.tilt(q)
            for i, (own, entry) in enumerate(zip(*self._masses(sin, cos, side, s), strict=True), start=1):
                M[:, i, i], M[:, 0, i], M[:, i, 0] = own, entry, entry
        return M

    def turns(self, columns: Array) -> tuple[Array, Array]:
        """Returns the columns of pitch and roll from k columns of modes, each of shape (T,); zeros for a missing mode."""
        modes = self.body.modes
        pitch, roll = (columns[:, modes.index(i)] if i in modes else np.zeros(len(columns)) for i in (1, 2))
        return pitch, roll

    def tilt(self, q: Array) -> tuple[Array, Array, Array, Array, Array | float]:
        """Returns the sine and cosine of theta, the sine and cosine of phi, and the distance s, each of shape (T,)."""
        theta, phi = self.turns(q)
        c, b = self.body.pitch_arm or 0.0, self.body.roll_arm or 0.0
        return np.sin(theta), np.cos(theta), np.sin(phi), np.cos(phi), c - 2 * b * np.sin(phi / 2) ** 2 if b else c

    def _masses(self, sin: Array, cos: Array, side: Array, s: Array | float) -> tuple[list[Array | float], list[Array]]:
        """Returns the entries of the mass matrix for pitch and roll, each of shape (T,): moments of inertia, and couplings with
        heave.

        Args:
            sin: sine of theta, as `tilt` returns it.
            cos: cosine of theta, as `tilt` returns it.
            side: sine of phi, as `tilt` returns it.
            s: distance s [m], as `tilt` returns it.
        """
        body, b = self.body, self.body.roll_arm or 0.0
        inertias, entries = list[Array | float](), list[Array]()
        if body.pitch_inertia is not None:
            inertias.append(body.pitch_inertia + (self.yaw_inertia - body.pitch_inertia) * side**2 + body.mass * s**2)
            entries.append(-body.mass * s * sin)
        if body.roll_inertia is not None:
            inertias.append(body.roll_inertia + body.mass * b**2)
            entries.append(-body.mass * b * side * cos)
        return inertias, entries

    def _turned(self, q: Array, rates: Array, push: Array) -> Array:
        """Returns q'', the accelerations of the modes that generalised forces cause, shape (T, k)."""
        mass, b = self.body.mass, self.body.roll_arm or 0.0
        if q.shape[1] == 1:
            return push / mass - GRAVITY
        sin, cos, side, turned, s = self.tilt(q)
        inertias, entries = self._masses(sin, cos, side, s)
        lift, moments = push[:, 0], list(push[:, 1:].T)
        theta_dot, phi_dot = self.turns(rates)
        if self.body.pitch_inertia is not None and self.body.roll_inertia is not None:
            slope = 2 * (self.yaw_inertia - self.body.pitch_inertia) * side * turned - 2 * mass * s * b * side
            moments = [moments[0] - slope * theta_dot * phi_dot, moments[1] + slope * theta_dot**2 / 2]
        if not self.body.has_axis:
            turns = [moment / own for moment, own in zip(moments, inertias, strict=True)]
            return np.stack([lift / mass - GRAVITY, *turns], axis=-1)
        # Terms with products of rates in the heave equation: they come from the rates of change of both coupling entries of the
        # mass matrix.
        lift = lift + mass * (s * cos * theta_dot - b * side * phi_dot * sin) * theta_dot
        lift = lift + mass * b * (turned * cos * phi_dot - side * sin * theta_dot) * phi_dot
        rows = list(zip(entries, moments, inertias, strict=True))
        of_others = sum(entry * moment / own for entry, moment, own in rows)
        lifted = (lift - of_others) / (mass - sum(entry**2 / own for entry, _, own in rows))
        turns = [(moment - entry * lifted) / own for entry, moment, own in rows]
        return np.stack([lifted - GRAVITY, *turns], axis=-1)

    def split(self, state: Array) -> tuple[Array, Array, Array, Array]:
        """Returns the modes q, the hub heights z_u, and their rates."""
        c, k = self.shape.shape
        q, hubs, rates, hub_rates = np.split(state, [k, k + c, 2 * k + c], axis=1)
        return q, hubs, rates, hub_rates

    def _struts(self, q: Array, hubs: Array, rates: Array, hub_rates: Array) -> tuple[Array, Array, Array, Array]:
        """Returns the deflections d and their rates d', shape (T, c), the matrices J, shape (T, c, k), and the factors e of the
        hub forces, shape (T, c).
        """
        if q.shape[1] == 1:
            return q - hubs, rates - hub_rates, np.ones((*hubs.shape, 1)), np.ones_like(hubs)
        if self.body.has_axis:
            d, v = q @ self.shape.T - hubs, rates @ self.shape.T - hub_rates
            return d, v, np.broadcast_to(self.shape, (len(q), *self.shape.shape)), np.ones_like(d)
        x, y = (np.array([getattr(corner, axis) for corner in self.body.corners]) for axis in "xy")
        sin, cos, side, turned, _ = (np.reshape(one, (-1, 1)) for one in self.tilt(q))
        over = side * y  # rolling by the angle phi turns the point (x, y, 0) into (x, y cos phi, y sin phi)
        along, across = x * cos + over * sin - x, y * turned - y
        rise = q[:, :1] - hubs - x * sin + over * cos
        height = STRUT + rise
        length = np.sqrt(along**2 + across**2 + height**2)
        J = [height / length]
        if self.body.pitch_inertia is not None:
            J.append((along * (over * cos - x * sin) - height * (x * cos + over * sin)) / length)
        if self.body.roll_inertia is not None:
            J.append(y * (along * turned * sin - across * side + height * turned * cos) / length)
        by_q = np.stack(J, axis=-1)
        # For a strut that is inclined only slightly, a difference of two lengths would lose digits, so another formula is used.
        upright = height > 0
        far = length + np.where(upright, height, -height)
        d = np.where(upright, (along**2 + across**2) / far, length - height) + rise
        return d, (by_q * rates[:, None]).sum(axis=-1) - J[0] * hub_rates, by_q, J[0]


def rigid_motion(body: RigidBody, signals: Sequence[Signal], further: Sequence[Signal]) -> RigidMotion:
    """Returns the equations of motion of a body on struts.

    Args:
        body: body with its masses, geometry, springs and dampers.
        signals: signals of the c suspension deflections, the c tyre deflections, the rates of the body's modes, and the c hub
            velocities.
        further: additional signals, as in `RigidMotion`.
    """
    inertias = [own for own in (body.pitch_inertia, body.roll_inertia) if own is not None]
    names, more = (tuple(signal.name for signal in some) for some in (signals, further))
    return RigidMotion(body, body.shape, max(inertias, default=0.0), names, more)
