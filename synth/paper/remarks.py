"""What the paper's remarks 4 and 5 say of other ways to a gain: L = 0, and a genetic algorithm.

Remark 4: with the states (30) problem (25) has no solution for L = 0. With z_s, z_u and their velocities, as in [33], it has one
for controller I and none for II. There the road's height is w, for its velocity would need a state more; z is the same.

Remark 5: in [19] controller I was found by a genetic algorithm. Its kind of search stands here as `differential_evolution`: it
asks for nothing but the norm of a gain, within a box that has to be given, and what it finds depends on box and seed.
"""

import time
from dataclasses import dataclass

import numpy as np
from scipy.optimize import differential_evolution

from models.common.arrays import Array
from synth.certificate.norm import hinf_norm
from synth.certificate.stability import stability
from synth.design import state_path, two_step_design, zero_l_design
from synth.designer import Designer
from synth.errors import InfeasibleError
from synth.numerics import numerics
from synth.paper.printed import CY
from synth.plant import Feedback, GeneralizedPlant

TO_RELATIVE = np.array([[1.0, -1.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
ROAD = np.array([[0.0], [-1.0], [0.0], [0.0]])  # (30) is TO_RELATIVE [z_s z_u z_s' z_u']' + ROAD z_r
BOX = 2e4  # of every entry of the gain, in its unit: about twice the paper's largest
SEED = 1
TOLERANCE = 1e-6  # of the population's norms, relative, at which the search ends
UNSTABLE = 1e6  # what an unstable loop counts: far more than a stable one, and the more the faster it grows


@dataclass(frozen=True, eq=False)
class WithoutL:
    """Remark 4 of one controller.

    Attributes:
        controller: I or II.
        states: "(30)" or "[33]".
        gain: K, shape (1, q); None where (25) has no solution for L = 0.
        bound: gamma of (25); None likewise.
        best: gamma of (22) for the same plant, what no gain beats.
    """

    controller: str
    states: str
    gain: Array | None
    bound: float | None
    best: float


@dataclass(frozen=True, eq=False)
class Way:
    """Remark 5: one way to a gain.

    Attributes:
        controller: I or II.
        how: in words.
        gain: K, shape (1, q).
        norm: that it reaches.
        work: in words: problems solved, or norms computed.
        seconds: of processor time.
    """

    controller: str
    how: str
    gain: Array
    norm: float
    work: str
    seconds: float


def absolute_states(plant: GeneralizedPlant) -> GeneralizedPlant:
    """The paper's plant with the states of [33], z_s, z_u, z_s' and z_u', and w = z_r."""
    A = np.vstack([np.eye(4)[2:], plant.A[2:] @ TO_RELATIVE])
    B, Bw = (np.vstack([np.zeros((2, 1)), rows]) for rows in (plant.B[2:], plant.A[2:] @ ROAD))
    return GeneralizedPlant(A=A, B=B, Bw=Bw, C=plant.C @ TO_RELATIVE, D=plant.D, Dw=plant.C @ ROAD)


def remark_4(designer: Designer) -> list[WithoutL]:
    """L = 0 for both controllers, with both choices of states.

    Args:
        designer: of the paper's vehicle.
    """
    found = []
    for states, plant, turned in (
        ("(30)", designer.plant, np.eye(4)),
        ("[33]", absolute_states(designer.plant), TO_RELATIVE),
    ):
        best = state_path(plant)[-1].gamma
        for name, Cy in CY.items():
            try:
                design = zero_l_design(plant, Cy @ turned)
            except InfeasibleError:
                found.append(WithoutL(name, states, None, None, best))
            else:
                found.append(WithoutL(name, states, design.gain, design.certificate.bound, best))
    return found


@numerics()
def remark_5(designer: Designer) -> list[Way]:
    """The two steps beside a genetic algorithm, for both controllers.

    Args:
        designer: of the paper's vehicle.
    """
    found, plant = [], designer.plant
    for name, Cy in CY.items():
        begin = time.process_time()
        design = two_step_design(plant, Cy)
        seconds = time.process_time() - begin
        found.append(Way(name, "two steps", design.gain, design.certificate.norm.value, "2 LMI problems", seconds))

        def norm(K: Array, Cy: Array = Cy) -> float:
            loop = plant.closed_loop(Feedback(K[None], Cy))
            poles = stability(loop.A)
            return hinf_norm(loop).value if poles.stable else UNSTABLE + float(poles.worst.real)

        begin = time.process_time()
        search = differential_evolution(
            norm, [(-BOX, BOX)] * len(Cy), rng=np.random.default_rng(SEED), tol=TOLERANCE, polish=False
        )
        seconds = time.process_time() - begin
        found.append(Way(name, "genetic", search.x[None], float(search.fun), f"{search.nfev} norms", seconds))
    return found
