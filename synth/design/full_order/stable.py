"""Full-order laws that are stable themselves, so that they do not wind up when forces saturate.

Central laws for a larger gamma are slower, and some of them are stable. A descent continues from the best stable laws. The
descent lowers the norms of two plants with one gain [D, C; B, A]. The first plant is the given plant with the law's states. The
second plant consists of only the law's states, x_c' = v, with a small weight. The closed loop of the second plant is x_c' = A
x_c, whose norm is finite as long as the law itself is stable. If a law subtracts forces from its measurements, its matrix A
changes before the law is executed. The stability of the law is therefore checked with the changed matrix A.
"""

import contextlib
from collections.abc import Callable
from itertools import product

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.linear import LinearLaw
from synth.design.full_order.riccati import SHARES, RiccatiSearch, TradeOffPoint
from synth.design.multi_objective.design import multi_objective_design
from synth.design.multi_objective.problem import FamilyMember, GainErrors, MultiObjectiveProblem, NormSpecification
from synth.plant.generalized import Plant, gain_law, law_gain

# values of gamma that are tried, relative to the lower bound; a smaller gamma gives a faster law with a norm closer to the
# bound
GAMMAS = (1.0005, 1.002, 1.01, 1.05, 1.3, 3.0, 1e3)
STARTS = 2  # number of designed laws from which a descent starts
LIGHTLY = 1e-3  # weight of the law's own states in the second plant, relative to the norm in internal units
LARGER = 10.0  # largest allowed entry of the law, relative to the largest entry at the start of the descent


def stable_laws(search: RiccatiSearch, fits: Callable[[TradeOffPoint], bool], most: int) -> list[TradeOffPoint]:
    """Returns laws that are themselves stable and that make the loop stable.

    Args:
        search: search for laws for the plant; the internal units of this search are used.
        fits: function that returns True if a law is itself stable and its loop is slow enough.
        most: largest number of entries of a law from which a descent continues.
    """
    tried = [search.traded(share, search.bound * gamma) for share, gamma in product(SHARES, GAMMAS)]
    # A descent cannot turn a fast law into a slow law.
    laws = sorted((each for each in tried if each is not None and fits(each)), key=lambda each: (each.excess > 1, each.norm))
    for start in laws[:STARTS]:
        if (start.own.states + search.own.plant.B.shape[1]) * (start.own.states + len(search.own.plant.Cy)) <= most:
            with contextlib.suppress(InputError, np.linalg.LinAlgError):
                lower = search.judged(0.0, _descend_from(search, start))
                laws += [lower] if lower is not None and fits(lower) else []
    return laws


def _descend_from(search: RiccatiSearch, start: TradeOffPoint) -> LinearLaw:
    """Returns the law at the end of the descent from a stable law, in internal units. Rounding may have made the law at the end
    of the descent unstable.

    Raises:
        DesignError: the descent fails.
    """
    own, k = search.own, start.own.states
    gain = descend_stable(own.plant.with_states(k), law_gain(start.own), k, LIGHTLY * start.norm * own.norm)
    return gain_law(gain, *own.plant.Dyu.T.shape)


def descend_stable(plant: Plant, start: Array, states: int, light: float, structure: Array | None = None) -> Array:
    """Returns the gain [D, C; B, A] at the end of the descent from a stable law. Rounding may have made the law at the end of
    the descent unstable.

    Args:
        plant: plant with the law's states, and the measurements on which the gain acts.
        start: gain of the stable law from which the descent starts; the loop with this law must also be stable.
        states: number k of the law's states.
        light: weight of the law's states in the second plant.
        structure: mask: True for entries that may be nonzero. None if all entries may be nonzero.

    Raises:
        DesignError: the descent fails.
    """
    k, (rows, columns) = states, start.shape
    m, q = rows - k, columns - k
    alone = Plant(
        A=np.zeros((k, k)),
        B=np.hstack([np.zeros((k, m)), np.eye(k)]),
        Bw=np.eye(k) * (plant.dt or 1.0),
        C=light * np.eye(k),
        D=np.zeros((k, m + k)),
        Dw=np.zeros((k, k)),
        dt=plant.dt,
        Cy=np.vstack([np.zeros((q, k)), np.eye(k)]),
    )
    problem = MultiObjectiveProblem(
        members=(FamilyMember((plant,)), FamilyMember((alone,))),
        minimise=NormSpecification(),
        tolerance=GainErrors(np.zeros(columns), np.zeros(rows)),
        structure=np.ones(start.shape, dtype=bool) if structure is None else structure,
        gain=LARGER * float(np.abs(start).max()),
    )
    return multi_objective_design(problem, [start]).gain
