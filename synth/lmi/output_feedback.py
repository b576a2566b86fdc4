"""State feedback, problem (22), and static output feedback u = K y, y = C_y x: L (14) and R (9), then (25) for K (13)."""

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.lmi.central_path import LIMIT, CentralPoint, central_path
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError, NoSolutionError
from synth.plant.units import independent, own_units, unit_rows


def state_feedback(plant: Plant, mu: float = LIMIT) -> list[CentralPoint]:
    """Returns the central path of (22). Its last point is the optimal state feedback u = G_s x, with G_s = Y X^-1 (3) as K.

    Args:
        mu: path parameter, see `central_path`.

    Raises:
        NoSolutionError: no state feedback moves every mode by more than rounding.
    """
    n = len(plant.A)
    return central_path(plant, Q=np.zeros((n, 0)), R=np.eye(n), mu=mu)


def nullspace(Cy: Array) -> Array:
    """Returns Q, an orthonormal basis of the nullspace of C_y, shape (n, n - q). K does not depend on the choice of basis."""
    return linalg.null_space(unit_rows(Cy)[0])


def independent_rows(plant: Plant) -> list[int]:
    """Returns the indices of rows of C_y that are linearly independent of earlier ones, ascending; (9) needs full row rank.

    The states are scaled by `own_units` and the rows to length one, so that the result does not depend on units. No row may be
    zero.
    """
    return independent(plant.Cy * own_units(plant, measured=True).states)


def l_matrix(X: Array, Cy: Array, Q: Array) -> Array:
    """Returns L = Q^+ X C_y' (C_y X C_y')^-1, shape (n - q, q), equation (14).

    Args:
        X: the state-feedback X, shape (n, n).
        Cy: shape (q, n), full row rank.
        Q: shape (n, n - q).

    Raises:
        DesignError: C_y X C_y' is singular to rounding.
    """
    rows, lengths = unit_rows(Cy)
    try:
        return np.linalg.pinv(Q) @ X @ rows.T @ np.linalg.inv(rows @ X @ rows.T) / lengths
    except np.linalg.LinAlgError as error:
        raise DesignError(
            f"L (14) could not be computed: C_y X C_y' is singular to rounding ({error}), as X grows without bound or vanishes "
            "in a measured signal; weight that signal, or the control force, more"
        ) from error


def r_matrix(Cy: Array, Q: Array, L: Array) -> Array:
    """Returns R = C_y^+ + Q L, shape (n, q), equation (9)."""
    rows, lengths = unit_rows(Cy)
    return np.linalg.pinv(rows) / lengths + Q @ L


def output_feedback(plant: Plant, L: Array, Q: Array) -> list[CentralPoint]:
    """Returns the central path of (25) for a given L. Its last point is the controller u = K y, with K = Y_R X_R^-1 (13).

    Args:
        plant: plant whose C_y, shape (q, n), has full row rank.
        L: shape (n - q, q): (14), or zero for the one-step design of remark 4.
        Q: basis of the nullspace of C_y, shape (n, n - q).

    Raises:
        NoSolutionError: (25) has no solution with eta > 0 for this L.
    """
    try:
        return central_path(plant, Q, r_matrix(plant.Cy, Q, L))
    except NoSolutionError as error:
        which, advice = ("L = 0", ", or use the L of equation (14)") if L.size and not np.any(L) else ("this L", "")
        raise NoSolutionError(f"problem (25) has no solution with eta > 0 for {which}: {error}{advice}") from error
