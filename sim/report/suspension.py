"""The damper diagram: what a suspension pulls with over how fast, or how far, it is stretched, beside its curve or its limits."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.curves.fitted import Fitted
from models.curves.reading import VELOCITY
from models.damping.adjustable import Adjustable
from models.figures.figure import Curve, Dash, Figure, Panel
from models.vehicle import Vehicle
from sim.linear.dampers import stretching
from sim.report.scope import Scope
from sim.response.regime import over
from sim.response.response import Response
from sim.runs.run import Run

POINTS = 400  # of MuJoCo
ROOM = 1.15  # times what was reached, on both axes
OF_LINE = 600  # points of a curve


@dataclass(frozen=True, eq=False)
class _Diagram:
    """One panel.

    Attributes:
        title: of the parameter, and where.
        over: what the force is over, in words with the unit.
        x: that of a response, shape (T,).
        force: what pulls together at those x in the response [N], shape (T,).
        lines: forces over x that are drawn, with the label, dash and width of each.
    """

    title: str
    over: str
    x: Callable[[Response], Array]
    force: Callable[[Array, Response], Array]
    lines: tuple[tuple[Callable[[Array], Array], str, Dash, float], ...]


def suspension_figure(scope: Scope, runs: Sequence[Run], where: str) -> Figure | None:
    """Force over velocity of every damper that has a curve or is adjustable, over deflection of every spring with a curve.

    Args:
        scope: what the report is about.
        runs: one of every controller.
        where: over which road, in words.

    Returns:
        The figure; None of a vehicle with neither.
    """
    diagrams = _diagrams(scope.vehicle)
    if not diagrams:
        return None
    title = (
        f"What dampers and springs pull with {where}, beside their curves or limits, and the lines of linear analysis.\n"
        "Points: MuJoCo, a damper with its actuator"
    )
    panels = tuple(_panel(scope, diagram, runs) for diagram in diagrams)
    return Figure("suspension", title, panels, columns=min(2, len(panels)))


def _diagrams(vehicle: Vehicle) -> list[_Diagram]:
    """Those of a vehicle's curves, then of its adjustable dampers."""
    adjusted = {vehicle.kind.pushed(one.force) for one in vehicle.adjustable}
    alone = [one for one in vehicle.fitted if one.over is not VELOCITY or one.deflection not in adjusted]
    return [*(_of_curve(vehicle, one) for one in alone), *(_of_adjustable(vehicle, one) for one in vehicle.adjustable)]


def _of_curve(vehicle: Vehicle, one: Fitted) -> _Diagram:
    signal = vehicle.kind.signal(over(vehicle, one))
    actuator = next(each.force for each in vehicle.kind.suspensions if each.deflection == one.deflection)
    pushed = one.over is VELOCITY and actuator in vehicle.linear_model.inputs
    words = signal.name.replace("_", " ")
    return _Diagram(
        f"{one.parameter.replace('_', ' ')}, {words}",
        f"{words} [{signal.unit}]",
        lambda response: response[signal.name],
        lambda x, response: one.curve(x) - (response[actuator] if pushed else 0.0),
        ((one.curve, "curve", "solid", 1.8), (lambda x: one.curve.slope * x, "line at rest", "dash", 1.0)),
    )


def _of_adjustable(vehicle: Vehicle, one: Adjustable) -> _Diagram:
    model, damper = vehicle.linear_model, one.damper
    row = stretching(vehicle)[model.inputs.index(one.force)]
    place = one.ending.replace("_", " ")

    def beside(x: Array) -> Array:
        return one.beside.pieces.force(x) if one.beside is not None else np.zeros_like(x)

    return _Diagram(
        f"adjustable damper{place}",
        f"suspension velocity{place} [m/s]",
        lambda response: np.stack([response[name] for name in model.states], axis=-1) @ row,
        lambda x, response: one.nominal * x + beside(x) - response[one.force],
        (
            (lambda x: damper.c_min * x + beside(x), "c_min", "solid", 1.8),
            (lambda x: damper.c_max * x + beside(x), "c_max", "solid", 1.8),
            (lambda x: one.nominal * x, "line at rest", "dash", 1.0),
        ),
    )


def _panel(scope: Scope, diagram: _Diagram, runs: Sequence[Run]) -> Panel:
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
    lines = [Curve(x, line(x), label, "#000000", dash, width=width) for line, label, dash, width in diagram.lines]
    high = ROOM * max(high, *(float(np.abs(line.y).max()) for line in lines if line.dash == "solid"))
    limits = (-ROOM * far, ROOM * far), (-high, high)
    return Panel(diagram.title, diagram.over, "force [N]", (*points, *lines), None, xlim=limits[0], ylim=limits[1])
