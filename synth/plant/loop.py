"""Closed loop of a plant and a linear control law: its states at the samples, and its time responses.

    x' = A x + B u + E d,    y = C x + D u + F d.

The law computes the forces u from some of the plant's outputs y. The other inputs d of the plant include the road, loads,
measurement noise and forces from a road preview. In continuous time, the law acts without delay.

In discrete time, the law samples y every T seconds, just before the new force starts to act. A measurement therefore contains
the force that acted before the sample was taken. In each part of the sample period, the acting force is a force that was
computed some samples ago. The state at a sample is

    [x; states of the law; u[k-1]; ...; u[k-p]],

where u[k-1], ..., u[k-p] are those previous forces that still act or that a measurement contains.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from models.common.arrays import Array, recursion
from models.common.checks import CheckedFields, Index, PositiveTime, accept_former_names
from models.laws.linear import LinearLaw
from synth.plant.state_space import Exponential, StateSpace, spectral_radius

# Prefix of the output names for the states of the law, and suffix of the output names for the requested forces
LAW_STATE, REQUESTED = "law_state_", ".requested"


@accept_former_names(late="delay_samples")
@dataclass(frozen=True, eq=False)
class HoldInterval(CheckedFields):
    """Part of the sample period during which one force is held constant.

    Attributes:
        duration: duration of the interval [s].
        delay_samples: number of samples by which the acting force is delayed.
    """

    duration: PositiveTime
    delay_samples: Index


def hold_intervals(period: float, delay: float) -> tuple[HoldInterval, ...]:
    """Returns the parts of a sample period [s] for a delay [samples]: two parts if the delay has a fractional part, otherwise
    one.
    """
    late = math.floor(delay)
    share = delay - late
    pieces = ((share, late + 1), (1 - share, late)) if share else ((1.0, late),)
    return tuple(HoldInterval(part * period, samples) for part, samples in pieces)


@dataclass(frozen=True, eq=False)
class Loop:
    """Closed loop of a plant and a linear control law.

    Attributes:
        plant: plant with n states, either in continuous time, or in discrete time with held inputs.
        law: designed law from the measured outputs to the forces; `acting_law` is the law as it runs.
        measured: names of the measured outputs.
        forces: names of the m inputs that the law computes.
        hold: parts of the sample period in chronological order, each with the delay of the acting force; empty in continuous
            time.
        step: time during which disturbances are held constant [s]; the parts of the period are multiples of this time.
        exponential: function that computes the matrix exponential over a step. With `taylor4`, the loop predicts the steps of
            an RK4 integrator.
    """

    plant: StateSpace
    law: LinearLaw
    measured: tuple[str, ...]
    forces: tuple[str, ...]
    hold: tuple[HoldInterval, ...] = ()
    step: float | None = None
    exponential: Exponential = linalg.expm

    @cached_property
    def acting_law(self) -> LinearLaw:
        """Law as it runs in the loop: discrete with the sample period of the loop, or in continuous time.

        Raises:
            InputError: the law cannot be converted to the sample period of the loop, or to continuous time; see `LinearLaw`.
        """
        if not self.law.states:
            return self.law
        return self.law.sampled(self.period) if self.hold else self.law.continuous()

    @cached_property
    def disturbances(self) -> tuple[str, ...]:
        """Names of those inputs of the plant that are not forces of the law."""
        return tuple(name for name in self.plant.inputs if name not in self.forces)

    @cached_property
    def law_states(self) -> tuple[str, ...]:
        """Names of those outputs that are states of the law."""
        return tuple(f"{LAW_STATE}{i}" for i in range(1, self.law.states + 1))

    @cached_property
    def requested_forces(self) -> tuple[str, ...]:
        """Names of those outputs that are the forces computed by the law, without external forces."""
        return tuple(f"{name}{REQUESTED}" for name in self.forces)

    @property
    def direct(self) -> Array:
        """Direct gain (without delay) from acting forces to requested forces, through measurements that contain forces, shape
        (m, m).
        """
        return self.acting_law.D @ self.plant.part(self.measured, self.forces).D

    @property
    def direct_radius(self) -> float:
        """Spectral radius of the matrix `direct`.

        If the radius is 1 or more, a sampled or delayed force grows, because the measurements contain this force.
        """
        return spectral_radius(self.direct)

    @property
    def period(self) -> float:
        """Sample period [s]; 0 for a loop in continuous time."""
        return sum(part.duration for part in self.hold)

    @cached_property
    def by_step(self) -> tuple[int, ...]:
        """Delay of the force that acts in each step of the sample period, as a number of samples."""
        assert self.step is not None, "the disturbances are held over steps"
        return tuple(part.delay_samples for part in self.hold for _ in range(round(part.duration / self.step)))

    @cached_property
    def stored_forces(self) -> int:
        """Number p of those previous samples whose forces are states of the loop."""
        if not self.hold:
            return 0
        measured = self.plant.D[self.plant.rows(self.measured)][:, self.plant.columns(self.forces)].any()
        return max(self.hold[0].delay_samples, self.hold[-1].delay_samples + 1 if measured else 0)

    @cached_property
    def _forced_plant(self) -> StateSpace:
        """Plant whose first inputs are the forces."""
        inputs = (*self.forces, *self.disturbances)
        return self.plant if inputs == self.plant.inputs else self.plant.part(self.plant.outputs, inputs)

    @cached_property
    def _held_plant(self) -> StateSpace:
        """Plant with the forces as its first inputs, discretised with the step if disturbances are constant during each step."""
        plant = self._forced_plant
        if self.step is None or plant.dt is not None:
            return plant
        Phi, Gamma = plant.hold_matrices(self.step, self.exponential)
        return replace(plant, A=Phi, B=Gamma, dt=self.step)

    def hold_matrices(self, duration: float) -> tuple[Array, Array]:
        """Returns Phi and Gamma of the plant for inputs that are held constant for a duration [s]. The forces are the first
        inputs, so their columns of Gamma come first.
        """
        return self._held_plant.hold_matrices(duration, self.exponential)

    @cached_property
    def open_loop(self) -> StateSpace:
        """Open loop, which is cut open at all forces.

        The inputs of the open loop are the forces and the disturbances. The outputs are the outputs of the plant, the states of
        the law, and the forces that the law requests. In discrete time, the force inputs are the forces that are computed at a
        sample. Disturbances are then constant during the sample period, and the outputs have their values just after the
        sample.
        """
        plant = self._forced_plant
        law, measured, m, p = self.acting_law, plant.rows(self.measured), len(self.forces), self.stored_forces
        n, k = len(plant.A), law.states
        N = n + k + p * m
        # The rows select from [x; x_c; previous forces; u; d]. From here on, the names of signals stand for matrices that act
        # on this vector.
        x, x_c, previous, u, d = np.split(np.eye(N + len(plant.inputs)), [n, n + k, N, N + m])
        forces = [u, *(previous[i * m : (i + 1) * m] for i in range(p))]  # previous forces by age [samples]
        acting = before = u
        if self.hold:
            acting, last = forces[self.hold[0].delay_samples], self.hold[-1].delay_samples + 1
            # Force that acts until the sample; it is needed if a measurement contains the force
            before = forces[last] if p >= last else 0 * u
        y = plant.C @ x + plant.D @ np.vstack([acting, d])
        readings = plant.C[measured] @ x + plant.D[measured] @ np.vstack([before, d])
        outputs = np.vstack([y, x_c, law.D @ readings + law.C @ x_c])
        for part in self.hold:
            Phi, Gamma = self.hold_matrices(part.duration)
            x = Phi @ x + Gamma @ np.vstack([forces[part.delay_samples], d])
        if not self.hold:
            x = plant.A @ x + plant.B @ np.vstack([u, d])
        states = np.vstack([x, law.B @ readings + law.A @ x_c, *forces[:p]])
        A, B, C, D = states[:, :N], states[:, N:], outputs[:, :N], outputs[:, N:]
        names = (*plant.outputs, *self.law_states, *self.requested_forces)
        return StateSpace(A, B, C, D, plant.inputs, names, self.period if self.hold else None)

    @cached_property
    def closed_loop(self) -> StateSpace:
        """Closed loop, in which the requested forces are added to the force inputs, so that the force inputs are external
        forces.

        Raises:
            InputError: the algebraic loop through measurements that contain forces has no solution (only in continuous time).
        """
        return self.open_loop.closed(self.requested_forces, self.forces)

    def cut(self, forces: Sequence[str]) -> StateSpace:
        """Returns the loop from acting to requested forces, which is cut open at some forces and closed at all other forces."""
        others = [name for name in self.forces if name not in forces]
        system = self.open_loop.closed([f"{name}{REQUESTED}" for name in others], others)
        return system.part([f"{name}{REQUESTED}" for name in forces], forces)


@np.errstate(over="ignore", invalid="ignore")  # the response of an unstable loop may overflow
def respond(loop: Loop, outputs: Sequence[str], inputs: Mapping[str, Array], start: Array | None = None) -> Array:
    """Returns outputs of a sampled-data loop at every step, shape (..., T, p).

    One recursion computes the states of the loop at all samples. The outputs at the steps between samples are then computed for
    all samples together.

    Args:
        loop: sampled-data loop for which `step` is given.
        outputs: names of p outputs. States and requested forces of the law keep the values of the last sample.
        inputs: input signals by name, each of shape (..., T). Disturbances are constant during each step. Inputs with the name
            of a force are added to the requested force at the samples.
        start: initial states of the plant, shape (n,). Default: zero.
    """
    system, lates, names = loop.closed_loop, loop.by_step, list(inputs)
    *runs, T = next(iter(inputs.values())).shape
    P, n, m, columns = len(lates), len(loop.plant.A), len(loop.forces), np.array(system.columns(names), dtype=int)
    K, rows, outside = -(-T // P), system.rows(outputs), columns >= m  # `outside` is True for inputs that are disturbances
    d = np.zeros((*runs, K * P, len(names)))
    for i, values in enumerate(inputs.values()):
        d[..., :T, i] = values
    d = d.reshape(*runs, K, P, len(names))
    at_sample, by_step = d[..., 0, :], d[..., outside]
    push = at_sample @ system.B[:, columns].T
    Phi, Gamma = loop.hold_matrices(loop.step or 0.0)
    if P > 1:  # effect of the disturbances that change within the sample period
        more, into = np.zeros_like(push[..., :n]), Gamma[:, columns[outside]].T
        for i in range(1, P):
            more = more @ Phi.T + (by_step[..., i, :] - by_step[..., 0, :]) @ into
        push[..., :n] += more
    states = recursion(system.A, push, None if start is None else np.pad(start, (0, len(system.A) - n)))

    def at_samples(rows: list[int]) -> Array:
        return states @ system.C[rows].T + at_sample @ system.D[rows][:, columns].T

    if P == 1:
        return at_samples(rows)
    computed = at_samples(system.rows(loop.requested_forces))
    for i in np.flatnonzero(~outside):
        computed[..., columns[i]] += at_sample[..., i]
    plant, acting = loop.plant, [*range(m), *columns[outside]]
    steps = np.empty((*runs, K, P, n + len(acting)))  # vector [x; forces; disturbances] at every step
    steps[..., 0, :n], steps[..., n + m :] = states[..., :n], by_step
    into = np.hstack([Phi, Gamma[:, acting]]).T
    for i, late in enumerate(lates):
        steps[..., i, n : n + m] = _delay_forces(computed, late)
        if i + 1 < P:
            steps[..., i + 1, :n] = steps[..., i, :] @ into
    of_plant = [row if row < len(plant.outputs) else 0 for row in rows]
    seen = np.hstack([plant.C[of_plant], plant.D[of_plant][:, plant.columns([system.inputs[i] for i in acting])]])
    y = (steps.reshape(-1, seen.shape[1]) @ seen.T).reshape(*runs, K, P, len(rows))
    if others := [i for i, row in enumerate(rows) if row >= len(plant.outputs)]:
        y[..., others] = at_samples([rows[i] for i in others])[..., None, :]
    return y.reshape(*runs, K * P, len(rows))[..., :T, :]


def _delay_forces(forces: Array, samples: int) -> Array:
    """Returns forces, shape (..., K, m), that are delayed by a number of samples; the first forces are zero."""
    count = forces.shape[-2]
    return np.concatenate([np.zeros_like(forces[..., :samples, :]), forces[..., : max(count - samples, 0), :]], axis=-2)
