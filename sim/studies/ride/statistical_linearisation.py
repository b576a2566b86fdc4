"""Statistical linearisation, which replaces a nonlinear force on a random road by the best straight line and a remainder.

The *curve* is the characteristic of a nonlinear spring or damper. `synth.controller.equivalent_line.py` computes the best
straight line.

The remainder is the difference between the curve and the line. The effect of the remainder is computed to second order. The
remainder acts as a noise force, which also contains frequencies below those of the road. The noise mainly excites a slow mode
of the controlled vehicle; without the remainder, travel would be about 5 % too small.

For a Gaussian signal x = m + s z with mean m and standard deviation s, a curve F is a sum of Hermite polynomials of z,

    F(x) = E F + s E F' z + e,    e = sum over n >= 2 of c_n He_n(z),    n! c_n = s sum over knots of d_i phi(a_i)
    He_{n-2}(a_i),

where d_i is the change of the slope at a knot of the curve, and a_i is the position of this knot minus m, divided by s. Simple
statistical linearisation neglects the remainder e. If rho_ij is the correlation of the signals x_i and x_j, the covariance of e
is (F. G. Mehler's formula)

    D_ij(tau) = E e_i(t + tau) e_j(t) = sum of c_in c_jn n! rho_ij(tau)^n.

The even terms of this covariance have a spectrum that extends to frequency 0, where the road has no power but a slow loop
responds most. The slopes of the curves are correlated with e, so they affect the motion that e causes. If R_ij(tau) is the
impulse response of the signal x_i to a force at curve j, then to second order in e,

    F(x) = <F> + s E F' z + sum over j of (Sigma_ij * x_j) + noise of covariance D,
    Sigma_ij(tau) = R_ij(tau) sum over n >= 2 of n^2 (n - 1)! c_in c_jn / (s_i s_j) rho_ij(tau)^(n-1),
    <F_i> = E F_i + sum over j of the integral of R_ij(tau) sum over n >= 2 of (n + 1)! c_i,n+1 c_jn / s_i rho_ij(tau)^n,

where s, rho and R are those of the resulting vehicle (the direct interaction approximation: R. H. Kraichnan (1959), J. Fluid
Mech. 5, 497-543; P. C. Martin, E. D. Siggia and H. A. Rose (1973), Phys. Rev. A 8, 423-437). The memory Sigma acts like
frequency-dependent slopes from the signals to the forces of the curves. The noise is an additional source of excitation,
independent of the road. The remainder also changes the mean force <F_i>.

Hermite polynomials of degrees 2 to 4 are included. Hermite polynomials of higher degrees excite frequencies that no suspension
amplifies. For characteristics with sharp bends, for example due to friction, the second-order terms of polynomials of higher
degrees are too large. If polynomials of all degrees were included, the error of the expected ride would grow by 0.3 %, and no
other error would decrease. If the share of e in the variance of a force exceeds `SHARP`, accelerations are computed from the
line alone. The error of accelerations that are computed from the line alone is up to 3 %. If the remainder were included, the
accelerations would be up to 13 % too small. Slow signals always include the remainder, without which travel would be up to 25 %
too small.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy  # `scipy.special` is imported only when it is used, because the import takes a tenth of a second

from models.characteristics.curve import ForceCurve
from models.common.arrays import Array
from models.common.printed import percent, three_digits
from models.roads.spectrum import Spectrum, longest_panel, sources
from models.vehicle.vehicle import Vehicle
from sim.linear.frequency_response import sampled_frequency_response, stepwise_frequency_response
from sim.studies.ride.quadrature import loop_poles, power_of
from synth.controller.controller import Controller
from synth.controller.equivalent_line import EquivalentLine, averages, equivalent_line, mean_outputs
from synth.controller.loop_of import loop_of, radius
from synth.plant.quadrature import sample_band

if TYPE_CHECKING:
    from models.parts.part import SuspensionPart

DEGREES = (2, 3, 4)  # degrees of the Hermite polynomials that represent a nonlinear force
COUNT = 4096  # number of frequencies in a spectrum
HIGHEST = 2 * np.pi * 125.0  # the frequencies extend at least to this value [rad/s]
ABOVE = 6.0  # for a fast vehicle, the frequencies extend to this multiple of the frequency of its fastest oscillation
MEMORY_CONSISTENT = 1e-6  # the iteration ends if the relative change is smaller than this
MEMORY_DIRECT = 10  # number of first iterations that take full steps
MEMORY_ROUNDS = 100  # largest number of iterations
# a curve counts as sharp (for example, due to friction) if the remainder has a larger share of the variance of its force
SHARP = 0.04
GAUSS = np.polynomial.hermite_e.hermegauss(200)  # nodes and weights for averages over a Gaussian variable
LOWEST = 1e-3  # lowest frequency of the noise that represents the remainder, relative to the lowest frequency of the road


@dataclass(frozen=True, eq=False)
class Remainder:
    """Remainders of e nonlinear characteristics (curves), modelled by a linear transfer matrix (the memory) and by noise.

    Attributes:
        pulls: names of the e deflections along which the forces of the nonlinear characteristics act on the vehicle.
        index: index of each characteristic's argument among the outputs of the vehicle, shape (e,).
        omega: frequencies of the spectra [rad/s], ascending from 0, shape (F,).
        memory: transfer matrix from the characteristics' arguments to their forces, without the slopes of the equivalent lines,
            shape (F, e, e).
        noise: matrix of the one-sided spectra of the noise forces [N^2/Hz], shape (F, e, e).
        mean_force: mean forces of the remainders, without the mean forces of the equivalent lines [N], shape (e,).
        share: largest share of a remainder in the variance of the characteristic's force.
    """

    pulls: tuple[str, ...]
    index: Array
    omega: Array
    memory: Array
    noise: Array
    mean_force: Array
    share: float

    @property
    def sharp(self) -> bool:
        """True if accelerations are computed without the remainder, because the remainder's share is large."""
        return self.share > SHARP

    def sources(self, vehicle: Vehicle, road: Spectrum, omega: Array, timestep: float, at_steps: Array) -> Array:
        """Returns the excitation of the wheels and of the nonlinear characteristics, relative to the amplitude of the road.

        Args:
            vehicle: linear vehicle with r wheels, in which the nonlinear characteristics are replaced by straight lines.
            road: spectrum of the road.
            omega: frequencies of the road [rad/s], shape (F,).
            timestep: timestep of the sampled loop [s].
            at_steps: result of `stepwise_frequency_response` for the loop, from the road velocities and from forces along the
                deflections `pulls`.

        Returns:
            Excitation of r wheels and e curves (rows) by the two road sources and by e noise sources (columns), shape (F, r +
            e, 2 + e).
        """
        by_road, steps = sources(vehicle, road, omega), len(at_steps) - 1
        by_road = by_road * ((omega >= road.band[0]) & (omega <= road.band[1]))[:, None, None]
        values, vectors = np.linalg.eigh(_interpolate_matrices(self.omega, self.noise, omega))
        by_noise = vectors * np.sqrt(np.maximum(values, 0.0) / road.density)[:, None, :]
        wheels = by_road.shape[1]
        excitation = np.zeros((len(omega), wheels + len(self.index), 2 + len(self.index)), dtype=complex)
        excitation[:, :wheels, :2], excitation[:, wheels:, 2:] = by_road, by_noise
        turn = np.exp(-1j * np.multiply.outer(np.arange(steps) * timestep, omega))[..., None, None]
        response = (turn * at_steps[:-1][:, :, self.index]).mean(axis=0)  # component of the response at the frequency omega
        memory = _interpolate_matrices(self.omega, self.memory, omega)
        closed = np.linalg.solve(np.eye(len(self.index)) - response[..., wheels:] @ memory, response @ excitation)
        excitation[:, wheels:] += memory @ closed
        return excitation


