"""The second step for a discrete plant with a slack variable: a relaxation of (25), in which W replaces one X.

If some W satisfies [-X + eta Bw Bw', 0, A W + B Y; *, -I, C W + D Y; *, *, X - W - W'] < 0, X proves the bound eta^-1/2 of the
gain Y W^-1 (de Oliveira, Bernussou, Geromel 1999). Then C_y does not constrain X: with W = Q W_Q + R W_R R' for any W_Q and
W_R, and Y = Y_R R', the gain is Y W^-1 = K C_y with K = Y_R W_R^-1, as C_y Q = 0 and C_y R = I. W = X gives (25) itself.

In differences over a step T, X and W divided by T, and the last block row and column added to the first, it is

    [ He(A W + B Y) + eta Bw Bw'                        *                 *            ]
    [ C W + D Y + eta Dw Bw'                            -I + eta Dw Dw'   *            ]
    [ sqrt(T) (A W + B Y)' + (X - W) / sqrt(T)          sqrt(T) (..)'     X - W - W'   ]  < 0,

which for W = X is the bordered matrix of `certificate.py`. Its central path, of log det of this matrix alone, starts from a point
of that of (25). Its limit is unique, too, and independent of coordinates.
"""

import numpy as np

from models.common.arrays import Array
from models.common.threads import one_thread
from synth.lmi.barrier import Barrier, boundary, newton
from synth.lmi.central_path import BREAKS_OFF, CENTRED, INSIDE, LIMIT, CentralPoint
from synth.lmi.structured_barrier import direction
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError

ENTERED = 0.1  # mu / eta of the point of (25), far from the boundary, at which the path starts
RATIO = 0.1  # of mu, from point to point


def slack_path(plant: Plant, start: CentralPoint) -> list[CentralPoint]:
    """Returns points of the central path up to its limit; the X of each proves its bound.

    Args:
        plant: plant in discrete time with n states, m inputs, and C_y of full row rank.
        start: point on the path of (25): its X, which determines R (9), is the first W.

    Raises:
        DesignError: the path could not be followed to its limit.
    """
    assert plant.dt is not None
    with one_thread(), np.errstate(all="ignore"):
        try:
            return _Slack(plant, start).follow()
        except np.linalg.LinAlgError as error:
            raise DesignError(
                f"rounding errors stop the central path with a slack variable ({error}); rescale the plant"
            ) from error


