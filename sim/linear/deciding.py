"""What a controller decides at a sample, of a vehicle with adjustable dampers, and how near that was to another decision."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.damping.laws import SemiActive, SemiActiveLaw
from models.damping.range import range_of
from models.law import LinearLaw
from models.vehicle import Vehicle
from sim.semi_active.numbers import numbers_at, numbers_of
from synth.controller import Controller

OTHERWISE = 1e-4  # of a damper's range: two coefficients that are further apart were decided otherwise
VELOCITY = "velocity"  # of the suspensions, which are no signal
NEAREST = 1e-13  # of what is decided on; double precision has no nearer


@dataclass(frozen=True)
class Otherwise:
    """A sample at which physics and its reference decided otherwise, as rounding had it.

    Attributes:
        time: of the sample [s].
        force: which damper's.
        near: how much of their peaks at most the numbers on which it was decided would have to be others, for the other decision.
    """

    time: float
    force: str
    near: float


class Decisions:
    """What the controller of one run decides, sample by sample.

    Attributes:
        of: what the dampers can be.
        kept: the states of the controller at its last sample, shape (k,).
    """

    def __init__(
        self, vehicle: Vehicle, controller: Controller | SemiActive, period: float, near: float, peaks: Callable[[str], float]
    ) -> None:
        """For a controller that samples every so many seconds.

        Args:
            vehicle: the vehicle.
            controller: its controller.
            period: [s].
            near: how near a decision has to be to another one for rounding to make it that, see `Otherwise`.
            peaks: the peak of a signal, or of "velocity", that of the suspensions.
        """
        self.forces, self._near = vehicle.linear_model.inputs, near
        self.of = range_of([vehicle.adjustable], self.forces)
        self._law = controller.law.sampled(period) if isinstance(controller, Controller) else controller.law
        states = self._law.states if isinstance(self._law, LinearLaw) else 0
        self._nominal = np.array([one.nominal for one in vehicle.adjustable])
        self._numbers = numbers_of(self._law, [vehicle]) if isinstance(self._law, SemiActiveLaw) else None
        self.kept, self._next = np.zeros(states), np.zeros(states)
        self._scales = np.array([peaks(name) for name in controller.measured] + [peaks(VELOCITY)] * len(self.forces))
        self._largest = np.zeros(states)

    def __call__(self, y: Array, velocity: Array) -> Array:
        """The commands (see `Range.commands`) at the next sample, shape (2 m,).

        Args:
            y: what is measured, shape (q,).
            velocity: of the suspensions [m/s], shape (m,).
        """
        self.kept = self._next
        if isinstance(self._law, LinearLaw):
            self._next = self._law.A @ self.kept + self._law.B @ y
        self._largest = np.maximum(self._largest, np.abs(self.kept))
        return self._decided(np.concatenate([y, velocity])[None], self.kept[None])[0]

    def nearness(self, y: Array, velocity: Array, other: Array) -> Array:
        """How near each decision just made was to others, see `Otherwise.near`; infinite beyond what is allowed, shape (m,).

        Args:
            y, velocity: on which it was made.
            other: coefficients beyond the nominal ones, shape (m,).
        """
        seen, m = np.concatenate([y, velocity, self.kept]), len(self.forces)
        moves = np.concatenate([self._scales, self._largest])
        rows = np.concatenate([np.diag(moves), -np.diag(moves)])
        found, epsilon = np.full(m, np.inf), NEAREST
        while epsilon <= self._near * (1 + 1e-9):
            tried = seen + epsilon * rows
            split = len(y) + m
            decided = self._decided(tried[:, :split], tried[:, split:])[:, :m]
            slack = OTHERWISE * np.where(self.of.adjustable, self.of.high[0] - self.of.low[0], 0.0)
            within = (decided.min(axis=0) - slack <= other) & (other <= decided.max(axis=0) + slack)
            found = np.where(within & np.isinf(found), epsilon, found)
            epsilon *= 10
        return found

    def _decided(self, seen: Array, kept: Array) -> Array:
        """Commands from what is measured and the velocities, shape (P, q + m), and the states, shape (P, k)."""
        m, which = len(self.forces), np.zeros(len(seen), dtype=int)
        closing = np.where(self.of.adjustable, -seen[:, -m:], 0.0) + self.of.at_rest
        if not isinstance(self._law, LinearLaw):
            assert self._numbers is not None, "of a semi-active law"
            numbers = numbers_at(self._numbers.some(which), self.of, closing, which)
            asked = self._law.coefficients(seen[:, :-m], numbers) - self._nominal
            return self.of.set_to(asked, closing, which)
        asked = seen[:, :-m] @ self._law.D.T + kept @ self._law.C.T
        return self.of.commands(np.concatenate([asked, closing], axis=-1), which)
