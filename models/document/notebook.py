"""Figure of a gain against frequency, which a notebook shows below the text about a control loop."""

from collections.abc import Mapping

import numpy as np

from models.common.arrays import Array
from models.document.figure import BLUE, GREY, Curve, Dash, Figure, Panel

POINTS = 400  # number of points of a curve over frequency


def gain_figure(
    title: str, A: Array, B: Array, C: Array, D: Array, dt: float | None = None, levels: Mapping[str, float | None] | None = None
) -> Figure:
    """Returns the figure of a system's largest singular value against frequency; the frequency range covers the poles of the
    system.

    Args:
        title: description of the system.
        A: state matrix, shape (n, n).
        B: input matrix, shape (n, r).
        C: output matrix, shape (p, n).
        D: feedthrough matrix, shape (p, r).
        dt: sample period [s]; None for a continuous system.
        levels: gains that are marked by horizontal lines, at most two, by name of the line; a line with the gain None is
            omitted.
    """
    poles = np.linalg.eigvals(A).astype(complex)
    speeds = np.abs(poles if dt is None else np.log(np.where(poles == 0, 1, poles)) / dt)
    speeds = speeds[speeds > 1e-9 * speeds.max(initial=0.0)]
    low, high = (speeds.min(), speeds.max()) if len(speeds) else (1.0, 1.0)
    omega = np.geomspace(low / 10, 10 * high if dt is None else np.pi / dt, POINTS)
    points = 1j * omega if dt is None else np.exp(1j * omega * dt)
    response = C @ np.linalg.solve(points[:, None, None] * np.eye(len(A)) - A, B) + D
    dashes: tuple[Dash, ...] = ("dash", "dot")
    known = [(name, level) for name, level in (levels or {}).items() if level is not None]
    lines = [
        Curve(omega[[0, -1]], np.full(2, level), label=name, color=GREY, dash=dash)
        for (name, level), dash in zip(known, dashes, strict=False)
    ]
    curves = (*lines, Curve(omega, np.linalg.norm(response, 2, axis=(1, 2)), color=BLUE, name="gain"))
    return Figure("gain", title, (Panel("", "frequency [rad/s]", "gain [-]", curves, xlog=True, ylog=True),), columns=1)