class _Slack:
    """The problem in coordinates in which the first X is I, with the first gain closed."""

    def __init__(self, plant: Plant, point: CentralPoint) -> None:
        assert plant.dt is not None
        self.step, self.K, self.eta, self.mu = plant.dt, point.K, point.eta, point.mu
        X = point.X / plant.dt
        self.T = np.linalg.cholesky(X)
        own = plant.differences.closed_loop(point.K @ plant.Cy).in_coordinates(self.T)
        # Units of inputs and disturbances, in which their matrices have the size of A.
        self.input_unit = np.linalg.norm(own.A) / np.linalg.norm(own.B)
        self.plant, rows = own.with_inputs(self.input_unit * np.eye(own.B.shape[1])), own.Cy
        # C_y X C_y' of (12) is X_R, and X C_y' X_R^-1 is R.
        self.R = rows.T @ np.linalg.inv(rows @ rows.T)
        self.Q = np.linalg.svd(rows)[2][len(rows) :].T
        self.units()

    def units(self) -> None:
        """Computes the coefficients of the unknowns: X above its diagonal, W_Q, W_R, Y_R by rows, and eta."""
        (n, q), m = self.R.shape, self.plant.B.shape[1]
        above = np.triu_indices(n)
        of_x, of_wq, of_wr, of_y = len(above[0]), (n - q) * n, q * q, m * q
        self.size = of_x + of_wq + of_wr + of_y + 1
        X, W, Y = np.zeros((self.size, n, n)), np.zeros((self.size, n, n)), np.zeros((self.size, m, n))
        index = np.arange(of_x)
        X[index, above[0], above[1]] = X[index, above[1], above[0]] = 1
        W[of_x : of_x + of_wq] = self.Q @ np.eye(of_wq).reshape(of_wq, n - q, n)
        self.in_wr = slice(of_x + of_wq, of_x + of_wq + of_wr)
        W[self.in_wr] = self.R @ np.eye(of_wr).reshape(of_wr, q, q) @ self.R.T
        self.in_y = slice(self.in_wr.stop, self.in_wr.stop + of_y)
        Y[self.in_y] = np.eye(of_y).reshape(of_y, m, q) @ self.R.T
        self.X, self.W, self.Y = X, W, Y

    def matrix(self) -> tuple[Array, Array]:
        """Returns F0 and F of the matrix F0 + sum p_i F_i, shapes (k, k) and (N, k, k)."""
        plant, root = self.plant, self.step**0.5
        n, d = len(plant.A), len(plant.C)
        top, low = plant.A @ self.W + plant.B @ self.Y, plant.C @ self.W + plant.D @ self.Y
        W, F = self.W.swapaxes(1, 2), np.zeros((self.size, 2 * n + d, 2 * n + d))
        F[:, :n, :n] = top
        F[:, n : n + d, :n] = low
        F[:, n + d :, :n] = root * top.swapaxes(1, 2) + (self.X - self.W) / root
        F[:, n + d :, n : n + d] = root * low.swapaxes(1, 2)
        F[:, n + d :, n + d :] = self.X / 2 - W
        F += F.swapaxes(1, 2)
        disturbance = np.vstack([plant.Bw, plant.Dw])
        F[-1, : n + d, : n + d] = disturbance @ disturbance.T
        F0 = np.zeros(F.shape[1:])
        F0[np.arange(n, n + d), np.arange(n, n + d)] = -1
        return F0, F

    def follow(self) -> list[CentralPoint]:
        """Follows the central path from W = X to its limit."""
        n = len(self.R)
        F0, F = self.matrix()
        barrier, p = Barrier([(-F0, -F)]), np.zeros(self.size)
        p[: n * (n + 1) // 2] = np.eye(n)[np.triu_indices(n)]
        whole = self.W[n * (n + 1) // 2 : self.in_wr.stop].reshape(-1, n * n).T
        p[n * (n + 1) // 2 : self.in_wr.stop] = np.linalg.lstsq(whole, np.eye(n).ravel())[0]
        p[-1] = self.eta
        if barrier.at(p) is None:
            raise np.linalg.LinAlgError("the point of (25) is not strictly feasible")
        mu, points, here = self.mu * self.eta, list[CentralPoint](), None
        while True:
            p, decrement, here = newton(barrier, p, direction(self.size, -1 / mu), CENTRED, here=here)
            if decrement > 0.5:
                raise DesignError(
                    f"the central path with a slack variable could not be followed below mu = {mu / abs(p[-1]):.1e} (Newton "
                    f"decrement {decrement:.1e}): {BREAKS_OFF}"
                )
            points.append(self.point(p, mu))
            if mu <= LIMIT * p[-1] * 1.001:
                return points
            ratio = max(RATIO, LIMIT * p[-1] / mu)
            step = here.solve(here.half(direction(self.size, 1 / mu)))
            p, here = p + min(1 - ratio, INSIDE * boundary(here, step)) * step, None
            mu *= ratio

    def point(self, p: Array, mu: float) -> CentralPoint:
        """Returns a point in the user's coordinates and units."""
        q = self.R.shape[1]
        W_R, Y_R = p[self.in_wr].reshape(q, q), p[self.in_y].reshape(-1, q)
        X = self.T @ np.tensordot(p, self.X, 1) @ self.T.T
        return CentralPoint(self.step * X, self.K + self.input_unit * Y_R @ np.linalg.inv(W_R), float(p[-1]), mu / float(p[-1]))
