"""Open loops of a vehicle with its actuators and controller states, and closed loops from one sample to the next.

A law with states is a static gain on a larger vehicle: its states are integrators, x_c' = v, driven by inputs v of their own.
Then every formula of a loop that is closed by a gain holds for any law. Continuous, v = A_c x_c + B_c y. Sampled every T seconds,
v = ((A_d - I) x_c + B_d y) / T is held meanwhile, which takes x_c to A_d x_c + B_d y exactly.

A law for study may measure heights over the datum of a flat road, which contain that of the road. In continuous time the road's
height then acts by the law, too. Sampled, it acts as it is at the sample.

A measured acceleration contains the force. In continuous time that loop is solved. A sampled reading is taken before the new
force acts: y = C x + D u, with the previous u, which is a state too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError, error_in
from models.kinds.linear_model import LinearModel
from models.kinds.signals import KEPT
from models.laws.linear import LinearLaw
from models.vehicle.limits_and_implementation import Implementation, steps_held, steps_per_sample
from models.vehicle.vehicle import Vehicle
from synth.analysis.stability import sampled_growth
from synth.controller.controller import Controller
from synth.controller.loop_of import with_lag
from synth.plant.discrete import held_inputs


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """A vehicle with its actuators and controller states, and the gain to its inputs.

    Attributes:
        model: linear model whose n states are those of vehicle, lag and law, and the previous forces. Its inputs are the m
            requested forces and the k rates of the controller states.
        G: gain from its states to all inputs, shape (m + k, n).
        hold: gain from the acting forces to the rates, shape (k, m).
        reading: gain from a disturbance of each measurement to all inputs, shape (m + k, q).
        forces: number m.
    """

    model: LinearModel
    G: Array
    hold: Array
    reading: Array
    forces: int

    @property
    def law_states(self) -> slice:
        """Position of the law's states among those of the model."""
        named = [i for i, name in enumerate(self.model.states) if name.startswith(KEPT)]
        return slice(named[0], named[-1] + 1) if named else slice(0)

    @property
    def asked(self) -> Array:
        """Gain from the states to the requested forces, shape (m, n)."""
        return self.G[: self.forces]

    @property
    def kept(self) -> Array:
        """Gain from the states to the rates of the controller states, without that of the acting forces, shape (k, n)."""
        return self.G[self.forces :]

    def inputs(self, acting: Array, kept: Array | None = None, last: Array | None = None) -> Array:
        """Returns the acting forces and the rates of the controller states, stacked, shape (..., m + k, c).

        Args:
            acting: the forces, shape (..., m, c).
            kept: the rates without the effect of the forces, shape (..., k, c). Default: those of the states.
            last: the acting forces at the period's end. Default: `acting`.
        """
        kept = self.kept if kept is None else kept
        if not len(self.hold):
            return acting
        rates = kept + self.hold @ (acting if last is None else last)
        return np.concatenate([acting, rates], axis=-2)


def readings_of_road(cut: OpenLoop, controller: Controller) -> Array:
    """Returns the effect of the road's velocity on all inputs, by measured accelerations of wheels on tyres that damp.

    Its shape is (m + k, r).
    """
    return cut.reading @ cut.model.Dw[[cut.model.outputs.index(name) for name in controller.measured]]


def heights_read(cut: OpenLoop, controller: Controller) -> Array:
    """Returns the effect of the road's heights on all inputs, by heights over the datum of a flat road that are measured.

    Its shape is (m + k, r).
    """
    return cut.reading @ cut.model.Cr[[cut.model.outputs.index(name) for name in controller.measured]]


def continuous(vehicle: Vehicle, controller: Controller) -> OpenLoop:
    """Returns the open loop in continuous time; a discrete law as its bilinear counterpart.

    What the road's heights do by the law is part of its model's Br and Cr.

    Raises:
        InputError: the measurements contain the force, and that loop has no solution.
    """
    model = with_lag(vehicle)
    C, D = model.rows(controller.measured)
    cut = _kept(model, controller.law.continuous().fed_back(D), C, np.zeros((len(C), 0)))
    felt = heights_read(cut, controller)
    if not felt.any():
        return cut
    return replace(cut, model=replace(cut.model, Br=cut.model.Br + cut.model.B @ felt, Cr=cut.model.Cr + cut.model.D @ felt))


