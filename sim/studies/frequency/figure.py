"""Frequency responses drawn as in the paper's Fig. 3: lines are analysis, points are MuJoCo.

The lines are of the paper's continuous loop, or, where the controller is slower or later than the timestep, of the loop as built.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from models.common.arrays import Array
from models.figures.figure import Curve, Dash, Figure, Panel
from models.roads.spectrum import as_met
from models.vehicle.vehicle import Vehicle
from sim.linear.frequency_response import continuous_frequency_response, sampled_frequency_response
from sim.response.response import SILENT
from sim.studies.frequency.describing_function import DescribingFunction
from sim.studies.frequency.identification import HIGHEST, LOWEST, Lines
from synth.controller.controller import Controller

POINTS = 600  # of a line, as far apart as a hundredth of their frequency
CLOSELY = 41  # more where it is largest or least
TICKS = (0.1, 0.3, 1.0, 3.0, 10.0, 25.0)  # Hz


def sweep_figure(
    vehicle: Vehicle,
    sweeps: Sequence[Lines],
    amplitude: float,
    timestep: float,
    speed: float,
    style: Mapping[str, tuple[str, Dash]],
    own: Sequence[DescribingFunction] = (),
) -> Figure:
    """Magnitudes of all weighted signals that answer over frequency, one panel each.

    Args:
        vehicle: the vehicle; the signals it weighs are drawn.
        amplitude: largest height of the roads [m], for the caption.
        timestep: [s], for the caption.
        speed: forward velocity [m/s].
        style: colour and line style of every controller.
        own: of laws in Python, which have points and no line.
    """
    how = vehicle.implementation
    signals = [name for name, weight in vehicle.performance.items() if weight > 0]
    curves: dict[str, list[Curve]] = {name: [] for name in signals}
    for one in sweeps:
        name = one.controller.name
        color, dash = style[name]
        fine, predicted = drawn_line(vehicle, one.controller, timestep, speed)
        for signal in signals:
            i = one.outputs.index(signal)
            alike = [k for k, unit in enumerate(one.units) if unit == one.units[i]]
            if np.abs(one.sampled[:, i]).max() <= SILENT * np.abs(one.sampled[:, alike]).max():
                continue  # no control force, or no roll on a road that is the same on both sides
            curves[signal].append(Curve(fine / (2 * np.pi), predicted[:, i], name, color, dash))
            points = np.abs(one.measured[:, i])
            curves[signal].append(Curve(one.omega / (2 * np.pi), points, "", color, "none", "o", name=f"{name}, MuJoCo"))
    for one in own:
        name = one.controller.name
        for signal in signals:
            i = one.outputs.index(signal)
            if np.any(moves := ~np.isnan(one.outside[:, i])):
                hertz, points = one.omega[moves] / (2 * np.pi), np.abs(one.measured[moves, i])
                curves[signal].append(
                    Curve(hertz, points, name, style[name][0], "none", "x", name=f"{name}, fundamental in MuJoCo")
                )
    signals = [name for name in signals if curves[name]]
    curves[signals[0]].append(Curve(np.zeros(0), np.zeros(0), "MuJoCo", "#666666", "none", "o"))

    panels = []
    for name in signals:
        signal = vehicle.kind.signal(name)
        unit = signal.unit.replace("s2", "s²")
        panels.append(
            Panel(
                title=f"{name.replace('_', ' ')}, {signal.symbol}",
                xlabel="frequency [Hz]",
                ylabel=f"per road velocity [{unit} per m/s]",
                curves=tuple(curves[name]),
                xlog=True,
                ylog=True,
                xticks=TICKS,
                xlim=(LOWEST, HIGHEST),
            )
        )
    ended = sorted({name for one in (*sweeps, *own) for name in one.ended})
    regime = f"; outside the linear regime: {', '.join(ended)}" if ended else ""
    loop = "continuous" if how.undelayed else f"as built, {', '.join(how.without_noise.phrases)}"
    without = f" without its {how.noise_text}" if how.has_measurement_noise else ""
    crosses = "; crosses: the fundamental that a law that is not linear makes of one sinusoid at a time" if own else ""
    title = (
        f"{vehicle.kind.name.replace('_', ' ')}: response to road velocity. Lines: linear analysis, {loop}. Points: MuJoCo "
        f"at {1e3 * timestep:g} ms,\nidentified{without} on roads of {1e3 * amplitude:g} mm{crosses}{regime}"
    )
    return Figure("sweep", title, tuple(panels), columns=2 if len(signals) <= 4 else 3 if len(signals) <= 9 else 4)


def drawn_line(vehicle: Vehicle, controller: Controller, timestep: float, speed: float) -> tuple[Array, Array]:
    """Returns the frequencies of a drawn line [rad/s], shape (F,), dense about its extremes, and its magnitudes, shape (F, S)."""

    def magnitudes(omega: Array) -> Array:
        if vehicle.implementation.undelayed:
            response = continuous_frequency_response(vehicle, controller, omega)
        else:  # no step makes this loop continuous
            response = sampled_frequency_response(vehicle, controller, omega, timestep)
        return np.abs(response @ as_met(vehicle, omega, speed)[..., None])[..., 0]

    grid = 2 * np.pi * np.geomspace(LOWEST, HIGHEST, POINTS)
    coarse = magnitudes(grid)
    around = np.unique([coarse.argmax(axis=0), coarse.argmin(axis=0)])
    between = [np.geomspace(grid[max(i - 1, 0)], grid[min(i + 1, POINTS - 1)], CLOSELY) for i in around]
    closely = np.concatenate(between)
    omega, order = np.unique(np.concatenate([grid, closely]), return_index=True)
    return omega, np.concatenate([coarse, magnitudes(closely)])[order]
