"""The loop of a vehicle and its controller, cut at some actuators with the others closed.

    x' = A x + B u,    v = G x + H u,    L(s) = G (s I - A)^-1 B + H,

where u is the force that acts and v the force asked for; the loop is closed by u = v. The states are the vehicle's and the
controller's own. H is zero, but for a measured acceleration, which has the force in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.laws.linear import LinearLaw
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller
from synth.controller.open_loop import LoopModel, continuous, with_lag
from synth.plant.discrete import held_inputs

DECAYS = 1e-9  # of the fastest of a law: a mode that decays as slowly does not


@dataclass(frozen=True, eq=False)
class LoopTransfer:
    """A loop, cut at k actuators.

    Attributes:
        A: state matrix with the other actuators' loops closed, shape (n, n).
        B: input matrix of the forces that act, shape (n, k).
        G: gain to the commanded forces, shape (k, n).
        H: feedthrough from the forces that act to the commanded ones, shape (k, k).
        sampling: the sampled loop with a controller with states; None for a static one.
    """

    A: Array
    B: Array
    G: Array
    H: Array
    sampling: "SampledLaw | None" = None

    @property
    def M(self) -> Array:
        """Returns the contribution of closing the loop to A if H is zero, shape (n, n)."""
        return self.B @ self.G

    @property
    def comes_back(self) -> float:
        """Returns the direct gain of a force through its own measurement: from 1 on the loop has no delay margin."""
        return float(np.abs(np.linalg.eigvals(self.H)).max(initial=0.0))

    def balanced(self) -> "LoopTransfer":
        """The same with its states in units that make its numbers of a like size, powers of two."""
        _, (scale, _) = linalg.matrix_balance(np.abs(self.A) + np.abs(self.M), permute=False, separate=True)
        return LoopTransfer(self.A * scale / scale[:, None], self.B / scale[:, None], self.G * scale, self.H, self.sampling)

    def closed(self, factor: Array | complex) -> Array:
        """A of the loops that are closed by u = factor v, shape (..., n, n), for factors of any shape."""
        factor = np.asarray(factor)[..., None, None]
        if not np.any(self.H):
            return self.A + factor * self.M
        return self.A + self.B @ np.linalg.solve(np.eye(len(self.H)) - factor * self.H, factor * self.G)

    def from_sample_to_sample(self, start: float, step: float, count: int) -> Array:
        """Transitions of the closed loop that is sampled, at the periods start + step, start + 2 step and so on [s].

        Returns:
            Shape (count, N, N): N is n, and for a law with states what `SampledLaw` adds.
        """
        if self.sampling is not None:
            return self.sampling.transitions(start, step, count)
        held = _held(self.A, self.B, start, step, count)
        n = len(self.A)
        return held[:, :n, :n] + held[:, :n, n:] @ self.G

    def sampled_growth(self, period: float) -> float:
        """Spectral radius of one of these, made by itself, less 1."""
        if self.sampling is None:
            Phi, Gamma = held_inputs(self.A, period, linalg.expm, self.B)
            transition = Phi + Gamma @ self.G
        elif self.sampling.whole:
            prompt = replace(self.sampling.vehicle, implementation=Implementation())
            transition = LoopModel(prompt, self.sampling.controller, period).closed_loop.transition
        else:
            (transition,) = self.sampling.transitions(0.0, period, 1)
        return float(np.abs(np.linalg.eigvals(transition)).max() - 1)

    def transfer(self, omega: Array) -> Array:
        """L(j omega), shape (F, k, k), for angular frequencies [rad/s] of shape (F,)."""
        resolvent = 1j * omega[:, None, None] * np.eye(len(self.A)) - self.A
        return self.G @ np.linalg.solve(resolvent, np.broadcast_to(self.B, (len(omega), *self.B.shape))) + self.H


def loop_transfer(vehicle: Vehicle, controller: Controller, actuators: Sequence[int]) -> LoopTransfer:
    """The loop of a vehicle and its controller, cut at some actuators; with their lag, if the vehicle's have one."""
    law, model = controller.law.continuous(), with_lag(vehicle)
    C, D = model.rows(controller.measured)
    others = [i for i in range(len(law.D)) if i not in actuators]
    if not law.states and not np.any(D):
        G = continuous(vehicle, controller).G
        H = np.zeros((len(actuators), len(actuators)))
        return LoopTransfer(model.A + model.B[:, others] @ G[others], model.B[:, actuators], G[actuators], H)
    A = np.block([[model.A, np.zeros((len(model.A), law.states))], [law.B @ C, law.A]])
    B, G, H = np.vstack([model.B, law.B @ D]), np.hstack([law.D @ C, law.C]), law.D @ D
    # The others' forces: u = inverse (their rows of G x + H u of the cut ones).
    inverse = np.linalg.inv(np.eye(len(others)) - H[np.ix_(others, others)])
    closing, through = inverse @ G[others], inverse @ H[np.ix_(others, actuators)]
    return LoopTransfer(
        A + B[:, others] @ closing,
        B[:, actuators] + B[:, others] @ through,
        G[actuators] + H[np.ix_(actuators, others)] @ closing,
        H[np.ix_(actuators, actuators)] + H[np.ix_(actuators, others)] @ through,
        SampledLaw(vehicle, controller, tuple(actuators)),
    )


