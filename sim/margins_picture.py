"""Margins drawn: how fast the loop grows or decays with more gain, delay and sample period, and its norm on other vehicles."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from models.arrays import Array
from models.reality import Implementation
from models.vehicle import Vehicle
from sim.bisection import Search
from sim.linear import sampled_radius
from sim.loop_margins import LoopMargins
from sim.picture import new_figure, save
from sim.robustness import BOX, MASS, TYRES, Robustness
from synth.controller import Controller

POINTS = 30  # of a predicted curve
DECAYS, GROWS, LINE = "tab:blue", "tab:red", "0.25"


def draw_margins(
    path: Path, vehicle: Vehicle, controller: Controller, loop: LoopMargins, box: Robustness, timestep: float
) -> None:
    """Lines are the poles of the implemented linear loop, points are MuJoCo's runs: where both cross zero is the margin.

    Args:
        path: .png or .svg.
        vehicle: the vehicle, its controller ideal.
        controller: its controller.
        loop: all its loops at once.
        box: the controller on other vehicles.
        timestep: of the physics [s].
    """
    figure = new_figure(10.4, 7.4)
    axes = figure.subplots(2, 2).ravel()

    def rate(vehicle: Vehicle, controller: Controller) -> float:
        return math.log(sampled_radius(vehicle, controller, timestep)) / timestep

    def of_gain(factor: float) -> float:
        return rate(vehicle, replace(controller, gain=factor * controller.gain))

    def of_delay(seconds: float) -> float:
        return rate(replace(vehicle, implementation=Implementation(delay=round(seconds / timestep))), controller)

    def of_period(seconds: float) -> float:
        held = max(1, round(seconds / timestep)) * timestep
        return rate(replace(vehicle, implementation=Implementation(sample_period=held)), controller)

    gain = [("more gain, all loops at once", loop.gain, of_gain, 1.0, "factor on the gain", "")]
    times: list[tuple[str, Search, Callable[[float], float], float, str, str]] = [
        ("delay from measurement to force", loop.delay, of_delay, 1e3, "delay [ms]", " ms"),
        ("sample period of the controller", loop.sample_period, of_period, 1e3, "sample period [ms]", " ms"),
    ]
    predicted = [loop.sampled_gain, loop.predicted.delay, loop.predicted.sample_period]
    found = [loop.gain.found, loop.delay.unstable, loop.found_sample_period]
    for axis, (title, search, growth, scale, label, unit), at, seen in zip(axes, gain + times, predicted, found, strict=False):
        _draw_search(axis, search, growth, scale)
        numbers = [f"{scale * value:.4g}{unit}" if math.isfinite(value) else "any" for value in (at, seen)]
        if search is loop.gain and loop.bears:
            title = "more gain: any; what ends it is the sampling"
        axis.set_title(f"{title}\nbears, predicted: {numbers[0]}; in MuJoCo: {numbers[1]}", fontsize=10)
        axis.set_xlabel(label, fontsize=9)
        axis.set_ylabel("growth of the loop [1/s]", fontsize=9)
    _draw_box(axes[3], vehicle, controller, box)
    figure.suptitle(
        f"{vehicle.kind.name.replace('_', ' ')}, controller {controller.name}: what its loop bears. Lines: poles of the sampled "
        f"linear loop. Points: MuJoCo runs at {1e3 * timestep:g} ms",
        fontsize=11,
    )
    save(figure, path)


def _draw_search(axis, search: Search, growth: Callable[[float], float], scale: float) -> None:
    """One panel: the predicted rate over the amount, and that of the runs near where it changes its sign."""
    # Far from the margin nothing is to be seen, and the rates are large.
    end = 1.35 * search.unstable if math.isfinite(search.unstable) else max(search.tried)
    amounts: Array = np.linspace(0.0, end, POINTS)
    if not search.step:
        amounts = np.linspace(1.0, end, POINTS) if end > 1 else amounts
    rates = np.array([growth(amount) for amount in amounts])
    axis.plot(scale * amounts, rates, color=LINE, linewidth=1.4, label="linear analysis")
    axis.set_ylim(1.3 * rates.min(), min(1.1 * rates.max(), -4 * rates.min()) if rates.max() > 0 else -0.3 * rates.min())
    for grows, color, marker, label in ((False, DECAYS, "o", "MuJoCo decays"), (True, GROWS, "x", "MuJoCo grows")):
        runs = {a: one.rate for a, one in search.tried.items() if one.grows == grows and a <= end and math.isfinite(one.rate)}
        x, y = scale * np.array(list(runs)), list(runs.values())
        face = {"markerfacecolor": "white"} if marker == "o" else {}
        axis.plot(x, y, marker, color=color, markersize=5, label=label, zorder=3, **face)
    axis.axhline(0.0, color="black", linewidth=0.8)
    axis.grid(color="0.9", linewidth=0.7)
    axis.legend(fontsize=8, frameon=False)


def _draw_box(axis, vehicle: Vehicle, controller: Controller, box: Robustness) -> None:
    """The last panel: the norm over sprung mass and tyre stiffness, with what physics did at the corners."""
    mass, tyres = (100 * (factors - 1) for factors in box.factors)
    shown = np.ma.masked_invalid(np.where(np.isfinite(box.norms), box.norms, np.nan)).T
    image = axis.contourf(mass, tyres, shown, levels=14, cmap="YlOrBr")
    axis.figure.colorbar(image, ax=axis, label="H-infinity norm")
    corners: Sequence[tuple[float, float]] = [(m, k) for m in BOX[MASS] for k in BOX[TYRES]]
    for (m, k), corner in zip(corners, box.corners, strict=True):
        fine = corner.decays and corner.agrees
        axis.plot(
            100 * (m - 1),
            100 * (k - 1),
            "o" if fine else "x",
            color=DECAYS if fine else GROWS,
            markerfacecolor="white",
            clip_on=False,
            zorder=3,
        )
    axis.plot(0, 0, "k+", markersize=9)
    nominal = controller.certificate.norm.value
    verdict = "agrees and settles at every corner" if box.holds else "and analysis do not say the same at every corner"
    axis.set_title(f"other vehicles: worst norm {box.norm:.4g}, designed {nominal:.4g}\nMuJoCo {verdict}", fontsize=10)
    axis.set_xlabel("sprung mass [% off]", fontsize=9)
    axis.set_ylabel("tyre stiffness [% off]", fontsize=9)
