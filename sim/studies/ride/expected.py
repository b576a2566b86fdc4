"""Expected metrics of a linear vehicle on a random road, and the remaining transient when measuring begins.

The road's vertical velocity is white within its band: the one-sided spectrum (2 pi n0)^2 G_d(n0) V per Hz. Rear wheels follow
with a delay, and the two tracks have the road's coherency, so wheel j moves by e_j(omega) of two independent white sources. With
the frequency response H of the loop with its implementation,

    S_ik(omega) = G_v sum over sources of (H e)_i conj(H e)_k,    cov(i, k) = integral of Re S_ik df.

If the controller's sample period is several timesteps, the loop is periodic, and H has a value for every step of a period. A
sinusoid of the road gives images at omega + 2 pi k / period, each weighted at its own frequency. Spectra are by the road's
frequency and include the images: |H e|^2 of every step, whose mean over the steps is the sum over the images (Parseval). Means
over time are means over the steps. Spreads and largest values use the mean spectrum.

The band is that of the road's lines plus half a line spacing at both ends: the integral is the sum over the lines, to second
order in their spacing. Signals are Gaussian (`gaussian.py`). Exact for a stationary linear run are the metrics that are means:
mean squares, also of the tyre load, which is never negative; shares of time; power and energy of the held force; and the integral
in the VDV, by E a^4 = 3 sigma^4. Curves of dampers or springs are replaced by equivalent lines (`statistical_linearisation.py`),
which is approximate.

Largest values are approximate, and too large for windows that are short compared with the vehicle's memory. Compared with linear
responses over 200 roads, for the three vehicles as they ship with `passive`, `I` and `II`, at 10, 20 and 35 m/s for 10 s: MTVV
within 2.5 %, crest factors within 5 %, peaks within 7 %, the travel of the passive quarter-car within 12 %. The expected values
are the larger ones, but for crest factors of well damped loops, which are up to 4 % too small, and 7 % for windows of 3 s. Errors
are larger for light damping (100 N s/m, at 10 to 35 m/s for 3 and 10 s), and all values too large: VDV 8 %, MTVV 9 %, crest
factors 14 %, the largest travel 23 %. The spread from road to road, which assumes a window much longer than the memory, is then
up to 45 % too large.

When measuring begins, the response to a line of the road is its steady-state response, less the free response to the state that
the former has when a wheel enters the road. X_j is the complex amplitude of the states per unit of road velocity at wheel j, x0_j
their equilibrium with that wheel raised by 1, L the transition over one sample. With wheel j on the road for k_j samples, a
signal of gain C at time t is

    A exp(j omega t) - B,    A = sum over j of (C X_j + Cr_j / j omega) e_j,
    B = sum over j of (C L^k_j (X_j - x0_j / j omega) + (C x0_j + Cr_j) / j omega) e_j at the start,

summed over the wheels on the road. The phases of the lines are independent, so the variance is the integral over the band of

    |A|^2 + |B|^2 - 2 Re A conj(B) exp(j omega t).

It may exceed its final value: the start excites modes that are slower than the road's lowest line.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from models.characteristics import SIDES
from models.common.arrays import Array
from models.common.threads import one_thread
from models.roads.spectrum import Spectrum, as_met, longest_panel, sources, tracks
from models.vehicle.vehicle import Vehicle
from sim.linear.frequency_response import driven_loop, stepwise_frequency_response
from sim.studies.ride.gaussian import Gaussian, RandomSignals, positive_part
from sim.studies.ride.metrics import metrics_of
from sim.studies.ride.quadrature import loop_poles, power_of
from sim.studies.ride.statistical_linearisation import LOWEST, Equivalent, equivalent
from sim.studies.ride.weighting import SampledWk, sampled_wk
from synth.analysis.stability import stability
from synth.controller.controller import AnyController, is_linear
from synth.controller.loop_of import HEIGHT, MIDWAY, loop_of, radius, with_ending
from synth.plant.loop import harmonic_states
from synth.plant.quadrature import sample_band

STILL = 1e-12  # relative to the largest variance in the same unit: a signal with less does not move


@dataclass(frozen=True)
class RemainingTransient:
    """The variance of a signal when measuring begins.

    Attributes:
        share: share of its final value; may exceed 1.
        signal: the measured signal whose share is furthest from 1.
    """

    share: float
    signal: str


def remaining_transient(
    vehicle: Vehicle, controller: AnyController, road: Spectrum, timestep: float, start: float
) -> RemainingTransient | None:
    """Returns the measured signal furthest from its final variance when measuring begins, or None for an unstable loop
    and for a law that is not linear.

    It is None, too, if a preview has the rear wheels' road before these are on it.

    Args:
        road: the spectrum of the road; its roughness has no effect.
        timestep: timestep of the sampled loop [s].
        start: time at which measurement begins [s]; rounded to a sample of the controller, as are the delays of rear wheels.
    """
    shares = settled_shares(vehicle, controller, road, timestep, start)
    if not shares:
        return None
    furthest = max(shares, key=lambda name: abs(shares[name] - 1))
    return RemainingTransient(shares[furthest], furthest)


def settled_shares(
    vehicle: Vehicle, controller: AnyController, road: Spectrum, timestep: float, start: float
) -> dict[str, float]:
    """Returns every measured, moving signal's share of its final variance, by name; empty where `remaining_transient` is None."""
    if not is_linear(controller, vehicle) or radius(whole := loop_of(vehicle, controller, timestep)) >= 1:
        return {}
    model = vehicle.linear_model
    system = whole.closed_loop.part(model.outputs, whole.closed_loop.inputs)
    loop, C, period = system.A, system.C, whole.period
    now, midway = (system.columns(with_ending(model.disturbances, ending)) for ending in (HEIGHT, MIDWAY))
    Cr = system.D[:, now]
    raised = np.linalg.solve(np.eye(len(loop)) - loop, system.B[:, now] + system.B[:, midway])  # by a road one metre higher
    sample = round(start / period)
    late = np.array([round(wheel.behind(vehicle.parameters) / road.speed / period) for wheel in vehicle.kind.wheels])
    if controller.preview is not None and late.any():
        return {}
    here = late <= sample
    left_behind = {k: C @ np.linalg.matrix_power(loop, sample - k) for k in set(late[here].tolist())}

    def states(omega: Array) -> tuple[Array, Array]:
        """Returns the response from each wheel's road velocity to the states at the samples, and to the outputs."""
        X = harmonic_states(*driven_loop(vehicle, controller, omega, timestep), omega)
        return X, C @ X + Cr / (1j * omega[:, None, None])

    def amplitudes(omega: Array) -> Array:
        """Returns A and B by source, shape (F, 2 p, 2)."""
        X, steady = states(omega)
        s, left = 1j * omega[:, None, None], np.zeros((len(omega), len(C), len(late)), dtype=complex)
        for j in np.flatnonzero(here):
            left[..., j] = (left_behind[int(late[j])] @ (X - raised / s) + (C @ raised + Cr) / s)[..., j]
        shares, inputs = tracks(vehicle, road, omega), as_met(vehicle, omega, road.speed)[..., None]
        return np.concatenate([steady[..., here] @ (inputs * shares)[:, here], left @ shares], axis=1)

    def final(omega: Array) -> Array:
        """Returns the final variance per Hz, shape (F, p), with all wheels on the road."""
        wheel_roads = as_met(vehicle, omega, road.speed)[..., None] * tracks(vehicle, road, omega)
        return power_of(states(omega)[1] @ wheel_roads)

    low, high = road.band
    poles, _ = loop_poles(vehicle, controller, timestep, high)
    longest = longest_panel(vehicle, road.speed, controller.ahead)
    band = sample_band(amplitudes, lambda _, both: power_of(both), low, high, poles, longest)
    A, B = np.split(band.values, 2, axis=1)
    # A has the phase of time 0 and B that of the start, so the product is turned by the time between.
    cross = np.real(band.turning(sample * period) @ np.sum(A * np.conj(B), axis=-1))
    now = band.share @ (power_of(A) + power_of(B)) - 2 * cross
    comes_to = band.share @ (power_of(A) if here.all() else final(band.omega))

    units, measured = [vehicle.kind.signal(name).unit for name in model.outputs], {one.source for one in metrics_of(vehicle)}
    loudest = np.array([max(v for v, u in zip(comes_to, units, strict=True) if u == unit) for unit in units])
    return {
        name: max(float(now[i] / comes_to[i]), 0.0)
        for i, name in enumerate(model.outputs)
        if name in measured and comes_to[i] > STILL * loudest[i]
    }


