"""The map of validity, drawn so that it needs no explanation."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from models.curves.curve import LEAVES
from models.figures.figure import Classes, Curve, Figure, Panel, level
from models.loads.load import Load
from models.roads.loaded import PLUS
from models.vehicle import Vehicle
from sim.linear.curved import is_curved
from sim.response.regime import CURVE, REGIME_ENDS, End
from sim.validity.cells import Cells
from synth.controller import Controller

if TYPE_CHECKING:
    from sim.validity.grid import Axis

LABELS = {"height": "bump height [m]", "length": "bump length [m]", "speed": "speed [m/s]"}
NOTHING, UNKNOWN = "#dcefdc", "#ffffff"


def envelope_figure(
    vehicle: Vehicle,
    controller: Controller,
    cells: Cells,
    axes: "Sequence[Axis]",
    fixed: Mapping[str, float],
    threshold: float,
    loads: Sequence[Load] = (),
) -> Figure:
    """Colours say what broke first in MuJoCo; the solid line is what linear analysis predicts; dashed, where its error passes.

    Args:
        vehicle: the vehicle.
        controller: its controller.
        cells: of the grid, the second axis running faster.
        axes: vertical and horizontal.
        fixed: what is not varied.
        threshold: error at which linear analysis is said to hold.
        loads: on the body over every bump.
    """
    # Height, or else length, is vertical, whatever order was asked for.
    shape = (len(axes[0].values), len(axes[1].values))
    turned = axes[1].name == "height" or axes[0].name == "speed"
    vertical, horizontal = (axes[1], axes[0]) if turned else (axes[0], axes[1])

    def plane(values):
        return values.reshape(shape).T if turned else values.reshape(shape)

    x, y = np.array(horizontal.values), np.array(vertical.values)
    broke = np.where(cells.done, cells.first, -2)
    colors = (UNKNOWN, NOTHING, *(end.color for end in REGIME_ENDS))
    first = (f"{end.name} breaks first{_at(vehicle, end)}" for end in REGIME_ENDS)
    nothing = "nothing breaks: the regime is linear" if not cells.short else "nothing breaks; its dampers are short of force"
    ground = Classes(x, y, plane(broke + 2), colors, ("", nothing, *first))

    curves = []

    used = plane(np.where(cells.done, cells.used.max(axis=-1), np.nan))
    if np.nanmin(used) < 1 < np.nanmax(used):
        whose = "from its response with dampers" if cells.short else "from one linear run"
        whose = "from responses with its curves" if is_curved(vehicle) else whose
        whose = whose.replace("one linear run", "linear runs") + " under the loads" if loads else whose
        curves.append(Curve(*level(x, y, np.log(used), 0.0), f"predicted end, {whose}", "#000000", width=1.8))
    error = plane(np.where(cells.done, np.clip(cells.error, threshold / 10, 10 * threshold), np.nan))
    if np.nanmin(error) < threshold < np.nanmax(error):
        text = f"linear prediction off by {100 * threshold:g} % of a peak"
        curves.append(Curve(*level(x, y, np.log(error), float(np.log(threshold))), text, "#b22222", "dash", width=1.6))
    wrong = cells.done & ~cells.agrees
    if np.any(wrong):
        row, column = np.nonzero(plane(wrong))
        curves.append(Curve(x[column], y[row], "another end than predicted", "#000000", "none", "x"))

    rest = ", ".join(
        f"{LABELS[name].split(' [')[0]} {value:g} {LABELS[name].split('[')[1][:-1]}" for name, value in fixed.items()
    )
    which = "analysis with adjustable dampers" if cells.short else "linear analysis"
    ends = (
        f"end the analysis with its dampers as predicted; {cells.short}" if cells.short else "end the linear regime as predicted"
    )
    rest += f", under {PLUS.join(load.label for load in loads)}" if loads else ""
    title = (
        f"How far {which} may be trusted: {vehicle.kind.name.replace('_', ' ')}, controller {controller.name}, {rest}\n"
        f"{100 * cells.agreement:.4g} % of {cells.counted('MuJoCo runs')} {ends}"
    )
    panel = Panel("", LABELS[horizontal.name], LABELS[vertical.name], tuple(curves), ground)
    return Figure("envelope", title, (panel,), columns=1, size=(9.0, 5.2))


def _at(vehicle: Vehicle, end: End) -> str:
    """Where the vehicle has a limit that was chosen for it, the same either way; of a curve how far off its line that is."""
    if end is CURVE:
        return f" (off its line by {100 * LEAVES:g} % of its largest force)"
    values = {(limit.value, vehicle.kind.signal(limit.signal).unit) for limit in end.thresholds(vehicle) if not limit.sign}
    return "".join(f" (at ±{value:g} {unit})" for value, unit in values)
