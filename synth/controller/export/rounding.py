"""Rounding of exported code at every sample, from the readings and states that it computes with.

Binary floating point. A sum of products rounds every product and, from the second on, every partial sum. Rounding moves a
number v by at most half its last digit, and that by at most u |v| with the unit roundoff u. Errors are even over the last digit
d, so that their mean square is d^2 / 12. With mantissas from 1 to 2 that are even on a logarithmic scale, d^2 is (2 u v)^2 times
the mean 3 / (8 ln 2) of 1 / mantissa^2, and the mean square is (u v)^2 / (8 ln 2). Readings are rounded to the format first.

Fixed point. A reading, a force and a next state are rounded to their units: by at most half of one, and evenly.

Coefficients are rounded once. Their error is known, and is no noise: it is that of another law.

Bounds are to first order in u; `SECOND` covers what is left.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.controller.export.c_law import NUMBERS, ExportedLaw
from synth.controller.export.fixed_point import summed_responses
from synth.controller.open_loop import LoopModel, readings_of_road, with_lag

UNIT = {"double": 2.0**-53, "float": 2.0**-24}
SHARE = 1 / (8 * math.log(2))  # mean square of a rounding error over (u v)^2
SECOND = 1.001
DOUBLINGS, STAYS = 60, 1e-15  # of a sum of covariances, and what no longer counts of it
PARTS = 8  # of a sample period, over which a road's bounded velocity is held at its worst


@dataclass(frozen=True, eq=False)
class LocalErrors:
    """Errors of one computation, at S samples, of q readings, m forces and k next states.

    Attributes:
        known: of [forces; next states] by the law's rounded coefficients, shape (S, m + k).
        square: mean square of the errors of [readings; forces; next states], shape (S, q + m + k).
        most: bound on their magnitude, shape (S, q + m + k); that of the forces and states includes `known`.
    """

    known: Array
    square: Array
    most: Array


def rounded_law(law: ExportedLaw) -> tuple[Array, Array]:
    """Returns [D, C; B, A] as given, and as the code has it, shapes (m + k, q + k)."""
    exact = np.block([[law.D, law.C], [law.B, law.A]])
    if law.fixed is not None:
        return exact, law.fixed.held
    return exact, exact.astype(NUMBERS[law.numbers]).astype(float)


def law_states(law: ExportedLaw, y: Array) -> Array:
    """Returns the states at S samples, shape (S, k), from rest, of readings, shape (S, q), that no limit clips."""
    x = np.zeros((len(y), law.states))
    driven = y @ law.B.T
    for i in range(len(y) - 1):
        x[i + 1] = law.A @ x[i] + driven[i]
    return x


def local_errors(law: ExportedLaw, y: Array) -> LocalErrors:
    """Returns the errors at S samples.

    Args:
        law: linear, without adjustable dampers.
        y: the readings, shape (S, q).
    """
    exact, held = rounded_law(law)
    values, q = np.hstack([y, law_states(law, y)]), law.readings
    known = values @ (held - exact).T
    if law.fixed is not None:
        steps = _steps(law)
        most = np.concatenate([np.zeros((len(y), q)), np.abs(known)], axis=1) + steps / 2
        return LocalErrors(known, np.broadcast_to(steps**2 / 12, most.shape), most)
    u = UNIT[law.numbers]
    square, most = np.empty((len(y), q + len(held))), np.empty((len(y), q + len(held)))
    square[:, :q], most[:, :q] = SHARE * (u * y) ** 2, u * np.abs(y)
    for i, used in _orders(law, held):
        products = values[:, used] * held[i, used]
        sums = np.cumsum(products, axis=1)[:, 1:]
        square[:, q + i] = SHARE * u**2 * (np.sum(products**2, axis=1) + np.sum(sums**2, axis=1))
        most[:, q + i] = u * (np.abs(products).sum(axis=1) + np.abs(sums).sum(axis=1)) + np.abs(known[:, i])
    flips = law.resolution  # a reading on the edge between two steps goes to either
    return LocalErrors(known, square, SECOND * most + np.r_[flips, np.zeros(len(held))])


def entering(loop: LoopModel, law: ExportedLaw) -> Array:
    """Returns the map from errors of [readings; forces; next states] to the inputs that a loop computes at a sample."""
    q, m, k = law.readings, len(law.outputs), law.states
    into = np.zeros((len(loop.open_loop.G), q + m + k))
    into[:, :q] = loop.open_loop.reading
    into[range(m + k), range(q, q + m + k)] = np.repeat([1.0, 1 / loop.period], [m, k])
    return into


@dataclass(frozen=True)
class SteadyRounding:
    """Effect of rounding on the forces of a stable loop for ever, on two kinds of road under every wheel.

    Attributes:
        rms: rms of the error over that of the force, the largest of any force, where the road's velocity is white noise.
        most: bound on the error of any force [N], where the road's velocity is at most 1 m/s.
    """

    rms: float
    most: float


def steady_rounding(loop: LoopModel, law: ExportedLaw) -> SteadyRounding | None:
    """Returns what rounding does for ever, or None if the loop is not stable.

    A reading that contains the road's velocity, by tyres that damp, contains its mean over the last period, as in
    `synth.controller.implementation_norm`. These means are states of their own behind those of the loop.

    Args:
        loop: with the sample period as its timestep.
        law: the exported law of its controller, linear and without adjustable dampers.
    """
    if loop.radius >= 1:
        return None
    cut, closed, (exact, held) = loop.open_loop, loop.closed_loop, rounded_law(law)
    q, m, size, names = law.readings, len(law.outputs), len(closed.transition), loop.controller.measured
    model = with_lag(loop.vehicle)
    C, D = model.rows(names)
    Dw, felt = model.Dw[[model.outputs.index(name) for name in names]], readings_of_road(cut, loop.controller)
    r = len(model.Bw[0]) if np.any(Dw) else 0
    Dw, felt = Dw[:, :r], felt[:, :r]
    read = np.zeros((q + law.states, size + r))  # from the loop's state and mean velocities to [readings; states of the law]
    read[:q, : C.shape[1]], read[:q, size:] = C, Dw
    read[q:, loop.open_loop.law_states] = np.eye(law.states)
    if np.any(D):
        read[:q, C.shape[1] + law.states :][:, : D.shape[1]] = D  # the previous forces
    asked = np.hstack([cut.asked, np.zeros((m, size - cut.asked.shape[1]))])
    into = entering(loop, law)
    added, direct = closed.added @ into, into[:m]
    change = held - exact
    T = np.zeros((size + r, size + r))  # from sample to sample; a mean velocity is forgotten after one
    T[:size] = np.hstack([closed.transition, closed.added @ felt])

    # White velocity: covariances of the loop, then of its error beside it.
    n = len(cut.model.A)
    A, Bw = (
        linalg.block_diag(cut.model.A, np.zeros((r, r))),
        np.vstack([cut.model.Bw, np.eye(r, len(cut.model.Bw[0])) / loop.period]),
    )
    moving = np.r_[:n, size : size + r]
    of_period = linalg.expm(loop.period * np.block([[-A, Bw @ Bw.T], [np.zeros_like(A), A.T]]))
    Q = np.zeros_like(T)
    Q[np.ix_(moving, moving)] = of_period[n + r :, n + r :].T @ of_period[: n + r, n + r :]
    P = _covariance(T, Q)
    S = read @ P @ read.T
    V = np.diag(_mean_squares(law, held, S))
    both = np.block([[T, np.zeros((size + r, size))], [added[:, q:] @ change @ read, closed.transition]])
    driven = np.zeros_like(both)
    driven[: size + r, : size + r], driven[size + r :, size + r :] = Q, added @ V @ added.T
    joint = _covariance(both, driven)
    off = np.hstack([change[:m] @ read, asked])
    errors = np.diag(off @ joint @ off.T + direct @ V @ direct.T)
    wanted = np.hstack([asked, felt[:m]])
    forces = np.diag(wanted @ P @ wanted.T)
    rms = float(np.sqrt(np.max(np.maximum(errors, 0.0) / np.where(forces > 0, forces, np.inf))))

    # Bounded velocity: peaks of what the law sees, then the sum of all responses to the largest errors.
    share = loop.period / PARTS
    pushes = np.zeros((size + r, PARTS * len(Bw[0])))
    pushes[moving] = np.hstack([linalg.expm(A * share * (i + 0.5)) @ Bw * share for i in range(PARTS)])
    peaks = summed_responses(read, T, pushes)
    most = _most(law, held, change, peaks)
    return SteadyRounding(rms, float(np.max(summed_responses(asked, closed.transition, added * most) + np.abs(direct) @ most)))


def _covariance(T: Array, Q: Array) -> Array:
    """Returns the covariance of a stable loop that noise of the covariance Q drives at every sample: P = T P T' + Q.

    The sum of T^k Q T'^k is doubled until it stays. It has no units to mix, as a system of equations for all of P has.
    """
    P, power = Q, T
    for _ in range(DOUBLINGS):
        more = power @ P @ power.T
        P, power = P + more, power @ power
        if np.all(np.abs(np.diag(more)) <= STAYS * np.diag(P)):
            break
    return P


def _steps(law: ExportedLaw) -> Array:
    """Returns the steps of [readings; forces; next states] in fixed point; 0 for a reading that has its own steps anyway."""
    assert law.fixed is not None, "it is in fixed point"
    finer = np.where(law.resolution == law.fixed.seen, 0.0, law.fixed.seen + law.resolution)
    return np.concatenate([finer, law.fixed.given, law.fixed.kept])


def _orders(law: ExportedLaw, held: Array) -> Iterator[tuple[int, Array]]:
    """Yields the columns of every row that are not 0, in the order of the code's sums."""
    q, m = law.readings, len(law.outputs)
    for i, row in enumerate(held):
        order = np.arange(q + law.states) if i < m else np.r_[q : q + law.states, :q]
        yield i, order[row[order] != 0]  # a product with 0 is exact, and so is the sum


