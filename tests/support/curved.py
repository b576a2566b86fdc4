"""Vehicles with curves, and the quarter-car's motion with them from the equations (28), written out and integrated by SciPy."""

import re

import numpy as np
from scipy.integrate import solve_ivp

from models.roads.road import Bump
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle

# An asymmetric, digressive damper, as cars have it: rebound some twice as hard as bump, both softer the faster.
DIGRESSIVE = "{ velocity = [-1.5, -0.6, -0.15, 0.0, 0.15, 0.6, 1.5], force = [-1350, -750, -262.5, 0, 262.5, 1000, 1900] }"
PROGRESSIVE = "{ deflection = [-0.1, -0.06, 0.0, 0.05, 0.1], force = [-2100, -920, 0, 655, 1350] }"
AXLES = {
    "suspension_damping_front": DIGRESSIVE,
    "suspension_damping_rear": DIGRESSIVE,
    "suspension_stiffness_rear": "{ deflection = [-0.1, -0.06, 0.0, 0.05, 0.1], force = [-3500, -1500, 0, 1100, 2300] }",
}


def with_curves(kind: str = "quarter_car", more: str = "", **curves: str) -> Vehicle:
    """A vehicle that ships, with curves in place of some of its parameters, and more sections."""
    return parse_vehicle(curved_text(kind, more, **curves))


def curved_text(kind: str = "quarter_car", more: str = "", **curves: str) -> str:
    """The text of its file."""
    text = read_vehicle(kind).text
    for name in curves:
        text, count = re.subn(rf"^{name} = .*\n", "", text, flags=re.M)
        assert count == 1, name
    return "\n".join([text, "[curves]", *(f"{name} = {table}" for name, table in curves.items()), more])


def integrated_by_scipy(vehicle: Vehicle, road: Bump, time: np.ndarray) -> np.ndarray:
    """Suspension and tyre deflection, and velocities of body and wheel of a passive quarter-car, shape (T, 4).

    From (28), with forces straight between the points of the tables, and the road held at its middle over every step, as MuJoCo
    has it. DOP853 to 1e-12, started again wherever the damper or the spring passes one of its points.
    """
    p, (h, curves) = vehicle.parameters, (float(time[1]), {one.part.argument: one.curve for one in vehicle.fitted})

    def table(name, slope):
        if name not in curves:
            return (lambda x: slope * x), []
        x, y = curves[name].x, curves[name].force
        first, last = (y[1] - y[0]) / (x[1] - x[0]), (y[-1] - y[-2]) / (x[-1] - x[-2])

        def force(at):
            if at < x[0]:
                return y[0] + first * (at - x[0])
            return y[-1] + last * (at - x[-1]) if at > x[-1] else np.interp(at, x, y)

        return force, x.tolist()

    spring, spring_knots = table("deflection", p["suspension_stiffness"])
    damper, damper_knots = table("velocity", p["suspension_damping"])
    static = (p["sprung_mass"] + p["unsprung_mass"]) * 9.81 / p["tyre_stiffness"]

    def rate(z_r):
        def of(_, x):
            z_s, z_u, v_s, v_u = x
            f = spring(z_s - z_u) + damper(v_s - v_u)
            tyre = p["tyre_stiffness"] * (z_u - z_r)
            assert z_u - z_r < static, "the wheel stays on the road"
            return [v_s, v_u, -f / p["sprung_mass"], (f - tyre) / p["unsprung_mass"]]

        return of

    events = [lambda _, x, k=knot: x[2] - x[3] - k for knot in damper_knots]
    events += [lambda _, x, k=knot: x[0] - x[1] - k for knot in spring_knots]
    for event in events:
        vars(event)["terminal"] = True
    x, found = np.zeros(4), []
    for k, start in enumerate(time):
        found.append([x[0] - x[1], x[1] - road.displacement(start), x[2], x[3]])
        z_r, at, end = road.displacement(start + h / 2), 0.0, h
        for _ in range(20):
            step = solve_ivp(rate(z_r), (at, end), x, "DOP853", rtol=1e-12, atol=1e-15, events=events)
            x, at = step.y[:, -1], float(step.t[-1])
            if at >= end or k == len(time) - 1:
                break
            # An event ends the step on its knot; a nudge of a millionth of it goes on past it.
            nudge = min(1e-6 * h, end - at)
            x, at = x + nudge * np.array(rate(z_r)(at, x)), at + nudge
    return np.array(found)
