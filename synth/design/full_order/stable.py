"""Full-order laws that are stable by themselves, so that nothing winds up where forces are clipped.

Central laws of larger gamma are slower, and some of them are stable. From the best of these a descent goes on: one gain
[D, C; B, A] for two plants. One is the plant with the law's states. The other has these states alone, x_c' = v, lightly weighed.
Its loop is x_c' = A x_c, whose norm is finite as long as the law is stable. A law that takes forces out of what it reads runs
with another A than it is designed with: it is judged as it runs.
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

GAMMAS = (1.0005, 1.002, 1.01, 1.05, 1.3, 3.0, 1e3)  # times the bound; a smaller one is a law nearer to it, and faster
STARTS = 2  # from which a descent goes on
LIGHTLY = 1e-3  # of the norm, in own units: how much a law's own states weigh
LARGER = 10.0  # times a start's largest entry: so large may entries become


def stable_laws(search: RiccatiSearch, fits: Callable[[TradeOffPoint], bool], most: int) -> list[TradeOffPoint]:
    """Returns laws that fit and have stable loops.

    Args:
        search: search on the plant, whose own units are used.
        fits: returns True for a law that is stable by itself, with a loop that is not too fast.
        most: largest number of entries of a law for which a descent continues from the best.
    """
    tried = [search.traded(share, search.bound * gamma) for share, gamma in product(SHARES, GAMMAS)]
    # From a fast law no way leads down to a slow one.
    laws = sorted((each for each in tried if each is not None and fits(each)), key=lambda each: (each.excess > 1, each.norm))
    for start in laws[:STARTS]:
        if (start.own.states + search.own.plant.B.shape[1]) * (start.own.states + len(search.own.plant.Cy)) <= most:
            with contextlib.suppress(InputError, np.linalg.LinAlgError):
                lower = search.judged(0.0, _descend_from(search, start))
                laws += [lower] if lower is not None and fits(lower) else []
    return laws


def _descend_from(search: RiccatiSearch, start: TradeOffPoint) -> LinearLaw:
    """Returns the law at the end of the descent from a stable one, in own units; it may be unstable by rounding.

    Raises:
        DesignError: there is no way down.
    """
    own, k = search.own, start.own.states
    gain = descend_stable(own.plant.with_states(k), law_gain(start.own), k, LIGHTLY * start.norm * own.norm)
    return gain_law(gain, *own.plant.Dyu.T.shape)


def descend_stable(plant: Plant, start: Array, states: int, light: float, structure: Array | None = None) -> Array:
    """Returns the gain [D, C; B, A] at the end of the descent from that of a stable law; it may be unstable by rounding.

    Args:
        plant: plant with the law's states, and the measurements of the gain.
        start: gain of the start, whose loop is stable, too.
        states: number k of the law's states.
        light: weight of the law's own states.
        structure: True for the entries that may be other than zero; None for all.

    Raises:
        DesignError: there is no way down.
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
