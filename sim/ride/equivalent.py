"""Statistical linearisation: over a random road, the line that does on average what a curve does, in place of the curve.

A signal y over a random road is nearly Gaussian, of mean m and standard deviation s. Of all lines the one that misses the curve F
least, in mean square, goes through its mean with its mean slope,

    F(y) ~ E F + E F' (y - m),    E F' = c_0 + sum over knots of d_i Q((k_i - m) / s),
    E F = F(first knot) + c_0 (m - first knot) + sum of d_i s (phi(a_i) - a_i Q(a_i)),    a_i = (k_i - m) / s,

where the slope changes by d_i at the knot k_i, and phi and Q are the normal density and tail: in closed form for straight lines
(T. K. Caughey (1963), J. Acoust. Soc. Am. 35, 1706-1711; J. B. Roberts and P. D. Spanos, Random Vibration and Statistical
Linearization, 1990, chapter 5). With those slopes the vehicle is linear, and has other m and s: so it goes round until they are
consistent. An asymmetric damper has a force on average, which the springs hold: the body stands lower or higher (jacks down).

What a curve has beyond its line is left out of that, and is added to second order (`remainder.py`): noise that it makes of its
own, down to frequencies that the road has not. Where a controller leaves a slow mode, which that moves most, travel is some 5 %
low without it.

Where two wheels share a parameter their slopes are averaged: a road and a car are the same on both sides.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.roads.spectrum import Spectrum
from models.vehicle import Vehicle
from sim.linear.curved import Elements, elements, is_curved
from sim.linear.frequency import stepwise_frequency_response
from sim.response.regime import over
from sim.ride.band import longest_panel, loop_poles, power_of, sources
from sim.ride.quadrature import sample_band
from sim.ride.remainder import Remainder, averages, remainder
from synth.controller import Controller
from synth.implemented.controlled import continuous
from synth.implemented.loop import sampled_radius

CONSISTENT = 1e-6  # by which slopes still change, relative
DIRECT = 10  # rounds
MOST_ROUNDS = 100


@dataclass(frozen=True, eq=False)
class Equivalent:
    """The linear vehicle that a vehicle is on average over a random road.

    Attributes:
        vehicle: without curves.
        mean: of the output signals that have one, by name [the signal's unit].
        rounds: after how many it was consistent; 0 where there was nothing to do.
        remainder: what the curves have beyond their lines; None where there is nothing, or none that is consistent.
    """

    vehicle: Vehicle
    mean: Mapping[str, float] = field(default_factory=dict)
    rounds: int = 0
    remainder: Remainder | None = None


def equivalent(vehicle: Vehicle, controller: Controller, road: Spectrum, timestep: float) -> Equivalent | None:
    """The linear vehicle in place of one with curves; None where on the way its loop is not stable, or it is never consistent.

    Args:
        vehicle: the vehicle.
        controller: its controller.
        road: the spectrum of the road.
        timestep: of the sampled loop [s].
    """
    if not is_curved(vehicle):
        return Equivalent(vehicle)
    curves = [one for one in vehicle.fitted if len(one.curve.pieces.slope)]
    signals, names = [over(vehicle, one) for one in curves], [one.parameter for one in curves]
    pulls = elements(vehicle, vehicle.linear_model)
    slopes, means = np.array([one.curve.slope for one in curves]), np.zeros(len(curves))
    for rounds in range(1, MOST_ROUNDS + 1):
        shared = {name: float(np.mean(slopes[[i for i, other in enumerate(names) if other == name]])) for name in names}
        linear = replace(vehicle.straight, parameters={**vehicle.parameters, **shared})
        if sampled_radius(linear, controller, timestep) >= 1:
            return None
        deviations = _deviations(linear, controller, road, timestep, signals)
        moments = [averages(one.curve, m, s) for one, m, s in zip(curves, means, deviations, strict=True)]
        of_line = np.array([shared[name] for name in names])
        outputs = _mean_outputs(linear, controller, pulls, np.array([force for force, _ in moments]) - of_line * means)
        found, shifted = np.array([slope for _, slope in moments]), np.array([outputs[signal] for signal in signals])
        if np.all(np.abs(found - slopes) <= CONSISTENT * np.abs(found).max()) and np.all(
            np.abs(shifted - means) <= CONSISTENT * (np.abs(shifted) + deviations)
        ):
            return _with_remainder(Equivalent(linear, outputs, rounds), controller, road, timestep, pulls, signals, of_line)
        step = 1.0 if rounds < DIRECT else 1 / 4  # where it overshoots, as with a spring that a controller all but cancels
        slopes, means = slopes + step * (found - slopes), means + step * (shifted - means)
    return None


def _with_remainder(
    line: Equivalent,
    controller: Controller,
    road: Spectrum,
    timestep: float,
    pulls: Elements,
    signals: list[str],
    slopes: Array,
) -> Equivalent:
    """With what the curves have beyond their lines, where that is consistent."""
    cut = continuous(line.vehicle, controller)
    poles = np.linalg.eigvals(cut.model.A + cut.model.B @ cut.G)
    fastest = float(np.abs(poles[np.abs(poles.imag) > np.abs(poles.real)]).max(initial=0.0))

    def resting(forces: Array) -> Array:
        outputs = _mean_outputs(line.vehicle, controller, pulls, forces)
        return np.array([outputs[signal] for signal in signals])

    index, means = np.array([line.vehicle.linear_model.outputs.index(signal) for signal in signals]), line.mean
    began = np.array([means[signal] for signal in signals])
    found = remainder(line.vehicle, controller, road, timestep, fastest, pulls, index, began, slopes, resting)
    if found is not None:
        means = _mean_outputs(line.vehicle, controller, pulls, found.mean_force)
    return replace(line, mean={name: value for name, value in means.items() if value}, remainder=found)


def line_words(vehicle: Vehicle, line: Equivalent) -> list[str]:
    """What is expected of a vehicle with curves, in a sentence; none of one without."""
    if not line.rounds:
        return []
    found = line_object(vehicle, line)
    slopes = [f"{name} {slope:.4g}, not {vehicle.parameters[name]:.4g} as at rest" for name, slope in found["slopes"].items()]
    means = [f"{name} is {1e3 * mean:.3g} mm on average" for name, mean in found["mean"].items()]
    beyond = "with what the curves have beyond them to second order" if line.remainder else "without what they have beyond them"
    return [
        "expected numbers are by statistical linearisation, of the lines that do on average over this road what the curves do, "
        f"{beyond}: " + "; ".join([*slopes, *means]),
        "so they are approximate: rms and dynamic load to about 1 % for digressive dampers and progressive springs, to 3 % with "
        "friction, or other sharp bends at rest; energy to 5 %",
    ]


def line_object(vehicle: Vehicle, line: Equivalent) -> dict[str, Any]:
    """The same as JSON has it, SI units."""
    names = dict.fromkeys(one.parameter for one in vehicle.fitted if len(one.curve.pieces.slope))
    travels = [one.deflection for one in vehicle.kind.suspensions]
    return {
        "slopes": {name: line.vehicle.parameters[name] for name in names},
        "mean": {name: line.mean.get(name, 0.0) for name in travels},
        "rounds": line.rounds,
        "second_order": line.remainder is not None,
    }


def _deviations(vehicle: Vehicle, controller: Controller, road: Spectrum, timestep: float, signals: list[str]) -> Array:
    """Standard deviation of some output signals of a linear vehicle over the road, shape (k,)."""
    low, high = road.band
    poles, _ = loop_poles(vehicle, controller, timestep, high)
    index = [vehicle.linear_model.outputs.index(name) for name in signals]

    def spectra(omega: Array) -> Array:
        at_steps = stepwise_frequency_response(vehicle, controller, omega, timestep)[:-1, :, index]
        return road.density * power_of(at_steps @ sources(vehicle, road, omega)).mean(axis=0)

    band = sample_band(spectra, lambda _, found: found, low, high, poles, longest_panel(vehicle, road.speed))
    return np.sqrt(band.share @ band.values)


def _mean_outputs(vehicle: Vehicle, controller: Controller, pulls: Elements, forces: Array) -> dict[str, float]:
    """Means of all output signals of a linear vehicle whose curves pull with these forces on average [N], shape (k,)."""
    cut = continuous(vehicle, controller)
    push = np.zeros(len(cut.model.A))
    push[: len(pulls.push)] = pulls.push @ forces
    state = -np.linalg.lstsq(cut.model.A + cut.model.B @ cut.G, push)[0]
    found = cut.model.C @ state + cut.model.D @ (cut.G @ state)
    # At rest on average, nothing moves or accelerates.
    still = {name for name in vehicle.linear_model.outputs if vehicle.kind.signal(name).unit not in ("m", "rad", "N")}
    return {name: 0.0 if name in still else float(value) for name, value in zip(cut.model.outputs, found, strict=True)}
