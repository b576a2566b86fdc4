"""Equations of motion from a mass matrix, potential energy and lengths alone, beside those of the project.

Coordinates are q = (heave, pitch, roll; heights of the hubs; travel of a seat), without a turn that the body lacks. With the
lengths L(q) of suspensions, tyres and anti-roll bars, their Jacobian J, and the force that pulls the ends of each together,
Lagrange's equations are

    M q'' = -J' (forces) - M' q' + d(q' M q' / 2) / dq - dV / dq.

All derivatives are complex steps, exact to rounding. Forces of suspensions are a function of deflections, rates and inputs.
"""

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from models.roads.road import RoadInput
from models.vehicle.vehicle import Vehicle

STEP = 1e-200  # of a complex step
G = 9.81  # m/s2
STRUT = 0.44  # m, of every strut at rest in the MJCF
CORNERS = {
    "quarter_car": ("",),
    "half_car": ("_front", "_rear"),
    "half_car_roll": ("_left", "_right"),
    "full_car": tuple(f"_{axle}_{side}" for axle in ("front", "rear") for side in ("left", "right")),
}
Number = np.ndarray | float
Forces = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]  # (d, v, u), each (T, c) -> pulls at the wheels (T, c)


def axle(corner: str) -> str:
    """The suffix of a corner's parameters: that of its axle, or of its side if all wheels are on one."""
    return corner.removesuffix("_left").removesuffix("_right") or corner


def jacobian(f, q):
    """Returns df/dq, shape (T, ..., n), for f of rows q, shape (T, n)."""
    return np.stack([np.imag(f(q + 1j * STEP * row)) / STEP for row in np.eye(q.shape[1])], axis=-1)


def straight(x, force) -> Callable:
    """Lines between the points of a table, and on beyond them."""
    x, force = np.array(x), np.array(force)
    slopes = np.diff(force) / np.diff(x)

    def of(at):
        return np.interp(at, x, force) + slopes[0] * np.minimum(at - x[0], 0.0) + slopes[-1] * np.maximum(at - x[-1], 0.0)

    return of


def rk4(rate, x, h):
    """Returns the states after one step of h, by the classical Runge-Kutta method."""
    k1 = rate(x)
    k2 = rate(x + h / 2 * k1)
    k3 = rate(x + h / 2 * k2)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + h * k3))


def static_loads(vehicle: Vehicle) -> np.ndarray:
    """Returns the body's weight on each suspension [N], shape (c,)."""
    p, corners = vehicle.parameters, CORNERS[vehicle.kind.name]
    reach = np.array([p.get("axle_distance_rear" if "front" in end else "axle_distance_front", 1.0) for end in corners])
    if "centre_offset" in p:
        reach = p["track"] / 2 + p["centre_offset"] * np.array([1.0, -1.0])
    loads = p["sprung_mass"] * G * reach / reach.sum()
    if "seat_mass" in p:
        x, y = places(vehicle)
        body = [np.ones(len(x)), *([-x] if "pitch_inertia" in p else []), *([y] if "roll_inertia" in p else [])]
        at = [1.0, *([-p["seat_x"]] if "seat_x" in p else []), *([p["seat_y"]] if "seat_y" in p else [])]
        loads = loads + np.linalg.lstsq(np.stack(body), p["seat_mass"] * G * np.array(at), rcond=None)[0]
    return loads


