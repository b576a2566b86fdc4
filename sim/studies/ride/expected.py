"""Expected metrics of a linear vehicle on a random road, and the transient that remains when the measurement begins.

The vertical road velocity is white noise within a frequency band, with the one-sided spectrum G_v = (2 pi n0)^2 G_d(n0) V per
Hz at the speed V. Rear wheels reach each point of the road later, and the road defines the coherence of its left and right
tracks. The road velocity at wheel j is therefore a combination e_j(omega) of two independent white sources. If H is the
frequency response of the implemented loop, the spectrum and the covariance of outputs i and k are

    S_ik(omega) = G_v sum over sources of (H e)_i conj(H e)_k,    cov(i, k) = integral of Re S_ik df.

If the sample period of the controller is several timesteps, the loop is periodic, and H has a value for each step of a period.
A sinusoidal road then causes aliases (images) at omega + 2 pi k / period, and each image is weighted at its own frequency. A
spectrum is a function of the road frequency omega. The spectrum includes the images, because |H e|^2 is computed at each step
of the period. The mean of the spectrum over the steps of a period is the sum over the images (Parseval). Means over time are
computed as means over the steps of a period. Standard deviations from road to road, and largest values, are computed from the
mean spectrum.

The band contains all frequency lines of the road, and extends half a line spacing beyond the first and the last line. The
integral over the band then equals the sum over the lines, to second order in the line spacing. Signals are assumed to be
Gaussian (`gaussian.py`). For a stationary linear run, the expected values of mean quantities are exact. Mean quantities are
mean squares (including the tyre load, which is never negative), shares of time, and power and energy of held forces. The
integral in the vibration dose value (VDV) is also exact, because E a^4 = 3 sigma^4 for a Gaussian acceleration a. For a vehicle
with nonlinear springs and dampers, equivalent linear characteristics are used (`statistical_linearisation.py`), which is an
approximation.

The expected values of largest magnitudes are approximate. The expected values of largest magnitudes are too large if the window
is short compared with the decay time of the vehicle. The errors of the expected values were found by comparison with linear
responses over 200 roads. The comparison covers three built-in vehicles with the controllers `passive`, `I` and `II`, at 10, 20
and 35 m/s over 10 s. The errors are at most 2.5 % for MTVV, 5 % for crest factors, 7 % for peaks, and 12 % for the travel of
the passive quarter-car. The expected values are too large, except crest factors of well-damped loops. Crest factors of
well-damped loops are up to 4 % too small, and up to 7 % for windows of 3 s. For light damping (100 N s/m, 10 to 35 m/s, 3 and
10 s), expected values are too large by up to 8 % (VDV), 9 % (MTVV), 14 % (crest factors) and 23 % (largest travel). With light
damping, the standard deviation from road to road is up to 45 % too large. The formula for this standard deviation assumes a
window much longer than the decay time.

When the measurement begins, the transient has not decayed completely. The response to a line of the road is its steady-state
response minus a free response. The free response starts from the steady-state value of the states at the time when a wheel
enters the road. X_j is the complex amplitude of the states per unit road velocity at wheel j. x0_j is the equilibrium of the
states if wheel j is raised by 1 m. L is the transition matrix over one sample. k_j is the number of samples for which wheel j
has been on the road. The value of a signal with output row C at time t is a sum over the wheels on the road:

    A exp(j omega t) - B,    A = sum over j of (C X_j + Cr_j / j omega) e_j,
    B = sum over j of (C L^k_j (X_j - x0_j / j omega) + (C x0_j + Cr_j) / j omega) e_j at the start,

The phases of the lines are independent, so the variance is the integral over the band of

    |A|^2 + |B|^2 - 2 Re A conj(B) exp(j omega t).

The variance can exceed its final value, because the start of the road excites modes that are slower than the lowest line of the
road.
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
from synth.plant.harmonic_response import harmonic_states
from synth.plant.quadrature import sample_band

STILL = 1e-12  # a signal counts as zero if its variance is smaller than this, relative to the largest variance in the same unit


@dataclass(frozen=True)
class RemainingTransient:
    """The measured signal whose variance at the start of the measurement differs most from the signal's final variance.

    Attributes:
        share: variance of the signal relative to its final value; may exceed 1.
        signal: name of the signal.
    """

    share: float
    signal: str


def remaining_transient(
    vehicle: Vehicle, controller: AnyController, road: Spectrum, timestep: float, start: float
) -> RemainingTransient | None:
    """Returns the measured signal whose variance at the start of the measurement differs most from the signal's final variance.

    Returns None for an unstable loop, for a nonlinear law, and for a preview controller of a vehicle with rear wheels.

    Args:
        vehicle: vehicle that the controller controls.
        controller: controller of this vehicle.
        road: spectrum of the road; the roughness has no effect on the result.
        timestep: timestep of the sampled loop [s].
        start: time at which the measurement begins [s]. The start time and the delays of rear wheels are rounded to an integer
            number of controller samples.
    """
    shares = settled_shares(vehicle, controller, road, timestep, start)
    if not shares:
        return None
    furthest = max(shares, key=lambda name: abs(shares[name] - 1))
    return RemainingTransient(shares[furthest], furthest)


def settled_shares(
    vehicle: Vehicle, controller: AnyController, road: Spectrum, timestep: float, start: float
) -> dict[str, float]:
    """Returns the variance of each measured signal that moves, relative to the signal's final variance, by name.

    The arguments are those of `remaining_transient`. The result is empty if `remaining_transient` returns None.
    """
    if not is_linear(controller, vehicle) or radius(whole := loop_of(vehicle, controller, timestep)) >= 1:
        return {}
    model = vehicle.linear_model
    system = whole.closed_loop.part(model.outputs, whole.closed_loop.inputs)
    loop, C, period = system.A, system.C, whole.period
    now, midway = (system.columns(with_ending(model.disturbances, ending)) for ending in (HEIGHT, MIDWAY))
    Cr = system.D[:, now]
    # equilibrium of the loop if all heights are 1 m larger
    raised = np.linalg.solve(np.eye(len(loop)) - loop, system.B[:, now] + system.B[:, midway])
    sample = round(start / period)
    late = np.array([round(wheel.behind(vehicle.parameters) / road.speed / period) for wheel in vehicle.kind.wheels])
    if controller.preview is not None and late.any():
        return {}
    here = late <= sample
    left_behind = {k: C @ np.linalg.matrix_power(loop, sample - k) for k in set(late[here].tolist())}

    def states(omega: Array) -> tuple[Array, Array]:
        """Returns the frequency responses from the road velocity at each wheel to the states at the samples and to the
        outputs.
        """
        X = harmonic_states(*driven_loop(vehicle, controller, omega, timestep), omega)
        return X, C @ X + Cr / (1j * omega[:, None, None])

    def amplitudes(omega: Array) -> Array:
        """Returns A and B of the module docstring for both road sources, shape (F, 2 p, 2)."""
        X, steady = states(omega)
        s, left = 1j * omega[:, None, None], np.zeros((len(omega), len(C), len(late)), dtype=complex)
        for j in np.flatnonzero(here):
            left[..., j] = (left_behind[int(late[j])] @ (X - raised / s) + (C @ raised + Cr) / s)[..., j]
        shares, inputs = tracks(vehicle, road, omega), as_met(vehicle, omega, road.speed)[..., None]
        return np.concatenate([steady[..., here] @ (inputs * shares)[:, here], left @ shares], axis=1)

    def final(omega: Array) -> Array:
        """Returns the final variance density per Hz when all wheels are on the road, shape (F, p)."""
        wheel_roads = as_met(vehicle, omega, road.speed)[..., None] * tracks(vehicle, road, omega)
        return power_of(states(omega)[1] @ wheel_roads)

    low, high = road.band
    poles, _ = loop_poles(vehicle, controller, timestep, high)
    longest = longest_panel(vehicle, road.speed, controller.ahead)
    band = sample_band(amplitudes, lambda _, both: power_of(both), low, high, poles, longest)
    A, B = np.split(band.values, 2, axis=1)
    # The phase of A refers to time 0, and the phase of B to the start, so the product is rotated by the difference.
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


# when the measurement begins, the variance of the slowest mode may differ from its final value by at most this share
FORGOTTEN = 0.01
EXACT = 1e-4  # the error of an integral is reported if it exceeds this share of the integral


@dataclass(frozen=True, eq=False)
class ExpectedMetrics:
    """Expected metrics of a run over all random roads with the same spectrum.

    Attributes:
        mean: expected value of each metric, by name. For an rms, the expected value is the root of the expected mean square.
            For the VDV, the expected value is the fourth root of the expected integral. The mean of an rms over roads is lower
            than the root of the expected mean square, by half the relative variance of the rms. The mean of a VDV over roads is
            lower than the fourth root of the expected integral, by 1.5 times the relative variance of the VDV.
        spread: standard deviation of each rms metric between random roads, by metric.
        error: upper estimate of the relative error of the integrals; this error is reported if it exceeds `EXACT`.
        line: linear vehicle from which the expected values are computed (`statistical_linearisation.py`).
    """

    mean: dict[str, float]
    spread: dict[str, float]
    error: float
    line: Equivalent


def settling_time(vehicle: Vehicle, controller: AnyController) -> float:
    """Returns the time [s] after which the variance of the slowest mode differs from its final value by at most the share
    `FORGOTTEN`.

    The settling time is infinite for an unstable loop and for a nonlinear law.
    """
    if not is_linear(controller, vehicle):
        return math.inf
    return _settling_time(loop_of(vehicle, controller).closed_loop.A)


def passive_settling_time(vehicle: Vehicle) -> float:
    """Returns the settling time of the vehicle without control [s], as defined in `settling_time`; infinite if this vehicle is
    unstable.
    """
    return _settling_time(vehicle.linear_model.A)


def _settling_time(A: Array) -> float:
    one = stability(A)
    return math.log(FORGOTTEN) / (2 * one.worst.real) if one.stable else math.inf


@one_thread()
def expect(vehicle: Vehicle, controller: AnyController, road: Spectrum, timestep: float, window: float) -> ExpectedMetrics | None:
    """Returns the expected metrics of a run; None if the loop is unstable or nonlinear, or if no linear equivalent is found.

    Args:
        vehicle: vehicle that the controller controls.
        controller: controller of this vehicle.
        road: spectrum of the road.
        timestep: timestep of the sampled loop [s].
        window: duration of the measurement from which metrics are computed [s].
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
        """Returns the spectra of all signals, of weighted accelerations and of actuator work, for each step of a period."""
        pulls = () if rest is None else rest.pulls
        at_steps, jumps = stepwise_frequency_response(vehicle, controller, omega, timestep, pulls)
        for name, tyre in damped.items():  # deflection at which a tyre without damping would have the same force
            at_steps[:, :, index[name]] += tyre.time * at_steps[:, :, index[tyre.hub]]
            turns = np.exp(1j * omega * timestep * np.arange(len(at_steps))[:, None])
            at_steps[:, :, index[name], loads[name]] -= tyre.time * turns
        outside = sources(vehicle, road, omega) if rest is None else rest.sources(vehicle, road, omega, timestep, at_steps)
        responses = at_steps, jumps
        at_steps, jumps = (one @ outside for one in responses)
        if rest is not None and rest.sharp:
            of_road = outside * (np.arange(outside.shape[1]) < len(vehicle.kind.wheels))[:, None]
            at_steps[:, :, ride], jumps[:, :, ride] = (one[:, :, ride] @ of_road for one in responses)
        # the mean of the values before and after a jump is used, see `metrics.py`
        at_steps[:-1, :, ride] -= jumps[:, :, ride] / 2
        weighted = weigh_images(at_steps[:-1, :, ride], omega, timestep, weigh)
        works = [work_spectra(at_steps[:, :, force], at_steps[:, :, along], lags) for force, along in pushed]
        powers = np.concatenate([power_of(at_steps[:-1]), power_of(weighted), *works], axis=-1)
        return road.density * np.moveaxis(powers, 0, 1)

    def checked(_: Array, spectra_by_step: Array) -> Array:
        """Returns the spectra that cannot be negative, each averaged over the steps of a period."""
        return spectra_by_step[:, :, : len(index) + len(ride)].mean(axis=1)

    band = sample_band(spectra, checked, low, high, poles, longest_panel(vehicle, road.speed, controller.ahead))
    if rest is not None:
        below = sample_band(spectra, checked, LOWEST * low, low, poles, longest_panel(vehicle, road.speed, controller.ahead))
        band = below.before(band)
    # The integral equals the sum over the lines of the road only if each resonance is wider than the spacing of the lines.
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
        # Because the lines of a road have fixed amplitudes, a metric over the whole length of the road is the same for every
        # seed.
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
    """Returns the amplitudes of signals after frequency weighting with W_k, with the shape of `at_steps`. Each image is
    weighted with W_k at its own frequency.

    Args:
        at_steps: amplitudes of `a` signals caused by both road sources at each step of a period, shape (steps, F, a, 2).
        omega: frequencies of the road [rad/s], shape (F,).
        timestep: duration of a step [s].
        weigh: function for the frequency weighting W_k of sampled signals.
    """
    steps = np.arange(len(at_steps))[:, None]
    turn = np.exp(1j * omega * timestep * steps)[..., None, None]
    images = np.fft.fft(at_steps / turn, axis=0)
    weights = weigh.response(omega + 2 * np.pi / (len(at_steps) * timestep) * steps, timestep)
    return turn * np.fft.ifft(weights[..., None, None] * images, axis=0)


