"""Modes that make stabilisation impossible, and other proofs that no controller of a type stabilises a plant.

A controller can stabilise a plant only if every mode that does not decay is controllable and observable.
"""

import contextlib
from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.printed import rough
from synth.analysis.stability import balance, pole_text, stability
from synth.plant.generalized import Plant
from synth.plant.numerics import InfeasibleError
from synth.plant.units import own_units

ZERO = 1e-12  # a sum counts as zero if it is smaller than this multiple of the sum of the magnitudes of its terms
UNCONTROLLABLE = 1e-8  # an input whose relative effect on a mode is smaller than this does not control the mode


def uncontrollable_modes(A: Array, B: Array, dt: float | None) -> list[tuple[complex, Array]]:
    """Returns the uncontrollable modes that do not decay; each conjugate pair is listed once.

    Args:
        A: state matrix, shape (n, n).
        B: input matrix, shape (n, m).
        dt: sample period of a discrete plant [s], None for a continuous plant. For a discrete plant, A and B describe its
            differences (`Plant.differences`), and the eigenvalues are poles z.

    Returns:
        Pairs of an eigenvalue [rad/s] (discrete: z) and a left eigenvector, one pair for each mode.
    """
    balanced, scale = balance(A)
    inputs = B / scale[:, None]
    size = np.linalg.norm(inputs, axis=0)
    inputs = inputs[:, size > 0] / size[size > 0]
    modes: list[tuple[complex, Array]] = []
    where = stability(A if dt is None else np.eye(len(A)) + dt * A, dt)
    for given in where.poles[(where.growth >= 0) | where.on_axis]:
        if given.imag < 0:
            continue
        pole = given if dt is None else (given - 1) / dt
        pencil = np.hstack([balanced - pole * np.eye(len(A)), inputs * (np.linalg.norm(balanced, 2) or 1.0)])
        left, sizes, _ = np.linalg.svd(pencil)
        known = any(abs(given - other) <= 1e-6 * max(abs(given), 1e-300) for other, _ in modes)
        if sizes[-1] <= UNCONTROLLABLE * sizes[0] and not known:
            modes.append((complex(given), left[:, -1].conj() / scale))
    return modes


def stabilisability_failures(plant: Plant, states: Sequence[str] = ()) -> list[str]:
    """Explains why no controller can stabilise the plant, as a list of reasons. The returned list is empty if no single mode
    prevents stabilisation.

    Args:
        plant: plant to check. If the plant has no measurements, every state counts as measured.
        states: names of the states. Default: x1, x2, ...
    """
    names, dt = list(states) or [f"x{i + 1}" for i in range(len(plant.A))], plant.dt
    plant = own_units(plant, measured=True).into(plant.differences)
    reasons = [
        f"the plant cannot be stabilised: no input acts on the mode at {pole_text(pole, dt)}, which does not decay and appears "
        f"most in {largest(vector, names)}; add an actuator that acts on this mode, or remove the mode from the model"
        for pole, vector in uncontrollable_modes(plant.A, plant.B, dt)
    ]
    if len(plant.Cy):
        reasons += [
            f"the plant cannot be stabilised with these measurements: none of them contains the mode at {pole_text(pole, dt)}, "
            f"which does not decay and appears most in {largest(vector, names)}; measure a signal that contains this mode"
            for pole, vector in uncontrollable_modes(plant.A.T, plant.Cy.T, dt)
        ]
    return reasons


def check_stabilisable(plant: Plant, states: Sequence[str] = ()) -> None:
    """Raises an InfeasibleError if no static gain can stabilise the plant and a simple proof exists.

    The proof is based on a single mode, or on the sum or the product of the poles.
    """
    reasons = list[str]()
    with contextlib.suppress(InputError):  # an entry of the matrix is too large in its units, so this check proves nothing
        reasons = stabilisability_failures(plant, states) or static_feedback_obstructions(plant)
    if reasons:
        raise InfeasibleError("; ".join(reasons))


def static_feedback_obstructions(plant: Plant) -> list[str]:
    """Explains why no static output feedback stabilises the plant, as a list of reasons. The returned list is empty if no
    reason is found.

    The plant must be stabilisable and detectable. A gain K changes the sum of the poles by tr(K C_y B), and multiplies the
    product of the poles by det(I - K C_y (-A)^-1 B). For a discrete plant, both relations hold for the poles of
    `Plant.differences`, in which the pole z = 1 becomes 0. The sum of the poles does not include decaying poles that no gain
    can change, such as the poles of a weighting filter.
    """
    where, Cy = stability(plant.A, plant.dt), plant.Cy
    if where.stable:
        return []
    A, B = plant.differences.A, plant.differences.B
    diagonal, mode = np.diagonal(A), pole_text(where.worst, plant.dt)
    fixed = _fixed_poles(A, B, Cy) if np.all(np.abs(Cy @ B) <= ZERO * (np.abs(Cy) @ np.abs(B))) else None
    if fixed is not None and (total := diagonal.sum() - sum(fixed)) >= -ZERO * np.abs(diagonal).sum():
        count, some = len(A) - len(fixed), "the poles that a gain moves" if fixed else "all poles"
        stays = f"{rough(total)} 1/s" if plant.dt is None else f"{rough(count + plant.dt * total)} (of {count} poles)"
        return [
            f"no static gain on these measurements stabilises the plant, whose mode at {mode} does not decay: no force acts "
            f"directly on the rate of a measured signal (C_y B = 0), so the sum of {some} stays {stays}; measure a velocity"
        ]
    if np.linalg.cond(balance(A)[0]) * ZERO > 1:
        return []
    inverse = np.linalg.inv(A)
    inverted, above = ("A", "above zero") if plant.dt is None else ("(I - A)", "above one")
    silent = np.all(np.abs(Cy @ inverse @ B) <= ZERO * (np.abs(Cy) @ np.abs(inverse) @ np.abs(B)))
    if silent and np.linalg.slogdet(-A)[0] < 0:
        return [
            f"no static gain on these measurements stabilises the plant, whose mode at {mode} does not decay: a constant force "
            f"leaves all measurements zero (C_y {inverted}^-1 B = 0), so one pole stays real and {above}; measure a position"
        ]
    return []


def _fixed_poles(A: Array, B: Array, Cy: Array) -> list[float]:
    """Returns the real parts of those simple poles that no gain can change, because they are not controllable or not
    observable.
    """
    balanced, scale = balance(A)
    inputs, outputs, size, fixed = B / scale[:, None], Cy * scale, np.linalg.norm(balanced, 2) or 1.0, list[float]()
    inputs = inputs / np.maximum(np.linalg.norm(inputs, axis=0), np.finfo(float).tiny) * size
    outputs = outputs / np.maximum(np.linalg.norm(outputs, axis=1, keepdims=True), np.finfo(float).tiny) * size
    poles = np.linalg.eigvals(balanced)
    for i, pole in enumerate(poles):
        shifted = balanced - pole * np.eye(len(A))
        simple = np.all(np.abs(np.delete(poles, i) - pole) > 1e-6 * size)
        pencils = np.hstack([shifted, inputs]), np.vstack([shifted, outputs])
        if simple and min(np.linalg.svd(one, compute_uv=False)[-1] for one in pencils) <= UNCONTROLLABLE * size:
            fixed.append(float(pole.real))
    return fixed


def largest(vector: Array, names: Sequence[str]) -> str:
    """Returns the name of the state with the largest entry in an eigenvector."""
    return names[int(np.argmax(np.abs(vector)))]