def remainder(
    line: EquivalentLine,
    controller: Controller,
    road: Spectrum,
    timestep: float,
    fastest: float,
    index: Array,
    means: Array,
    resting: Callable[[Array], Array],
) -> Remainder | None:
    """Returns the remainders of nonlinear characteristics on a road, found by iteration; None if this iteration does not
    converge.

    Args:
        line: equivalent straight lines that replace the e nonlinear characteristics.
        controller: the controller.
        road: spectrum of the road.
        timestep: timestep of the sampled loop [s].
        fastest: frequency of the fastest oscillation of the loop [rad/s].
        index: index of each characteristic's argument among the outputs of the vehicle, shape (e,).
        means: initial mean values of the characteristics' arguments, shape (e,).
        resting: function that computes the means of the characteristics' arguments, shape (e,), from the mean forces of the
            remainders, shape (e,).
    """
    vehicle, lines = line.vehicle, line.slopes
    highest = min(max(HIGHEST, ABOVE * fastest), 0.9 * np.pi / timestep)
    omega = highest / COUNT * np.arange(COUNT + 1)
    omega[0] = 1e-3 * omega[1]
    between, dt = omega[1] / (2 * np.pi), np.pi / highest
    wheels = len(vehicle.kind.wheels)
    responses = sampled_frequency_response(vehicle, controller, omega, timestep, pulls=line.deflections)[:, index]
    to_force = responses[..., wheels:]
    inputs = sources(vehicle, road, omega) * ((omega >= road.band[0]) & (omega <= road.band[1]))[:, None, None]
    of_road = math.sqrt(road.density) * responses[..., :wheels] @ inputs
    identity, memory, noise = np.eye(len(line.curves)), np.zeros_like(to_force), np.zeros_like(to_force)
    for rounds in range(1, MEMORY_ROUNDS + 1):
        closed = np.linalg.inv(identity - to_force @ memory)
        by_road, by_force = closed @ of_road, closed @ to_force
        spectra = by_road @ _adjoint(by_road) + by_force @ noise @ _adjoint(by_force)
        covariance = np.fft.irfft(spectra, axis=0) * COUNT * between
        deviations = np.sqrt(np.diagonal(covariance[0]))
        if not np.all(deviations > 0):
            return None
        rho = covariance / np.outer(deviations, deviations)
        back = np.fft.irfft(by_force, axis=0) / dt
        answer = np.concatenate([back[:1], back[1:COUNT] + back[:COUNT:-1], np.zeros_like(back[COUNT:])])
        moments = [averages(one, m, s) for one, m, s in zip(line.curves, means, deviations, strict=True)]
        hermite = np.array([coefficients(one, m, s) for one, m, s in zip(line.curves, means, deviations, strict=True)])
        force, slopes, of_noise = _second_order(rho, answer * dt, hermite, deviations)
        beyond = force + [mean for mean, _ in moments] - lines * means
        shifted = resting(beyond)
        transfer = np.diag([slope for _, slope in moments] - lines) + np.fft.rfft(slopes, axis=0)
        new_noise = 2 * dt * np.fft.rfft(of_noise, axis=0)
        still = np.abs(shifted - means) <= MEMORY_CONSISTENT * (np.abs(shifted) + deviations)
        settled = (np.abs(transfer - memory) <= MEMORY_CONSISTENT * np.abs(lines).max()).all()
        settled &= (np.abs(new_noise - noise) <= MEMORY_CONSISTENT * np.abs(new_noise).max()).all()
        if settled and np.all(still):
            each = zip(line.curves, means, deviations, moments, strict=True)
            share = max(_share_beyond(curve, m, s, slope) for curve, m, s, (_, slope) in each)
            return Remainder(line.deflections, index, omega, transfer, new_noise, beyond, share)
        step = 1.0 if rounds < MEMORY_DIRECT else 1 / 4  # if a controller nearly cancels a spring, full steps would overshoot
        memory, noise, means = (
            memory + step * (transfer - memory),
            noise + step * (new_noise - noise),
            means + step * (shifted - means),
        )
    return None


