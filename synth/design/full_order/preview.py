"""Preview LQ control: the smallest mean square of z if the disturbance is known in advance (Tomizuka 1975; Hac 1992).

In the formulas, z = C x + D u, and w is white noise that is known from now until T seconds ahead. X and K are the solution and
the gain of the LQR Riccati equation. With R = D'D and A_K = A + B K, the force is

    u(t) = K x(t) + integral from 0 to T of F(s) w(t + s) ds,    F(s) = -R^-1 B' exp(A_K' s) X Bw.

The feedback gain is the same as in LQR, so preview does not change the poles. Preview reduces the mean square of z to

    mean square = trace Bw' X Bw - integral from 0 to T of trace F(s)' R F(s) ds.

The mean square decreases as T grows. For T = 0, the mean square equals that of an LQR controller. The integral in this
expression is computed from a Lyapunov equation.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.laws.preview import RoadPreview
from models.laws.python_law import AHEAD
from synth.design.full_order.quadratic import lqr_design, on_rows, state_rows
from synth.design.problem import DesignProblem, DesignResult, Progress
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError, numerics
from synth.plant.units import own_units


@numerics()
def preview_design(plant: Plant, preview: float, states: Sequence[str] = (), Cy: Array | None = None) -> DesignResult:
    """Designs the law with the smallest mean square of z if w is known in advance.

    D_w is ignored, as in `lqr_design`.

    Args:
        plant: generalised plant with n states, m inputs and r disturbances.
        preview: time T by which w is known in advance [s].
        states: names of the states, used in error messages.
        Cy: measurement matrix, shape (q, n); the state must be computable from these measurements. Default: the measurements of
            the plant, or the state itself if the plant has no measurements.

    Returns:
        The feedback law; its attribute `preview` contains the force that is computed from the future disturbance. `h2_norm` is
        the H2 norm with preview, and `without` is the H2 norm without preview.

    Raises:
        InputError: the preview time is not allowed, or `lqr_design` raises this type of error.
        InfeasibleError: the plant cannot be stabilised; the message describes the mode that cannot be stabilised.
        DesignError: some force has no weight in z, or `lqr_design` raises this type of error.

    Example:
        >>> from synth import GeneralizedPlant, preview_design
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> design = preview_design(oscillator, preview=0.5)
        >>> f"{design.without:.4f} {design.h2_norm:.4f}"
        '0.1892 0.1184'
    """
    seconds = AHEAD.number("a preview", preview)
    state = plant.measured(np.eye(len(plant.A)))
    plant = state if Cy is None and not len(plant.Cy) else plant.measured(Cy)
    rows = state_rows(plant)
    lqr = lqr_design(plant, states)
    if lqr.remark:
        raise DesignError("a preview design needs a weight on every control force; give each force a weight in [performance]")
    units = own_units(state, measured=True)
    own, K = units.into(plant), lqr.law.D * units.states / units.inputs[:, None]
    closed, cost = own.A + own.B @ K, own.C + own.D @ K
    X = linalg.solve_continuous_lyapunov(closed.T, -cost.T @ cost)
    half = np.linalg.pinv(own.D)
    B, C = X @ own.Bw, -half @ half.T @ own.B.T
    later = linalg.expm(closed.T * seconds)
    forces = own.D @ C
    saved = linalg.solve_continuous_lyapunov(closed, -forces.T @ forces)
    saved = np.trace(B.T @ (saved - later.T @ saved @ later) @ B)
    least = np.sqrt(max(np.trace(own.Bw.T @ X @ own.Bw) - saved, 0.0))
    ahead = RoadPreview(seconds, closed.T, B, np.zeros_like(B), units.inputs[:, None] * C) if seconds else None
    law = on_rows(lqr.law, plant.Cy, rows)
    return replace(lqr, law=law, preview=ahead, value=float(least), without=lqr.h2_norm)


def preview(problem: DesignProblem, progress: Progress) -> DesignResult:
    """Designs the feedback law, and the additional force that is computed from the road ahead."""
    result = preview_design(problem.plant, problem.preview, problem.states, problem.plant.Cy)
    return replace(result, certificate=replace(result.certificate, below=problem.lower_bound))
