"""The one door through which a vehicle's named signals come in: from a vehicle and a controller's name to a certified gain."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.linear_model import LinearModel
from models.vehicle import Vehicle
from synth.certificate.certificate import Certificate
from synth.plant import GeneralizedPlant


@dataclass(frozen=True, eq=False)
class Controller:
    """A static controller u = K y with what is known of it.

    Attributes:
        name: as asked for.
        measured: the signals y, q of them. Empty for `passive`.
        gain: K, shape (m, q) [N per measured unit].
        designed: whether it was designed here; otherwise the gain was given (or is zero, for `passive`).
        state_step_gap: how far from the optimum of (22), relative in gamma, the X was taken that L (14) comes from: 0 at the
            limit of the central path, more where the second problem is infeasible from there.
        optimum_gap: how far from the optimum of its own problem, relative in gamma, the gain was taken: 0 at the limit, more
            where the optimum is reached only by gains beyond any actuator.
        moved: how far the gain still moved from the point of its path before, relative to its largest entry; a hundredth of it is
            about what is left to the limit.
        redundant: the signals among `measured` that follow from the others; their gain is zero.
        certificate: what is true of it.
        case: what is the case where (22) has no optimum, or every gain is one, in words; else empty.
        instead: how else the gain was found, and why the two steps did not lead to one, in words; empty where they did.
        false_claims: what of the certificate that came with its gain does not hold, in words.
    """

    name: str
    measured: tuple[str, ...]
    gain: Array
    designed: bool
    certificate: Certificate
    state_step_gap: float = 0.0
    optimum_gap: float = 0.0
    moved: float = 0.0
    redundant: tuple[str, ...] = ()
    case: str = ""
    instead: str = ""
    false_claims: tuple[str, ...] = ()

    def state_gain(self, vehicle: Vehicle) -> Array:
        """G = K C_y (6) for a vehicle that has these signals, shape (m, n)."""
        Cy, _ = vehicle.linear_model.rows(self.measured)
        return self.gain @ Cy


def generalized_plant(vehicle: Vehicle) -> GeneralizedPlant:
    """The plant (15) of a vehicle: its linear model, and the weighted signals of `[performance]` as z (34)-(37)."""
    model = vehicle.linear_model
    weighted = [signal for signal, weight in vehicle.performance.items() if weight > 0]
    C, D = model.rows(weighted)
    weights = np.array([vehicle.performance[signal] for signal in weighted])[:, None]
    Br, Cr = _twist(model, weighted)
    return GeneralizedPlant(
        A=model.A,
        B=model.B,
        Bw=np.hstack([model.Bw, Br]),
        C=weights * C,
        D=weights * D,
        Dw=np.hstack([np.zeros((len(C), model.Bw.shape[1])), weights * Cr]),
    )


def _twist(model: LinearModel, signals: Sequence[str]) -> tuple[Array, Array]:
    """What the road's heights do where they act as such, as disturbances of their own, shapes (n, k) and (len(signals), k).

    From the road's velocity a lasting twist is an integral, which no controller bounds. As a disturbance beside the velocities it
    is bounded, and counts at the rate of wheel hop (`LinearModel.twist_rate`): a bound that holds for both together.
    """
    Cr = model.Cr[[model.outputs.index(signal) for signal in signals]]
    _, sizes, directions = np.linalg.svd(np.vstack([model.Br, model.Cr]))
    directions = directions[: int(np.sum(sizes > 1e-12 * sizes.max(initial=0.0)))] if np.any(sizes) else directions[:0]
    return model.Br @ directions.T / model.twist_rate, Cr @ directions.T / model.twist_rate