def work_spectra(force: Array, travel: Array, lags: bool) -> Array:
    """Returns the spectra that determine the work of an actuator in each step of a period.

    Args:
        force: force amplitudes due to both road sources, at each step and at the first step of the next period [N], shape
            (steps + 1, F, 2).
        travel: amplitudes of the travel of the actuator's suspension due to both road sources [m], shape (steps + 1, F, 2).
        lags: True if the force changes within a step, False if the force is held.

    Returns:
        Cospectrum of the force and the change of travel, spectrum of the force, and spectrum of the change, shape (steps, F,
        3).
    """
    acting, change = (force[:-1] + force[1:]) / 2 if lags else force[:-1], np.diff(travel, axis=0)
    cospectrum = np.sum(np.real(acting * np.conj(change)), axis=-1)
    return np.stack([cospectrum, power_of(acting), power_of(change)], axis=-1)


def work_rate(covariance: Array, force: Array, change: Array, *, mean: float) -> tuple[float, float]:
    """Returns an actuator's expected work per step, and the expected positive part of this work [J], averaged over the steps of
    a period.

    Args:
        covariance: covariance of the force and the change of travel in each step [J], shape (steps,).
        force, change: variances of the force [N^2] and of the change of travel [m^2] in each step, shape (steps,).
        mean: mean value of the force [N].
    """
    steps = zip(covariance.tolist(), np.sqrt(force).tolist(), np.sqrt(change).tolist(), strict=True)
    return float(covariance.mean()), float(np.mean([positive_part(*step, mean) for step in steps]))
