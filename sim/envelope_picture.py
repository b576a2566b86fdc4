"""The map of validity, drawn so that it needs no explanation."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from models.vehicle import Vehicle
from sim.broken import ENDS
from sim.picture import new_figure, save
from sim.validity import Cells
from synth.controller import Controller

if TYPE_CHECKING:
    from sim.envelope import Axis

LABELS = {"height": "bump height [m]", "length": "bump length [m]", "speed": "speed [m/s]"}
NOTHING, UNKNOWN = "#dcefdc", "white"
COLORS = ("#7aa6d8", "#e8955a", "#c9a3d9", "#555555")  # of ENDS


def draw_envelope(
    path: Path,
    vehicle: Vehicle,
    controller: Controller,
    cells: Cells,
    axes: "Sequence[Axis]",
    fixed: Mapping[str, float],
    threshold: float,
) -> None:
    """Colours say what broke first in MuJoCo; the solid line is what linear analysis predicts; dashed, where its error passes.

    Args:
        path: .png or .svg.
        vehicle: the vehicle.
        controller: its controller.
        cells: of the grid, the second axis running faster.
        axes: vertical and horizontal.
        fixed: what is not varied.
        threshold: error at which linear analysis is said to hold.
    """
    from matplotlib.colors import ListedColormap
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    # Height, or else length, is vertical, whatever order was asked for.
    shape = (len(axes[0].values), len(axes[1].values))
    turned = axes[1].name == "height" or axes[0].name == "speed"
    vertical, horizontal = (axes[1], axes[0]) if turned else (axes[0], axes[1])

    def plane(values):
        return values.reshape(shape).T if turned else values.reshape(shape)

    figure = new_figure(10.4, 5.8)
    axis = figure.subplots()
    x, y = np.array(horizontal.values), np.array(vertical.values)
    broke = np.where(cells.done, cells.first, -2)
    axis.pcolormesh(x, y, plane(broke), cmap=ListedColormap([UNKNOWN, NOTHING, *COLORS]), vmin=-2.5, vmax=len(ENDS) - 0.5)

    limits = vehicle.limits
    values = dict.fromkeys(ENDS, "")
    if limits.suspension_stroke is not None:
        values["bump stop"] = f" (at ±{limits.suspension_stroke:g} m)"
    if limits.actuator_force is not None:
        values["force saturation"] = f" (at ±{limits.actuator_force:g} N)"
    legend: list = [Patch(color=NOTHING, label="nothing: the regime is linear")]
    legend += [Patch(color=COLORS[i], label=end + values[end]) for i, end in enumerate(ENDS) if np.any(broke == i)]
    used = plane(np.where(cells.done, cells.used.max(axis=-1), np.nan))
    if np.nanmin(used) < 1 < np.nanmax(used):
        axis.contour(x, y, np.log(used), levels=[0.0], colors="black", linewidths=1.8)
        legend.append(
            Line2D([], [], color="black", linewidth=1.8, label="predicted end of the linear\nregime, from one linear run")
        )
    error = plane(np.where(cells.done, np.clip(cells.error, threshold / 10, 10 * threshold), np.nan))
    if np.nanmin(error) < threshold < np.nanmax(error):
        axis.contour(x, y, np.log(error), levels=[np.log(threshold)], colors="firebrick", linewidths=1.6, linestyles="--")
        text = f"linear prediction off by {100 * threshold:g} %\nof a signal's peak"
        legend.append(Line2D([], [], color="firebrick", linewidth=1.6, linestyle="--", label=text))
    wrong = cells.done & ~cells.agrees
    if np.any(wrong):
        row, column = np.nonzero(plane(wrong))
        axis.plot(x[column], y[row], "x", color="black", markersize=6)
        legend.append(Line2D([], [], color="black", marker="x", linestyle="", label="another end than predicted"))

    axis.set(xlabel=LABELS[horizontal.name], ylabel=LABELS[vertical.name])
    figure.legend(
        handles=legend,
        loc="outside right upper",
        title="What breaks first, in MuJoCo",
        frameon=False,
        alignment="left",
        fontsize=9,
    )
    rest = ", ".join(
        f"{LABELS[name].split(' [')[0]} {value:g} {LABELS[name].split('[')[1][:-1]}" for name, value in fixed.items()
    )
    axis.set_title(
        f"How far linear analysis may be trusted: {vehicle.kind.name.replace('_', ' ')}, controller {controller.name}, {rest}\n"
        f"{100 * cells.agreement:.4g} % of {int(cells.done.sum())} MuJoCo runs end the linear regime as predicted",
        fontsize=10,
    )
    save(figure, path)
