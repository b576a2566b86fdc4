"""A discrete plant as a continuous one with the same norms: Tustin's map s = (2 / dt) (z - 1) / (z + 1).

It takes the unit circle to the imaginary axis and its inside to the left half plane. So a loop is stable, and its norm is some
gamma, where that of the mapped plant is; and the X of the bounded-real LMI (20) is that of the discrete one, but for a factor dt.
What is measured then contains what is done and what disturbs, y = C_y x + Dyw w + Dyu u: the gain is the same gain, of a loop
that is solved for at once.

A pole at z = -1 has no place on the imaginary axis. Where the plant has one, a gain that moves it is closed first, and what is
mapped is the plant under that gain: every gain K of the plant is K - K0 of the other.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError
from synth.plant import GeneralizedPlant

LOST = 1e-6  # relative; how near to singular A + I, balanced, may be: as many digits are lost at most
MOVES = 20  # gains that are tried where A has a pole next to -1
SEED = 20261122


@dataclass(frozen=True, eq=False)
class Mapped:
    """A continuous plant for a discrete one.

    Attributes:
        plant: n states, m inputs, r disturbances.
        Cy: shape (q, n).
        Dyw: shape (q, r).
        Dyu: shape (q, m), of y = C_y x + Dyw w + Dyu u.
        before: K0, shape (m, q): the gain K of the discrete plant is K - K0 here.
    """

    plant: GeneralizedPlant
    Cy: Array
    Dyw: Array
    Dyu: Array
    before: Array


def mapped(plant: GeneralizedPlant, Cy: Array, Dyw: Array | None = None) -> Mapped:
    """The continuous plant for a discrete one and what it measures; a continuous one is its own.

    Args:
        plant: n states, m inputs, r disturbances.
        Cy: shape (q, n).
        Dyw: shape (q, r); zero where it is not given.

    Raises:
        InputError: the plant has a pole at z = -1, and no gain from what is measured moves it.
    """
    m, r = plant.B.shape[1], plant.Bw.shape[1]
    noise = np.zeros((len(Cy), r)) if Dyw is None else Dyw
    if plant.dt is None:
        return Mapped(plant, Cy, noise, np.zeros((len(Cy), m)), np.zeros((m, len(Cy))))
    K0 = _away_from_minus_one(plant, Cy)
    loop = plant.closed_loop(K0 @ Cy)
    through = K0 @ noise
    inputs = np.hstack([plant.Bw + plant.B @ through, plant.B])
    direct = np.block([[plant.Dw + plant.D @ through, plant.D], [noise, np.zeros((len(Cy), m))]])
    A, B, C, D = _tustin((loop.A - np.eye(len(loop.A))) / plant.dt, inputs / plant.dt, np.vstack([loop.C, Cy]), direct, plant.dt)
    d = len(plant.C)
    continuous = GeneralizedPlant(A, B[:, r:], B[:, :r], C[:d], D[:d, r:], D[:d, :r])
    return Mapped(continuous, C[d:], D[d:, :r], D[d:, r:], K0)


def continuous_loop(loop: GeneralizedPlant, turned: bool = False) -> GeneralizedPlant:
    """The continuous loop, from w to z, for a discrete one without a pole at z = -1; a continuous one is its own.

    Args:
        loop: continuous or discrete.
        turned: whether a discrete one is turned by half a circle first, z for -z: then z = -1 is mapped to 0, not to infinity. It
            has the same norm, and the same X.
    """
    if loop.dt is None:
        return loop
    return from_differences((replace(loop, A=-loop.A, Bw=-loop.Bw) if turned else loop).differences, loop.dt)


def from_differences(loop: GeneralizedPlant, step: float) -> GeneralizedPlant:
    """The same for a loop in differences (`GeneralizedPlant.differences`) over a step [s].

    X of (20) is the same in both. A loop of step 0 is its own.
    """
    if not step:
        return loop
    A, Bw, C, Dw = _tustin(loop.A, loop.Bw, loop.C, loop.Dw, step)
    return GeneralizedPlant(A, np.zeros((len(A), 0)), Bw, C, np.zeros((len(C), 0)), Dw)


def true_frequency(omega: float, dt: float | None) -> float:
    """The frequency [rad/s] at which a discrete plant does what the mapped one does at `omega`, infinity included."""
    return omega if dt is None else float(2 / dt * np.arctan(omega * dt / 2))


def mapped_frequency(omega: float, dt: float | None) -> float:
    """The way back: where the mapped plant does what the discrete one does at `omega` [rad/s]."""
    if dt is None:
        return omega
    return float(2 / dt * np.tan(omega * dt / 2)) if omega * dt < np.pi else np.inf


def _tustin(A: Array, B: Array, C: Array, D: Array, step: float) -> tuple[Array, Array, Array, Array]:
    """The map of what stands in differences over a step."""
    beside = np.linalg.inv(2 * np.eye(len(A)) + step * A)
    inputs = beside @ B
    return 2 * A @ beside, 2 * inputs, 2 * C @ beside, D - step * C @ inputs


def _away_from_minus_one(plant: GeneralizedPlant, Cy: Array) -> Array:
    """K0 after which no pole lies next to z = -1, shape (m, q); zero where none does.

    In other units of states, inputs or measurements it is the same, but for a pole at the very distance LOST, where the powers of
    two decide that balancing leaves; in coordinates that mix the states it need not be.
    """

    def lost(K: Array) -> float:
        balanced = linalg.matrix_balance(plant.A + plant.B @ K @ Cy, permute=False)[0] if len(plant.A) else plant.A
        sizes = np.linalg.svd(balanced + np.eye(len(plant.A)), compute_uv=False)
        return float(sizes[-1] / max(1.0, sizes[0])) if len(sizes) else 1.0

    nothing = np.zeros((plant.B.shape[1], len(Cy)))
    if lost(nothing) > LOST:
        return nothing
    generator = np.random.default_rng(SEED)
    scale = 0.5 / _reach(plant, Cy).T
    best = max((scale * generator.standard_normal(nothing.shape) for _ in range(MOVES)), key=lost)
    if lost(best) <= LOST:
        raise InputError(
            "the plant has a pole at z = -1 that no gain from what is measured moves; take it out of the model, or add an "
            "actuator that acts on it or a measurement that it shows in"
        )
    return best


def _reach(plant: GeneralizedPlant, Cy: Array) -> Array:
    """The size in which an input first shows in a measurement, all signs alike, shape (q, m); 1 where it never does.

    It is |C_y| |A|^k |B|, entry by entry, of the first k where that is not 0: no unit of a state is in it.
    """
    spread, reach = np.abs(plant.B), np.zeros((len(Cy), plant.B.shape[1]))
    for _ in range(len(plant.A)):
        reach = np.where(reach > 0, reach, np.abs(Cy) @ spread)
        spread = np.abs(plant.A) @ spread
    return np.where(reach > 0, reach, 1.0)
