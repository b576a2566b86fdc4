"""Results of a sweep for linear controllers, comparison of these results with linear analysis, and the JSON object."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.printed import digits
from models.document.field import OMITTED_KEY, Field, Record
from models.vehicle.mjcf import has_geometry
from models.vehicle.vehicle import Vehicle
from sim.linear.nonlinear_elements import at_rest
from sim.runs.agreement import COARSEST, SLACK
from sim.studies.frequency import describing_function, eusama
from sim.studies.frequency.describing_function import DescribingFunction, describing_failures
from sim.studies.frequency.eusama import MinimumLoad, load_failures, minimum_loads
from sim.studies.frequency.identification import Lines, difference, ideal_measurements, measure_responses
from sim.studies.frequency.worst_case_gain import Extremes, extremes
from synth.analysis.specification import SampledNorm
from synth.controller.controller import Controller
from synth.controller.report import norm_if_implemented

LINES, EXTREMES, OWN = "frequency responses", "norms", "laws in Python"
# Relative difference of a response that body rotations may cause, in addition to the known error of RK4. On roads of 0.1 mm,
# rotations cause a relative difference of only 3e-7.
TOLERANCE = 1e-4
# Height of the lower road relative to the requested road, and smallest height [m]. Body rotations cause smaller differences on
# a lower road.
SMALLER, LEAST_AMPLITUDE = 0.1, 1e-6
ABOVE = 1e-5  # relative amount by which a gain may exceed the norm, because of remaining free motion
NORM_TOLERANCE = 1e-3  # relative amount by which a gain may be below the norm
OFF = Field[float]("error", lambda one: one, "{:.2e}".format)
GAIN = Field[float]("L2 gain", lambda one: one, digits)


@dataclass(frozen=True, eq=False)
class Sweep:
    """Results of one linear controller: frequency response, largest gains and minimum tyre loads."""

    lines: Lines
    extremes: Extremes
    sampled: SampledNorm | None  # exact norm of the implemented loop; None without [implementation] and for preview
    loads: tuple[MinimumLoad, ...]  # smallest load of each tyre in the EUSAMA test
    # text that names the noise and quantisation which the runs omit although the vehicle file has them; empty if the runs omit
    # nothing
    without: str
    # Response over a road with 1/10 or 1/100 of the height; measured if a nonlinearity may have caused the difference from
    # linear analysis
    small: Lines | None = None

    @property
    def controller(self) -> Controller:
        """Controller to which the sweep belongs."""
        return self.lines.controller

    @property
    def is_bounded(self) -> bool:
        """False if the loop is stable but has no finite H-infinity norm, which is possible only for laws with `study = true`."""
        return not self.controller.certificate.stable or math.isfinite(self.controller.certificate.norm.value)

    @property
    def worst_omega(self) -> float:
        """Frequency of the worst sinusoidal road, as simulated [rad/s]."""
        return self.extremes.tried

    @property
    def ended(self) -> tuple[str, ...]:
        """Names of the limits that ended the linear regime in any of the runs."""
        return tuple(dict.fromkeys((*self.lines.ended, *self.extremes.ended)))

    @property
    def gains(self) -> dict[str, float]:
        """L2 gains from the disturbance w to the performance output z, by name of the road."""
        return {**self.extremes.gains, **({} if self.lines.gain is None else {"chirp": self.lines.gain})}


def sweep(
    vehicle: Vehicle,
    controllers: Sequence[Controller],
    amplitude: float,
    timestep: float,
    speed: float,
    progress: Callable[[str], None] = lambda text: None,
) -> list[Sweep]:
    """Measures the frequency response, the largest gains and the minimum tyre loads of each linear controller.

    Arguments and errors are those of `sim.studies.frequency.identification.measure_responses`. The callback `progress` receives
    the names of the two stages, `LINES` and `EXTREMES`.
    """
    progress(LINES)
    near = at_rest(vehicle)
    lines = measure_responses(near, controllers, amplitude, timestep, speed)
    progress(EXTREMES)
    most = extremes(near, controllers, amplitude, timestep, speed)
    loads = minimum_loads(vehicle.with_ideal_actuators, controllers, timestep)
    off = [line.controller for line in lines if _off(line)[0] > _off(line)[1] and not line.ended]
    small: dict[str, Lines] = {}
    for share in (SMALLER, SMALLER**2) if near.parts.nonlinear or has_geometry(near) else ():
        if off and amplitude * share >= LEAST_AMPLITUDE:
            small |= {line.controller.name: line for line in measure_responses(near, off, amplitude * share, timestep, speed)}
            off = [one for one in off if not _off(small[one.name])[0] <= _off(small[one.name])[1]]
    ideal = ideal_measurements(near)
    norms = [
        None if one.preview is not None or _reads_road(ideal, one) else norm_if_implemented(ideal, one.without_noise, timestep)
        for one in controllers
    ]
    noise = vehicle.implementation.noise_text
    return [
        Sweep(line, extreme, norm, load, noise, small.get(line.controller.name))
        for line, extreme, norm, load in zip(lines, most, norms, loads, strict=True)
    ]


def _reads_road(vehicle: Vehicle, controller: Controller) -> bool:
    """Returns True if any measurement of the controller depends directly on the road velocity.

    The sampled norm averages a measurement of the road velocity over a sample period, whereas MuJoCo averages the measurement
    over a timestep, so the results differ.
    """
    model = vehicle.linear_model
    return bool(np.any(model.Dw[[model.outputs.index(name) for name in controller.measured]]))


def _off(lines: Lines) -> tuple[float, float, str, bool]:
    """Returns the measured response whose difference from the sampled-data prediction is largest relative to the allowed
    difference.

    Returns:
        Difference, allowed difference, name of the signal, and True if the timestep is too large for the frequency of this
        response.
    """
    off = difference(lines.measured, lines.sampled, lines.units)
    integrator = SLACK * difference(lines.integrated, lines.sampled, lines.units)
    allowed = np.minimum(integrator, COARSEST) + TOLERANCE
    at = np.unravel_index(np.argmax(off / allowed), off.shape)
    return float(off[at]), float(allowed[at]), lines.outputs[at[1]], bool(integrator[at] > COARSEST)


def failures(one: Sweep | DescribingFunction) -> list[str]:
    """Returns a text for each check that a sweep fails. For a nonlinear law, the only check is that not every run diverged."""
    if isinstance(one, DescribingFunction):
        return describing_failures(one)
    code = one.controller.code
    rounds = code.law.numbers if code is not None and code.law.fixed is not None else ""
    why = f"; linear analysis omits rounding to {rounds}: give a larger --amplitude" if rounds else ""
    return [text + why for text in _failures(one, bool(rounds))]


def _failures(one: Sweep, rounds: bool) -> list[str]:
    """Returns a text for each check that the sweep of a linear law fails.

    `rounds` is True if the controller is exported code in fixed-point arithmetic.
    """
    failed, gains, norm = [], one.gains, one.extremes.worst.gain
    # A road with a smaller amplitude causes smaller rotations, so the response over this road determines the result.
    off, allowed, signal, coarse = _off(one.lines if one.small is None else one.small)
    if not off <= allowed:
        why = "; the timestep is too coarse, give a smaller timestep" if coarse and not rounds else ""
        why = f"{OFF.text(allowed)} is allowed{why}"
        failed.append(f"the frequency response of {signal} differs from the sampled response by {OFF.text(off)}; {why}")
    for invariant in one.extremes.invariants:
        if not invariant.error <= invariant.allowed:
            size, most = OFF.text(invariant.error), OFF.text(invariant.allowed)
            failed.append(f"|{invariant.name}| differs from its invariant value by {size}; {most} is allowed")
    failed += load_failures(one.loads)
    if not one.is_bounded:
        return failed
    own = min(SLACK * abs(one.extremes.integrated - norm), COARSEST * norm)
    low, high, what = norm * (1 - NORM_TOLERANCE) - own, norm * (1 + ABOVE) + own, "the discrete-time norm"
    if not one.extremes.lti:
        predicted, finer = one.extremes.predicted
        near = ABOVE * predicted + own
        failed += _gain_failure("worst sinusoid", gains, "the prediction", predicted, predicted - near, predicted + near)
        norm, what = math.inf if one.sampled is None else one.sampled.value, "the norm of the sampled loop"
        low, high = -math.inf, norm * (1 + ABOVE) + own + SLACK * abs(predicted - finer)
    for road in gains:
        failed += _gain_failure(road, gains, what, norm, low if road == "worst sinusoid" else -math.inf, high)
    return failed


def _gain_failure(road: str, gains: Mapping[str, float], what: str, value: float, low: float, high: float) -> list[str]:
    """Returns a list with one text if the gain over a road is not between `low` and `high`; otherwise an empty list.

    Args:
        road: name of the road whose gain is checked.
        gains: measured gain over each road, by name of the road.
        what: name of the reference value, which the text contains.
        value: reference value, which the text contains.
        low, high: smallest and largest allowed gain over the road.
    """
    if low <= gains[road] <= high:
        return []
    return [f"the {road} has an L2 gain of {GAIN.text(gains[road])}; {what} is {GAIN.text(value)}"]


def holds(one: Sweep | DescribingFunction) -> bool:
    """Returns True if a result passes all checks of `failures`, or if a run with a linear law left the linear regime."""
    return not failures(one) or (isinstance(one, Sweep) and bool(one.ended))


def _signals(one: Sweep) -> dict[str, Any]:
    """Returns the responses of each output signal and their largest errors for the JSON output."""
    lines = one.lines
    error = {"sampled": lines.error(lines.sampled), "continuous": lines.error(lines.continuous)}
    return {
        name: {key: getattr(lines, key)[:, i] for key in ("measured", "sampled", "continuous")}
        | {"error": {key: value[i] for key, value in error.items()}}
        for i, name in enumerate(lines.outputs)
    }


INVARIANT = Record("name", "omega", "expected", "measured")
RECORD = Record[Sweep](
    controller="controller.name",
    without=lambda one: one.without or None,
    omega="lines.omega",
    signals=_signals,
    order="lines.order",
    invariants=INVARIANT.all("extremes.invariants"),
    norm=Record(
        sampled="extremes.worst.gain",
        peak_frequency="extremes.worst.omega",
        continuous="controller.certificate.norm.value",
    ),
    sampled_norm=lambda one: OMITTED_KEY if one.sampled is None else one.sampled.value,
    minimum_load=lambda one: eusama.RECORD(one.loads),
    gains="gains",
    ended="ended",
    failures=failures,
)


def record(one: Sweep | DescribingFunction) -> dict[str, Any]:
    """Returns a sweep or a describing function as a JSON object in SI units. Complex numbers are written as [real, imaginary]."""
    return describing_function.RECORD(one) if isinstance(one, DescribingFunction) else RECORD(one)
