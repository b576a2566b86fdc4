"""Frequency responses drawn as in the paper's Fig. 3: lines are analysis, points are MuJoCo."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.vehicle import Vehicle
from sim.frequency import as_met, continuous_frequency_response
from sim.identification import HIGHEST, LOWEST, Lines
from sim.picture import new_figure, save

# The paper's colours and line styles; whatever else is asked for comes after.
STYLES: dict[str, tuple[str, Any]] = {
    "passive": ("black", ":"),
    "state": ("tab:blue", "--"),
    "I": ("tab:red", "-."),
    "II": ("tab:green", "-"),
}
OTHERS = [(color, (0, (8, 2))) for color in ("tab:purple", "tab:orange", "tab:brown", "tab:cyan", "tab:pink", "tab:olive")]


def draw_lines(path: Path, vehicle: Vehicle, sweeps: Sequence[Lines], amplitude: float, timestep: float, speed: float) -> None:
    """Magnitudes of all weighted signals over frequency, one panel each.

    Args:
        path: .png or .svg.
        vehicle: the vehicle; the signals it weighs are drawn.
        sweeps: one per controller.
        amplitude: largest height of the roads [m], for the caption.
        timestep: [s], for the caption.
        speed: forward velocity [m/s].
    """
    signals = [name for name, weight in vehicle.performance.items() if weight > 0]
    columns = 2 if len(signals) <= 4 else 3 if len(signals) <= 9 else 4
    rows = -(-len(signals) // columns)
    figure = new_figure(5.2 * columns, 3.5 * rows + 1.0)
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()

    fine = 2 * np.pi * np.geomspace(LOWEST, HIGHEST, 600)
    met = as_met(vehicle, fine, speed)[..., None]
    others = iter(OTHERS * len(sweeps))
    for one in sweeps:
        color, style = STYLES.get(one.controller.name) or next(others)
        curves = np.abs(continuous_frequency_response(vehicle, one.controller, fine) @ met)[..., 0]
        for axis, name in zip(axes, signals, strict=False):
            i = one.outputs.index(name)
            if not np.any(one.measured[:, i]):
                continue  # no control force
            axis.plot(fine / (2 * np.pi), curves[:, i], color=color, linestyle=style, linewidth=1.5, label=one.controller.name)
            points = np.abs(one.measured[:, i])
            axis.plot(one.omega / (2 * np.pi), points, "o", color=color, markersize=3.6, markerfacecolor="white", zorder=3)

    for axis, name in zip(axes, signals, strict=False):
        signal = vehicle.kind.signal(name)
        axis.set(xscale="log", yscale="log", xlim=(LOWEST, HIGHEST))
        unit = signal.unit.replace("s2", "s²")
        axis.set_title(f"{name.replace('_', ' ')}, {signal.symbol}", fontsize=10)
        axis.set_ylabel(f"per road velocity [{unit} per m/s]", fontsize=9)
        axis.set_xticks([0.1, 0.3, 1, 3, 10, 25], ["0.1", "0.3", "1", "3", "10", "25"])
        axis.tick_params(axis="x", which="minor", labelbottom=False)
        axis.grid(which="major", color="0.85", linewidth=0.7)
    for i, axis in enumerate(axes):
        if i >= len(signals):
            axis.set_visible(False)
        elif i + columns >= len(signals):
            axis.tick_params(labelbottom=True)
            axis.set_xlabel("frequency [Hz]", fontsize=9)

    axes[0].plot([], [], "o", color="0.4", markerfacecolor="white", markersize=4, label="MuJoCo")
    lines, labels = axes[0].get_legend_handles_labels()
    figure.legend(lines, labels, loc="outside lower center", ncols=len(lines), fontsize=9, frameon=False)
    ended = sorted({name for one in sweeps for name in one.ended})
    regime = f"; outside the linear regime: {', '.join(ended)}" if ended else ""
    figure.suptitle(
        f"{vehicle.kind.name.replace('_', ' ')}: response to road velocity. Lines: linear analysis, continuous. Points: MuJoCo "
        f"at {1e3 * timestep:g} ms,\nidentified on roads of {1e3 * amplitude:g} mm{regime}",
        fontsize=11,
    )
    save(figure, path)