FORGOTTEN = 0.01  # share of the variance that the slowest mode may still lack when measuring begins
EXACT = 1e-4  # relative error of an integral that is not reported


@dataclass(frozen=True, eq=False)
class ExpectedMetrics:
    """Expected metrics of one run over roads of a kind.

    Attributes:
        mean: expected value by metric; for an rms the root of the expected mean square, for the VDV the fourth root of the
            expected integral. The mean of an rms over roads is lower by half its relative variance, that of a VDV by 1.5 times
            its.
        spread: standard deviation of each rms metric from road to road, by metric.
        error: upper estimate of the relative error of the integrals; report it if above `EXACT`.
        line: the linear vehicle, with equivalent lines instead of curves (`statistical_linearisation.py`).
    """

    mean: dict[str, float]
    spread: dict[str, float]
    error: float
    line: Equivalent


def settling_time(vehicle: Vehicle, controller: AnyController) -> float:
    """Returns the time [s] at which the slowest mode has all but `FORGOTTEN` of its variance.

    Infinite for an unstable loop, and for a law that is not linear.
    """
    if not is_linear(controller, vehicle):
        return math.inf
    loop_stability = stability(loop_of(vehicle, controller).closed_loop.A)
    return math.log(FORGOTTEN) / (2 * loop_stability.worst.real) if loop_stability.stable else math.inf