@dataclass(frozen=True, eq=False)
class SampledLaw:
    """A controller with states, whose loop is sampled at one period or another.

    The forces of the cut actuators are sampled by a copy of the law. The others are in continuous time, by a copy of their own.
    Each copy has the states of the law that its forces depend on.

    Attributes:
        vehicle: the vehicle; what its `[implementation]` says does not count.
        controller: the controller.
        actuators: actuators at which the loop is cut.
    """

    vehicle: Vehicle
    controller: Controller
    actuators: tuple[int, ...]

    @cached_property
    def whole(self) -> bool:
        """True if all forces are sampled and held: if all are cut, if forces are measured, or if two copies would drift apart.

        Copies drift apart if both have a mode that does not decay, as an integrator has: nothing measures their difference.
        """
        model, law = with_lag(self.vehicle), self.controller.law.continuous()
        mine = np.isin(np.arange(len(law.D)), self.actuators)
        if mine.all() or np.any(model.rows(self.controller.measured)[1]):
            return True
        both = _needed(law, mine) & _needed(law, ~mine)
        return bool(np.any(np.linalg.eigvals(law.A[np.ix_(both, both)]).real >= -DECAYS * np.abs(law.A).max(initial=0.0)))

    def _split(self) -> tuple[Array, Array, Array, Array, LinearLaw]:
        """Returns A and B of what is not sampled, the measurements on its states and forces, and the sampled law."""
        model, law = with_lag(self.vehicle), self.controller.law.continuous()
        C, D = model.rows(self.controller.measured)
        if self.whole:
            return model.A, model.B, C, D, law
        mine = np.isin(np.arange(len(law.D)), self.actuators)
        own, others = (_part(law, each) for each in (mine, ~mine))
        into, k = model.B[:, ~mine], others.states
        A = np.block([[model.A + into @ others.D @ C, into @ others.C], [others.B @ C, others.A]])
        B = np.vstack([model.B[:, mine], np.zeros((k, int(mine.sum())))])
        return A, B, np.hstack([C, np.zeros((len(C), k))]), D[:, mine], own

    def transitions(self, start: float, step: float, count: int) -> Array:
        """Returns `LoopTransfer.from_sample_to_sample`: the loop of `LoopModel`, by powers of one exponential.

        A discrete law counts as its continuous counterpart here, at its own sample period, too.
        """
        A_rest, B_rest, C, D, law = self._split()
        (n, m), (k, q) = B_rest.shape, law.B.shape
        held = _held(A_rest, B_rest, start, step, count)
        # As in `LinearLaw.sampled`, but for the ramp, which is not over the period yet.
        chain = np.zeros((k + 2 * q, k + 2 * q))
        chain[:k, :k], chain[:k, k : k + q], chain[k : k + q, k + q :] = law.A, law.B, np.eye(q)
        periods = start + step * np.arange(1, count + 1)
        powers = _powers(chain, start, step, count)
        A, ramp = powers[:, :k, :k], powers[:, :k, k + q :] / periods[:, None, None]
        B, through = powers[:, :k, k : k + q] - ramp + A @ ramp, law.D + law.C @ ramp
        # From [x; x_c; previous forces], which are states only where they are measured.
        previous = m if np.any(D) else 0
        seen = np.hstack([C, np.zeros((q, k)), D[:, :previous]])
        forces = through @ seen
        forces[:, :, n : n + k] += law.C
        moved = np.zeros((count, n + k + previous, n + k + previous))
        moved[:, :n] = held[:, :n, n:] @ forces
        moved[:, :n, :n] += held[:, :n, :n]
        moved[:, n : n + k] = B @ seen
        moved[:, n : n + k, n : n + k] += A
        moved[:, n + k :] = forces[:, :previous]
        return moved


def _needed(law: LinearLaw, forces: Array) -> Array:
    """Returns the mask of the states that some forces depend on, directly or through other states, shape (k,)."""
    needed = np.any(law.C[forces] != 0, axis=0)
    for _ in range(law.states):
        needed = needed | np.any(law.A[needed] != 0, axis=0)
    return needed


def _part(law: LinearLaw, forces: Array) -> LinearLaw:
    """Returns the law of some forces, with the states that they depend on."""
    kept = _needed(law, forces)
    return LinearLaw(law.A[np.ix_(kept, kept)], law.B[kept], law.C[np.ix_(forces, kept)], law.D[forces])


def _held(A: Array, B: Array, start: float, step: float, count: int) -> Array:
    """Phi and Gamma side by side of x' = A x + B u with u held, over zeros and I, for those durations."""
    n, m = B.shape
    return _powers(np.vstack([np.hstack([A, B]), np.zeros((m, n + m))]), start, step, count)


def _powers(A: Array, start: float, step: float, count: int) -> Array:
    """exp(A t) at t = start + step, start + 2 step and so on, shape (count, n, n)."""
    by, now = linalg.expm(A * step), linalg.expm(A * start)
    made = np.empty((count, *A.shape))
    with np.errstate(over="ignore", invalid="ignore"):  # an unstable law's own growth in long periods
        for i in range(count):
            now = now @ by
            made[i] = now
    return made
