"""Predictions for one vehicle with one controller over one road: before any physics, or with the decisions of physics replayed.

They are linear except for curves of dampers and springs: `sampled` and `integrated` follow these.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError
from models.kinds.signals import kept_signals
from models.laws.python_law import Programmed
from models.laws.semi_active import SemiActive
from models.roads.road import Road, RoadInput
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.mjcf import has_geometry
from models.vehicle.vehicle import Vehicle
from sim.linear.sampled_response import continuous_response, response_of, sampled_response, taylor4
from sim.response.response import Response
from synth.controller.controller import Controller, Driver, code_of
from synth.controller.open_loop import LoopModel

if TYPE_CHECKING:
    from sim.linear.switched_response import DecisionMismatch, Switched
    from sim.runs.code_effect import CodeEffect


SIGMAS = 6.0  # deviations of noise: thousands of samples stay within them


@dataclass(frozen=True, eq=False)
class Prediction:
    """Linear responses of one run, with the expected accuracy of physics.

    For a law in Python they are the vehicle's responses to the forces that it requested: linear analysis does not cover the law.

    Attributes:
        input: the vehicle, with the limits and implementation of this run, and its road.
        controller: controller of the run.
        sampled: exact response of the sampled loop: linear, except for curves.
        integrated: response of the loop that RK4 integrates.
        continuous: exact linear response of the continuous closed loop.
        spread: largest effect of measurement noise (in `SIGMAS` deviations) and quantisation on each output signal, with the
            measured effect of exported code, at every sample, shape (T,); empty without them.
        radius: growth per timestep of the sampled loop, unstable above 1; NaN if the loop is too large, or not linear.
        requested_force: requests of a law in Python, shape (T, m): forces [N], or with adjustable dampers the commands,
            shape (T, 2 m), see `models.suspension.damper_range.CoefficientRange.commands`; empty for a linear controller, which
            determines them.
        otherwise: samples at which the responses follow a different decision of physics on adjustable dampers.
        played: True if they follow all decisions of physics, because of noisy measurements or a law in Python.
        loop: the linear loop, or None.
        code_effect: effect of the exported code compared with the law, or None without such code.
    """

    input: RoadInput
    controller: Driver
    sampled: Response
    integrated: Response
    continuous: Response
    spread: Mapping[str, Array]
    radius: float
    requested_force: Array = field(default_factory=lambda: np.zeros((0, 0)))
    otherwise: "tuple[DecisionMismatch, ...]" = ()
    played: bool = False
    loop: LoopModel | None = None
    code_effect: "CodeEffect | None" = None

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle, with the limits and implementation of this run."""
        return self.input.vehicle

    @property
    def road(self) -> Road:
        """The road."""
        return self.input.road

    @property
    def time(self) -> Array:
        """Equidistant sample times from 0 [s], shape (T,)."""
        return self.input.time

    @property
    def timestep(self) -> float:
        """Returns the timestep of the run [s]."""
        return self.input.timestep

    @property
    def blur_text(self) -> str:
        """Names of what `spread` is of; empty without any."""
        return " and ".join(filter(None, [self.vehicle.implementation.noise_text, self.rounding_text]))

    @property
    def rounding_text(self) -> str:
        """Returns the numbers to which exported code rounds; empty without code, or in double."""
        code = code_of(self.controller)
        return f"rounding to {code.law.numbers}" if code is not None and code.law.numbers != "double" else ""


