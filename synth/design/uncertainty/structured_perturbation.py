"""Nearly worst perturbation of a loop with structured errors, found by power iteration at one frequency, and verified.

At one frequency, the structured singular value is the largest spectral radius of Q M over all unitary Q with the structure of
the errors (Doyle 1982). The power iteration of Packard, Fan and Doyle (1988, A power method for the structured singular value,
CDC) searches for the Q with the largest spectral radius. Any unitary Q with the structure of the errors gives a lower bound on
the structured singular value. At one frequency, a stable first-order all-pass can have the required phase of an error, so
linear systems of equal norm realise the errors. The loop with the all-pass errors is then checked: it is either unstable, or
its norm gives the lower bound.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.laws.linear import LinearLaw
from synth.analysis.norm import hinf_norm
from synth.analysis.stability import is_stable
from synth.design.uncertainty.structured_loop import StructuredLoop
from synth.plant.augmented import append, closed_by
from synth.plant.generalized import Plant
from synth.plant.state_space import StateSpace

# a norm counts as equal to the inverse of the size of the errors if their relative difference is smaller than this
EQUALITY_TOLERANCE = 1e-9
STARTS, ITERATIONS = 12, 80
# frequencies used instead of 0 and infinity, where an error has no phase, as multiples of the slowest and fastest pole
SLOW, FAST = 1e-4, 1e4
BEYOND = (
    0.0,
    1e-9,
    1e-7,
    1e-5,
    1e-3,
)  # relative amounts by which the gain errors are enlarged, because rounding may keep a pole off the imaginary axis


@dataclass(frozen=True, eq=False)
class WorstErrors:
    """Errors that give a lower bound on the structured singular value.

    Attributes:
        mu: lower bound on the structured singular value.
        frequency: frequency at which the structured singular value is at least `mu` [rad/s].
        errors: stable errors Delta, each with a norm of at most 1 / mu.
    """

    mu: float
    frequency: float
    errors: tuple[StateSpace, ...]


def worst_errors(structured: StructuredLoop, omega: float) -> WorstErrors:
    """Returns the worst errors that are found at a frequency and verified on the loop; `mu` is 0 if no such errors are found.

    Args:
        structured: loop that is stable without errors.
        omega: frequency, for example the peak frequency of an upper bound [rad/s].
    """
    size = np.abs(np.linalg.eigvals(structured.loop.A))
    omega = float(np.clip(omega, SLOW * size.min(initial=1.0), FAST * size.max(initial=1.0)))
    value, deltas = lower_bound(structured.at(np.array([omega]))[0], structured.errors)
    if not value:
        return WorstErrors(0.0, omega, ())
    amount, reached, errors = 1 / value, 0.0, ()
    for beyond in BEYOND:
        amount = (1 + beyond) / value
        errors = tuple(_all_pass(amount, float(angle), omega) for angle in np.angle(deltas))
        reached = _norm(closed_by_errors(structured, errors), structured)
        if reached * amount >= 1 - EQUALITY_TOLERANCE:
            break
    return WorstErrors(min(1 / amount, reached), omega, errors)


def lower_bound(M: Array, errors: int) -> tuple[float, Array]:
    """Returns the largest spectral radius of Q M that is found, and the corresponding errors of modulus 1, shape (k,).

    Args:
        M: matrix, complex, shape (d + k, r + k).
        errors: number k of errors.
    """
    k = errors
    outputs = _blocks(M.shape[0], k)
    inputs = _blocks(M.shape[1], k)
    random = np.random.default_rng(0)
    b = random.standard_normal((STARTS, M.shape[1], 2)) @ np.array([1, 1j])
    b[0] = np.linalg.svd(M)[2][0].conj()
    w = b / np.linalg.norm(b, axis=1, keepdims=True)
    b, tiny = w.copy(), np.finfo(float).tiny
    best: tuple[float, Array] = (0.0, np.ones(k, dtype=complex))
    for i in range(ITERATIONS):
        a = b @ M.T
        a /= np.linalg.norm(a, axis=1, keepdims=True) + tiny
        z = a.copy()
        for out, into in zip(outputs, inputs, strict=True):
            z[:, out] *= (_size(w[:, into]) + tiny) / (_size(a[:, out]) + tiny)
        w = z @ M.conj()
        w /= np.linalg.norm(w, axis=1, keepdims=True) + tiny
        b = w.copy()
        for out, into in zip(outputs, inputs, strict=True):
            b[:, into] *= (_size(a[:, out]) + tiny) / (_size(w[:, into]) + tiny)
        if i % 10 == 9:
            best = max(
                [best, *(_radius(M, k, outputs, inputs, one, other) for one, other in zip(a, b, strict=True))], key=lambda x: x[0]
            )
    return best


def closed_by_errors(structured: StructuredLoop, errors: Sequence[StateSpace]) -> Plant | None:
    """Returns the closed loop with the given errors; None if the loop is not well-posed.

    The loop is from w to z or, if there is no performance block, from p to q.
    """
    M, k, E = structured.loop, structured.errors, append(*errors)
    rows, q = slice(None, -k) if structured.performance else slice(None), M.Dw[-k:]
    if np.linalg.cond(np.eye(k) - E.D @ q[:, -k:]) > 1e12:
        return None
    # The errors act like a control law from the last outputs to the last inputs.
    plant = Plant(M.A, M.Bw[:, -k:], M.Bw[:, rows], M.C[rows], M.Dw[rows, -k:], M.Dw[rows, rows])
    plant = replace(plant, Cy=M.C[-k:], Dyu=q[:, -k:], Dyw=q[:, rows])
    return closed_by(plant, LinearLaw(E.A, E.B, E.C, E.D))


def _norm(closed: Plant | None, structured: StructuredLoop) -> float:
    """Returns the norm of a loop; infinite if the loop is not stable, and 0 if no loop or no performance block exists."""
    if closed is None:
        return 0.0
    if not is_stable(closed.A):
        return np.inf
    return hinf_norm(closed).value if structured.performance else 0.0


def _blocks(size: int, k: int) -> list[slice]:
    """Returns the performance block, if there is one, and the blocks of the errors, as slices."""
    return [*([slice(0, size - k)] if size > k else []), *(slice(size - k + i, size - k + i + 1) for i in range(k))]


def _size(part: Array) -> Array:
    return np.linalg.norm(part, axis=1, keepdims=True)


def _radius(M: Array, errors: int, outputs: list[slice], inputs: list[slice], a: Array, b: Array) -> tuple[float, Array]:
    """Returns the spectral radius of Q M for the Q that maps a to b, and the errors in this Q.

    The phase of the errors is rotated so that the spectral radius is itself an eigenvalue of Q M.
    """
    Q = np.zeros((M.shape[1], M.shape[0]), dtype=complex)
    for out, into in zip(outputs, inputs, strict=True):
        from_, to = a[out], b[into]
        sizes = np.linalg.norm(from_) * np.linalg.norm(to)
        Q[into, out] = np.outer(to, from_.conj()) / sizes if sizes > 0 else np.eye(len(to), len(from_))
    values = linalg.eigvals(Q @ M)
    largest = values[np.abs(values).argmax()]
    turn = np.conj(largest) / abs(largest) if largest else 1.0
    firsts = [Q[into, out][0, 0] * turn for out, into in zip(outputs, inputs, strict=True)]
    return float(abs(largest)), np.array(firsts[-errors:])


def _all_pass(amount: float, angle: float, omega: float) -> StateSpace:
    """Returns an error as a stable all-pass with constant gain that has a given phase [rad] at a frequency."""
    sign = 1.0 if angle >= 0 else -1.0
    # phase of (s - c) / (s + c), which falls from pi at 0 rad/s to 0 at infinity
    phase = angle if angle >= 0 else angle + np.pi
    if min(phase, np.pi - phase) < 1e-12:
        constant = sign * (1.0 if phase < np.pi / 2 else -1.0)
        return StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[amount * constant]]))
    c = omega * np.tan(phase / 2)
    return StateSpace(np.array([[-c]]), np.array([[c]]), np.array([[-2 * sign * amount]]), np.array([[sign * amount]]))