def sampled(vehicle: Vehicle, controller: Controller, period: float) -> OpenLoop:
    """Returns the open loop for a sample period [s]."""
    model = with_lag(vehicle)
    C, D = model.rows(controller.measured)
    with error_in(f"controller {controller.name!r}:"):
        law = controller.law.sampled(period)
    try:
        rates = LinearLaw((law.A - np.eye(law.states)) / period, law.B / period, law.C, law.D)
    except InputError as error:
        raise InputError(
            f"controller {controller.name!r} cannot run every {period:g} s, because its states change too fast: of their rates, "
            f"(A - I) / T and B / T, {error}; scale its states, so that B is smaller and C larger"
        ) from error
    return _kept(model, rates, C, D if np.any(D) else np.zeros((len(C), 0)), 1 / period)


def _kept(model: LinearModel, law: LinearLaw, C: Array, D: Array, rate: float = 0.0) -> OpenLoop:
    """Returns the open loop with the states of a law, and with the previous forces if a measurement contains them.

    Args:
        model: n states, m forces.
        law: law in continuous time with k states.
        C: output matrix of the measurements, shape (q, n).
        D: gain from the previous forces to the measurements, shape (q, m), or (q, 0) if they are not measured.
        rate: rate at which an acting force becomes the previous one [1/s].
    """
    (n, m), k, previous = model.B.shape, law.states, D.shape[1]
    more = k + previous
    if not more:
        return OpenLoop(model, law.D @ C, np.zeros((0, m)), law.D, m)
    readings = np.hstack([C, np.zeros((len(C), k)), D])
    G = np.vstack(
        [
            law.D @ readings + np.hstack([np.zeros((m, n)), law.C, np.zeros((m, previous))]),
            law.B @ readings + np.hstack([np.zeros((k, n)), law.A, np.zeros((k, previous))]),
            np.hstack([np.zeros((previous, n + k)), -rate * np.eye(previous)]),
        ]
    )
    hold = np.vstack([np.zeros((k, m)), rate * np.eye(previous, m)])
    reading = np.vstack([law.D, law.B, np.zeros((previous, len(C)))])
    names = [f"{KEPT}{i}" for i in range(1, k + 1)] + [f"acted_{name}" for name in model.inputs[:previous]]
    larger = replace(
        model,
        A=linalg.block_diag(model.A, np.zeros((more, more))),
        B=linalg.block_diag(model.B, np.eye(more)),
        **{name: np.pad(getattr(model, name), ((0, more), (0, 0))) for name in ("Bw", "Br", "Bl", "Bt")},
        **{name: np.pad(getattr(model, name), ((0, 0), (0, more))) for name in ("C", "D")},
        states=(*model.states, *names),
        inputs=(*model.inputs, *(f"rate_of_{name}" for name in names)),
    )
    return OpenLoop(larger, G, hold, reading, m)


@dataclass(frozen=True, eq=False)
class HoldSegment:
    """A part of the period in which one force is held.

    Attributes:
        steps: duration in timesteps.
        inputs: gain from the loop's state to all inputs of `SampledClosedLoop.open_loop`, shape (m + k, s).
        feedthrough: gain from a disturbance of the inputs computed at the sample to those inputs, shape (m + k, m + k).
    """

    steps: int
    inputs: Array
    feedthrough: Array


@dataclass(frozen=True, eq=False)
class SampledClosedLoop:
    """A closed loop from one sample of the controller to the next.

    The s states are those of `open_loop.sampled`, followed by the delayed forces, the next to act first.

    Attributes:
        open_loop: the open loop of vehicle and controller.
        transition: shape (s, s).
        added: gain from a disturbance of the inputs computed at a sample to the next state, shape (s, m + k).
        parts: segments of the period in order; more than one if the delay has a fraction of a sample.
    """

    open_loop: OpenLoop
    transition: Array
    added: Array
    parts: tuple[HoldSegment, ...]

    @property
    def by_step(self) -> list[HoldSegment]:
        """The held part at every timestep of the period."""
        return [part for part in self.parts for _ in range(part.steps)]