def predict(loop: LoopModel, road: RoadInput, most_states: float = math.inf) -> Prediction:
    """Returns the prediction of one run, from rest.

    Args:
        loop: loop of the vehicle and its controller, at the timestep of the road's samples.
        most_states: largest number of states, delayed forces included, of a loop whose eigenvalues are computed.

    Raises:
        InputError: a larger loop has noise or quantisation, whose spread is then not known.
    """
    vehicle, cut = loop.vehicle, loop.open_loop
    small = len(cut.model.A) + vehicle.implementation.pending_forces * cut.forces <= most_states
    noisy = vehicle.implementation.has_measurement_noise
    if noisy and not small:
        raise InputError(
            f"the spread of its {vehicle.implementation.noise_text} is not computed: its loop has too many delayed forces"
        )
    sampled = sampled_response(loop, road)
    return Prediction(
        input=road,
        controller=loop.controller,
        sampled=sampled,
        integrated=sampled_response(loop, road, exponential=taylor4),
        continuous=continuous_response(loop, road),
        spread=_spread(loop, len(road.time)) if noisy else {},
        radius=loop.radius if small else math.nan,
        loop=loop,
    )


def _spread(loop: LoopModel, samples: int) -> dict[str, Array]:
    """Returns the effect of noise and quantisation on each output signal; empty if they affect no measurement."""
    how = loop.vehicle.implementation
    if not {*how.noise, *how.quantisation} & {*loop.controller.measured}:
        return {}
    from sim.linear.measurement_noise import most_quantised, noise_rms

    far = SIGMAS * noise_rms(loop, samples) + most_quantised(loop, samples)
    return dict(zip(loop.vehicle.linear_model.outputs, far.T, strict=True))


def predict_forced(controller: Programmed, road: RoadInput, requested_force: Array) -> Prediction:
    """Returns the predicted responses to forces [N], shape (T, m), that a law in Python requested in a run from rest."""
    from sim.linear.forced_response import forced_continuous_response, forced_response

    return Prediction(
        input=road,
        controller=controller,
        sampled=forced_response(requested_force, road),
        integrated=forced_response(requested_force, road, taylor4),
        continuous=forced_continuous_response(requested_force, road),
        spread={},
        radius=math.nan,
        requested_force=requested_force,
    )


@dataclass(frozen=True, eq=False)
class ScaledPrediction:
    """Prediction of a run over a share of its road's height.

    Attributes:
        sampled: exact response of the sampled loop.
        integrated: response of the loop that RK4 integrates, or None if both are proportional to the whole road's.
    """

    sampled: Response
    integrated: Response | None


def smaller(prediction: Prediction, share: float) -> ScaledPrediction:
    """Predicts the run over a share of the road's height, with the same share of the forces of a law in Python."""
    whole, loop = prediction.sampled, prediction.loop
    if not prediction.vehicle.is_curved:
        return ScaledPrediction(Response(whole.time, whole.signals, share * whole.values), None)
    road = prediction.input.scaled(share)

    def response(exponential: Callable[[Array], Array]) -> Response:
        if loop is not None:
            return sampled_response(loop, road, exponential)
        from sim.linear.forced_response import forced_response

        return forced_response(share * prediction.requested_force, road, exponential)

    return ScaledPrediction(response(linalg.expm), response(taylor4))


def predict_switched(
    controller: Driver, road: RoadInput, physics: Response, near: float, requested_force: Array | None = None
) -> Prediction:
    """Predicts the exact response of a vehicle with adjustable dampers, a switched linear system, in a run from rest.

    For a law that is not linear there is no continuous loop, and `continuous` is the same response.

    Args:
        near: largest difference of physics, over a peak, that explains a different decision.
        requested_force: the commands of a law in Python, shape (T, 2 m).
    """
    from sim.linear.dampers import commands_of, damper_signals
    from sim.linear.switched_response import Decisions, switched

    vehicle, time, h = road.vehicle, road.time, road.timestep
    linear = LoopModel(vehicle, controller, h) if isinstance(controller, Controller) else None
    played = isinstance(controller, Programmed) or vehicle.implementation.has_measurement_noise
    period = steps_per_sample(vehicle.implementation, h) * h
    commands = commands_of(vehicle, physics) if requested_force is None else requested_force
    peaks = partial(_peak, vehicle, physics)
    measured = () if played else controller.measured

    def response(as_rk4: bool) -> "tuple[Response, Switched]":
        decisions = None
        if not played and isinstance(controller, Controller | SemiActive):
            decisions = Decisions(vehicle, controller, period, near, peaks)
        switched_run = switched(road, decisions, commands, measured, as_rk4)
        beside = damper_signals(vehicle, switched_run.beyond, switched_run.missing)
        whole = response_of(vehicle.linear_model, road, switched_run.states, switched_run.inputs, switched_run.outside, beside)
        if linear is None:
            return whole, switched_run
        law = linear.controller.law
        kept = np.zeros((len(time), law.states)) if played else law.of_state(period) * switched_run.kept
        return whole.beside(kept_signals(range(1, law.states + 1)), kept), switched_run

    sampled_one, switched_run = response(False)
    return Prediction(
        input=road,
        controller=controller,
        sampled=sampled_one,
        integrated=response(True)[0],
        continuous=sampled_one if linear is None else continuous_response(linear, road),
        spread={},
        radius=math.nan,
        requested_force=commands if isinstance(controller, Programmed) else np.zeros((0, 0)),
        otherwise=switched_run.otherwise,
        played=played,
    )


