"""Figures in a notebook, below the table of an object."""

import hashlib
from html import escape

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.document.figure import Curve, Dash, Figure, Panel, legend
from models.document.picture import check_drawing, key_svg, panel_svg

POINTS = 400  # of a curve over frequency
BLUE, RED, GREY, DARK = "#1f77b4", "#d62728", "#888888", "#404040"
STYLE = """<style>
.roadproof {max-width: 480px; margin: 0}
.roadproof text {font: 13px sans-serif; fill: currentColor}
.roadproof figcaption svg {width: 34px; height: 14px; vertical-align: middle}
</style>"""


def notebook_figure(panel: Panel) -> str:
    """Returns a panel as an HTML figure, with title and legend as its caption; without matplotlib, a line on its installation."""
    try:
        check_drawing()
    except InputError:
        return "<p>Figures need matplotlib: pip install 'roadproof[report]'.</p>"
    name = hashlib.sha256(repr((panel.title, [curve.y.tobytes() for curve in panel.curves])).encode()).hexdigest()[:16]
    entries = enumerate(legend(Figure(name, "", (panel,))))
    keys = [f"{key_svg(entry, f'{name}-{k}')} {escape(entry.label)}" for k, entry in entries]  # one page has many figures
    caption = " &#8195; ".join([escape(panel.title), *keys])
    return f'{STYLE}<figure class="roadproof"><figcaption>{caption}</figcaption>{panel_svg(panel, name)}</figure>'


def gain_curve(A: Array, B: Array, C: Array, D: Array, dt: float | None = None) -> tuple[Array, Array]:
    """Returns frequencies around the poles of a system [rad/s], and its largest singular value there, shapes (POINTS,).

    Args:
        A, B, C, D: the system, shapes (n, n), (n, r), (p, n), (p, r).
        dt: sample period [s]; None for a continuous system.
    """
    poles = np.linalg.eigvals(A).astype(complex)
    speeds = np.abs(poles if dt is None else np.log(np.where(poles == 0, 1, poles)) / dt)
    speeds = speeds[speeds > 1e-9 * speeds.max(initial=0.0)]
    low, high = (speeds.min(), speeds.max()) if len(speeds) else (1.0, 1.0)
    omega = np.geomspace(low / 10, 10 * high if dt is None else np.pi / dt, POINTS)
    points = 1j * omega if dt is None else np.exp(1j * omega * dt)
    response = C @ np.linalg.solve(points[:, None, None] * np.eye(len(A)) - A, B) + D
    return omega, np.linalg.norm(response, 2, axis=(1, 2))


def gain_panel(title: str, omega: Array, curve: Array, levels: dict[str, float]) -> Panel:
    """Returns a panel with a gain over frequency, and horizontal lines at given levels.

    Args:
        omega: frequencies [rad/s], shape (N,).
        curve: largest singular value at each, shape (N,).
        levels: horizontal lines by name, at most two.
    """
    dashes: tuple[Dash, ...] = ("dash", "dot")
    lines = [
        Curve(omega[[0, -1]], np.full(2, level), label=name, color=GREY, dash=dash)
        for (name, level), dash in zip(levels.items(), dashes, strict=False)
    ]
    curves = (*lines, Curve(omega, curve, color=BLUE))
    return Panel(title, "frequency [rad/s]", "gain [-]", curves, xlog=True, ylog=True)