def places(vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Returns x and y of the hubs from the centre of mass [m], each of shape (c,)."""
    p, corners = vehicle.parameters, CORNERS[vehicle.kind.name]
    x = [p.get(f"axle_distance{axle(end)}", 0.0) * (-1 if "rear" in end else 1) for end in corners]
    wide = np.array([p.get(f"track{axle(end)}", p.get("track", 0.0)) for end in corners])
    return np.array(x), wide / 2 * [1 if "left" in end else -1 for end in corners] - p.get("centre_offset", 0.0)


def trig(angle):
    """Returns cosine and sine."""
    return np.cos(angle), np.sin(angle)


class Mechanism:
    """Car of c corners whose body has k of heave, pitch and roll."""

    def __init__(self, vehicle: Vehicle, forces: Forces, inertance: Callable | None = None) -> None:
        """Takes the forces at the wheels: all of a suspension but the load that it carries at rest, and inertances by d."""
        p, corners = vehicle.parameters, CORNERS[vehicle.kind.name]

        def each(name):
            return np.array([p.get(f"{name}{axle(end)}", 0.0) for end in corners])

        wide = np.array([p.get(f"track{axle(end)}", p.get("track", 0.0)) for end in corners])
        x, y = places(vehicle)
        self.seat = [p.get(f"seat_{name}", 0.0) for name in ("mass", "stiffness", "damping", "x", "y")]
        mass, at, load = p["sprung_mass"], {"_front": x.max(), "_rear": -x.min()}, static_loads(vehicle)
        arms, rolls = [0.0, 0.0], "roll_centre_height_front" in p
        if pitches := "pitch_centre_height" in p:
            arms[0] = p["centre_height"] - p["pitch_centre_height"]
        if rolls:
            front, rear = p["roll_centre_height_front"], p["roll_centre_height_rear"]
            arms[1] = p["centre_height"] - (front * at["_rear"] + rear * at["_front"]) / sum(at.values())
        if "roll_centre_height" in p:
            arms[1], rolls = p["centre_height"] - p["roll_centre_height"], True
        bars = []
        for end in ("", "_front", "_rear"):
            if k := p.get(f"anti_roll_stiffness{end}", 0.0):
                signs = [(1 if "left" in one else -1) * one.startswith(end) for one in corners]
                bars.append((k, np.array(signs) / wide))
        self.turns = [i for i, name in enumerate(("pitch_inertia", "roll_inertia"), start=1) if name in p]
        inertia = [p[("pitch_inertia", "roll_inertia")[i - 1]] for i in self.turns]
        self.x, self.y, self.mass, self.load, self.arms, self.bars, self.inertia = x, y, mass, load, arms, bars, inertia
        self.unsprung, self.tyre, self.rubber = each("unsprung_mass"), each("tyre_stiffness"), each("tyre_damping")
        self.k, self.c, self.has_axis, self.forces = 1 + len(inertia), len(corners), rolls or pitches, forces
        self.inertance, self.n = inertance, self.k + self.c + ("seat_mass" in p)

    def of_seat(self, q):
        """Returns height and Jacobian of a seat, shapes (T,) and (T, 3, n): it turns by roll, then by pitch, about both axes."""
        (a, b), (theta, phi), (*_, x, y) = self.arms, self.angles(q), self.seat
        none, one = np.zeros_like(theta), np.ones_like(theta)

        def pitched(c, s, at):
            return np.stack([c * at[0] + s * at[2], none, c * at[2] - s * at[0]])

        def rolled(c, s, at):
            return np.stack([none, c * at[1] - s * at[2], s * at[1] + c * at[2]])

        keep_x, keep_y, (cos, sin), (c, s) = x * one, np.array([[0.0], [1.0], [0.0]]), trig(theta), trig(phi)
        at = [none, y * one, q[:, -1] + b]
        inner = rolled(c, s, at) + np.stack([keep_x, none, (a - b) * one])
        J = np.zeros((len(q), 3, self.n), dtype=q.dtype)
        J[:, 2, 0] = 1.0
        if 1 in self.turns:
            J[:, :, 1] = pitched(-sin, cos, inner).T
        tilted = [(self.k - 1, rolled(-s, c, at))] if 2 in self.turns else []
        for i, part in (*tilted, (-1, rolled(c, s, [none, none, one]))):
            J[:, :, i] = (pitched(cos, sin, part) + keep_y * part).T
        return q[:, 0] - a + pitched(cos, sin, inner)[2], J

    def angles(self, q):
        """Returns pitch and roll, shapes (T,)."""
        return [q[:, 1 + self.turns.index(i)] if i in self.turns else np.zeros_like(q[:, 0]) for i in (1, 2)]

    def masses(self, q):
        """Returns M, shape (T, n, n). The centre of mass is at (s sin pitch, -b sin roll, z - a + s cos pitch)."""
        (a, b), (theta, phi) = self.arms, self.angles(q)
        M, s = np.zeros((len(q), self.n, self.n), dtype=q.dtype), a - b * (1 - np.cos(phi))
        M[:, 0, 0] = self.mass
        if 1 in self.turns:
            M[:, 1, 1] = self.inertia[0] * np.cos(phi) ** 2 + max(self.inertia) * np.sin(phi) ** 2 + self.mass * s**2
            M[:, 0, 1] = M[:, 1, 0] = -self.mass * s * np.sin(theta)
        if 2 in self.turns:
            i = self.k - 1
            M[:, i, i] = self.inertia[-1] + self.mass * b**2
            M[:, 0, i] = M[:, i, 0] = -self.mass * b * np.sin(phi) * np.cos(theta)
        hubs = np.arange(self.k, self.k + self.c)
        M[:, hubs, hubs] = self.unsprung
        if self.n > self.k + self.c:
            J = self.of_seat(q)[1]
            M += self.seat[0] * np.einsum("tij,tik->tjk", J, J)
        return M

    def potential(self, q):
        """Returns V of the weight [J], shape (T,)."""
        (a, b), (theta, phi) = self.arms, self.angles(q)
        s = a - b * (1 - np.cos(phi))
        of_seat = self.seat[0] * (self.of_seat(q)[0] - q[:, -1]) if self.n > self.k + self.c else 0.0  # its spring holds it
        hubs = q[:, self.k : self.k + self.c]
        return G * (self.mass * (q[:, 0] - a + s * np.cos(theta)) + hubs @ self.unsprung + of_seat)

    def lengths(self, q):
        """Returns deflections of the suspensions, heights of the hubs, and angles of the bars, shape (T, 2 c + bars)."""
        theta, phi, hubs = *(one[:, None] for one in self.angles(q)), q[:, self.k : self.k + self.c]
        if self.has_axis or self.k == 1:
            d = q[:, :1] - theta * self.x + phi * self.y - hubs
        else:
            over = np.sin(phi) * self.y
            along, across = self.x * np.cos(theta) + over * np.sin(theta) - self.x, self.y * np.cos(phi) - self.y
            rise = q[:, :1] - hubs - self.x * np.sin(theta) + over * np.cos(theta)
            length = np.sqrt(along**2 + across**2 + (STRUT + rise) ** 2)
            d = (along**2 + across**2) / (length + STRUT + rise) + rise  # length - STRUT, without its rounding
        return np.concatenate([d, hubs, *(phi - (hubs @ arm)[:, None] for _, arm in self.bars)], axis=1)

    def rate(self, x, heights, u: Number = 0.0, velocities: Number = 0.0, loads: Number = 0.0):
        """Returns x' of states x = (q, q'), shape (T, 2 n).

        Args:
            heights, velocities: of the road under the wheels [m, m/s], shape (T, c).
            u: inputs of the suspensions' forces, shape (T, c).
            loads: generalized forces on q, shape (T, n).
        """
        q, rates = np.split(x, 2, axis=1)
        c, J, dM, lengths = self.c, jacobian(self.lengths, q), jacobian(self.masses, q), self.lengths(q)
        speeds = np.einsum("tij,tj->ti", J, rates)
        pull = np.zeros_like(lengths)
        pull[:, :c] = self.forces(lengths[:, :c], speeds[:, :c], np.broadcast_to(u, lengths[:, :c].shape)) - self.load
        squeeze = self.load + self.unsprung * G - self.tyre * (lengths[:, c : 2 * c] - heights)
        pull[:, c : 2 * c] = -np.maximum(squeeze + self.rubber * (velocities - speeds[:, c : 2 * c]), 0.0)
        for i, (k, _) in enumerate(self.bars, 2 * c):
            pull[:, i] = k * lengths[:, i]
        bias = np.einsum("tijk,tj,tk->ti", dM, rates, rates) - np.einsum("tjki,tj,tk->ti", dM, rates, rates) / 2
        push = loads - np.einsum("tij,ti->tj", J, pull) - bias - jacobian(self.potential, q)
        if self.n > self.k + self.c:
            push[:, -1] -= self.seat[1] * q[:, -1] + self.seat[2] * rates[:, -1]
        masses = self.masses(q)
        if self.inertance is not None:
            b, turning = self.inertance(lengths[:, :c]), np.zeros((len(q), c))
            for side in (1e-5, -1e-5):  # s along the present motion, for J' q'
                turning += np.einsum("tij,tj->ti", jacobian(self.lengths, q + side * rates)[:, :c], rates) / (2 * side)
            push -= np.einsum("tij,ti->tj", J[:, :c], b * turning)
            masses = masses + np.einsum("tij,ti,tik->tjk", J[:, :c], b, J[:, :c])
        return np.concatenate([rates, np.linalg.solve(masses, push[..., None])[..., 0]], axis=1)

    def linearised(self, modes):
        """Returns A, B, Bw and Br of the states (d, modes t, body's rates, hubs' rates; travel and velocity of a seat), by
        differences of order 6.
        """
        n, c, hubs = self.n, self.c, slice(self.k, self.k + self.c)
        still, unit = np.zeros((2 * n, 2 * n)), np.eye(c)

        def slope(f, h):
            return np.sum([w * (f(i * h) - f(-i * h)) / h for i, w in ((1, 3 / 4), (2, -3 / 20), (3, 1 / 60))], axis=0).T

        A = slope(lambda e: self.rate(e * np.eye(2 * n), 0.0), 2e-3)
        Br, B, Bw = (
            slope(lambda e, i=i: self.rate(still[:c], *(e * unit * (i == j) for j in range(3))), h)
            for i, h in enumerate((2e-3, 100.0, 0.1))
        )
        T, P = np.zeros((len(A), len(A))), len(modes)
        T[:c, :n] = jacobian(self.lengths, still[:1, :n])[0, :c]
        moves = self.k + c
        T[c : c + P, hubs], T[c + P : c + P + moves, n : n + moves] = modes, np.eye(moves)
        if n > moves:
            T[-2, n - 1], T[-1, n:] = 1.0, self.of_seat(still[:1, :n])[1][0, 2]
        R = np.zeros((len(A), c))
        R[c : c + P] = -modes
        A = T @ A @ np.linalg.inv(T)
        return A, T @ B, R + T @ Bw, T @ Br - A @ R


def acting(on: RoadInput, run) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inputs at the samples, what is commanded over the steps, and rates of lags [1/s], shapes (T, c), (T - 1, c) and (c,).

    Inputs are forces of actuators, or coefficients beyond the nominal ones. RK4 turns a lag of rate w into the factor R(w h).
    """
    of = {one.force: (one.coefficient, one.nominal, one.damper.bandwidth or 0.0) for one in on.vehicle.parts.adjustable}
    usual = on.vehicle.limits.actuator_bandwidth or 0.0
    names = [of.get(place.force, (place.force, 0.0, usual)) for place in on.vehicle.kind.suspensions]
    u, lag = np.stack([run[name] - nominal for name, nominal, _ in names], axis=-1), np.array([one[2] for one in names])
    a = lag * on.timestep
    gone = 1 - np.polyval([1 / 24, -1 / 6, 1 / 2, -1.0, 1.0], a)
    return u, u[:-1] + np.diff(u, axis=0) / np.where(lag, gone, np.inf), lag


