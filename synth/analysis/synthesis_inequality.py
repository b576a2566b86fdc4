"""The Gahinet-Apkarian inequality of a plant, without the controller's terms, in exact integers and in floats.

For state feedback (21) has a Y exactly if N' (21) N < 0 at Y = 0, N a basis of all q with [B; D]' q = 0 (the elimination lemma;
Gahinet, Apkarian 1994). For output feedback from y = C_y x + Dyw w there is a second one, the same of the transposed plant, in S.

**Directions that cost nothing.** Inputs v with D v = 0 let X grow without bound along B v, and along A B v, ... as far as C does
not see it. Let F hold these directions (`steered`). No dual solution can weigh them, so N is also orthogonal to [F; 0] and
[A F; C F], and of X only J X J' remains, J a basis of all rows with J F = 0. Of the transposed plant, whose B is C_y' and D is
Dyw', F is what y and those of its derivatives show that are free of w (`shown`).

The same goes for states that z does not see and that decay by themselves: in them, too, X grows at no price.

All of this is decided on the numbers of the plant as they stand, by integers: no tolerance tells a rank, so a direction that is
small counts, and units of states, inputs, time, w and z as a whole mean nothing.
"""

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from models.common.arrays import Array
from synth.analysis.rigorous import Nullspace, floats, identity, integers, product, without_factors
from synth.plant.generalized import GeneralizedPlant, check_continuous

GROWTH = 1e-9  # of |A|; less is rounding


@dataclass(frozen=True, eq=False)
class Side:
    """N' (21) N < 0 as He(Q X U') + eta b b' - c c' < 0 for X of the a coordinates that are not steered.

    Attributes:
        J: rows that the steered directions do not touch, shape (a, n); integers.
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
    def of(cls, plant: GeneralizedPlant) -> "Side":
        """The side of state feedback; of the transposed plant that of the observer.

        Raises:
            InputError: the plant is discrete; then it is the one that it is mapped to that has a side.
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
        """U, Q, b, c in floats, every entry rounded once."""
        one, two = Fraction(1, self.scale), Fraction(1, self.scale * self.unit)
        return floats(self.U, one), floats(self.Q, two), floats(self.b, two), floats(self.c, one)


def transposed(plant: GeneralizedPlant, Cy: Array, Dyw: Array | None = None) -> GeneralizedPlant:
    """The plant whose state feedback is the injection of y = C_y x + Dyw w, and whose w and z have changed places.

    Args:
        plant: n states, r disturbances.
        Cy: shape (q, n).
        Dyw: shape (q, r); zero where it is not given.
    """
    D = np.zeros((plant.Bw.shape[1], len(Cy))) if Dyw is None else np.asarray(Dyw).T
    return GeneralizedPlant(plant.A.T, np.asarray(Cy).T, plant.C.T, plant.Bw.T, D, plant.Dw.T)


def meeting(one: Side, other: Side) -> tuple[Array, int]:
    """J_other J_one', each J the identity in its coordinates: integers of shape (a_other, a_one), and what they are over."""
    across, down = (each.J[np.arange(len(each.J)), each.coordinates] for each in (one, other))
    over = math.lcm(*across) * math.lcm(*down)
    return product(other.J, one.J.T) * over // np.multiply.outer(down, across), over


def steered(plant: GeneralizedPlant) -> Array:
    """F: what inputs steer at no cost, and what they steer through it, likewise: independent columns of integers, (n, f)."""
    n, (system, _) = len(plant.A), integers(plant.system_matrix)
    return _closure(system[:, :n], system[:, n : n + plant.B.shape[1]])


def shown(plant: GeneralizedPlant, Cy: Array, Dyw: Array | None = None) -> Array:
    """What y and those of its derivatives show that are free of w: independent rows of integers, shape (q', n).

    G Dyw = 0 and G C_y Bw = 0 make G y' = G C_y A x + (known) another measurement, and so on.
    """
    return steered(transposed(plant, Cy, Dyw)).T


def _closure(states: Array, inputs: Array) -> Array:
    """The smallest space that holds B v where D v = 0 and, with f, also A f + B v where C f + D v = 0: columns, shape (n, f)."""
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
    """The states that z does not see without control, columns of shape (n, h); none where some of them grow by themselves.

    Were that misjudged, the bound would be weaker, and no less true: fewer dual solutions remain.
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