def _mean_squares(law: ExportedLaw, held: Array, S: Array) -> Array:
    """Returns the mean squares of the errors of [readings; forces; next states], where the latter two see the covariance S."""
    if law.fixed is not None:
        return _steps(law) ** 2 / 12
    u2, q = UNIT[law.numbers] ** 2, law.readings
    square = np.concatenate([np.diag(S)[:q], np.zeros(len(held))])
    for i, used in _orders(law, held):
        one = held[i, used][:, None] * S[np.ix_(used, used)] * held[i, used]
        sums = [one[: j + 1, : j + 1].sum() for j in range(1, len(used))]
        square[q + i] = np.trace(one) + sum(sums)
    return SHARE * u2 * square


def _most(law: ExportedLaw, held: Array, change: Array, peaks: Array) -> Array:
    """Returns bounds on the same errors where readings and states have peaks, shape (q + m + k,)."""
    q = law.readings
    if law.fixed is not None:
        return _steps(law) / 2 + np.concatenate([np.zeros(q), np.abs(change) @ peaks])
    u = UNIT[law.numbers]
    most = np.concatenate([u * peaks[:q] + law.resolution, np.abs(change) @ peaks])
    for i, used in _orders(law, held):
        products = np.abs(held[i, used]) * peaks[used]
        most[q + i] += u * (products.sum() + np.cumsum(products)[1:].sum())
    return SECOND * most
