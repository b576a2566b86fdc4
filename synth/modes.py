"""Which mode stands in the way: the test of Popov, Belevitch and Hautus, one eigenvalue at a time.

A mode that does not decay by itself must be reached by an input and be seen in a measurement, or no controller stabilises it.
"""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from synth.certificate.stability import balance, pole_text, stability
from synth.plant import GeneralizedPlant
from synth.scaling import own_units

ZERO = 1e-12  # of what the parts of a sum come to; more than rounding leaves of zero
UNREACHED = 1e-8  # relative size of what an input does to a mode that it does not reach, up to rounding


def unreached(A: Array, B: Array, dt: float | None = None) -> list[tuple[complex, Array]]:
    """Modes that do not decay and that no input reaches: eigenvalue [rad/s] and left eigenvector, each conjugate pair once.

    Args:
        A: shape (n, n).
        B: shape (n, m).
        dt: seconds between samples of a discrete plant, whose A and B are those of its differences, and whose eigenvalues z.
    """
    balanced, scale = balance(A)
    inputs = B / scale[:, None]
    size = np.linalg.norm(inputs, axis=0)
    inputs = inputs[:, size > 0] / size[size > 0]
    found: list[tuple[complex, Array]] = []
    where = stability(A if dt is None else np.eye(len(A)) + dt * A, dt)
    for given in where.poles[(where.growth >= 0) | where.on_axis]:
        if given.imag < 0:
            continue
        pole = given if dt is None else (given - 1) / dt
        pencil = np.hstack([balanced - pole * np.eye(len(A)), inputs * (np.linalg.norm(balanced, 2) or 1.0)])
        left, sizes, _ = np.linalg.svd(pencil)
        known = any(abs(given - other) <= 1e-6 * max(abs(given), 1e-300) for other, _ in found)
        if sizes[-1] <= UNREACHED * sizes[0] and not known:
            found.append((complex(given), left[:, -1].conj() / scale))
    return found


def obstacles(plant: GeneralizedPlant, Cy: Array | None = None, states: Sequence[str] = ()) -> list[str]:
    """Why no controller stabilises the plant, in words; empty where no single mode forbids it.

    Args:
        plant: n states, m inputs.
        Cy: shape (q, n); without it every state counts as measured.
        states: names of the states; x1, x2, ... without them.
    """
    names, own, dt = list(states) or [f"x{i + 1}" for i in range(len(plant.A))], own_units(plant, Cy), plant.dt
    plant = own.into(plant.differences)
    found = [
        f"the plant cannot be stabilised: no input reaches the mode at {pole_text(pole, dt)}, which does not decay and shows "
        f"most in {largest(vector, names)}; add an actuator that acts on it, or take it out of the model"
        for pole, vector in unreached(plant.A, plant.B, dt)
    ]
    if Cy is not None:
        found += [
            f"the plant cannot be stabilised from what is measured: no measurement shows the mode at {pole_text(pole, dt)}, "
            f"which does not decay and moves most in {largest(vector, names)}; measure a signal that it is seen in"
            for pole, vector in unreached(plant.A.T, (Cy * own.states).T, dt)
        ]
    return found


def immovable(plant: GeneralizedPlant, Cy: Array) -> list[str]:
    """Why no static gain from what is measured stabilises the plant, though its modes are reached and seen; empty where unknown.

    A gain moves the sum of the poles by tr(K C_y B), and their product by det(I - K C_y (-A)^-1 B). Of a discrete plant the same
    is true of its differences, in which z = 1 is 0.

    Args:
        plant: n states, m inputs.
        Cy: shape (q, n).
    """
    where = stability(plant.A, plant.dt)
    if where.stable:
        return []
    A, B = plant.differences.A, plant.differences.B
    diagonal, mode = np.diagonal(A), pole_text(where.worst, plant.dt)
    stays = f"{diagonal.sum():.4g} 1/s" if plant.dt is None else f"{np.trace(plant.A):.4g}, and their number is {len(A)}"
    if np.all(np.abs(Cy @ B) <= ZERO * (np.abs(Cy) @ np.abs(B))) and diagonal.sum() >= -ZERO * np.abs(diagonal).sum():
        return [
            f"no gain from what is measured stabilises the plant, whose mode at {mode} does not decay: no force acts at once on "
            f"a measured signal (C_y B = 0), so the sum of all poles stays {stays}; measure one on which it does, as a velocity"
        ]
    if np.linalg.cond(balance(A)[0]) * ZERO > 1:
        return []
    inverse = np.linalg.inv(A)
    inverted, above = ("A", "above zero") if plant.dt is None else ("(I - A)", "above one")
    silent = np.all(np.abs(Cy @ inverse @ B) <= ZERO * (np.abs(Cy) @ np.abs(inverse) @ np.abs(B)))
    if silent and np.linalg.slogdet(-A)[0] < 0:
        return [
            f"no gain from what is measured stabilises the plant, whose mode at {mode} does not decay: a constant force leaves "
            f"what is measured at zero (C_y {inverted}^-1 B = 0), so one pole stays real and {above}; measure a position"
        ]
    return []


def largest(vector: Array, names: Sequence[str]) -> str:
    """The state with the largest part of an eigenvector."""
    return names[int(np.argmax(np.abs(vector)))]
