"""A common static gain for a family of plants, in the two steps of the paper with a slack variable (`lmi/sdp.py`).

1. State feedback for all of them: W of the LMIs with C_y = I.
2. L (14) with W' instead of X, so that the W of the first step has the form that the second requires; then the LMIs with W = Q
   W_Q + R W_R R' and Y = Y_R R'.

**The solver proposes, the certificate decides.** The result is proved for every plant without the solver, by an X just above that
plant's norm. The scalar f of the LMIs is the one whose gain has the smallest worst norm.

The problem is solved in units in which its numbers have size one, by the inputs, the disturbances and A of the first plant; f is
independent of the time unit. Plants may measure in different ways, as with a sensor that is 10 % off. Each is transformed to its
own coordinates, in which all measure the same; X_i needs no common ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, quoted
from synth.analysis.bounding import certify_tightly
from synth.analysis.certificate import Certificate
from synth.analysis.norm import hinf_norm
from synth.design.two_step import independent_rows, l_matrix, nullspace, r_matrix
from synth.lmi.central_path import fits
from synth.lmi.sdp import first_step, second_step, together
from synth.plant.generalized import (
    Feedback,
    Plant,
    check_continuous,
    check_inputs,
    check_posed,
    real_matrix,
)
from synth.plant.numerics import DesignError, numerics
from synth.plant.units import NormalisedSystem, own_units, reachable

MOST = 1000  # unknowns; 26 states of one plant take a minute
SOLVED_AT = 3.0  # what f is in the unit of time in which the problem is solved


@dataclass(frozen=True, eq=False)
class SlackDesign:
    """A gain for a family, with the proofs of each loop.

    Attributes:
        gain: K, shape (m, q); exactly zero where its structure is zero.
        bound: bound of the LMIs for all plants by the solver; not proved.
        f: f of the LMIs, in units of one over the rate of the first plant (`units.own_units`).
        certificates: certificates of the plants, in order.
        redundant: rows of C_y that follow from others, by index; their gain is zero.
    """

    gain: Array
    bound: float
    f: float
    certificates: tuple[Certificate, ...]
    redundant: tuple[int, ...] = ()

    @property
    def worst(self) -> float:
        """The largest norm."""
        return max(each.norm.value for each in self.certificates)

    @property
    def proved(self) -> float:
        """The bound on the norms of all plants, proved without the solver."""
        return max(each.bound or np.inf for each in self.certificates)


@numerics()
def slack_design(
    plants: Sequence[Plant],
    Cys: Sequence[Array],
    structure: Array | None = None,
    f: Sequence[float] = (0.1, 0.3, 1.0),
) -> SlackDesign:
    """The gain u = K y of the two steps with a slack variable that is best for the worst of some plants.

    Args:
        plants: plants in continuous time, alike in the number of states and inputs; one is a family, too.
        Cys: measurement matrix of each plant, shape (q, n) each.
        structure: mask of ones and zeros, shape (m, q), with ones where K may be other than zero. None: everywhere.
        f: values to try, each above 0, in units of one over the rate of the first plant.

    Raises:
        InputError: the plants do not fit one another, or a C_y, the structure or an f does not fit.
        TooLargeError: the problem has too many unknowns for an answer within a minute.
        DesignError: the LMIs have no solution for any f, the solver gave up, or no gain that it proposed stabilises all plants;
            there may be a gain nevertheless.

    Example:
        >>> import numpy as np
        >>> from synth import GeneralizedPlant, slack_design
        >>> C, D = [[1, 0], [0, 0]], [[0], [0.1]]
        >>> B, Dw = [[0], [1]], [[0], [0]]
        >>> plants = [GeneralizedPlant([[0, 1], [-k, -0.1]], B, B, C, D, Dw) for k in (3, 5)]
        >>> design = slack_design(plants, [np.array([[0.0, 1.0]])] * 2)
        >>> design.gain.shape, f"{design.worst:.3f}"
        ((1, 1), '0.333')
    """
    posed, allowed = _checked(plants, Cys, structure, f)
    n, m = posed[0].B.shape
    fits(len(plants) * (n * (n + 1) // 2) + n * n + m * n, MOST, "the one with a slack variable")
    rows = independent_rows(posed[0])
    problem = _Problem([plant.rows(rows) for plant in posed], allowed[:, rows])
    candidates: list[tuple[float, float, float, Array]] = []
    failures: list[DesignError] = []
    for each in f:
        try:
            K, bound = problem.two_steps(each)
        except DesignError as error:
            failures.append(error)
            continue
        gain = np.zeros(allowed.shape)
        gain[:, rows] = K
        norms = [hinf_norm(plant.closed_loop(Feedback(gain, plant.Cy))).value for plant in posed]
        candidates.append((max(norms), each, bound, gain))
    redundant = tuple(i for i in range(len(posed[0].Cy)) if i not in rows)
    best: list[SlackDesign] = []
    for worst, each, bound, gain in sorted(candidates, key=lambda one: one[0]):
        if not np.isfinite(worst):
            failures.append(DesignError(f"with f = {each:g} the gain that Clarabel proposes leaves a plant unstable"))
            continue
        certificates = tuple(certify_tightly(plant, Feedback(gain, plant.Cy)) for plant in posed)
        failed = [failure for certificate in certificates for failure in certificate.failures]
        if failed:
            failures.append(DesignError(f"the certificate fails: {failed[0]}"))
            continue
        best.append(SlackDesign(gain, bound, each, certificates, redundant))
        if not any(certificate.beyond_actuators for certificate in certificates):
            return best[-1]
    if best:  # all are beyond actuators
        return best[0]
    raise type(failures[0])(f"{failures[0]} (tried: f = {', '.join(f'{each:g}' for each in f)})")


def _checked(
    plants: Sequence[Plant], Cys: Sequence[Array], structure: Array | None, f: Sequence[float]
) -> tuple[list[Plant], Array]:
    """Returns the plants with their measurements after a check, and the structure of K as bools, shape (m, q)."""
    if not plants or len(plants) != len(Cys):
        raise InputError(f"Cys has {len(Cys)} matrices for {len(plants)} plants; give at least one plant, and one C_y for each")
    for plant in plants:
        check_inputs(plant)
        check_continuous(plant)
        check_posed(plant)
    posed = [plant.measured(Cy) for plant, Cy in zip(plants, Cys, strict=True)]
    (n, m), q = posed[0].B.shape, len(posed[0].Cy)
    for i, plant in enumerate(posed):
        if plant.B.shape != (n, m) or len(plant.Cy) != q:
            raise InputError(
                f"plant {i} has n = {len(plant.A)}, m = {plant.B.shape[1]} and q = {len(plant.Cy)}, plant 0 has n = {n}, m = {m} "
                f"and q = {q}; a common gain needs equal n, m and q"
            )
    (tried,) = real_matrix([f], "the row of f", "(1, k), numbers above 0 such as 0.1, 0.3 and 1")
    if not len(tried) or not np.all(tried > 0):
        raise InputError(f"f = {quoted(f)} is not a list of positive numbers; give numbers above 0, such as 0.1, 0.3 and 1")
    shape = m, q
    pattern = np.ones(shape) if structure is None else real_matrix(structure, "the structure", str(shape))
    if pattern.shape != shape or not np.all((pattern == 0) | (pattern == 1)):
        raise InputError(
            f"the structure has shape {pattern.shape}; expected {shape}, a row for each input and a column for each "
            "measurement, with 1 where the gain may be other than zero, and 0 elsewhere"
        )
    return posed, pattern.astype(bool)


class _Problem:
    """A family in units in which all numbers of the first plant have size one, and all measure the same."""

    def __init__(self, plants: Sequence[Plant], pattern: Array) -> None:
        units = own_units(plants[0], measured=True)
        self.rate, self.pattern, self.input_units = units.rate, pattern, units.inputs
        own = [units.into(plant) for plant in plants]
        self.lengths = np.linalg.norm(own[0].Cy, axis=1)
        states = reachable(own[0], 0)
        rows = [plant.Cy / self.lengths[:, None] @ states for plant in own]
        self.Cy = rows[0]
        # Coordinates T in which a plant that measures C_i measures as the first: C_i T = C_y.
        alike = [np.eye(len(states)) - np.linalg.pinv(C_i) @ (C_i - self.Cy) for C_i in rows]
        self.plants = [plant.in_coordinates(states @ T).measured(self.Cy) for plant, T in zip(own, alike, strict=True)]

    def two_steps(self, f: float) -> tuple[Array, float]:
        """Returns the gain in the given units, and Clarabel's bound."""
        rate, n = SOLVED_AT * self.rate / f, len(self.Cy.T)
        blocks = together(self.pattern)
        eye = np.eye(n)
        scaled = NormalisedSystem(self.plants, rate, eye[:, :0], eye, np.ones((n, n)))
        W = scaled.T @ first_step(scaled.plants, SOLVED_AT, blocks).W @ scaled.T.T
        Q = nullspace(self.Cy)
        R = r_matrix(self.Cy, Q, l_matrix(W.T, self.Cy, Q))
        scaled, a = NormalisedSystem(self.plants, rate, Q, R, blocks), Q.shape[1]
        second = second_step(scaled.plants, SOLVED_AT, eye[:, :a], eye[:, a:], self.pattern)
        K = np.where(self.pattern, scaled.force * second.K @ np.linalg.inv(scaled.measured), 0.0)
        return self.input_units[:, None] * K / self.lengths, second.eta**-0.5 / scaled.gain
