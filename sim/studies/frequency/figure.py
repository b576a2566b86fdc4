"""Figure of the frequency responses of controllers, like Fig. 3 of the paper. Lines show the results of linear analysis, and
points show those of MuJoCo.

The lines show the continuous loop or, if `[implementation]` has a sample period or a delay, the sampled loop.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from models.common.arrays import Array
from models.common.printed import as_name
from models.document.field import Field
from models.document.figure import Curve, Figure, Panel, Style
from models.roads.spectrum import as_met
from models.vehicle.names import PASSIVE
from models.vehicle.vehicle import Vehicle
from sim.drive.response import SILENT, loudest_alike
from sim.linear.frequency_response import continuous_frequency_response, sampled_frequency_response
from sim.studies.frequency.describing_function import DescribingFunction
from sim.studies.frequency.identification import Lines
from sim.studies.frequency.sinusoids import HIGHEST, LOWEST
from synth.controller.controller import Controller

POINTS = 600  # number of points of a line; neighbouring frequencies then differ by 1 %
CLOSELY = 41  # number of points that are added at each maximum and minimum of a line
EVERY = 2  # only every second measured frequency is drawn
STEP = Field[float]("timestep", lambda one: one, "g", 1e3, unit="ms")
HERTZ = Field[float]("frequency", lambda one: one, ".3g", unit="Hz")
PEAK = Field[float]("peak", lambda one: one, ".3g")
SHARE = Field[float]("share", lambda one: one, ".0f", 100, unit="%")
BAND = (LOWEST, HIGHEST)
TICKS = (0.1, 0.3, 1.0, 3.0, 10.0, 25.0)  # labelled frequencies [Hz]


def sweep_figure(
    vehicle: Vehicle,
    sweeps: Sequence[Lines],
    timestep: float,
    speed: float,
    style: Mapping[str, Style],
    own: Sequence[DescribingFunction] = (),
) -> Figure:
    """Returns the figure of response magnitudes against frequency, with a panel for each weighted signal that responds to the
    road.

    Args:
        vehicle: vehicle whose responses are drawn.
        sweeps: frequency responses of the linear controllers that are drawn.
        timestep: timestep of the simulation [s].
        speed: forward velocity of the vehicle [m/s].
        style: colour and line style of each controller, by controller name.
        own: describing functions of the nonlinear laws, which the figure shows as points without a line.
    """
    how = vehicle.implementation
    signals = [name for name, weight in vehicle.performance.items() if weight > 0]
    curves: dict[str, list[Curve]] = {name: [] for name in signals}
    for one in sweeps:
        name = one.controller.name
        look = style[name]
        fine, predicted = drawn_line(vehicle, one.controller, timestep, speed)
        for signal in signals:
            i = one.outputs.index(signal)
            sizes = np.abs(one.sampled).max(axis=0)
            if sizes[i] <= SILENT * loudest_alike(sizes, one.units)[i]:
                # The signal is zero: for example, the force of the passive vehicle, or the roll on a road whose left and right
                # sides are equal.
                continue
            curves[signal].append(Curve(fine / (2 * np.pi), predicted[:, i], name, look.color, look.dash))
            points = np.abs(one.measured[:, i])
            some = np.union1d(np.arange(0, len(points), EVERY), [points.argmax(), points.argmin()])
            at = one.omega[some] / (2 * np.pi), points[some], name
            curves[signal].append(Curve(*at, look.color, "none", look.marker, name=f"{name}, MuJoCo"))
    for one in own:
        name = one.controller.name
        look = style[name]
        for signal in signals:
            i = one.outputs.index(signal)
            if np.any(moves := ~np.isnan(one.outside[:, i])):
                at = one.omega[moves] / (2 * np.pi), np.abs(one.measured[moves, i]), name
                seen = f"{name}, fundamental in MuJoCo"
                curves[signal].append(Curve(*at, look.color, "none", look.marker, name=seen, filled=True))
    signals = [name for name in signals if curves[name]]
    panels = []
    for name in signals:
        signal = vehicle.kind.signal(name)
        unit = signal.unit.replace("s2", "s²")
        title, label = f"{name.replace('_', ' ')}, {signal.symbol}", f"per road velocity [{unit} per m/s]"
        panels.append(Panel(title, "frequency [Hz]", label, tuple(curves[name]), xlog=True, ylog=True, xticks=TICKS, xlim=BAND))
    ended = sorted({name for one in (*sweeps, *own) for name in one.ended})
    regime = f"; outside the linear regime: {', '.join(ended)}" if ended else ""
    loop = "continuous" if how.undelayed else ", ".join(how.without_noise.phrases)
    full = "; full markers show fundamentals over single sinusoids" if own else ""
    title = f"Lines show linear analysis, {loop}. Markers show MuJoCo at {STEP.text(timestep)}{full}{regime}."
    body = next((name for name in signals if name.endswith("acceleration")), signals[0])
    columns = 2 if len(signals) <= 4 else 3 if len(signals) <= 9 else 4
    finding = _lowest_peak(curves[body], body, vehicle.kind.signal(body).unit)
    return Figure("frequency-responses", title, tuple(panels), columns, finding=finding)


def _lowest_peak(curves: Sequence[Curve], signal: str, unit: str) -> str:
    """Returns a sentence that names the controller whose line has the lowest peak; empty if fewer than two lines are drawn."""
    peaks = {one.label: (float(one.y.max()), float(one.x[one.y.argmax()])) for one in curves if one.dash != "none"}
    if len(peaks) < 2:
        return ""
    least = min(peaks, key=lambda name: peaks[name])
    peak, at = peaks[least]
    share = 1 - peak / peaks[PASSIVE][0] if PASSIVE in peaks else 0.0
    against = f", {SHARE.text(share)} below {as_name(PASSIVE)}" if share >= 0.005 else ""
    size = f"{PEAK.text(peak)} {unit} per m/s at {HERTZ.text(at)}"
    return f"{as_name(least)} has the lowest peak of {signal.replace('_', ' ')}: {size}{against}."


def drawn_line(vehicle: Vehicle, controller: Controller, timestep: float, speed: float) -> tuple[Array, Array]:
    """Returns the frequencies of a drawn line [rad/s], shape (F,), and the magnitudes of all output signals at these
    frequencies, shape (F, S).

    The frequencies are closely spaced near the maxima and minima of the outputs.
    """

    def magnitudes(omega: Array) -> Array:
        if vehicle.implementation.undelayed:
            response = continuous_frequency_response(vehicle, controller, omega)
        else:  # for a loop with a sample period or a delay, the line shows the sampled loop
            response = sampled_frequency_response(vehicle, controller, omega, timestep)
        return np.abs(response @ as_met(vehicle, omega, speed)[..., None])[..., 0]

    grid = 2 * np.pi * np.geomspace(LOWEST, HIGHEST, POINTS)
    coarse = magnitudes(grid)
    around = np.unique([coarse.argmax(axis=0), coarse.argmin(axis=0)])
    between = [np.geomspace(grid[max(i - 1, 0)], grid[min(i + 1, POINTS - 1)], CLOSELY) for i in around]
    closely = np.concatenate(between)
    omega, order = np.unique(np.concatenate([grid, closely]), return_index=True)
    return omega, np.concatenate([coarse, magnitudes(closely)])[order]