@dataclass(frozen=True, eq=False)
class LoopModel:
    """A vehicle with its linear controller at a timestep, and the matrices of their loop, computed when first used.

    Its properties raise an InputError if the sample period or the delay is not a multiple of the timestep, see
    `steps_per_sample`.

    Attributes:
        vehicle: vehicle with the controller's implementation.
        controller: controller of the loop.
        timestep: timestep of the run [s].
        exponential: the matrix exponential; `taylor4` to predict an RK4 integrator.
    """

    vehicle: Vehicle
    controller: Controller
    timestep: float
    exponential: Callable[[Array], Array] = linalg.expm

    @cached_property
    def steps(self) -> int:
        """Timesteps from one sample of the controller to the next."""
        return steps_per_sample(self.vehicle.implementation, self.timestep)

    @property
    def period(self) -> float:
        """Time from one sample of the controller to the next [s]."""
        return self.steps * self.timestep

    @cached_property
    def open_loop(self) -> OpenLoop:
        """The open loop of the vehicle and its sampled controller."""
        return sampled(self.vehicle, self.controller, self.period)

    @cached_property
    def continuous(self) -> OpenLoop:
        """The open loop in continuous time, without delay."""
        return continuous(self.vehicle, self.controller)

    @cached_property
    def closed_loop(self) -> SampledClosedLoop:
        """The closed loop as implemented."""
        return _implemented(self.open_loop, self.vehicle.implementation, self.timestep, self.exponential)

    def cut(self, actuators: Sequence[int] | None = None) -> tuple[Array, Array, Array]:
        """Returns Phi, Gamma and G of the loop from sample to sample, x[i+1] = Phi x[i] + Gamma u[i], v[i] = G x[i].

        Args:
            actuators: actuators that are cut, whose force u is not v; None for all. The others' forces are sampled and held, too.
        """
        closed, asked = self.closed_loop, self.open_loop.asked
        these = list(range(len(asked)) if actuators is None else actuators)
        G = np.pad(asked, ((0, 0), (0, len(closed.transition) - asked.shape[1])))[these]
        Gamma = closed.added[:, these]
        return closed.transition - Gamma @ G, Gamma, G

    @cached_property
    def radius(self) -> float:
        """Growth per timestep of the closed loop: above 1 it is unstable, at exactly 1 marginal."""
        return sampled_growth(self.closed_loop.transition) ** (1 / self.steps)


def _step_by_step(exponential: Callable[[Array], Array], steps: int, M: Array) -> Array:
    """Returns the exponential of a matrix by that of every step."""
    return np.linalg.matrix_power(exponential(M / steps), steps)


def _implemented(cut: OpenLoop, how: Implementation, timestep: float, exponential: Callable[[Array], Array]) -> SampledClosedLoop:
    intervals = steps_held(how, timestep)
    n, m, k = len(cut.model.A), cut.forces, len(cut.hold)
    force, rate = np.eye(m, m + k), np.eye(m + k)[m:]
    size, rest = n + how.pending_forces * m, how.pending_forces * m
    computed, kept = np.hstack([cut.asked, np.zeros((m, rest))]), np.hstack([cut.kept, np.zeros((k, rest))])
    acting = [np.eye(m, size, n + (how.pending_forces - late) * m) if late else computed for _, late in intervals]
    now = [np.zeros_like(force) if late else force for _, late in intervals]
    parts = tuple(
        HoldSegment(steps, cut.inputs(acts, kept, acting[-1]), cut.inputs(at_once, rate, now[-1]))
        for (steps, _), acts, at_once in zip(intervals, acting, now, strict=True)
    )
    transition, added = np.zeros((size, size)), np.zeros((size, m + k))
    transition[:n] = np.eye(n, size)
    for part in parts:
        over = exponential if exponential is linalg.expm else partial(_step_by_step, exponential, part.steps)
        Phi, Gamma = held_inputs(cut.model.A, part.steps * timestep, over, cut.model.B)
        transition[:n] = Phi @ transition[:n] + Gamma @ part.inputs
        added[:n] = Phi @ added[:n] + Gamma @ part.feedthrough
    if rest:
        transition[n : size - m, n + m :] = np.eye(rest - m)
        transition[size - m :, :n] = cut.asked
        added[size - m :] = force
    return SampledClosedLoop(cut, transition, added, parts)
