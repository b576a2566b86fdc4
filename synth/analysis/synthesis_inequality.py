"""The Gahinet-Apkarian inequality of a plant, without the controller's terms, in exact integers and in floats.

For state feedback (21) has a Y exactly if N' (21) N < 0 at Y = 0, N a basis of all q with [B; D]' q = 0 (the elimination lemma;
Gahinet, Apkarian 1994). For output feedback from y = C_y x + Dyw w there is a second one, the same of the transposed plant, in S.

**Directions without cost.** Inputs v with D v = 0 let X grow without bound along B v, and along A B v, ... as long as they are
not observable in z. Let F hold these directions (`steered`). No dual solution can weight them, so N is also orthogonal to [F; 0]
and [A F; C F], and only J X J' remains of X, J a basis of all rows with J F = 0. For the transposed plant, whose B is C_y' and D
is Dyw', F' are the rows that y and those of its derivatives show that are free of w (`shown`).

The same holds for stable states that are unobservable in z: X grows without cost there, too.

All ranks are decided in integers on the given numbers, without tolerances. So a small direction counts, and units of states,
inputs, time, w and z do not matter.
"""

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from models.common.arrays import Array
from synth.analysis.rigorous import Nullspace, floats, identity, integers, product, without_factors
from synth.plant.generalized import GeneralizedPlant, check_continuous

GROWTH = 1e-9  # relative to |A|; a smaller real part is rounding


@dataclass(frozen=True, eq=False)
class SynthesisInequality:
    """N' (21) N < 0 as He(Q X U') + eta b b' - c c' < 0, for X in the a coordinates that are not steered without cost.

    Attributes:
        J: rows orthogonal to the steered directions, shape (a, n); integers.
        coordinates: of the states, a of them; J is diagonal there.
        U, Q, b, c: shapes (k, a), (k, a), (k, r), (k, d); integers over `scale`, Q and b also over `unit`.
        unit, scale: powers of two.
    """

    J: Array
    coordinates: list[int]
    U: Array
    Q: Array
    b: Array
    c: Array
    unit: int
    scale: int

    @classmethod
    def of(cls, plant: GeneralizedPlant) -> "SynthesisInequality":
        """Returns the inequality of state feedback, or of the observer if the plant is the transposed one.

        Raises:
            InputError: the plant is discrete; map it to a continuous one first.
        """
        check_continuous(plant)
        n, (system, unit) = len(plant.A), integers(plant.system_matrix)
        m = plant.B.shape[1]
        states, inputs = system[:, :n], system[:, n : n + m]
        F = np.hstack([_closure(states, inputs), _hidden(plant, states)])
        F = F[:, Nullspace(F).independent]
        steered = Nullspace(F)
        J, _ = without_factors(steered.complete(identity(len(steered.free))))
        columns = np.hstack([inputs, np.vstack([F, 0 * system[n:, : F.shape[1]]]), product(states, F)])
        N = Nullspace(columns)
        basis, scale = without_factors(N.complete(identity(len(N.free))))
        low, at = basis.T, steered.free
        return cls(
            J=J.T,
            coordinates=at,
            U=low[:, at],
            Q=product(low, states)[:, at],
            b=product(low, system[:, n + m :]),
            c=low[:, n:],
            unit=unit,
            scale=scale,
        )

    def floats(self) -> tuple[Array, Array, Array, Array]:
        """Returns U, Q, b, c in floats, every entry rounded once."""
        one, two = Fraction(1, self.scale), Fraction(1, self.scale * self.unit)
        return floats(self.U, one), floats(self.Q, two), floats(self.b, two), floats(self.c, one)


def transposed(plant: GeneralizedPlant, Cy: Array, Dyw: Array | None = None) -> GeneralizedPlant:
    """Returns the transposed plant: its state feedback is the injection of y = C_y x + Dyw w, and w and z are exchanged.

    Args:
        Cy: shape (q, n).
        Dyw: shape (q, r); zero if it is not given.
    """
    D = np.zeros((plant.Bw.shape[1], len(Cy))) if Dyw is None else np.asarray(Dyw).T
    return GeneralizedPlant(plant.A.T, np.asarray(Cy).T, plant.C.T, plant.Bw.T, D, plant.Dw.T)


def meeting(one: SynthesisInequality, other: SynthesisInequality) -> tuple[Array, int]:
    """Returns J_other J_one', each J the identity in its coordinates: integers, shape (a_other, a_one), and their denominator."""
    across, down = (each.J[np.arange(len(each.J)), each.coordinates] for each in (one, other))
    over = math.lcm(*across) * math.lcm(*down)
    return product(other.J, one.J.T) * over // np.multiply.outer(down, across), over


def steered(plant: GeneralizedPlant) -> Array:
    """Returns F, the states that inputs control without cost in z: independent columns of integers, shape (n, f)."""
    n, (system, _) = len(plant.A), integers(plant.system_matrix)
    return _closure(system[:, :n], system[:, n : n + plant.B.shape[1]])


def shown(plant: GeneralizedPlant, Cy: Array, Dyw: Array | None = None) -> Array:
    """Returns the rows observable from y and those of its derivatives that are free of w: independent integers, shape (q', n).

    G Dyw = 0 and G C_y Bw = 0 make G y' = G C_y A x + (known) another measurement, and so on.
    """
    return steered(transposed(plant, Cy, Dyw)).T


def _closure(states: Array, inputs: Array) -> Array:
    """Returns the smallest space with B v if D v = 0 and, with f, A f + B v if C f + D v = 0: columns, shape (n, f)."""
    n = states.shape[1]
    F = inputs[:n, :0]
    while True:
        both = np.hstack([inputs, product(states, F)])
        silent = Nullspace(both[n:].T)
        new, _ = without_factors(product(both[:n], silent.complete(identity(len(silent.free)))))
        wider = np.hstack([F, new])
        wider = wider[:, Nullspace(wider).independent]
        if wider.shape[1] == F.shape[1]:
            return F
        F = wider


def _hidden(plant: GeneralizedPlant, states: Array) -> Array:
    """Returns the states that are unobservable in z without control, columns of shape (n, h); none if some of them grow.

    A misjudgement here would weaken the bound, not falsify it: fewer dual solutions remain.
    """
    n = len(plant.A)
    silent = Nullspace(states[n:].T)
    V, _ = without_factors(silent.complete(identity(len(silent.free))))
    while V.shape[1]:
        staying = Nullspace(np.hstack([product(states[:n], V), V]).T)  # A V c = -V e
        kept = product(V, staying.complete(identity(len(staying.free)))[: V.shape[1]])
        kept = kept[:, Nullspace(kept).independent]
        if kept.shape[1] == V.shape[1]:
            break
        V, _ = without_factors(kept)
    directions = V / np.max(np.abs(V), axis=0, initial=1)
    within = np.linalg.lstsq(directions.astype(float), plant.A @ directions.astype(float))[0]
    grows = np.any(np.linalg.eigvals(within).real > GROWTH * np.linalg.norm(plant.A))
    return V[:, :0] if grows else V
