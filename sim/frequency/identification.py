"""Frequency responses, measured in MuJoCo, beside what the linear analysis says they are.

A run starts from rest, so its first seconds are its own free motion, and the passive car's takes a minute to die. Its *shape* is
known, as it is that of the loop's poles; only its size is not. So the last period of a run is fitted, by least squares, with a
sine and a cosine at every line and with those decaying shapes. A wrong frequency response cannot hide there: nothing decaying
looks like a line over a whole period.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError
from models.reality import Implementation, steps_per_sample
from models.roads.sinusoids import chirp
from models.vehicle import Vehicle
from sim.frequency.gain import l2_gain
from sim.linear.frequency import as_met, continuous_frequency_response, sampled_frequency_response
from sim.linear.loop import taylor4
from sim.physics.simulate import simulate
from sim.response.regime import ended_by
from sim.response.response import SILENT, Response
from sim.runs.run import sample_times
from synth.controller import Controller
from synth.implemented.loop import implemented_loop, sampled_radius

LOWEST, HIGHEST, LINES = 0.1, 25.0, 60  # Hz, Hz, lines between them, evenly on a logarithmic scale; equal ones fall together
IMAGES = 8  # of a line on either side of so many multiples of the sample rate; later ones are smaller still
ALIASED = 0.98  # of half the controller's sample rate; a line above it has images that lie on other lines, or nearly
DEAD = 1e-12  # free motion that has decayed to this is none
SETTLED = 1e-7  # what may be left of it where its shape is not fitted


@dataclass(frozen=True, eq=False)
class Lines:
    """The frequency response of one controller, per road velocity under the first wheel.

    Attributes:
        controller: the controller.
        outputs: names of the p output signals.
        units: their units.
        omega: lines [rad/s], shape (F,).
        measured: in MuJoCo, complex, shape (F, p).
        sampled: exact, of the sampled loop as it is implemented.
        integrated: the same as RK4 makes it.
        continuous: exact, of the continuous loop.
        order: power of the timestep with which sampled tends to continuous; NaN where a delay or sample period stands between.
        gain: L2 gain of the run, from w to z; None where the road has a filter (`sim.frequency.gain`).
        ended: what ended the linear regime.
    """

    controller: Controller
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    omega: Array
    measured: Array
    sampled: Array
    integrated: Array
    continuous: Array
    order: float
    gain: float | None
    ended: tuple[str, ...]

    def error(self, reference: Array) -> Array:
        """Largest difference over the lines between measured and a reference, relative at each line, shape (p,)."""
        return difference(self.measured, reference, self.units).max(axis=0)


def difference(response: Array, reference: Array, units: Sequence[str]) -> Array:
    """Relative difference at every line, shape (F, p). A signal that symmetry keeps silent counts as `Response.scale` says."""
    size = np.abs(reference)
    same = np.array([[one == other for other in units] for one in units])
    loudest = np.where(same, size[:, None, :], 0.0).max(axis=-1)
    scale = np.maximum(size, SILENT * loudest)
    apart = np.abs(response - reference)
    return np.divide(apart, scale, out=np.where(apart > 0, np.inf, 0.0), where=scale > 0)


def ideal_measurements(vehicle: Vehicle) -> Vehicle:
    """The vehicle without noise and quantisation of `[implementation]`: those have no frequency response."""
    return replace(vehicle, implementation=vehicle.implementation.clear)


def identify(vehicle: Vehicle, controllers: Sequence[Controller], amplitude: float, timestep: float, speed: float) -> list[Lines]:
    """The frequency responses of controllers, each from one chirp of two periods.

    Args:
        vehicle: the vehicle.
        controllers: its controllers.
        amplitude: largest height of the road [m].
        timestep: [s].
        speed: forward velocity [m/s]; only vehicles with several axles notice.

    Raises:
        InputError: a timestep too coarse for the highest line, an amplitude that is not allowed, a loop that is unstable.
    """
    check(vehicle, controllers, amplitude, timestep)
    steps = steps_per_sample(vehicle.implementation, timestep)
    # In whole sample periods, so that the images of lines, which a slower controller makes, are other lines of the period.
    vehicle, period = ideal_measurements(vehicle), round(1 / LOWEST / timestep / steps) * steps
    omega = 2 * np.pi / (period * timestep) * np.unique(np.round(np.geomspace(1, HIGHEST / LOWEST, LINES)))
    omega = omega[omega < ALIASED * np.pi / (steps * timestep)]
    time = sample_times(vehicle, (1 + lead_in(vehicle, controllers, timestep, period)) * period * timestep, timestep)[:-1]
    road = chirp(omega, period * timestep, speed).to_height(amplitude, time[-period:])
    response = simulate([vehicle] * len(controllers), controllers, [road] * len(controllers), time, threads=0).response

    met, outputs = as_met(vehicle, omega, speed)[..., None], vehicle.linear_model.outputs
    units = tuple(vehicle.kind.signal(name).unit for name in outputs)
    found = []
    for i, controller in enumerate(controllers):
        run = response.run(i)
        sampled, half, integrated = (
            (sampled_frequency_response(vehicle, controller, omega, step, exponential) @ met)[..., 0]
            for step, exponential in ((timestep, linalg.expm), (timestep / 2, linalg.expm), (timestep, taylor4))
        )
        continuous = (continuous_frequency_response(vehicle, controller, omega) @ met)[..., 0]
        far, near = (difference(one, continuous, units).max() for one in (sampled, half))
        lines = fit(vehicle, controller, run, omega, period)
        driven = lines[vehicle.kind.wheels[0].road_velocity]
        measured = np.stack([lines[name] for name in outputs], axis=-1) / driven[:, None]
        gain, ended = l2_gain(vehicle, run), ended_by(vehicle, run)
        order = math.log2(far / near) if vehicle.implementation.ideal else math.nan
        found.append(Lines(controller, outputs, units, omega, measured, sampled, integrated, continuous, order, gain, ended))
    return found


def images(omega: Array, vehicle: Vehicle, timestep: float) -> Array:
    """Frequencies of the largest sinusoids that a controller makes besides the road's, as it samples every few steps [rad/s]."""
    steps = steps_per_sample(vehicle.implementation, timestep)
    rate = 2 * np.pi / (steps * timestep)
    orders = rate * np.arange(1, min(IMAGES, steps // 2) + 1)[:, None]
    found = np.unique(np.abs(np.concatenate([orders - omega, orders + omega])).ravel())
    return found[found < np.pi / timestep]


def fit(
    vehicle: Vehicle, controller: Controller, response: Response, omega: Array, samples: int, besides: Array | None = None
) -> dict[str, Array]:
    """Complex amplitude of every line in every signal, shape (F,) each, from the last samples of a run.

    Args:
        vehicle: the vehicle.
        controller: its controller.
        response: of one run.
        omega: lines [rad/s], shape (F,).
        samples: how many samples are fitted.
        besides: other lines [rad/s] that are in it, and are not asked for.
    """
    time, values = response.time[-samples:], response.values[-samples:]
    if not np.all(np.isfinite(values)):
        return {name: np.full(len(omega), np.nan + 0j) for name in response.names}
    timestep = float(time[1] - time[0])
    angle = np.multiply.outer(time, omega if besides is None else np.concatenate([omega, besides]))
    shapes = np.hstack(
        [np.ones((samples, 1)), np.cos(angle), -np.sin(angle), _free_motion(vehicle, controller, timestep, samples)]
    )
    coefficients = np.linalg.lstsq(shapes, values)[0]
    count = angle.shape[1]
    lines = coefficients[1 : 1 + count] + 1j * coefficients[1 + count : 1 + 2 * count]
    return dict(zip(response.names, lines[: len(omega)].T, strict=True))


def _free_motion(vehicle: Vehicle, controller: Controller, timestep: float, samples: int) -> Array:
    """How the loop moves by itself over some samples, shape (samples, k), without what has decayed in as many before them."""
    if steps_per_sample(vehicle.implementation, timestep) > 1:
        if controller.measured:
            return np.zeros((samples, 0))  # see `lead_in`
        vehicle = replace(vehicle, implementation=Implementation())
    loop = implemented_loop(vehicle, controller, timestep).transition
    poles = np.linalg.eigvals(loop)
    poles = poles[np.abs(poles) > DEAD ** (1 / samples)].astype(complex)
    motion = np.exp(np.multiply.outer(np.arange(samples), np.log(poles)))
    return np.hstack([np.real(motion), np.imag(motion)])


def lead_in(vehicle: Vehicle, controllers: Sequence[Controller], timestep: float, period: int) -> int:
    """How many periods a run has before the one that is fitted.

    Between the samples of a slower controller its force makes lines besides those of the road, which are not fitted. They look
    like free motion a little, so there that has to have died.
    """
    if steps_per_sample(vehicle.implementation, timestep) == 1:
        return 1
    slowest = max([sampled_radius(vehicle, one, timestep) for one in controllers if one.measured], default=0.0)
    return max(1, math.ceil(math.log(SETTLED) / math.log(slowest) / period)) if slowest else 1


def check(vehicle: Vehicle, controllers: Sequence[Controller], amplitude: float, timestep: float) -> None:
    """Whether these can be identified; raises InputError where they cannot."""
    sample_times(vehicle, 1.0, timestep)
    if timestep > 0.25 / HIGHEST:
        raise InputError(f"timestep = {timestep:g} s is too coarse for {HIGHEST:g} Hz; give at most {0.25 / HIGHEST:g} s")
    if not 1e-6 <= amplitude <= 1:
        raise InputError(f"amplitude = {amplitude:g} m is not allowed; give a number from 1e-06 to 1 m")
    for controller in controllers:
        radius = sampled_radius(vehicle, controller, timestep)
        if radius >= 1:
            raise InputError(
                f"controller {controller.name!r} makes a loop that does not decay at this timestep (a step multiplies it by "
                f"{radius:.6g}), and that has no frequency response; give another controller, or a smaller timestep"
            )