def coefficients(curve: ForceCurve, mean: float, deviation: float) -> Array:
    """Returns the coefficients [N] of a curve for the Hermite polynomials He_n((x - mean) / deviation) of `DEGREES`."""
    a = (curve.x - mean) / deviation
    weights = deviation * np.diff(curve.slopes) * np.exp(-(a**2) / 2) / math.sqrt(2 * math.pi)
    return np.array([float(weights @ scipy.special.eval_hermitenorm(n - 2, a)) / math.factorial(n) for n in DEGREES])


def _share_beyond(curve: ForceCurve, mean: float, deviation: float, slope: float) -> float:
    """Returns the share of the remainder in the variance of a characteristic's force, if the characteristic's argument is
    Gaussian.

    Args:
        curve: characteristic of the nonlinear spring or damper.
        mean, deviation: mean and standard deviation of the argument of the characteristic.
        slope: slope of the straight line that replaces the characteristic.
    """
    z, weights = GAUSS
    force = curve(mean + deviation * z)
    variance = np.average((force - np.average(force, weights=weights)) ** 2, weights=weights)
    return float(1 - (deviation * slope) ** 2 / variance)


def _second_order(rho: Array, answer: Array, c: Array, deviations: Array) -> tuple[Array, Array, Array]:
    """Returns the second-order terms of the equations in the module docstring.

    Args:
        rho: correlations rho_ij of the characteristics' arguments at T times, shape (T, e, e).
        answer: impulse responses R at the same T times, shape (T, e, e).
        c: Hermite coefficients c_n of each characteristic, shape (e, number of degrees).
        deviations: standard deviations of the characteristics' arguments, shape (e,).

    Returns:
        Changes of the mean forces, shape (e,); the memory, shape (T, e, e); the covariance of the noise, shape (T, e, e).
    """
    memory, noise, force = np.zeros_like(rho), np.zeros_like(rho), np.zeros(len(c))
    power = rho  # `power` is rho^(n-1), where n is the degree
    for k, n in enumerate(DEGREES):
        pairs = np.outer(c[:, k], c[:, k])
        memory += n**2 * math.factorial(n - 1) * pairs / np.outer(deviations, deviations) * power
        power = power * rho
        noise += math.factorial(n) * pairs * power
        if k + 1 < c.shape[1]:
            both = np.outer(c[:, k + 1] / deviations, c[:, k])
            force += math.factorial(n + 1) * (both * np.sum(answer * power, axis=0)).sum(axis=1)
    return force, answer * memory, noise


