"""Axes of a trade-off, and the norm on each axis as a function of the controller's gain. The norm on each axis is minimised and
has a proved bound.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, list_names, short_repr
from models.laws.goals import EVERYWHERE, NormOf
from models.laws.linear import LinearLaw
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.analysis.band_norm import norm_in_band
from synth.controller.problem import Problem, problem
from synth.design.descent.landscape import Landscape
from synth.design.multi_objective.band_norm import BandLandscape
from synth.design.multi_objective.problem import GainErrors
from synth.design.uncertainty.worst_case import worst_norm
from synth.plant.numerics import numerics
from synth.vehicle.multi_objective import with_outputs_of_norm

BAND = (4.0, 8.0)  # default frequency band [Hz]; people are most sensitive to vertical acceleration in this band
OFF = 0.1  # default relative gain error of each measurement
LOWEST, HIGHEST = 1e-3, 1e3  # smallest and largest frequency that a band may contain [Hz]
FEWEST, MOST = 2, 3  # smallest and largest number of axes of a trade-off
ACCELERATIONS = ("m/s2", "rad/s2")
AXES = ("ride", "travel", "road_holding", "force", "band", "tolerance")
DEFLECTIONS = {"travel": "suspension_deflection", "road_holding": "tyre_deflection"}
NUMBER = r"\d+(?:\.\d*)?"


@dataclass(frozen=True, eq=False)
class FrontAxis:
    """Axis of a trade-off.

    Attributes:
        name: name of the axis: ride, travel, road_holding, force, band or tolerance.
        norm: norm whose value is plotted on the axis, with the signals and the frequency band of this norm.
        off: largest relative gain error of each measurement. If `off` is not zero, the value of the axis is the worst norm over
            all errors up to this size.
        meaning: one-line description of the norm on this axis.
        unit: unit of the norm, per m/s of road velocity.
    """

    name: str
    norm: NormOf
    off: float
    meaning: str
    unit: str

    @property
    def label(self) -> str:
        """Label of the axis in a figure."""
        return f"{self.name.replace('_', ' ')} [{self.unit}]" if self.unit else self.name.replace("_", " ")


def axes_of(vehicle: Vehicle, text: str) -> tuple[FrontAxis, ...]:
    """Returns the axes that a text such as `ride:travel` or `band=4-8:travel:force` describes.

    Raises:
        InputError: the number of axes is wrong, or an axis is repeated or unknown, or the vehicle has no signals for an axis.
    """
    parts = [part.strip() for part in text.split(":")]
    if not FEWEST <= len(parts) <= MOST:
        raise InputError(
            f"--front {short_repr(text)} has {len(parts)} {'axis' if len(parts) == 1 else 'axes'}; give two or three "
            f"of the axes {list_names(AXES)}, separated by colons, such as ride:travel"
        )
    axes: list[FrontAxis] = []
    for part in parts:
        name, equals, given = part.partition("=")
        if name not in AXES:
            raise InputError(f"--front: there is no axis {short_repr(name)}; give two or three of {list_names(AXES)}")
        if any(axis.name == name for axis in axes):
            raise InputError(f"--front contains {name} twice; give each axis once")
        if equals and name not in ("band", "tolerance"):
            raise InputError(
                f"--front {part}: {name} takes no value, because only band=LOW-HIGH [Hz] and tolerance=PERCENT have "
                "values; omit the value"
            )
        axes.append(_axis(vehicle, name, given if equals else None))
    return tuple(axes)


def _axis(vehicle: Vehicle, name: str, given: str | None) -> FrontAxis:
    """Returns the axis with the name `name`; `given` is the text after "=", such as a frequency band, or None."""
    if name == "tolerance":
        return _tolerance(vehicle, given)
    if name == "force":
        signals, of, unit = dict.fromkeys(vehicle.linear_model.inputs, 1.0), "control force", "N per m/s"
    elif name in DEFLECTIONS:
        signals, of, unit = (
            _signals_with_prefix(vehicle, name, DEFLECTIONS[name]),
            DEFLECTIONS[name].replace("_", " "),
            "m per m/s",
        )
    else:
        signals = _accelerations(vehicle, name)
        of, unit = _weight_text(signals), _unit(vehicle, signals)
    text, band = f"norm from the road's velocity to {of}", EVERYWHERE
    if name == "band":
        band = BAND if given is None else _edges(given)
        text += f" from {band[0]:g} to {band[1]:g} Hz"
    return FrontAxis(name, NormOf(signals, band), 0.0, text, unit)


def _tolerance(vehicle: Vehicle, given: str | None) -> FrontAxis:
    off = OFF
    if given is not None:
        if not re.fullmatch(NUMBER, given) or not 0 < float(given) <= 90:
            raise InputError(f"--front tolerance={given} is not a valid error in percent; give a number above 0, up to 90")
        off = float(given) / 100
    if vehicle.filtered:
        raise InputError(
            "--front tolerance: measurement errors cannot be combined with filters in [performance]; omit tolerance, or "
            "the filters"
        )
    text = f"worst norm of z in [performance] if each measurement is off by up to {100 * off:g} %"
    return FrontAxis("tolerance", NormOf(), off, text, "")


def _edges(given: str) -> tuple[float, float]:
    """Returns the frequency band [Hz] that a text such as 4-8 describes."""
    match = re.fullmatch(f"({NUMBER})-({NUMBER})", given)
    low, high = (float(part) for part in match.groups()) if match else (0.0, 0.0)
    if not LOWEST <= low < high <= HIGHEST:
        raise InputError(
            f"--front band={given} is not a band; give the lower and the upper end, from {LOWEST:g} to {HIGHEST:g} "
            "Hz, such as band=4-8"
        )
    return low, high


def _accelerations(vehicle: Vehicle, axis: str) -> dict[str, float]:
    """Returns the body accelerations that have weights in `[performance]`, with these weights."""
    weights = {
        name: weight
        for name, weight in vehicle.performance.items()
        if weight > 0 and name in vehicle.linear_model.outputs and vehicle.kind.signal(name).unit in ACCELERATIONS
    }
    if not weights:
        raise InputError(
            f"--front {axis} needs a weighted acceleration, but [performance] weights no acceleration; give an "
            f"acceleration a weight in [performance], or omit {axis}"
        )
    return weights


def _signals_with_prefix(vehicle: Vehicle, axis: str, stem: str) -> dict[str, float]:
    """Returns the signals whose names begin with `stem`, each with the weight 1."""
    weights = {name: 1.0 for name in vehicle.linear_model.outputs if name == stem or name.startswith(f"{stem}_")}
    if not weights:
        raise InputError(f"--front {axis} needs signals called {stem}, but this vehicle has none; omit {axis}")
    return weights


def _weight_text(signals: Mapping[str, float]) -> str:
    names = {name: name.replace("_", " ") for name in signals}
    return ", ".join(names[name] if weight == 1 else f"{weight:g} x {names[name]}" for name, weight in signals.items())


def _unit(vehicle: Vehicle, signals: Mapping[str, float]) -> str:
    """Returns the unit of a norm of accelerations, or the text "weighted" if the accelerations differ in weight or unit."""
    units = {vehicle.kind.signal(name).unit.replace("s2", "s²") for name in signals}
    return f"{units.pop()} per m/s" if len(units) == 1 and set(signals.values()) == {1.0} else "weighted, per m/s"


# largest number of measurements if an axis has gain errors, because all corners of the box of errors are used
MOST_READINGS = 4


@dataclass(frozen=True)
class AxisValue:
    """Value of a control law on one axis of a trade-off.

    Attributes:
        value: norm that is the value of the axis.
        proved: proved upper bound on the norm.
        at: frequency at which the gain equals the norm [rad/s]; NaN for the worst norm over measurement errors.
    """

    value: float
    proved: float
    at: float


@numerics()
def norm_on(vehicle: Vehicle, axis: FrontAxis, entry: ControllerEntry, law: LinearLaw) -> AxisValue:
    """Returns the value of a control law on an axis; infinite if the loop with this law is unstable, even if only for some
    measurement errors.
    """
    problem = _axis_problem(vehicle, axis, entry)
    if axis.off and len(entry.measured):
        worst = worst_norm(problem.plant, None, law, axis.off)
        return AxisValue(worst.found, worst.proved, float("nan"))
    plant, G = problem.closed_loop(law)
    band = norm_in_band(plant.closed_loop(G), *axis.norm.rates)
    if not band.stability.stable:
        return AxisValue(np.inf, np.inf, float("nan"))
    return AxisValue(band.value, band.level if band.value else 0.0, band.peak_frequency)


def _axis_problem(vehicle: Vehicle, axis: FrontAxis, entry: ControllerEntry) -> Problem:
    return problem(with_outputs_of_norm(vehicle, axis.norm), entry.measured, entry.hardware)


def landscapes(vehicle: Vehicle, axis: FrontAxis, entry: ControllerEntry, like: Landscape) -> list[BandLandscape]:
    """Returns, for each combination of extreme measurement errors, the norm as a function of the controller's gain (a
    landscape).

    The value of the axis is the largest norm over all combinations of errors.

    Args:
        vehicle: vehicle for which the trade-off is computed.
        axis: axis of the trade-off.
        entry: section of the vehicle file that defines the controller.
        like: other landscape whose coordinates are used, so that a point represents the same gain in both landscapes.

    Raises:
        InputError: there are too many combinations of measurement errors.
    """
    plant, (m, q) = _axis_problem(vehicle, axis, entry).plant, like.shape
    off = (GainErrors(errors, np.zeros(m)).on(plant) for errors in _corners(axis, q))
    return [BandLandscape(each, axis.norm.rates, like) for each in off]


def _corners(axis: FrontAxis, readings: int) -> list[Array]:
    """Returns the combinations of measurement errors for which an axis is evaluated. The first combination has no errors."""
    if not axis.off:
        return [np.zeros(readings)]
    if readings > MOST_READINGS:
        raise InputError(
            f"--front {axis.name} allows at most {MOST_READINGS} measurements, but this controller has {readings}; "
            f"omit {axis.name}, or give a different controller with --controller"
        )
    return [np.zeros(readings), *(axis.off * np.array(signs) for signs in product((-1.0, 1.0), repeat=readings))]
