"""The figure of a gain over frequency, as notebooks show it below a loop."""

from collections.abc import Mapping

import numpy as np

from models.common.arrays import Array
from models.document.figure import BLUE, GREY, Curve, Dash, Figure, Panel

POINTS = 400  # of a curve over frequency


def gain_figure(
    title: str, A: Array, B: Array, C: Array, D: Array, dt: float | None = None, levels: Mapping[str, float | None] | None = None
) -> Figure:
    """Returns the figure of a system's largest singular value over frequency, around its poles.

    Args:
        title: description of the system.
        A, B, C, D: the system, shapes (n, n), (n, r), (p, n), (p, r).
        dt: sample period [s]; None for a continuous system.
        levels: horizontal lines by name, at most two; a line without a level is left out.
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
