"""Results of runs: the simulated response, the linear prediction, and a comparison of both."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from models.roads.road import Road
from models.vehicle.vehicle import Vehicle
from sim.drive.regime import FLAT, broken_by
from sim.drive.response import Response
from sim.linear.prediction import Prediction
from sim.observers.results import Energy
from sim.runs.agreement import Agreement
from synth.controller.controller import AnyController

COARSE = "the timestep is too coarse for accurate numbers"
NOT_REPEATABLE = "no command is compared: the control law is not repeatable, as its answers to the same measurements differ"
ADVICE = {  # advice to the user by reason why the checks of a run are undecided
    COARSE: "give a smaller timestep",
    NOT_REPEATABLE: "seed its random numbers, and keep its state in `state`, or reset the state in a method reset()",
}


@dataclass(frozen=True)
class HalfStep:
    """Change of the simulated response, after a tyre has left the ground, if the time step is halved but the controller's
    sample period is not.

    After a lift-off, no linear response is exact, and RK4 does not resolve the times at which a tyre leaves the ground and
    lands.

    Attributes:
        difference: largest difference among all signals, each relative to the signal's peak; infinite if one of the two runs
            diverged.
        signal: name of the signal with the largest difference.
    """

    difference: float
    signal: str


@dataclass(frozen=True, eq=False, repr=False)
class RunResult:
    """Simulated run with the linear prediction of this run.

    Attributes:
        prediction: linear responses for the vehicle, controller and road of the run.
        physics: response simulated by MuJoCo.
        agreement: comparison of the simulation with linear analysis, and checks of steps and commands.
        qpos: MuJoCo's generalised positions, shape (T, nq), for drawing the run; None if the energy balance is not computed.
        energy: energy balance of the run; None if no energy balance was computed.
        half_step: accuracy of the simulation after a lift-off; None if no tyre lifted off, or if the run became invalid. With
            noisy or quantised measurements, `half_step` is also None, because noise and quantisation depend on the time step.
    """

    prediction: Prediction
    physics: Response
    agreement: Agreement
    qpos: Array | None = None
    energy: Energy | None = None
    half_step: HalfStep | None = None

    @property
    def broke_off(self) -> tuple[str, float] | None:
        """Event after which all results of the run are meaningless, with the time [s] of this event; None if there is no such
        event.
        """
        ends = {FLAT.name: self.agreement.end_times[FLAT.name], broken_by(self.physics): self.physics.diverged}
        first = min(ends, key=lambda name: ends[name])
        return (first, ends[first]) if math.isfinite(ends[first]) else None

    @property
    def vehicle(self) -> Vehicle:
        """Vehicle with the limits and the implementation that hold in this run."""
        return self.prediction.vehicle

    @property
    def controller(self) -> AnyController:
        """Controller of the run."""
        return self.prediction.controller

    @property
    def road(self) -> Road:
        """Road of the run."""
        return self.prediction.road

    @property
    def sampled(self) -> Response:
        """Response of the sampled loop.

        The response of a linear loop is exact; if dampers or springs have characteristics, the response is computed by RK4.
        """
        return self.prediction.sampled

    @property
    def continuous(self) -> Response:
        """Exact linear response of the continuous closed loop."""
        return self.prediction.continuous

    @cached_property
    def line_errors(self) -> Mapping[str, float]:
        """Largest difference between the response of the linearised vehicle and MuJoCo, relative to the peak in MuJoCo, by
        signal.

        The difference is measured up to `agreement.until`, the time until which linear analysis applies. The mapping is empty
        for a vehicle without characteristics, or without a sampled response. Internal states of parts whose characteristic has
        a kink at equilibrium are omitted.
        """
        if (line := self.prediction.linearised) is None or self.agreement.until <= 0:
            return {}
        line, physics = (one.until(self.agreement.until) for one in (line, self.physics))
        left_out = {one.name for fitted in self.vehicle.parts if fitted.part.kinked_at_rest for one in fitted.states}
        names = [name for name in self.agreement.signals if name not in left_out]
        with np.errstate(over="ignore", invalid="ignore"):  # responses of an unstable linearisation may overflow
            apart = {name: float(np.max(np.abs(physics[name] - line[name]))) for name in names}
            return {name: one / (physics.scale(name) or 1.0) for name, one in apart.items()}

    @property
    def diverged(self) -> float:
        """Time at which the simulation diverged [s]; infinite if the simulation did not diverge."""
        return self.physics.diverged

    @property
    def undecided(self) -> tuple[str, ...]:
        """Reasons why the checks cannot confirm the run: the time step is too coarse, or the control law is not repeatable."""
        commands = self.agreement.commands
        coarse = self.agreement.coarse or (self.energy is not None and not self.energy.judged)
        return (*[COARSE] * coarse, *[NOT_REPEATABLE] * (commands is not None and not commands.repeatable))

    @property
    def agrees(self) -> bool | None:
        """True if the simulation agrees with the model (see `Agreement.agrees`); None if the checks are `undecided`."""
        return None if self.agreement.agrees and self.undecided else self.agreement.agrees

    @property
    def warnings(self) -> Iterator[str]:
        """Warnings about the run and about the road."""
        yield from (f"controller {self.controller.name!r}: agrees is None, as {why}; {ADVICE[why]}" for why in self.undecided)
        yield from self.road.warnings

    @property
    def passed(self) -> bool:
        """True if no check contradicts the analysis and the energy balance does not fail (if it is evaluated)."""
        return self.agreement.agrees and (self.energy is None or not self.energy.fails)
