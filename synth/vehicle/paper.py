"""Comparison with the paper's published designs (40)-(60), and with the paper's remarks 4 and 5, which are about different
design methods.

Remark 4: with the states of equation (30), problem (25) has no solution for L = 0. With the heights z_s and z_u and their
velocities as states, as in reference [33], problem (25) has a solution for controller I, but not for II. For the states of
reference [33], the disturbance w is the road height, because the road velocity would require an additional state. The output z
is the same for both choices of states.

Remark 5: in reference [19] of the paper, controller I was found by a genetic algorithm. Here,
`scipy.optimize.differential_evolution` is used instead of this genetic algorithm. The search evaluates only the norm of the
loop for each gain, within fixed limits on the gains. The result of the search depends on the limits on the gains and on the
random seed.
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

# The bases (47) and (57) are the choice of the paper; L depends on these bases, but K does not.
CY = {"I": np.eye(4)[[0, 2]], "II": np.eye(4)[[2]]}  # matrices (46) and (55)
Q = {"I": np.eye(4)[:, [1, 3]], "II": np.eye(4)[:, [1, 0, 3]]}  # bases (47) and (57)

SHORT = "the paper's solver stopped a little short of the limit of the central path, 2e-4 away in X"
EXACT = ""


@dataclass(frozen=True)
class PrintedNumber:
    """Number published in the paper, with its place.

    Attributes:
        equation: number of the equation in the paper.
        quantity: symbol of the quantity.
        entry: row and column of the number in the matrix, counted from 0; None for a scalar.
        value: number as published in the paper.
        digit: value of one unit in the last published digit of the number.
        reason: reason why Roadproof's value differs in the last published digit; empty if there is no difference.
    """

    equation: str
    quantity: str
    entry: tuple[int, int] | None
    value: float
    digit: float
    reason: str


NOT = math.nan  # entry that is not published, or that follows from symmetry
# The columns are: equation, symbol, unit of the last published digit, published value or matrix, and the entries that are
# inaccurate because the paper's solver stopped too early.
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
    """Returns True if a vehicle has the parameters of equation (33) and the weights of equation (38) in the paper."""
    paper = read_vehicle("quarter_car")
    return not vehicle.filtered and vehicle.parameters == paper.parameters and vehicle.performance == paper.performance


def ours(designer: Designer) -> dict[str, Array | float]:
    """Returns the quantities that the paper publishes, as computed by Roadproof, by symbol."""
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
    """Returns an entry of a matrix, or the quantity itself if `entry` is None."""
    return float(np.asarray(quantity)[entry] if entry is not None else quantity)


TO_RELATIVE = np.array([[1.0, -1.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
ROAD = np.array([[0.0], [-1.0], [0.0], [0.0]])  # the states in equation (30) are TO_RELATIVE [z_s z_u z_s' z_u']' + ROAD z_r
BOX = 2e4  # largest allowed entry of the gain [N per unit of the measurement]: about twice the paper's largest entry
SEED = 1
TOLERANCE = 1e-6  # the search ends if the norms in the population differ by less than this relative amount
# lower limit of the objective for unstable loops, far above the norms of stable loops; the objective increases from here with
# the growth rate
UNSTABLE = 1e6


@dataclass(frozen=True, eq=False)
class WithoutL:
    """Result for remark 4 of the paper (L = 0), for one controller.

    Attributes:
        controller: name of the controller, I or II.
        states: choice of states: "(30)" for equation (30), or "[33]" for reference [33] of the paper.
        gain: gain K, shape (1, q); None if problem (25) has no solution for L = 0.
        bound: value of gamma that problem (25) yields; None if the problem has no solution.
        best: value of gamma that problem (22) yields for the same plant, a lower bound on the norm for any gain.
    """

    controller: str
    states: str
    gain: Array | None
    bound: float | None
    best: float


@dataclass(frozen=True, eq=False)
class Way:
    """Result of one design method for remark 5 of the paper.

    Attributes:
        controller: name of the controller, I or II.
        how: name of the design method.
        gain: gain K, shape (1, q).
        norm: norm of the closed loop that the method achieves.
        work: text that states how many LMI problems were solved, or how many norms were computed.
        seconds: processor time that the method needed [s].
    """

    controller: str
    how: str
    gain: Array
    norm: float
    work: str
    seconds: float


def absolute_states(plant: Plant) -> Plant:
    """Returns the paper's plant with the states z_s, z_u, z_s' and z_u' of reference [33], and the road height as w."""
    A = np.vstack([np.eye(4)[2:], plant.A[2:] @ TO_RELATIVE])
    B, Bw = (np.vstack([np.zeros((2, 1)), rows]) for rows in (plant.B[2:], plant.A[2:] @ ROAD))
    return Plant(A=A, B=B, Bw=Bw, C=plant.C @ TO_RELATIVE, D=plant.D, Dw=plant.C @ ROAD)


def remark_4(designer: Designer) -> list[WithoutL]:
    """Returns the results for remark 4 (L = 0), for both controllers and both choices of states."""
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
    """Returns the results for remark 5, for the two-step method and a genetic algorithm, and for both controllers."""
    from scipy.optimize import differential_evolution  # this import takes half a second

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
        # two methods compute this norm; the search itself used only one of them
        value = hinf_norm(plant.closed_loop(Feedback(search.x[None], Cy))).value
        ways.append(Way(name, "genetic", search.x[None], value, f"{search.nfev} norms", seconds))
    return ways
