"""Comparison with the paper's printed designs, (40)-(60), and with its remarks 4 and 5 on other ways to a gain.

Remark 4: with the states (30) problem (25) has no solution for L = 0. With z_s, z_u and their velocities, as in [33], it has one
for controller I and none for II. There the road's height is w, for its velocity would need a state more; z is the same.

Remark 5: in [19] controller I was found by a genetic algorithm. Its kind of search stands here as `differential_evolution`: it
asks for nothing but the norm of a gain, within a box that has to be given, and what it finds depends on box and seed.
"""

import math
import time
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.vehicle.vehicle import Vehicle, read_vehicle
from synth.analysis.certificate import certify
from synth.analysis.norm import hinf_norm
from synth.design.descent.landscape import Landscape
from synth.design.two_step import l_matrix, output_feedback, r_matrix, state_path, two_step_design, zero_l_design
from synth.plant.generalized import Feedback, Plant
from synth.plant.numerics import NoSolutionError, numerics
from synth.vehicle.designer import Designer

# The bases (47) and (57) that the paper chose; L depends on them, K does not.
CY = {"I": np.eye(4)[[0, 2]], "II": np.eye(4)[[2]]}  # (46), (55)
Q = {"I": np.eye(4)[:, [1, 3]], "II": np.eye(4)[:, [1, 0, 3]]}  # (47), (57)

SHORT = "the paper's solver stopped a little short of the limit of the central path, 2e-4 away in X"
EXACT = ""


@dataclass(frozen=True)
class PrintedNumber:
    """A number of the paper.

    Attributes:
        equation: place in the paper.
        quantity: symbol of the quantity.
        entry: row and column from 0; None for a scalar.
        value: value as published.
        digit: unit of its last printed digit.
        reason: reason for a difference in that digit; empty without a difference.
    """

    equation: str
    quantity: str
    entry: tuple[int, int] | None
    value: float
    digit: float
    reason: str


NOT = math.nan  # an entry that is not printed, or follows by symmetry
# Equation, symbol, unit of the last printed digit, value or matrix, and the entries of which the paper's solver stopped short.
_RESULTS = (
    ("(40)", "G_s", 1e0, [[1.1810e4, 0.2333e4, -0.1096e4, 0.0109e4]], [(0, 2)]),
    ("(41)", "gamma_Gs", 1e-4, 7.8365, []),
    (
        *("(42)", "X_s", 1e-4),
        [
            [0.5965, -0.0020, -0.5075, -0.0085],
            [NOT, 0.0020, 0.0020, -0.0081],
            [NOT, NOT, 0.7659, -0.0015],
            [NOT, NOT, NOT, 8.0713],
        ],
        [(0, 0), (0, 2), (2, 2), (3, 3)],
    ),
    ("(48)", "L_I", 1e-4, [[-0.0025, 0.0009], [-0.0364, -0.0261]], [(1, 1)]),
    ("(49)", "R_I", 1e-4, [[1.0, 0.0], [-0.0025, 0.0009], [0.0, 1.0], [-0.0364, -0.0261]], [(3, 1)]),
    ("(50)", "K_I", 1e0, [[1.0824e4, -0.2071e4]], [(0, 0), (0, 1)]),
    ("(51)", "G_I", 1e0, [[1.0824e4, 0.0, -0.2071e4, 0.0]], [(0, 0), (0, 2)]),
    ("(52)", "gamma_GI", 1e-4, 7.8432, []),
    ("(56)", "L_II", 1e-4, [[0.0026], [-0.6627], [-0.0019]], [(1, 0)]),
    ("(57)", "R_II", 1e-4, [[-0.6627], [0.0026], [1.0], [-0.0019]], [(0, 0)]),
    ("(58)", "K_II", 1e-1, [[-8.9703e3]], [(0, 0)]),
    ("(59)", "G_II", 1e-1, [[NOT, NOT, -8.9703e3, NOT]], [(0, 2)]),
    ("(60)", "gamma_GII", 1e-4, 7.9068, []),
)
PRINTED_NUMBERS = tuple(
    PrintedNumber(equation, quantity, entry or None, float(value), digit, SHORT if entry in short else EXACT)
    for equation, quantity, digit, values, short in _RESULTS
    for entry, value in np.ndenumerate(values)
    if not np.isnan(value)
)


