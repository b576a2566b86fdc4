"""The damper diagram: what a suspension pulls with over how fast, or how far, it is stretched, beside its curve or its limits."""

from collections.abc import Sequence

import numpy as np

from models.figures.figure import Curve, Figure, Panel
from sim.acting.diagram import Diagram, diagrams
from sim.report.scope import Scope
from sim.runs.run import Run

POINTS = 400  # of MuJoCo
ROOM = 1.15  # times what was reached, on both axes
OF_LINE = 600  # points of a curve


def suspension_figure(scope: Scope, runs: Sequence[Run], where: str) -> Figure | None:
    """Force over velocity of every damper that has a curve or is adjustable, over deflection of every spring with a curve.

    Args:
        scope: what the report is about.
        runs: one of every controller.
        where: over which road, in words.

    Returns:
        The figure; None of a vehicle with neither.
    """
    found = diagrams(scope.vehicle)
    if not found:
        return None
    title = (
        f"What dampers and springs pull with {where}, beside their curves or limits, and the lines of linear analysis.\n"
        "Points: MuJoCo, a damper with its actuator"
    )
    panels = tuple(_panel(scope, diagram, runs) for diagram in found)
    return Figure("suspension", title, panels, columns=min(2, len(panels)))


def _panel(scope: Scope, diagram: Diagram, runs: Sequence[Run]) -> Panel:
    """The panel of a diagram: its lines as far as any run went, and a point at every so many samples."""
    points, far, high = [], 1e-3, 0.0
    for run in runs:
        response = run.physics.until(run.broke_off[1]) if run.broke_off is not None else run.physics
        x = diagram.x(response)
        force, (color, _) = diagram.force(x, response), scope.styles[run.controller.name]
        every = max(1, len(x) // POINTS)
        points.append(Curve(x[::every], force[::every], run.controller.name, color, "none", "o"))
        far, high = max(far, float(np.abs(x).max(initial=0.0))), max(high, float(np.abs(force).max(initial=0.0)))
    x = np.linspace(-ROOM * far, ROOM * far, OF_LINE)
    lines = [Curve(x, one.force(x), one.label, "#000000", one.dash, width=one.width) for one in diagram.lines]
    high = ROOM * max(high, *(float(np.abs(line.y).max()) for line in lines if line.dash == "solid"))
    limits = (-ROOM * far, ROOM * far), (-high, high)
    return Panel(diagram.title, diagram.over, "force [N]", (*points, *lines), None, xlim=limits[0], ylim=limits[1])
