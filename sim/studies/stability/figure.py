"""Margins drawn: growth or decay with more gain, delay and sample period, the norm with errors, and on other vehicles."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from models.common.printed import as_name
from models.document.field import Field
from models.document.figure import BLUE, GREEN, PURPLE, VERMILLION, Curve, Figure, Marker, Panel, Shades
from models.vehicle.limits_and_implementation import Implementation
from sim.studies.stability.delayed import slowest_from_sample_to_sample
from sim.studies.stability.edge import StabilityEdge
from sim.studies.stability.fragility import FragilityFound
from sim.studies.stability.robustness import Robustness
from sim.studies.stability.simulated_loop import Trial
from sim.studies.stability.study import StabilityMargins
from synth.controller.controller import Controller
from synth.controller.loop_of import loop_of, radius
from synth.controller.report import NORM
from synth.design.uncertainty.fragility import worst_error_found

POINTS, MEASURED = 40, 7  # of a predicted curve, and by MuJoCo's step
AMOUNTS = 16  # of errors at which the worst norm is looked for
RUG = 0.03  # of the height, above the axis: of such runs no norm is known, only whether they decay
SHOWN = 1.3  # times the norm, the highest that is shown with errors: beyond, it grows without end
MET, PROVED = PURPLE, GREEN
LINE = "#404040"
SIZE = Field[float]("margin", float, ".5g")
TIME = Field[float]("time", float, SIZE.form, 1e3, unit="ms")
ERROR = Field[float]("error", float, ".4g", 100.0, unit="%")
MARKERS: tuple[tuple[bool, str, Marker, str], ...] = (
    (False, BLUE, "o", "MuJoCo decays"),
    (True, VERMILLION, "x", "MuJoCo grows"),
)


def margins_figure(found: StabilityMargins) -> Figure:
    """Draws the growth rate of the slowest mode: lines by the poles of the sampled linear loop, points by MuJoCo's own step.

    The margin is the common zero of both.
    """
    controller, fragile, loop, built = found.controller, found.fragile, found.loops[""], found.built.get("")
    vehicle, timestep = fragile.vehicle, loop.timestep
    prompt = loop_of(replace(vehicle, implementation=Implementation()), controller, timestep)
    cut = prompt.cut(prompt.forces)

    def rate(trial: Trial) -> float:
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
    if math.isfinite(fragile.predicted.norm):
        panels.append(_fragile_panel(fragile))
    if found.box is not None:
        panels.append(_box_panel(controller, found.box))
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
    """Describes a margin, predicted and found."""
    first, second = (
        "not found" if math.isnan(one) else "any" if math.isinf(one) else field.text(one) for one in (predicted, found)
    )
    return f"predicted: {first}; MuJoCo: {second}"


def _search_panel(title: str, label: str, search: StabilityEdge, rate: Callable[[Trial], float], scale: float) -> Panel:
    """The predicted rate over the amount, and that of MuJoCo's step at a few amounts and where it changes its sign."""
    # Far from the margin nothing is to be seen, and the rates are large.
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
    """Returns amounts as multiples of one, from the first on; unchanged for real numbers."""
    given = np.array(amounts)
    return np.unique(np.maximum(np.round(given / multiple), 1) * multiple if multiple else given)


def _fragile_panel(fragile: FragilityFound) -> Panel:
    """Returns the panel of the worst norm over the size of errors: found, proved, and where MuJoCo decays and grows."""
    predicted, search = fragile.predicted, fragile.edge.search
    norm, stable = predicted.norm, predicted.stable
    end = min(1.2 * stable.smallest_violation, 1.0)
    known = [one.smallest_violation for one in predicted.within.values() if one.smallest_violation < end]
    amounts = np.unique([*np.linspace(0.0, min(stable.smallest_violation, 1.0), AMOUNTS), *known])
    largest = np.array([worst_error_found(fragile.gain, amount) for amount in amounts])
    curves = [Curve(100 * amounts, np.where(np.isfinite(largest), largest, np.nan), "worst norm found", MET)]
    steps = sorted((one.proved_margin, one.bound) for one in (*predicted.within.values(), stable) if one.proved_margin)
    edges, bounds = np.repeat([0.0, *(proved for proved, _ in steps)], 2)[1:-1], np.repeat([bound for _, bound in steps], 2)
    curves.append(Curve(100 * edges, bounds, "proved upper bound", PROVED, "dash"))
    low, high = norm - 0.15 * (SHOWN - 1) * norm, SHOWN * norm
    if math.isfinite(stable.smallest_violation):
        curves.append(
            Curve(np.full(2, 100 * stable.smallest_violation), np.array([low, high]), "unstable beyond", "#000000", width=0.8)
        )
    for grows, color, marker, name in MARKERS:
        runs = 100 * np.array([a for a in (search.unstable if grows else search.stable,) if 0 < a <= end])
        curves.append(Curve(runs, np.full(len(runs), low + RUG * (high - low)), name, color, "none", marker))
    both = _both(ERROR, stable.smallest_violation, fragile.edge.found) + " (extrapolated)" * fragile.edge.extrapolated
    title = f"independent errors of all signals\n{both}"
    return Panel(title, "error of each [%]", "H-infinity norm", tuple(curves), xlim=(0.0, 100 * end), ylim=(low, high))


def _box_panel(controller: Controller, box: Robustness) -> Panel:
    """Returns the panel of the norm over the variations, with physics at the corners; the worst of any beyond two."""
    percent = [100 * (factors - 1) for factors in box.factors]
    labels = [f"change of {one.name} [%]" for one in box.varied]
    norms = np.where(np.isfinite(box.norms), box.norms, np.nan)
    at = 100 * (np.array([corner.factors for corner in box.corners]) - 1)
    fine = np.array([corner.decays and corner.agrees for corner in box.corners])
    verdict = "MuJoCo agrees at every corner" if box.holds else "MuJoCo DOES NOT AGREE at every corner"
    nominal = controller.certificate.norm.value
    title = f"other vehicles: worst norm {NORM.digits(box.norm)}, nominal {NORM.digits(nominal)}\n{verdict}"
    if len(percent) == 1:
        curves, ground, height = [Curve(percent[0], norms, "H-infinity norm", LINE)], None, np.array([nominal])
        heights = np.array([corner.norm for corner in box.corners])
    else:
        worst = norms.max(axis=tuple(range(2, norms.ndim)))
        curves, ground, height, heights = [], Shades(percent[0], percent[1], worst.T, "H-infinity norm"), np.zeros(1), at[:, 1]
    curves.append(Curve(np.zeros(1), height, "nominal", "#000000", "none", "+"))
    for good, color, marker, _ in MARKERS:
        some = fine != good
        curves.append(Curve(at[some, 0], heights[some], "", color, "none", marker))
    return Panel(title, labels[0], labels[1] if ground else "H-infinity norm", tuple(curves), ground)
