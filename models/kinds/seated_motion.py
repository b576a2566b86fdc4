"""Exact equations of motion of a car with a seat, for large pitch and roll angles of the body.

The coordinates are y = (q, s): the coordinates q = (z, theta, phi) of the body, and the seat's travel s. The centre of mass of
the body is at the height c above the pitch axis and b above the roll axis (`rigid_motion.py`). The heights b and c are 0 if
links do not define axes. Relative to the road, the seat's mass is at the position P(y), where

    Y = y cos phi - (s + b) sin phi,     h = c - b + y sin phi + (s + b) cos phi,
    P = (x cos theta + h sin theta,  Y,  z - c - x sin theta + h cos theta).

If J is the Jacobian of P, and P'' = J y'' + a, Lagrange's equations of body and seat are

    (M + m J' J) y'' = (Q - ...) + (0, m g - k s - c_p s') - m J' (a + g e_z),

where M and the first term are the same as for the body without a seat, but with the static loads of body and seat.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.kinds.kind import GRAVITY
from models.kinds.rigid_motion import RigidMotion
from models.kinds.seat import JOINT, Seat
from models.kinds.signals import SEAT_ACCELERATION, SEAT_TRAVEL, SEAT_VELOCITY

if TYPE_CHECKING:
    from models.kinds.motion import Pulls

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class SeatedMotion:
    """Equations of motion of a car with a seat.

    The states are the modes q, the hub heights, the seat's travel, and the time derivatives of all these coordinates.

    Attributes:
        car: equations of motion of the body, with the static loads of body and seat.
        seat: seat with its mass, position, spring and damper.
    """

    car: RigidMotion
    seat: Seat

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.car.names, SEAT_TRAVEL.name, SEAT_VELOCITY.name)

    @property
    def joints(self) -> tuple[str, ...]:
        return (*self.car.joints, JOINT)

    def state(self, signals: Mapping[str, Array], heights: Array) -> Array:
        car, travel = self.car.state(signals, heights), signals[SEAT_TRAVEL.name]
        q, _, rates, _ = self.car.split(car)
        J = self._place(q, travel, np.zeros_like(rates), np.zeros_like(travel))[1][:, 2]
        speed = (signals[SEAT_VELOCITY.name] - (J[:, :-1] * rates).sum(axis=1)) / J[:, -1]
        n = car.shape[1] // 2
        return np.concatenate([car[:, :n], travel[:, None], car[:, n:], speed[:, None]], axis=1)

    def usable(self, state: Array) -> Array:
        return self.car.usable(self._split(state)[0])

    def read(self, state: Array, heights: Array) -> Array:
        car, travel, speed = self._split(state)
        q, _, rates, _ = self.car.split(car)
        J = self._place(q, travel, rates, speed)[1]
        moved = [travel, (J[:, 2] * np.column_stack([rates, speed])).sum(axis=1)]
        return np.concatenate([self.car.read(car, heights), np.stack(moved, axis=-1)], axis=1)

    def rate(self, state: Array, heights: Array, inputs: Array, pulls: "Pulls", loads: Array) -> Array:
        car, travel, speed = self._split(state)
        q, _, rates, _ = self.car.split(car)
        of_car = self.car.rate(car, heights, inputs, pulls, loads)
        free, on_hubs = np.split(of_car[:, of_car.shape[1] // 2 :], [q.shape[1]], axis=1)
        _, J, bent = self._place(q, travel, rates, speed)
        M, seat = self.car.masses(q), self.seat
        push = np.append(np.einsum("tij,tj->ti", M, free), self._pushed(travel, speed)[:, None], axis=1)
        push -= seat.mass * np.einsum("tij,ti->tj", J, bent + GRAVITY * UP)
        whole = seat.mass * np.einsum("tij,tik->tjk", J, J)
        whole[:, :-1, :-1] += M
        second = np.linalg.solve(whole, push[:, :, None])[:, :, 0]
        speeds = of_car[:, : of_car.shape[1] // 2]
        return np.concatenate([speeds, speed[:, None], second[:, :-1], on_hubs, second[:, -1:]], axis=1)

    def outputs(self, state: Array, heights: Array, inputs: Array, pulls: "Pulls", loads: Array) -> Mapping[str, Array]:
        car, travel, speed = self._split(state)
        of_car, _, second = self._split(self.rate(state, heights, inputs, pulls, loads))
        q, _, rates, _ = self.car.split(car)
        _, J, bent = self._place(q, travel, rates, speed)
        turning = np.column_stack([self.car.split(of_car)[2], second])
        return {**self.car.outputs_at(car, of_car), SEAT_ACCELERATION.name: (J[:, 2] * turning).sum(axis=1) + bent[:, 2]}

    def energy(self, state: Array, heights: Array) -> Array:
        """See `StoredEnergy`. The energy of the car includes the energy of the seat's weight, spring and motion."""
        car, travel, speed = self._split(state)
        q, _, rates, _ = self.car.split(car)
        P, J, _ = self._place(q, travel, rates, speed)
        velocity, seat = np.einsum("tij,tj->ti", J, np.column_stack([rates, speed])), self.seat
        potential = seat.mass * GRAVITY * (P[:, 2] - travel) + seat.stiffness * travel**2 / 2
        return self.car.energy(car, heights) + np.stack([potential, seat.mass * (velocity**2).sum(axis=1) / 2], axis=-1)

    def _pushed(self, travel: Array, speed: Array) -> Array:
        """Returns the force of the seat's spring and damper on the seat, in the direction of its travel [N], shape (T,)."""
        return self.seat.mass * GRAVITY - self.seat.stiffness * travel - self.seat.damping * speed

    def _split(self, state: Array) -> tuple[Array, Array, Array]:
        """Returns the states of the car, and the travel and the speed of the seat."""
        n = state.shape[1] // 2
        return np.delete(state, [n - 1, 2 * n - 1], axis=1), state[:, n - 1], state[:, -1]

    def _place(self, q: Array, travel: Array, rates: Array, speed: Array) -> tuple[Array, Array, Array]:
        """Returns the position P of the seat [m], its Jacobian J, and a = P'' - J y''.

        Args:
            q: modes of the body, shape (T, k).
            travel: extension of the seat's spring [m], shape (T,).
            rates: rates of the modes, shape (T, k).
            speed: rate at which the seat's spring extends [m/s], shape (T,).

        Returns:
            Arrays P, J and a of shape (T, 3), (T, 3, k + 1) and (T, 3).
        """
        car, x, y = self.car, self.seat.x, self.seat.y
        sin, cos, side, turned, _ = car.tilt(q)
        (pitch_rate, roll_rate), b, c = car.turns(rates), car.body.roll_arm or 0.0, car.body.pitch_arm or 0.0
        up, still = travel + b, np.zeros_like(travel)
        Y, rise = y * turned - up * side, y * side + up * turned
        h = c - b + rise
        P = np.stack([x * cos + h * sin, Y, q[:, 0] - c - x * sin + h * cos], axis=-1)
        by_each = (
            np.stack([still, still, still + 1.0], axis=-1),
            np.stack([h * cos - x * sin, still, -x * cos - h * sin], axis=-1),
            np.stack([Y * sin, -rise, Y * cos], axis=-1),
        )
        along = np.stack([turned * sin, -side, turned * cos], axis=-1)
        J = np.stack([*(by_each[mode] for mode in car.body.modes), along], axis=-1)
        h_dot = Y * roll_rate + turned * speed
        # Second time derivative of the height h, without the terms that contain angular accelerations
        bent = -rise * roll_rate**2 - 2 * side * roll_rate * speed
        a = [
            -(x * cos + h * sin) * pitch_rate**2 + 2 * h_dot * cos * pitch_rate + bent * sin,
            -Y * roll_rate**2 - 2 * turned * roll_rate * speed,
            (x * sin - h * cos) * pitch_rate**2 - 2 * h_dot * sin * pitch_rate + bent * cos,
        ]
        return P, J, np.stack(a, axis=-1)