def _adjoint(matrices: Array) -> Array:
    return np.conj(np.swapaxes(matrices, -1, -2))


def _interpolate_matrices(omega: Array, matrices: Array, at: Array) -> Array:
    """Returns matrices at other frequencies by linear interpolation, shape (F, e, e)."""
    i = np.clip(np.searchsorted(omega, at) - 1, 0, len(omega) - 2)
    share = np.clip((at - omega[i]) / (omega[i + 1] - omega[i]), 0.0, 1.0)[:, None, None]
    return (1 - share) * matrices[i] + share * matrices[i + 1]


@dataclass(frozen=True, eq=False)
class Equivalent:
    """Linear equivalent of a vehicle with nonlinear springs or dampers on a random road.

    Attributes:
        vehicle: vehicle in which the nonlinear characteristics are replaced by straight lines.
        mean: means of the output signals whose mean is not zero, each in the unit of the signal, by name.
        rounds: number of iterations until the equivalent lines converged; 0 for a linear vehicle.
        remainder: remainders of the nonlinear characteristics; None if the iteration for them did not converge.
    """

    vehicle: Vehicle
    mean: Mapping[str, float] = field(default_factory=dict)
    rounds: int = 0
    remainder: Remainder | None = None


def equivalent(vehicle: Vehicle, controller: Controller, road: Spectrum, timestep: float) -> Equivalent | None:
    """Returns the linear equivalent of a vehicle; None if the loop of this equivalent is unstable or the iteration does not
    converge.

    Args:
        vehicle: vehicle that the controller controls.
        controller: controller of this vehicle.
        road: spectrum of the road.
        timestep: timestep of the sampled loop [s].
    """
    if not vehicle.parts.nonlinear:
        return Equivalent(vehicle)
    line = equivalent_line(vehicle, controller, lambda car, signals: _deviations(car, controller, road, timestep, signals))
    return line and _with_remainder(line, controller, road, timestep)


def _with_remainder(line: EquivalentLine, controller: Controller, road: Spectrum, timestep: float) -> Equivalent:
    """Returns the linear equivalent; the remainders of the characteristics are included if the iteration for them converges."""
    poles = np.linalg.eigvals(loop_of(line.vehicle, controller).closed_loop.A)
    fastest = float(np.abs(poles[np.abs(poles.imag) > np.abs(poles.real)]).max(initial=0.0))

    def resting(forces: Array) -> Array:
        outputs = mean_outputs(line.vehicle, controller, line.deflections, forces)
        return np.array([outputs[signal] for signal in line.signals])

    index, means = np.array([line.vehicle.linear_model.outputs.index(signal) for signal in line.signals]), line.mean
    began = np.array([means[signal] for signal in line.signals])
    beyond = remainder(line, controller, road, timestep, fastest, index, began, resting)
    if beyond is not None:
        means = mean_outputs(line.vehicle, controller, line.deflections, beyond.mean_force)
    return Equivalent(line.vehicle, {name: value for name, value in means.items() if value}, line.rounds, beyond)