def passive_settling_time(vehicle: Vehicle) -> float:
    """Returns the settling time of the vehicle without control [s]; infinite if it is not stable. See `settling_time`."""
    own = stability(vehicle.linear_model.A)
    return math.log(FORGOTTEN) / (2 * own.worst.real) if own.stable else math.inf


@one_thread()
def expect(vehicle: Vehicle, controller: AnyController, road: Spectrum, timestep: float, window: float) -> ExpectedMetrics | None:
    """Returns the expected metrics, or None if the loop is unstable or not linear, or no equivalent line exists.

    Args:
        timestep: timestep of the sampled loop [s].
        window: duration of the measurement [s].
    """
    if not is_linear(controller, vehicle):
        return None
    if radius(loop_of(vehicle.linearised, controller, timestep)) >= 1:
        return None
    line = equivalent(vehicle, controller, road, timestep)
    if line is None:
        return None
    stops, metrics, vehicle, rest = vehicle.parts.strokes, metrics_of(vehicle), line.vehicle, line.remainder
    low, high = road.band
    poles, rounding = loop_poles(vehicle, controller, timestep, high)
    accelerations, static = vehicle.ride_points.all, vehicle.kind.static_tyre_deflection(vehicle.parameters)
    index = {name: i for i, name in enumerate(vehicle.linear_model.outputs)}
    damped = vehicle.kind.damped_tyres(vehicle.parameters)
    loads = {wheel.tyre_deflection: i for i, wheel in enumerate(vehicle.kind.wheels)}
    ride, weigh = [index[name] for name in accelerations], sampled_wk(timestep)
    pushing = [
        (name, vehicle.kind.deflection_of(name)) for name in vehicle.linear_model.inputs if vehicle.kind.deflection_of(name)
    ]
    pushed = [[index[signal] for signal in pair] for pair in pushing]
    lags = vehicle.limits.actuator_bandwidth is not None

    def spectra(omega: Array) -> Array:
        """Returns, for every step of a period, spectra of all signals, weighted accelerations and the actuators' work."""
        pulls = () if rest is None else rest.pulls
        at_steps, jumps = stepwise_frequency_response(vehicle, controller, omega, timestep, pulls)
        for name, tyre in damped.items():  # the deflection with the same force
            at_steps[:, :, index[name]] += tyre.time * at_steps[:, :, index[tyre.hub]]
            turns = np.exp(1j * omega * timestep * np.arange(len(at_steps))[:, None])
            at_steps[:, :, index[name], loads[name]] -= tyre.time * turns
        outside = sources(vehicle, road, omega) if rest is None else rest.sources(vehicle, road, omega, timestep, at_steps)
        responses = at_steps, jumps
        at_steps, jumps = (one @ outside for one in responses)
        if rest is not None and rest.sharp:
            of_road = outside * (np.arange(outside.shape[1]) < len(vehicle.kind.wheels))[:, None]
            at_steps[:, :, ride], jumps[:, :, ride] = (one[:, :, ride] @ of_road for one in responses)
        at_steps[:-1, :, ride] -= jumps[:, :, ride] / 2  # midway, see `metrics.py`
        weighted = weigh_images(at_steps[:-1, :, ride], omega, timestep, weigh)
        works = [work_spectra(at_steps[:, :, force], at_steps[:, :, along], lags) for force, along in pushed]
        powers = np.concatenate([power_of(at_steps[:-1]), power_of(weighted), *works], axis=-1)
        return road.density * np.moveaxis(powers, 0, 1)

    def checked(_: Array, spectra_by_step: Array) -> Array:
        """Returns the means over a period of the spectra that cannot be negative."""
        return spectra_by_step[:, :, : len(index) + len(ride)].mean(axis=1)

    band = sample_band(spectra, checked, low, high, poles, longest_panel(vehicle, road.speed, controller.ahead))
    if rest is not None:
        below = sample_band(spectra, checked, LOWEST * low, low, poles, longest_panel(vehicle, road.speed, controller.ahead))
        band = below.before(band)
    # The integral is the sum over the lines if every resonance is wider than their spacing.
    damping, rate = -np.real(poles), np.abs(np.imag(poles))
    narrowest = float(damping[(rate > low) & (rate < high)].min(initial=math.inf))
    grain = 2 * math.exp(-narrowest * road.length / road.speed)
    error = max(band.error, grain, rounding)

    @cache
    def of_column(column: int) -> Gaussian:
        return Gaussian(band.values[:, :, column].T, band.omega, band.share)

    works = np.einsum("f,fsc->cs", band.share, band.values[:, :, len(index) + len(ride) :])
    works = works.reshape(len(pushing), 3, band.values.shape[1])
    of_actuators = {}
    for (name, _), work in zip(pushing, works, strict=True):
        net, positive = work_rate(*work, mean=line.mean.get(name, 0.0))
        of_actuators[name] = vehicle.motion_ratios[name] * net, vehicle.motion_ratios[name] * positive
    random = RandomSignals(
        lambda name: of_column(index[name]),
        lambda name: of_column(len(index) + accelerations.index(name)),
        window,
        timestep,
        road.speed,
        # The lines of a road have fixed amplitudes, so metrics over its whole length have no spread.
        max(1 - window * road.speed / road.length, 0.0),
        line.mean,
        static,
        {name: (strokes.get(SIDES[0], math.inf), strokes.get(SIDES[1], math.inf)) for name, strokes in stops.items()},
        of_actuators,
    )
    mean, spread = {}, {}
    for metric in metrics:
        if (value := metric.expected(random)) is not None:
            mean[metric.name] = value[0]
            spread |= {metric.name: value[1]} if value[1] is not None else {}
    return ExpectedMetrics(mean, spread, error, line)


