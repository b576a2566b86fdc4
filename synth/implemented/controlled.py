"""A vehicle with its actuators and whatever its controller keeps, before any loop is closed.

A law with states is a static gain on a larger vehicle: its states are integrators, x_c' = v, driven by inputs v of their own.
Then every formula of a loop that is closed by a gain holds for any law. Continuous, v = A_c x_c + B_c y. Sampled every T seconds,
v = ((A_d - I) x_c + B_d y) / T is held meanwhile, which takes x_c to A_d x_c + B_d y exactly.

A measured acceleration has the force in it. Continuous, that loop is solved. Sampled, the reading is taken before the new force
acts: y = C x + D u, with the u that has acted until then, which is kept as a state too.
"""

from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.law import LinearLaw
from models.linear_model import LinearModel
from models.signals import KEPT
from models.vehicle import Vehicle
from synth.controller import Controller


@dataclass(frozen=True, eq=False)
class Controlled:
    """A vehicle, its actuators and its controller's states, and what is asked of its inputs.

    Attributes:
        model: its n states are the vehicle's, the lagged forces, the law's, and the forces that have acted; its inputs the m
            forces asked for, and k rates of what is kept.
        G: from its states to all those inputs, shape (m + k, n).
        hold: what the forces that act add to the rates, shape (k, m).
        reading: what a disturbance of each measurement adds to all the inputs, shape (m + k, q).
        forces: m.
    """

    model: LinearModel
    G: Array
    hold: Array
    reading: Array
    forces: int

    @property
    def law_states(self) -> slice:
        """Where the law's states are among those of the model."""
        named = [i for i, name in enumerate(self.model.states) if name.startswith(KEPT)]
        return slice(named[0], named[-1] + 1) if named else slice(0)

    @property
    def asked(self) -> Array:
        """From the states to the forces asked for, shape (m, n)."""
        return self.G[: self.forces]

    @property
    def kept(self) -> Array:
        """From the states to the rates of what is kept, but for what the forces that act add, shape (k, n)."""
        return self.G[self.forces :]

    def inputs(self, acting: Array, kept: Array | None = None, last: Array | None = None) -> Array:
        """All inputs, from the forces that act: both per the same, shape (..., m, c) to (..., m + k, c).

        Args:
            acting: the forces, shape (..., m, c).
            kept: the rates, but for what those add, shape (..., k, c); those of the states where none are given.
            last: the forces that act at the period's end, where those are others: they are what has acted then.
        """
        kept = self.kept if kept is None else kept
        if not len(self.hold):
            return acting
        rates = kept + self.hold @ (acting if last is None else last)
        return np.concatenate([acting, rates], axis=-2)


def continuous(vehicle: Vehicle, controller: Controller) -> Controlled:
    """In continuous time; a discrete law as its bilinear counterpart.

    Raises:
        InputError: what is measured has the force in it, and that loop has no solution.
    """
    model = with_lag(vehicle)
    C, D = model.rows(controller.measured)
    return _kept(model, controller.law.continuous().fed_back(D), C, np.zeros((len(C), 0)))


def sampled(vehicle: Vehicle, controller: Controller, period: float) -> Controlled:
    """Sampled every so many seconds.

    Args:
        vehicle: the vehicle.
        controller: its controller.
        period: [s].
    """
    model = with_lag(vehicle)
    C, D = model.rows(controller.measured)
    law = controller.law.sampled(period)
    try:
        rates = LinearLaw((law.A - np.eye(law.states)) / period, law.B / period, law.C, law.D)
    except InputError as error:
        raise InputError(
            f"controller {controller.name!r} changes its states too fast to be run every {period:g} s: of their rates, "
            f"(A - I) / T and B / T, {error}; scale its states, so that B is smaller and C larger"
        ) from error
    return _kept(model, rates, C, D if np.any(D) else np.zeros((len(C), 0)), 1 / period)


def _kept(model: LinearModel, law: LinearLaw, C: Array, D: Array, rate: float = 0.0) -> Controlled:
    """With the states of a law, and the forces that have acted, where a measurement has them in it.

    Args:
        model: n states, m forces.
        law: continuous, k states.
        C: of the measurements, shape (q, n).
        D: what the forces that have acted do in them, shape (q, m), or (q, 0) for nothing.
        rate: at which a force that acts becomes one that has acted [1/s].
    """
    (n, m), k, held = model.B.shape, law.states, D.shape[1]
    more = k + held
    if not more:
        return Controlled(model, law.D @ C, np.zeros((0, m)), law.D, m)
    readings = np.hstack([C, np.zeros((len(C), k)), D])
    G = np.vstack(
        [
            law.D @ readings + np.hstack([np.zeros((m, n)), law.C, np.zeros((m, held))]),
            law.B @ readings + np.hstack([np.zeros((k, n)), law.A, np.zeros((k, held))]),
            np.hstack([np.zeros((held, n + k)), -rate * np.eye(held)]),
        ]
    )
    hold = np.vstack([np.zeros((k, m)), rate * np.eye(held, m)])
    reading = np.vstack([law.D, law.B, np.zeros((held, len(C)))])
    names = [f"{KEPT}{i}" for i in range(1, k + 1)] + [f"acted_{name}" for name in model.inputs[:held]]
    larger = replace(
        model,
        A=np.block([[model.A, np.zeros((n, more))], [np.zeros((more, n + more))]]),
        B=np.block([[model.B, np.zeros((n, more))], [np.zeros((more, m)), np.eye(more)]]),
        Bw=np.vstack([model.Bw, np.zeros((more, model.Bw.shape[1]))]),
        Br=np.vstack([model.Br, np.zeros((more, model.Br.shape[1]))]),
        Bl=np.vstack([model.Bl, np.zeros((more, len(model.loads)))]),
        C=np.hstack([model.C, np.zeros((len(model.C), more))]),
        D=np.hstack([model.D, np.zeros((len(model.D), more))]),
        states=(*model.states, *names),
        inputs=(*model.inputs, *(f"rate_of_{name}" for name in names)),
    )
    return Controlled(larger, G, hold, reading, m)


def with_lag(vehicle: Vehicle) -> LinearModel:
    """The linear model with its actuators' lag, if they have one: the forces that act are its last states then."""
    return vehicle.linear_model.behind_lag(vehicle.limits.actuator_bandwidth)
