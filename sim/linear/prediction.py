"""Linear responses of one vehicle, controller and road, to compare with a MuJoCo run.

The responses are linear, but `sampled` and `integrated` also include the nonlinear characteristics of dampers and springs.
Norms, margins and designs refer to the vehicle linearised at equilibrium; `linearised` is the response of this vehicle.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from models.common.arrays import Array
from models.common.extensions import FEATURES
from models.roads.road import Road, RoadInput
from models.vehicle.mjcf import has_geometry
from models.vehicle.vehicle import Vehicle
from sim.drive.jumps import with_decisions
from sim.drive.response import Response
from sim.linear.sampled_response import continuous_response, sampled_response, taylor4
from synth.controller.controller import AnyController, is_linear
from synth.controller.loop_of import loop_of, radius
from synth.plant.loop import Loop

LINEAR, NONLINEAR = "linear analysis", "the nonlinear response with the characteristics"


@dataclass(frozen=True, eq=False)
class Prediction:
    """Linear responses of one run that starts in equilibrium. Each linear response is computed when it is first needed.

    Linear analysis does not cover a Python control law. For a Python control law, the responses are computed from the forces
    that the law requested in the run. A run whose controller sets semi-active dampers is not linear and has no sampled
    response. If a linear law sets semi-active dampers, the continuous response assumes that the dampers supply all requested
    forces.

    Attributes:
        input: road of the run, and the vehicle with the limits and the implementation that hold in this run.
        controller: controller whose control law closes the feedback loop.
        requested_force: commands of a Python control law, see `sim.drive.actuators`, shape (T, m) or (T, 2 m); empty for a
            linear controller.
        replayed: True if the commands of a Python control law come from a log, so that the law itself is not executed.
        most_states: largest number of states, including delayed forces, of a loop for which eigenvalues are computed.
    """

    input: RoadInput
    controller: AnyController
    requested_force: Array = field(default_factory=lambda: np.zeros((0, 0)))
    replayed: bool = False
    most_states: float = math.inf

    @property
    def sampled(self) -> Response:
        """Response of the sampled loop.

        The response of a linear loop is exact. If dampers or springs have characteristics, the response is computed by RK4. If
        a law sets semi-active dampers, the loop is not linear, and all values are NaN.
        """
        return self._sampled[0]

    @property
    def integrated(self) -> Response:
        """Response of the sampled loop, as integrated by RK4."""
        return self._sampled[1]

    @property
    def finer(self) -> Response | None:
        """The response `sampled` without the estimated error of RK4; None if `sampled` is exact."""
        return self._sampled[2]

    @cached_property
    @np.errstate(over="ignore", invalid="ignore")  # signals of an unstable loop may overflow
    def continuous(self) -> Response:
        """Exact linear response of the continuous closed loop; NaN if the law is not linear."""
        if self.controller.linear is True:
            return continuous_response(self.controller, self.input)
        if not self.is_linear:
            return self._nothing

        return FEATURES.load("response to given forces").forced_continuous_response(self.requested_force, self.input)

    @cached_property
    def radius(self) -> float:
        """Spectral radius of the matrix that maps the sampled loop's state from one time step to the next. If the spectral
        radius is above 1, the loop is unstable.

        The spectral radius is NaN if the loop has too many states or is not linear.
        """
        if not is_linear(self.controller, self.vehicle):
            return math.nan
        loop = loop_of(self.vehicle, self.controller, self.timestep)
        return radius(loop) if len(loop.open_loop.A) <= self.most_states else math.nan

    @cached_property
    def loop(self) -> Loop | None:
        """Linear loop in continuous time; None if the loop is not linear."""
        return loop_of(self.vehicle, self.controller) if is_linear(self.controller, self.vehicle) else None

    @cached_property
    @np.errstate(over="ignore", invalid="ignore")  # signals of an unstable loop may overflow
    def _sampled(self) -> tuple[Response, Response, Response | None]:
        """The responses `sampled`, `integrated` and `finer`."""
        controller, road = self.controller if self.controller.linear is True else None, self.input
        if not self.is_linear:
            states = self.continuous.signals[len(self._nothing.signals) :]
            nothing = self._nothing.with_signals(states, np.full((len(road.time), len(states)), np.nan))
            return nothing, nothing, None
        if self.vehicle.parts.nonlinear:
            stepping = FEATURES.load("stepped response")
            runs = (
                stepping.forced_run(self.requested_force, road)
                if controller is None
                else stepping.stepped_runs([controller], [road])
            )
            response = with_decisions(runs.single, [self.vehicle])
            return response, response, runs.finer.run(0)
        if controller is not None:
            respond = partial(sampled_response, controller, road)
        else:
            respond = partial(FEATURES.load("response to given forces").forced_response, self.requested_force, road)
        return with_decisions(respond(), [self.vehicle]), respond(exponential=taylor4), None

    @property
    def _nothing(self) -> Response:
        signals = self.vehicle.kind.signals
        return Response(self.time, signals, np.full((len(self.time), len(signals)), np.nan))

    @property
    def vehicle(self) -> Vehicle:
        """Vehicle with the limits and the implementation that hold in this run."""
        return self.input.vehicle

    @property
    def road(self) -> Road:
        """Road over which the vehicle drives in this run."""
        return self.input.road

    @property
    def time(self) -> Array:
        """Equidistant sample times from 0 [s], shape (T,)."""
        return self.input.time

    @property
    def timestep(self) -> float:
        """Time step of the run [s]."""
        return self.input.timestep

    @property
    def is_linear(self) -> bool:
        """True if a sampled response exists, because the controller sets no semi-active damper."""
        return not self.vehicle.dampers or not self.controller.acts

    @property
    def reference(self) -> str:
        """Name of the response with which the simulated run is compared."""
        return NONLINEAR if self.vehicle.parts.nonlinear else LINEAR

    @cached_property
    def linearised(self) -> Response | None:
        """Sampled response with every characteristic linearised at equilibrium; None if all characteristics are linear."""
        if not (self.vehicle.parts.nonlinear and self.is_linear):
            return None
        road = RoadInput(self.vehicle.linearised, self.road, self.time)
        if self.controller.linear is True:
            return sampled_response(self.controller, road)

        return FEATURES.load("response to given forces").forced_response(self.requested_force, road)

    @property
    def cause(self) -> str:
        """Text that lists the effects in the run that the sampled response omits; empty if only the error of RK4 is omitted."""
        noise = self.vehicle.implementation.noise_text if self.is_blurred else ""
        geometry = "geometry" if has_geometry(self.vehicle) else ""
        return " and ".join(filter(None, (geometry, noise, self.rounding_text)))

    @property
    def is_blurred(self) -> bool:
        """True if the measurements of the controller contain noise or quantisation."""
        how = self.vehicle.implementation
        return bool({*how.noise, *how.quantisation} & {*self.controller.measured})

    @property
    def varies(self) -> bool:
        """True if the commands would change with the time step, due to noise, quantisation or rounding."""
        return self.is_blurred or bool(self.rounding_text)

    @property
    def rounding_text(self) -> str:
        """Number format of exported code as text; empty if there is no exported code, or if the code uses double precision."""
        code = self.controller.code
        return f"rounding to {code.law.numbers}" if code is not None and code.law.numbers != "double" else ""


def predict_run(controller: AnyController, road: RoadInput, commands: Array, most_states: float = math.inf) -> Prediction:
    """Returns the prediction of a run that starts in equilibrium.

    Args:
        commands: commands of the actuators in the run, see `sim.drive.actuators`, shape (T, m) or (T, 2 m).
        most_states: largest number of states of a loop for which eigenvalues are computed, see `Prediction`.
    """
    requested = commands if controller.user_code else np.zeros((0, 0))
    return Prediction(road, controller, requested, most_states=most_states)
