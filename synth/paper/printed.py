"""The numbers that the paper prints of its designs, (40)-(60), and ours beside them."""

from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.vehicle import Vehicle, read_vehicle
from synth.certificate.certificate import certify
from synth.designer import Designer
from synth.lmi.output_feedback import l_matrix, output_feedback, r_matrix

# The bases (47) and (57) that the paper chose; L depends on them, K does not.
CY = {"I": np.eye(4)[[0, 2]], "II": np.eye(4)[[2]]}  # (46), (55)
Q = {"I": np.eye(4)[:, [1, 3]], "II": np.eye(4)[:, [1, 0, 3]]}  # (47), (57)

SHORT = "the paper's solver stopped a little short of the limit of the central path, 2e-4 away in X"
EXACT = ""


@dataclass(frozen=True)
class Printed:
    """A number of the paper.

    Attributes:
        equation: where it stands.
        quantity: its symbol.
        entry: row and column from 0; None for a scalar.
        value: as printed.
        digit: unit of its last printed digit.
        reason: why ours differs in that digit; empty where it does not.
    """

    equation: str
    quantity: str
    entry: tuple[int, int] | None
    value: float
    digit: float
    reason: str


PRINTED = (
    Printed("(40)", "G_s", (0, 0), 1.1810e4, 1e0, EXACT),
    Printed("(40)", "G_s", (0, 1), 0.2333e4, 1e0, EXACT),
    Printed("(40)", "G_s", (0, 2), -0.1096e4, 1e0, SHORT),
    Printed("(40)", "G_s", (0, 3), 0.0109e4, 1e0, EXACT),
    Printed("(41)", "gamma_Gs", None, 7.8365, 1e-4, EXACT),
    Printed("(42)", "X_s", (0, 0), 0.5965, 1e-4, SHORT),
    Printed("(42)", "X_s", (0, 1), -0.0020, 1e-4, EXACT),
    Printed("(42)", "X_s", (0, 2), -0.5075, 1e-4, SHORT),
    Printed("(42)", "X_s", (0, 3), -0.0085, 1e-4, EXACT),
    Printed("(42)", "X_s", (1, 1), 0.0020, 1e-4, EXACT),
    Printed("(42)", "X_s", (1, 2), 0.0020, 1e-4, EXACT),
    Printed("(42)", "X_s", (1, 3), -0.0081, 1e-4, EXACT),
    Printed("(42)", "X_s", (2, 2), 0.7659, 1e-4, SHORT),
    Printed("(42)", "X_s", (2, 3), -0.0015, 1e-4, EXACT),
    Printed("(42)", "X_s", (3, 3), 8.0713, 1e-4, SHORT),
    Printed("(48)", "L_I", (0, 0), -0.0025, 1e-4, EXACT),
    Printed("(48)", "L_I", (0, 1), 0.0009, 1e-4, EXACT),
    Printed("(48)", "L_I", (1, 0), -0.0364, 1e-4, EXACT),
    Printed("(48)", "L_I", (1, 1), -0.0261, 1e-4, SHORT),
    Printed("(49)", "R_I", (0, 0), 1.0, 1e-4, EXACT),
    Printed("(49)", "R_I", (0, 1), 0.0, 1e-4, EXACT),
    Printed("(49)", "R_I", (1, 0), -0.0025, 1e-4, EXACT),
    Printed("(49)", "R_I", (1, 1), 0.0009, 1e-4, EXACT),
    Printed("(49)", "R_I", (2, 0), 0.0, 1e-4, EXACT),
    Printed("(49)", "R_I", (2, 1), 1.0, 1e-4, EXACT),
    Printed("(49)", "R_I", (3, 0), -0.0364, 1e-4, EXACT),
    Printed("(49)", "R_I", (3, 1), -0.0261, 1e-4, SHORT),
    Printed("(50)", "K_I", (0, 0), 1.0824e4, 1e0, SHORT),
    Printed("(50)", "K_I", (0, 1), -0.2071e4, 1e0, SHORT),
    Printed("(51)", "G_I", (0, 0), 1.0824e4, 1e0, SHORT),
    Printed("(51)", "G_I", (0, 1), 0.0, 1e0, EXACT),
    Printed("(51)", "G_I", (0, 2), -0.2071e4, 1e0, SHORT),
    Printed("(51)", "G_I", (0, 3), 0.0, 1e0, EXACT),
    Printed("(52)", "gamma_GI", None, 7.8432, 1e-4, EXACT),
    Printed("(56)", "L_II", (0, 0), 0.0026, 1e-4, EXACT),
    Printed("(56)", "L_II", (1, 0), -0.6627, 1e-4, SHORT),
    Printed("(56)", "L_II", (2, 0), -0.0019, 1e-4, EXACT),
    Printed("(57)", "R_II", (0, 0), -0.6627, 1e-4, SHORT),
    Printed("(57)", "R_II", (1, 0), 0.0026, 1e-4, EXACT),
    Printed("(57)", "R_II", (2, 0), 1.0, 1e-4, EXACT),
    Printed("(57)", "R_II", (3, 0), -0.0019, 1e-4, EXACT),
    Printed("(58)", "K_II", (0, 0), -8.9703e3, 1e-1, SHORT),
    Printed("(59)", "G_II", (0, 2), -8.9703e3, 1e-1, SHORT),
    Printed("(60)", "gamma_GII", None, 7.9068, 1e-4, EXACT),
)


def is_the_papers(vehicle: Vehicle) -> bool:
    """Whether a vehicle has the parameters (33) and weights (38)."""
    paper = read_vehicle("quarter_car")
    return not vehicle.filtered and vehicle.parameters == paper.parameters and vehicle.performance == paper.performance


def ours(designer: Designer) -> dict[str, Array | float]:
    """The same quantities of the paper's vehicle, computed here, by symbol."""
    step = designer.state_feedback
    found: dict[str, Array | float] = {"G_s": step.K, "X_s": step.X, "gamma_Gs": step.gamma}
    for name in ("I", "II"):
        L = l_matrix(step.X, CY[name], Q[name])
        point = output_feedback(designer.plant, CY[name], L, Q[name])[-1]
        found |= {f"L_{name}": L, f"R_{name}": r_matrix(CY[name], Q[name], L), f"K_{name}": point.K}
        found[f"G_{name}"] = point.K @ CY[name]
        found[f"gamma_G{name}"] = certify(designer.plant, point.K @ CY[name]).norm.value
    return found


def entry_of(quantity: Array | float, entry: tuple[int, int] | None) -> float:
    """One number of a quantity."""
    return float(np.asarray(quantity)[entry] if entry is not None else quantity)