def _peak(vehicle: Vehicle, physics: Response, signal: str) -> float:
    """Returns the peak of a signal in physics until the run ends; for "velocity", the peak of all suspension velocities."""
    from sim.linear.dampers import stretching
    from sim.linear.switched_response import VELOCITY

    whole = physics.until(physics.diverged)
    if signal != VELOCITY:
        return float(whole.peak(signal))
    states = np.stack([whole[name] for name in vehicle.linear_model.states], axis=-1)
    return float(np.abs(states @ stretching(vehicle).T).max(initial=0.0))


NEAR = 1e-5  # of a peak, at 1 ms; MuJoCo is nearer to its exact response, and beyond it rounding explains no decision
ORDER = 4  # order of RK4's error in the step
NEAR_KNOTS, KNOTS_ORDER = 1e-4, 2  # its order with curves, as RK4 steps over their knots
NEAR_GEOMETRY = 1e-2  # effect of geometry on the whole road, of a peak, if bodies turn; proportional to the height


def predict_replayed(controller: Driver, road: RoadInput, physics: Response, requested_force: Array) -> Prediction:
    """Predicts a run from rest whose decisions are taken from the MuJoCo run.

    Args:
        controller: a law in Python, or any controller of a vehicle with adjustable dampers.
        requested_force: forces requested by the controller, see `PhysicsRuns`.
    """
    vehicle = road.vehicle
    if vehicle.dampers:
        at_1_ms, order = (NEAR_KNOTS, KNOTS_ORDER) if vehicle.is_curved else (NEAR, ORDER)
        near = NEAR_GEOMETRY if has_geometry(vehicle) else min(at_1_ms * max(1.0, road.timestep / 1e-3) ** order, NEAR_GEOMETRY)
        programmed = requested_force if isinstance(controller, Programmed) else None
        return predict_switched(controller, road, physics, near, programmed)
    assert isinstance(controller, Programmed), "a linear one is predicted by itself"
    return predict_forced(controller, road, requested_force)


def reference_at(share: float, prediction: Prediction, physics: Response) -> ScaledPrediction:
    """Predicts a run at a share of its road's height: proportional, as far as it is linear.

    Args:
        physics: the MuJoCo run at that share of the road, whose decisions adjustable dampers follow.
    """
    vehicle = prediction.vehicle
    if not vehicle.dampers:
        return smaller(prediction, share)
    from sim.linear.dampers import scaled_commands

    road = replace(prediction.input.scaled(share), vehicle=with_scaled_noise(share, vehicle))
    commands = scaled_commands(vehicle, prediction.requested_force, share) if len(prediction.requested_force) else None
    near = share * NEAR_GEOMETRY
    again = predict_switched(prediction.controller, road, physics, near, commands)
    return ScaledPrediction(again.sampled, again.integrated)


def with_scaled_noise(share: float, vehicle: Vehicle) -> Vehicle:
    """Returns the vehicle with this share of its noise, for the same share of a road."""
    return replace(vehicle, implementation=vehicle.implementation.scaled(share))
