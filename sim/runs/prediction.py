"""What analysis says of one vehicle with one controller over one road, before any physics is run.

It is linear but for the curves of dampers and springs, where a vehicle has some: `sampled` and `integrated` follow these.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError
from models.damping.laws import SemiActive
from models.own.python_law import Programmed
from models.reality import steps_per_sample
from models.roads.road import Road
from models.signals import kept_signals
from models.vehicle import Vehicle
from sim.linear.blur import most_quantised, noise_rms
from sim.linear.curved import is_curved
from sim.linear.dampers import commands_of, damper_signals, stretching
from sim.linear.deciding import VELOCITY, Decisions, Otherwise
from sim.linear.forced import forced_continuous_response, forced_response
from sim.linear.loop import continuous_response, response_of, sampled_response, taylor4
from sim.linear.switched import Switched, switched
from sim.response.response import Response
from synth.controller import Controller
from synth.implemented.controlled import sampled
from synth.implemented.loop import sampled_radius

SIGMAS = 6.0  # of noise: thousands of samples stay within it


@dataclass(frozen=True, eq=False)
class Prediction:
    """The linear responses of one run, and how well they are to be met.

    Of a law in Python linear analysis says nothing. Its responses are the vehicle's to the forces that it has asked for.

    Attributes:
        vehicle: the vehicle, with the limits and implementation of this run.
        controller: its controller.
        road: the road.
        sampled: exact response of the sampled loop: linear, but for curves.
        integrated: the same as RK4 makes it.
        continuous: exact linear response of the continuous closed loop.
        spread: how far noise (in `SIGMAS` deviations) and quantisation of the measurements move each output signal at most, at
            every sample, shape (T,); empty without them.
        radius: growth per timestep of the sampled loop: above 1 it is unstable; NaN where it is too large to be asked, or there
            is no linear loop.
        asked: what a law in Python asked for, shape (T, m): forces [N], or of vehicles with adjustable dampers the commands,
            shape (T, 2 m), see `models.damping.range.Range.commands`; empty of a linear controller, from which they follow.
        otherwise: where physics decided otherwise on adjustable dampers, as rounding had it, and the responses follow it.
        played: whether they follow physics in all that it decided, for what is measured is noisy or a law in Python decides.
    """

    vehicle: Vehicle
    controller: Controller | Programmed | SemiActive
    road: Road
    sampled: Response
    integrated: Response
    continuous: Response
    spread: Mapping[str, Array]
    radius: float
    asked: Array = field(default_factory=lambda: np.zeros((0, 0)))
    otherwise: tuple[Otherwise, ...] = ()
    played: bool = False

    @property
    def time(self) -> Array:
        """Equidistant sample times from 0 [s], shape (T,)."""
        return self.sampled.time

    @property
    def timestep(self) -> float:
        """Of the run [s]."""
        return float(self.time[1])


def predict(vehicle: Vehicle, controller: Controller, road: Road, time: Array, most_states: float = math.inf) -> Prediction:
    """The prediction of one run, from rest.

    Args:
        vehicle: the vehicle.
        controller: its controller.
        road: the road.
        time: equidistant sample times from 0 [s], shape (T,).
        most_states: of a loop, its delayed forces among them, of which eigenvalues are still taken.

    Raises:
        InputError: noise or quantisation goes through a larger loop than that, and its spread is not known.
    """
    timestep = float(time[1] - time[0])
    cut = sampled(vehicle, controller, timestep)
    small = len(cut.model.A) + vehicle.implementation.waiting * cut.forces <= most_states
    noisy = vehicle.implementation.blurred
    if noisy and not small:
        raise InputError(f"the spread of its {vehicle.implementation.blur} is not computed: its loop has too many delayed forces")
    return Prediction(
        vehicle=vehicle,
        controller=controller,
        road=road,
        sampled=sampled_response(vehicle, controller, road, time),
        integrated=sampled_response(vehicle, controller, road, time, exponential=taylor4),
        continuous=continuous_response(vehicle, controller, road, time),
        spread=_spread(vehicle, controller, timestep, len(time)) if noisy else {},
        radius=sampled_radius(vehicle, controller, timestep) if small else math.nan,
    )


def _spread(vehicle: Vehicle, controller: Controller, timestep: float, samples: int) -> dict[str, Array]:
    """What blurs the measurements, as it moves each output signal; empty where it is of nothing that is measured."""
    how = vehicle.implementation
    if not {*how.noise, *how.quantisation} & {*controller.measured}:
        return {}
    arguments = vehicle, controller, timestep, samples
    far = SIGMAS * noise_rms(*arguments) + most_quantised(*arguments)
    return dict(zip(vehicle.linear_model.outputs, far.T, strict=True))


def predict_forced(vehicle: Vehicle, controller: Programmed, road: Road, time: Array, asked: Array) -> Prediction:
    """What linear analysis makes of the forces that a law in Python has asked for in a run from rest.

    Args:
        vehicle: the vehicle.
        controller: its controller.
        road: the road.
        time: equidistant sample times from 0 [s], shape (T,).
        asked: the forces at those [N], shape (T, m).
    """
    return Prediction(
        vehicle=vehicle,
        controller=controller,
        road=road,
        sampled=forced_response(vehicle, asked, road, time),
        integrated=forced_response(vehicle, asked, road, time, taylor4),
        continuous=forced_continuous_response(vehicle, asked, road, time),
        spread={},
        radius=math.nan,
        asked=asked,
    )


@dataclass(frozen=True, eq=False)
class Smaller:
    """What is predicted of a run over a share of its road's height.

    Attributes:
        sampled: exact response of the sampled loop.
        integrated: the same as RK4 makes it; None where both are that share of the whole road's.
    """

    sampled: Response
    integrated: Response | None


def smaller(prediction: Prediction, share: float) -> Smaller:
    """What is predicted over a share of the road's height, and under the same share of the forces of a law in Python."""
    whole, vehicle, controller = prediction.sampled, prediction.vehicle, prediction.controller
    if not is_curved(vehicle):
        return Smaller(Response(whole.time, whole.signals, share * whole.values), None)
    road = prediction.road.scaled(share)

    def response(exponential: Callable[[Array], Array]) -> Response:
        if isinstance(controller, Controller):
            return sampled_response(vehicle, controller, road, whole.time, exponential)
        return forced_response(vehicle, share * prediction.asked, road, whole.time, exponential)

    return Smaller(response(linalg.expm), response(taylor4))