def line_words(vehicle: Vehicle, line: Equivalent) -> list[str]:
    """Returns sentences about the expected values of a vehicle with nonlinear springs or dampers; empty for a linear vehicle."""
    if not line.rounds:
        return []
    whole, usual = record(vehicle, line), {one.name: _slope(vehicle, one) for one in vehicle.parts.with_curve}
    slopes = [
        f"{name} {three_digits(slope)}, in equilibrium {three_digits(usual[name])}" for name, slope in whole["slopes"].items()
    ]
    slopes += [f"{name} is {three_digits(1e3 * mean)} mm on average" for name, mean in whole["mean"].items()]
    tabled = any(one.surface is not None for one in vehicle.parts.with_curve)
    note = (
        " A position-dependent damper is replaced by its mean force over all deflections; rms is then accurate to within 3 %."
        * tabled
    )
    rest, accuracy = (
        line.remainder,
        ("Rms and dynamic load are accurate to 1 %; vdv can be up to 4 % too high, energy up to 5 %, and crest up to 8 %. "),
    )
    if rest is not None and rest.sharp:
        accuracy = (
            f"The straight lines do not explain {percent(rest.share)} of the variance of a force, because its curve is sharp. "
            "Expected accelerations are therefore computed without second-order remainders. "
        )
        friction = (
            "As for all sharp curves, such as those of friction, rms is accurate to within 3 %, and dynamic load is up to 8 % "
            "too low"
        )
    else:
        friction = "With friction, rms and dynamic load are accurate to 4 %"
    return [
        f"Expected values use statistical linearisation {'with' if line.remainder else 'without'} second-order "
        f"remainders{', except for accelerations' * (rest is not None and rest.sharp)}. "
        "On this road, the straight lines that replace the curves of springs and dampers have these slopes: "
        f"{'; '.join(slopes)}.{note}",
        f"{accuracy}{friction}; vdv can be up to 10 % too high, and crest up to 35 %. If wheels leave the ground, vdv can be "
        "up to 8 % too high, and crest, travel and forces up to 15 %. If wheels are in the air for a fifth of the time, crest, "
        "travel and forces can be up to 20 % too high.",
    ]


def _slope(vehicle: Vehicle, one: "SuspensionPart") -> float:
    """Returns the slope of a part's force at equilibrium, with respect to the deflection or the deflection rate of the part
    itself [N/m or N s/m].
    """
    if one.parameter:
        return vehicle.parameters[one.parameter]
    line = next(each.part.line for each in vehicle.elements if each.name == one.element)
    return float(line.damping if one.damps else line.stiffness)


def record(vehicle: Vehicle, line: Equivalent) -> dict[str, Any]:
    """Returns the slopes of the equivalent lines and the mean travel as a JSON object in SI units."""
    bent = {one.name: one for one in vehicle.parts.with_curve if one.curve.is_nonlinear}
    travels = [one.deflection for one in vehicle.kind.suspensions]
    return {
        "slopes": {name: _slope(line.vehicle, one) for name, one in bent.items()},
        "mean": {name: line.mean.get(name, 0.0) for name in travels},
        "rounds": line.rounds,
        "second_order": line.remainder is not None,
    }


def _deviations(
    vehicle: Vehicle, controller: Controller, road: Spectrum, timestep: float, signals: Sequence[str]
) -> Array | None:
    """Returns the standard deviations of k output signals of a linear vehicle on a road, shape (k,); None if the vehicle is
    unstable.
    """
    if radius(loop_of(vehicle, controller, timestep)) >= 1:
        return None
    low, high = road.band
    poles, _ = loop_poles(vehicle, controller, timestep, high)
    index = [vehicle.linear_model.outputs.index(name) for name in signals]

    def spectra(omega: Array) -> Array:
        at_steps = stepwise_frequency_response(vehicle, controller, omega, timestep)[0][:-1, :, index]
        return road.density * power_of(at_steps @ sources(vehicle, road, omega)).mean(axis=0)

    band = sample_band(spectra, lambda _, value: value, low, high, poles, longest_panel(vehicle, road.speed, controller.ahead))
    return np.sqrt(band.share @ band.values)