def is_the_papers(vehicle: Vehicle) -> bool:
    """Returns True if a vehicle has the parameters (33) and weights (38)."""
    paper = read_vehicle("quarter_car")
    return not vehicle.filtered and vehicle.parameters == paper.parameters and vehicle.performance == paper.performance


def ours(designer: Designer) -> dict[str, Array | float]:
    """The same quantities of the paper's vehicle, computed here, by symbol."""
    step = designer.state_feedback
    values: dict[str, Array | float] = {"G_s": step.K, "X_s": step.X, "gamma_Gs": step.gamma}
    for name in ("I", "II"):
        L = l_matrix(step.X, CY[name], Q[name])
        point = output_feedback(designer.plant.measured(CY[name]), L, Q[name])[-1]
        values |= {f"L_{name}": L, f"R_{name}": r_matrix(CY[name], Q[name], L), f"K_{name}": point.K}
        values[f"G_{name}"] = point.K @ CY[name]
        values[f"gamma_G{name}"] = certify(designer.plant, point.K @ CY[name]).norm.value
    return values


def entry_of(quantity: Array | float, entry: tuple[int, int] | None) -> float:
    """Returns an entry of a matrix, or the number itself if `entry` is None."""
    return float(np.asarray(quantity)[entry] if entry is not None else quantity)


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
        gain: K, shape (1, q); None if (25) has no solution for L = 0.
        bound: gamma of (25); None likewise.
        best: gamma of (22) for the same plant, a lower bound for any gain.
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
        how: method, in words.
        gain: K, shape (1, q).
        norm: norm of the gain.
        work: number of problems solved or norms computed, in words.
        seconds: processor time [s].
    """

    controller: str
    how: str
    gain: Array
    norm: float
    work: str
    seconds: float


def absolute_states(plant: Plant) -> Plant:
    """The paper's plant with the states of [33], z_s, z_u, z_s' and z_u', and w = z_r."""
    A = np.vstack([np.eye(4)[2:], plant.A[2:] @ TO_RELATIVE])
    B, Bw = (np.vstack([np.zeros((2, 1)), rows]) for rows in (plant.B[2:], plant.A[2:] @ ROAD))
    return Plant(A=A, B=B, Bw=Bw, C=plant.C @ TO_RELATIVE, D=plant.D, Dw=plant.C @ ROAD)


def remark_4(designer: Designer) -> list[WithoutL]:
    """L = 0 for both controllers, with both choices of states."""
    cases = []
    for states, plant, turned in (
        ("(30)", designer.plant, np.eye(4)),
        ("[33]", absolute_states(designer.plant), TO_RELATIVE),
    ):
        best = state_path(plant)[-1].gamma
        for name, Cy in CY.items():
            try:
                design = zero_l_design(plant.measured(Cy @ turned))
            except NoSolutionError:
                cases.append(WithoutL(name, states, None, None, best))
            else:
                cases.append(WithoutL(name, states, design.gain, design.certificate.bound, best))
    return cases


@numerics()
def remark_5(designer: Designer) -> list[Way]:
    """The two steps beside a genetic algorithm, for both controllers."""
    from scipy.optimize import differential_evolution  # half a second

    ways, plant = [], designer.plant
    for name, Cy in CY.items():
        begin = time.process_time()
        design = two_step_design(plant, Cy)
        seconds = time.process_time() - begin
        ways.append(Way(name, "two steps", design.gain, design.certificate.norm.value, "2 LMI problems", seconds))

        def norm(K: Array, norms: Landscape) -> float:
            value = norms.norm(point := norms.point(K[None]))[0]
            return value if np.isfinite(value) else UNSTABLE + norms.abscissa(point)[0]

        begin = time.process_time()
        box, given, rng = [(-BOX, BOX)] * len(Cy), (Landscape(plant.measured(Cy)),), np.random.default_rng(SEED)
        search = differential_evolution(norm, box, given, rng=rng, tol=TOLERANCE, polish=False)
        seconds = time.process_time() - begin
        value = hinf_norm(plant.closed_loop(Feedback(search.x[None], Cy))).value  # by both routes; one is enough to search by
        ways.append(Way(name, "genetic", search.x[None], value, f"{search.nfev} norms", seconds))
    return ways