def predict_switched(
    vehicle: Vehicle,
    controller: Controller | Programmed | SemiActive,
    road: Road,
    time: Array,
    physics: Response,
    near: float,
    asked: Array | None = None,
) -> Prediction:
    """What the exact response of a vehicle with adjustable dampers is in a run from rest: a linear system that is switched.

    Of a law that is not linear there is no continuous loop, and `continuous` is the same response.

    Args:
        vehicle: the vehicle.
        controller: its controller.
        road: the road.
        time: equidistant sample times from 0 [s], shape (T,).
        physics: what MuJoCo made of it.
        near: how far physics may be from it, of a peak, for a decision to be otherwise for that alone.
        asked: the commands of a law in Python, shape (T, 2 m).
    """
    linear = controller if isinstance(controller, Controller) else None
    played = isinstance(controller, Programmed) or vehicle.implementation.blurred
    h = float(time[1])
    period = steps_per_sample(vehicle.implementation, h) * h
    made = commands_of(vehicle, physics) if asked is None else asked
    peaks = partial(_peak, vehicle, physics)
    measured = () if played else controller.measured

    def response(as_rk4: bool) -> tuple[Response, Switched]:
        decisions = None
        if not (played or isinstance(controller, Programmed)):
            decisions = Decisions(vehicle, controller, period, near, peaks)
        found = switched(vehicle, road, time, decisions, made, measured, as_rk4)
        beside = damper_signals(vehicle, found.beyond, found.missing)
        whole = response_of(vehicle, vehicle.linear_model, road, time, found.states, found.inputs, found.outside, beside)
        if linear is None:
            return whole, found
        kept = np.zeros((len(time), linear.law.states)) if played else linear.law.of_state(period) * found.kept
        return whole.beside(kept_signals(range(1, linear.law.states + 1)), kept), found

    sampled_one, found = response(False)
    return Prediction(
        vehicle=vehicle,
        controller=controller,
        road=road,
        sampled=sampled_one,
        integrated=response(True)[0],
        continuous=sampled_one if linear is None else continuous_response(vehicle, linear, road, time),
        spread={},
        radius=math.nan,
        asked=made if isinstance(controller, Programmed) else np.zeros((0, 0)),
        otherwise=found.otherwise,
        played=played,
    )


def _peak(vehicle: Vehicle, physics: Response, signal: str) -> float:
    """The peak of a signal in physics as long as it goes, or of "velocity", that of all the suspensions."""
    whole = physics.until(physics.diverged)
    if signal != VELOCITY:
        return float(whole.peak(signal))
    states = np.stack([whole[name] for name in vehicle.linear_model.states], axis=-1)
    return float(np.abs(states @ stretching(vehicle).T).max(initial=0.0))
