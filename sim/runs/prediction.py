"""Linear responses for one vehicle with one controller over one road, beside which a run of MuJoCo is measured.

They are linear except for the characteristics of dampers and springs: `sampled` and `integrated` follow these. Norm, margins and
designs are those of the linearisation at equilibrium, whose response is `linearised`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.roads.road import Road, RoadInput
from models.vehicle.mjcf import has_geometry
from models.vehicle.vehicle import Vehicle
from sim.linear.sampled_response import continuous_response, sampled_response, taylor4
from sim.response.response import Response
from synth.controller.controller import AnyController, Controller
from synth.controller.loop_of import loop_of, radius
from synth.plant.loop import Loop

if TYPE_CHECKING:
    from sim.runs.code_effect import CodeEffect


LINEAR, NONLINEAR = "linear analysis", "the nonlinear response with the characteristics"


@dataclass(frozen=True, eq=False)
class Prediction:
    """Linear responses of one run.

    For a law in Python they are the vehicle's responses to the forces that it requested: linear analysis does not cover the law.

    Attributes:
        input: the vehicle, with the limits and implementation of this run, and its road.
        controller: controller of the run.
        sampled: response of the sampled loop: exact if that is linear; with characteristics that of RK4. NaN if a law switches
            adjustable dampers, which is not linear.
        integrated: the same as RK4 makes it.
        continuous: exact linear response of the continuous closed loop; NaN if the law is not linear.
        radius: growth per timestep of the sampled loop, unstable above 1; NaN if the loop is too large, or not linear.
        requested_force: commands of a law in Python, see `sim.physics.actuators`, shape (T, m) or (T, 2 m); empty for others.
        loop: the linear loop in continuous time, or None.
        code_effect: measured difference of exported code from the law, or None without such code.
        replayed: True if the law in Python is not run, and its commands come from a log.
        finer: `sampled` without RK4's own error, as estimated; None if it has no such error.
    """

    input: RoadInput
    controller: AnyController
    sampled: Response
    integrated: Response
    continuous: Response
    radius: float = math.nan
    requested_force: Array = field(default_factory=lambda: np.zeros((0, 0)))
    loop: Loop | None = None
    code_effect: "CodeEffect | None" = None
    replayed: bool = False
    finer: Response | None = None

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
    def is_linear(self) -> bool:
        """Returns True if there is a sampled response."""
        return _has_response(self.vehicle, self.controller)

    @property
    def reference(self) -> str:
        """Names the response with which a run is compared."""
        return NONLINEAR if self.vehicle.parts.nonlinear else LINEAR

    @cached_property
    def linearised(self) -> Response | None:
        """The same sampled response with the line at equilibrium of every characteristic; None if nothing differs from lines."""
        if not (self.vehicle.parts.nonlinear and self.is_linear):
            return None
        road = RoadInput(self.vehicle.linearised, self.road, self.time)
        if self.controller.linear is True:
            return sampled_response(self.controller, road)
        from sim.linear.forced_response import forced_response

        return forced_response(self.requested_force, road)

    @property
    def cause(self) -> str:
        """Names what a run contains and its sampled response does not; empty if they differ by RK4's own error alone."""
        noise = self.vehicle.implementation.noise_text if self.is_blurred else ""
        geometry = "geometry" if has_geometry(self.vehicle) else ""
        return " and ".join(filter(None, (geometry, noise, self.rounding_text)))

    @property
    def is_blurred(self) -> bool:
        """Returns True if its controller measures with noise or quantisation."""
        how = self.vehicle.implementation
        return bool({*how.noise, *how.quantisation} & {*self.controller.measured})

    @property
    def varies(self) -> bool:
        """Returns True if its controller answers differently at another step: by noise, quantisation or rounding."""
        return self.is_blurred or bool(self.rounding_text)

    @property
    def rounding_text(self) -> str:
        """Returns the numbers to which exported code rounds; empty without code, or in double."""
        code = self.controller.code
        return f"rounding to {code.law.numbers}" if code is not None and code.law.numbers != "double" else ""


def predict(controller: Controller, road: RoadInput, most_states: float = math.inf) -> Prediction:
    """Returns the prediction of one run of a linear loop, from rest.

    Args:
        controller: linear controller of the road's vehicle.
        most_states: largest number of states, delayed forces included, of a loop whose eigenvalues are computed.
    """
    loop = loop_of(road.vehicle, controller, road.timestep)
    small = len(loop.open_loop.A) <= most_states
    sampled, integrated, finer = _sampled(road, partial(sampled_response, controller, road), controller)
    return Prediction(
        input=road,
        controller=controller,
        sampled=sampled,
        integrated=integrated,
        finer=finer,
        continuous=continuous_response(controller, road),
        radius=radius(loop) if small else math.nan,
        loop=loop_of(road.vehicle, controller),
    )


def predicted(controller: AnyController, road: RoadInput, commands: Array, most_states: float = math.inf) -> Prediction:
    """Returns the prediction of one run from rest, whatever its controller.

    For a law in Python it has the responses to the commands. A run whose controller sets adjustable dampers is not linear, and
    has no response; a linear law then has the continuous response that it would have if all its forces were given.

    Args:
        commands: commands of the actuators in the run, see `sim.physics.actuators`, shape (T, m) or (T, 2 m).
        most_states: see `predict`.
    """
    requested = commands if controller.user_code else np.zeros((0, 0))
    if not _has_response(road.vehicle, controller):
        signals = road.vehicle.kind.signals
        nothing = continuous = Response(road.time, signals, np.full((len(road.time), len(signals)), np.nan))
        if controller.linear is True:
            continuous = continuous_response(controller, road)
            states = continuous.signals[len(signals) :]
            nothing = nothing.beside(states, np.full((len(road.time), len(states)), np.nan))
        return Prediction(road, controller, nothing, nothing, continuous, requested_force=requested)
    if controller.linear is True:
        return predict(controller, road, most_states)
    from sim.linear.forced_response import forced_continuous_response, forced_response

    sampled, integrated, finer = _sampled(road, partial(forced_response, commands, road), commands)
    continuous = forced_continuous_response(commands, road)
    return Prediction(road, controller, sampled, integrated, continuous, requested_force=requested, finer=finer)


def _sampled(
    road: RoadInput, linear: Callable[..., Response], driver: Controller | Array
) -> tuple[Response, Response, Response | None]:
    """Returns `sampled`, `integrated` and `finer` of a prediction, of a controller or of known commands."""
    if not road.vehicle.parts.nonlinear:
        return linear(), linear(exponential=taylor4), None
    from sim.linear.stepped import forced, stepped

    runs = forced(driver, road) if isinstance(driver, np.ndarray) else stepped([driver], [road])
    response = runs.single
    return response, response, runs.finer.run(0)


def _has_response(vehicle: Vehicle, controller: AnyController) -> bool:
    """Returns True if there is an exact sampled response: the dampers are not adjusted."""
    return not vehicle.dampers or not controller.acts