def weigh_images(at_steps: Array, omega: Array, timestep: float, weigh: SampledWk) -> Array:
    """Returns the amplitudes of weighted signals, every image weighted at its own frequency, shaped like `at_steps`.

    Args:
        at_steps: amplitudes by source at every step of a period, shape (steps, F, a, 2).
        omega: frequencies of the road [rad/s], shape (F,).
        timestep: length of a step [s].
    """
    steps = np.arange(len(at_steps))[:, None]
    turn = np.exp(1j * omega * timestep * steps)[..., None, None]
    images = np.fft.fft(at_steps / turn, axis=0)
    weights = weigh.response(omega + 2 * np.pi / (len(at_steps) * timestep) * steps, timestep)
    return turn * np.fft.ifft(weights[..., None, None] * images, axis=0)


def work_spectra(force: Array, travel: Array, lags: bool) -> Array:
    """Returns, for every step of a period, the cospectrum of the force and the change of travel, and both spectra.

    Args:
        force: amplitudes by source at every step and at the next period's first, shape (steps + 1, F, 2) [N].
        travel: travel of its suspension, same shape [m].
        lags: True if the force changes within a step, False if it is held.

    Returns:
        Shape (steps, F, 3).
    """
    acting, change = (force[:-1] + force[1:]) / 2 if lags else force[:-1], np.diff(travel, axis=0)
    cospectrum = np.sum(np.real(acting * np.conj(change)), axis=-1)
    return np.stack([cospectrum, power_of(acting), power_of(change)], axis=-1)


def work_rate(covariance: Array, force: Array, change: Array, *, mean: float) -> tuple[float, float]:
    """Returns the expected work of a step and its positive part [J], see `metrics.py`, averaged over the steps of a period.

    Args:
        covariance: covariance of the force and the change of travel in each step [J], shape (steps,).
        force, change: variances of both [N^2, m^2], shape (steps,).
        mean: mean of the force [N].
    """
    steps = zip(covariance.tolist(), np.sqrt(force).tolist(), np.sqrt(change).tolist(), strict=True)
    return float(covariance.mean()), float(np.mean([positive_part(*step, mean) for step in steps]))