def integrated(on: RoadInput, force, knots, u, commands, lag, inertance=lambda d: 0.0) -> np.ndarray:
    """Deflections of suspension and tyre of a quarter-car, shape (T, 2), by DOP853, started again at each knot of a law.

    Road and commands are held over each step, as MuJoCo has them; inputs follow with their lag.

    Args:
        force: pull at the wheel [N] by deflection, its rate, the input and states of its own, and their `rates`.
        knots: functions of deflection and its rate, each 0 where the force has a knot.
        u, commands, lag: see `acting`.
        inertance: b by deflection [kg].
    """
    p, h = on.vehicle.parameters, on.timestep
    static = (p["sprung_mass"] + p["unsprung_mass"]) * G / p["tyre_stiffness"]

    def rate(since, x):
        held = to + (begin - to) * np.exp(-lag[0] * since)
        d, v, z = x[0] - x[1], x[2] - x[3], x[4:]
        f, b, t = float(force(d, v, held, z)), float(inertance(d)), x[1] - road
        body, wheel, on_wheel = p["sprung_mass"], p["unsprung_mass"], f - p["tyre_stiffness"] * min(t, static)
        both = body * wheel + b * (body + wheel)  # determinant of the mass matrix
        of_body, of_wheel = ((wheel + b) * -f + b * on_wheel) / both, (b * -f + (body + b) * on_wheel) / both
        return [x[2], x[3], of_body, of_wheel, *force.rates(d, v, z, held)]

    events = [lambda _, x: x[1] - road - static]
    events += [lambda _, x, knot=knot: float(knot(x[0] - x[1], x[2] - x[3])) for knot in knots]
    for event in events:
        vars(event)["terminal"] = True
    x, found = np.zeros(4 + len(on.vehicle.kind.of_parts)), []
    for k in range(len(u)):
        road, begin, to = on.midway[k, 0], u[k, 0], commands[min(k, len(commands) - 1), 0]
        found.append([x[0] - x[1], x[1] - on.heights[k, 0]])
        at = 0.0
        while at < h and k < len(u) - 1:
            step = solve_ivp(rate, (at, h), x, "DOP853", rtol=1e-11, atol=1e-14, events=events)
            x, at = step.y[:, -1], float(step.t[-1])
            past = min(1e-6 * h, h - at)  # on past the knot
            x, at = x + past * np.array(rate(at, x)), at + past
    return np.array(found)
