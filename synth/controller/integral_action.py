"""Integral action: converts a law whose states include integrals of its measurements to a law that measures these integrals,
and back.

If z contains a weighted integral, the integral must return to zero; otherwise z has no finite norm. A law designed for a z with
a weighted integral therefore feeds this integral back. The first states of the law are integrals of its measurements, x_c' = S
y. The integrals that are states of the law are also states of the plant. If a loop contained both copies of an integral, the
difference of the copies would never decay. The loop therefore contains each integral only once: the law is treated as a law on
[y; integrals].

Even if the law contains no integrals, its loop can have a finite norm, if the integrated signal is zero at 0 rad/s for every
road. Let the loop be x' = A x + B w, and let c x + d w be the integrated signal. If c A^-1 B = d, the integral is c A^-1 x,
because the derivative of c A^-1 x is c x + c A^-1 B w. The condition c A^-1 B = d means that the transfer function from w to
the integrated signal, d - c A^-1 B at 0 rad/s, is zero there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from models.laws.linear import LinearLaw
from synth.analysis.stability import MARGINAL, beside_weights, is_stable
from synth.controller.controller import Controller
from synth.controller.problem import ClosedLoop, Problem
from synth.plant.generalized import Feedback, Plant
from synth.plant.numerics import INTEGRATOR_POLE

RETURNS = 1e-9  # a transfer function counts as zero at 0 rad/s if its value is below this multiple of the terms that form it
IDLE_INTEGRAL = (
    "the integral of this law leaves a pole at 0 in the loop, so there is no finite norm: no constant force changes the "
    "integrated signal permanently, or no force uses the integral"
)


def with_integrators(law: LinearLaw, integrated: Array) -> LinearLaw:
    """Converts a law on [y; integrals of S y] to a law on the measurements y. The integrals become the first states of the
    converted law.

    Args:
        law: law on the q measurements and j integrals.
        integrated: matrix S, shape (j, q).
    """
    (j, q), k = integrated.shape, law.states
    A = np.block([[np.zeros((j, j + k))], [law.B[:, q:], law.A]])
    B = np.vstack([integrated, law.B[:, :q]])
    return LinearLaw(A, B, np.hstack([law.D[:, q:], law.C]), law.D[:, :q], law.sample_period, law.anti_windup)


def integrators_of(law: LinearLaw, integrated: Array | None) -> dict[int, tuple[int, float]]:
    """Finds the states of a continuous law that are integrals of its measurements.

    Args:
        law: law on the measurements.
        integrated: matrix S, shape (j, q); None if there are no integrals.

    Returns:
        For each row of S whose integral the law contains: the index of the state that is this integral, and the ratio of state
            to integral.
    """
    states: dict[int, tuple[int, float]] = {}
    for row, factors in enumerate(() if integrated is None else integrated):
        at = int(np.flatnonzero(factors)[0])
        for i in np.flatnonzero(~np.any(law.A, axis=1) & (law.B[:, at] != 0)).tolist():
            ratio = float(law.B[i, at] / factors[at])
            if np.array_equal(law.B[i], ratio * factors) and i not in [state for state, _ in states.values()]:
                states[row] = i, ratio
                break
    return states


def on_integrals(law: LinearLaw, integrated: Array | None, kept: Mapping[int, tuple[int, float]]) -> LinearLaw:
    """Converts a law on the measurements y to a law on [y; integrals of S y]. States that are integrals of S y are removed.

    Args:
        law: law on the measurements.
        integrated: matrix S, shape (j, q); None if there are no integrals.
        kept: result of `integrators_of`. If the law does not contain an integral, the gain on this integral is zero.
    """
    if integrated is None:
        return law
    own = [i for i in range(law.states) if i not in [state for state, _ in kept.values()]]
    (m, q), j = law.D.shape, len(integrated)
    B, D = np.zeros((len(own), q + j)), np.zeros((m, q + j))
    B[:, :q], D[:, :q] = law.B[own], law.D
    for row, (i, ratio) in kept.items():
        B[:, q + row], D[:, q + row] = law.A[own, i] * ratio, law.C[:, i] * ratio
    return LinearLaw(law.A[np.ix_(own, own)], B, law.C[:, own], D, anti_windup=law.anti_windup)


def settled_integrals(loop: Plant, plant: Plant, lacking: Sequence[int]) -> Array | None:
    """Returns the coefficients of integrals as combinations of the other states of a loop, shape (len(lacking), n -
    len(lacking)).

    The result is None if one of these integrals does not return to zero. An integral does not return to zero if the rest of the
    loop does not decay, or if w acts on the integrated signal at 0 rad/s.

    Args:
        loop: closed loop with n states, in which the integrals affect only z.
        plant: plant without the states of the law; its states are the first states of the loop.
        lacking: indices of the loop's states that are integrals, but that the law does not contain.
    """
    stay = np.setdiff1d(np.arange(len(loop.A)), lacking)
    A, c, d = loop.A[stay][:, stay], loop.A[lacking][:, stay], loop.Bw[lacking]
    others = beside_weights(plant, loop.A)  # the states of weighting filters are among the last states, after the integrals
    if not is_stable(np.delete(np.delete(others, lacking, axis=0), lacking, axis=1)):
        return None
    rows = np.linalg.solve(A.T, c.T).T
    left, size = np.abs(d - rows @ loop.Bw[stay]), np.abs(d) + np.abs(rows) @ np.abs(loop.Bw[stay])
    return rows if np.all(left <= RETURNS * size) else None


def loop_with_integrals(problem: Problem, law: LinearLaw) -> ClosedLoop:
    """Returns the closed loop of a law in continuous time for a control problem whose z contains integrals.

    Integrals that the law lacks are left out of the loop if they return to zero without the law.

    Raises:
        InputError: the algebraic loop has no solution.
    """
    kept = integrators_of(law, problem.integrated)
    mine = on_integrals(law, problem.integrated, kept)
    larger, G = problem.plant.with_law(mine)
    lacking = [i for i in problem.integrals if not any(problem.measured_integrals[row] == i for row in kept)]
    rows = settled_integrals(larger.closed_loop(G), problem.plant, lacking) if lacking else None
    if rows is None:
        return ClosedLoop(larger, G, problem.plant, problem.states, mine.states)
    stay = np.setdiff1d(np.arange(len(larger.A)), lacking)
    own = np.setdiff1d(np.arange(len(problem.plant.A)), lacking)
    C = larger.C[:, stay] + larger.C[:, lacking] @ rows
    short = replace(larger, A=larger.A[np.ix_(stay, stay)], B=larger.B[stay], Bw=larger.Bw[stay], C=C)
    p = problem.plant.unmeasured
    base = replace(p, A=p.A[np.ix_(own, own)], B=p.B[own], Bw=p.Bw[own], C=p.C[:, own])
    return ClosedLoop(short, Feedback(G.K, G.Cy[:, stay]), base, tuple(problem.states[i] for i in own), mine.states)


def notes_on_integral(controller: Controller) -> list[str]:
    """Returns a note if an integral of the law leaves a pole at 0 in the loop."""
    law, where = controller.law, controller.certificate.stability
    at_rest = 0.0 if law.sample_period is None else 1.0
    held = np.any(np.abs(np.linalg.eigvals(law.A) - at_rest) <= INTEGRATOR_POLE * (1 + np.abs(law.A).max(initial=0.0)))
    idle = held and where.verdict == MARGINAL and np.any(where.rates[where.on_axis] <= INTEGRATOR_POLE * (1 + where.rates.max()))
    return [IDLE_INTEGRAL] if idle else []
