"""Figure of stability margins, with the growth rate of the slowest mode against gain factor, delay and sample period."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from models.common.printed import as_name
from models.document.field import Field
from models.document.figure import BLUE, VERMILLION, Curve, Figure, Marker, Panel
from models.vehicle.limits_and_implementation import Implementation
from sim.linear.nonlinear_elements import at_rest
from sim.studies.stability.delayed import slowest_from_sample_to_sample
from sim.studies.stability.edge import StabilityEdge
from sim.studies.stability.margins import StabilityMargins
from sim.studies.stability.simulated_loop import LoopCase
from synth.controller.loop_of import loop_of, radius

POINTS, MEASURED = 40, 7  # number of points of a predicted curve, and number of points that are measured in MuJoCo
LINE = "#404040"
SIZE = Field[float]("margin", float, ".5g")
TIME = Field[float]("time", float, SIZE.form, 1e3, unit="ms")
MARKERS: tuple[tuple[bool, str, Marker, str], ...] = (
    (False, BLUE, "o", "MuJoCo decays"),
    (True, VERMILLION, "x", "MuJoCo grows"),
)


def margins_figure(found: StabilityMargins) -> Figure:
    """Returns a figure of the growth rate of the loop's slowest mode.

    Lines show values from the poles of the sampled linear loop, and points show values from the derivative of MuJoCo's step.
    The margin is the point at which the growth rate is zero.
    """
    controller, vehicle, loop, built = found.controller, found.vehicle, found.loops[""], found.implemented_loops.get("")
    timestep = loop.timestep
    prompt = loop_of(replace(at_rest(vehicle), implementation=Implementation()), controller, timestep)
    cut = prompt.cut(prompt.forces)

    def rate(trial: LoopCase) -> float:
        if steps := trial.vehicle.implementation.delay * (trial.vehicle.implementation.sample_period is None):
            return math.log(abs(slowest_from_sample_to_sample(cut, int(steps)))) / steps / timestep
        return math.log(radius(loop_of(trial.vehicle, trial.controller, timestep))) / timestep

    gain, period = loop.gain, loop.sample_period
    ended = math.isinf(gain.found) and math.isfinite(gain.search.unstable)
    title = "gain: any factor is stable; this limit is due to sampling" if ended else "gain of all loops together"
    found_delay, found_period, predicted = loop.found_delay, loop.found_sample_period, loop.predicted
    searches: list[tuple[str, str, StabilityEdge, Field[float], float, float]] = [
        (title, "factor on the gain", gain.search, SIZE, gain.sampled[0], gain.search.found),
        ("delay from measurement to force", "delay [ms]", loop.delay, TIME, predicted.delay, found_delay),
        ("sample period of the controller", "sample period [ms]", period, TIME, predicted.sample_period, found_period),
    ]
    if built is not None:
        of = built.gain
        searches.insert(0, ("gain of the implemented loop", "factor on the gain", of.search, SIZE, of.own, of.found))
    panels = [
        _search_panel(f"{title}\n{_both(field, at, seen)}", label, search, rate, field.scale)
        for title, label, search, field, at, seen in searches
    ]
    lag, lead = predicted.smallest_phase, predicted.lead
    about = f"{vehicle.kind.name.replace('_', ' ')}, controller {controller.name}: growth of the slowest mode"
    title = f"{about}. Lines: linear analysis. Points: MuJoCo at {1e3 * timestep:g} ms"
    limits = [f"{TIME.text(found_delay)} of delay" if math.isfinite(found_delay) else "any delay that is tried"]
    limits.append(f"a sample period of {TIME.text(found_period)}" if math.isfinite(found_period) else "any sample period")
    if math.isfinite(lead):
        limits.append(f"a phase {'lead' if lead < lag else 'lag'} of {SIZE.text(min(lag, lead))} rad")
    finding = f"The loop of {as_name(controller.name)} tolerates {', '.join(limits[:-1])} or {limits[-1]}."
    return Figure("margins", title, tuple(panels), finding=finding)


def _both(field: Field[float], predicted: float, found: float) -> str:
    """Returns a text that states the predicted margin and the margin found in MuJoCo."""
    first, second = (
        "not found" if math.isnan(one) else "any" if math.isinf(one) else field.text(one) for one in (predicted, found)
    )
    return f"predicted: {first}; MuJoCo: {second}"


def _search_panel(title: str, label: str, search: StabilityEdge, rate: Callable[[LoopCase], float], scale: float) -> Panel:
    """Returns a panel with the growth rate against the amount, as a predicted line and points from MuJoCo.

    The points include the two amounts between which the sign of the growth rate in MuJoCo changes.

    Args:
        title: title of the panel.
        label: label of the axis for the amount.
        search: finished search for the stability limit, with its amounts.
        rate: function that returns the predicted growth rate of a loop [1/s].
        scale: factor that converts an amount from SI units to the unit of the label.
    """
    # The plot ends soon after the margin, because larger growth rates are of no interest.
    end = 1.35 * search.unstable if math.isfinite(search.unstable) else search.stable
    known = [amount for amount in (search.stable, search.unstable) if 0 < amount < math.inf]
    amounts, points = (_multiples([*np.linspace(0.0, end, count), *known], search.multiple) for count in (POINTS, MEASURED))
    rates = np.array([rate(search.trial(amount)) for amount in amounts])
    curves = [Curve(scale * amounts, rates, "linear analysis", LINE)]
    measured = np.array([search.loop(amount).rate for amount in points])
    for grows, color, marker, name in MARKERS:
        some = (measured > 0) == grows
        curves.append(Curve(scale * points[some], measured[some], name, color, "none", marker))
    curves.append(Curve(np.array([0.0, scale * end]), np.zeros(2), "", "#000000", width=0.8))
    top = min(1.1 * rates.max(), -4 * rates.min()) if rates.max() > 0 else -0.3 * rates.min()
    return Panel(title, label, "growth of the loop [1/s]", tuple(curves), ylim=(1.3 * rates.min(), top))


def _multiples(amounts: Sequence[float], multiple: float) -> Array:
    """Returns the amounts after rounding to positive multiples of `multiple`, without duplicates; unchanged if `multiple` is
    0.
    """
    given = np.array(amounts)
    return np.unique(np.maximum(np.round(given / multiple), 1) * multiple if multiple else given)
