"""Results of runs: physics, its prediction, and their comparison."""

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
ADVICE = {  # reasons for which a run is undecided, and what to do
    COARSE: "give a smaller timestep",
    NOT_REPEATABLE: "seed its random numbers, and keep its state in `state`, or reset the state in a method reset()",
}


@dataclass(frozen=True)
class HalfStep:
    """Change of the physics by half the timestep, with the same sampling of the controller, after a tyre has left the road.

    After a lift-off no linear response is exact, and RK4 steps over the moments at which a tyre leaves and lands.

    Attributes:
        difference: largest difference of any signal, over its peak; infinite if one of the two runs diverged.
        signal: name of that signal.
    """

    difference: float
    signal: str


@dataclass(frozen=True, eq=False, repr=False)
class RunResult:
    """Run of physics with its prediction.

    Attributes:
        prediction: responses by analysis of this vehicle, controller and road.
        physics: the response in MuJoCo.
        agreement: physics against analysis.
        qpos: generalized positions of the physics, shape (T, nq), to draw it, or None for a run without its energy balance.
        energy: energy balance, or None.
        half_step: accuracy of the physics after a lift-off. None if no tyre lifted, the run broke off, or the measurements are
            noisy or quantised, which differs at other steps.
    """

    prediction: Prediction
    physics: Response
    agreement: Agreement
    qpos: Array | None = None
    energy: Energy | None = None
    half_step: HalfStep | None = None

    @property
    def broke_off(self) -> tuple[str, float] | None:
        """Returns the event that ended the run and its time [s], after which all numbers are meaningless, or None."""
        ends = {FLAT.name: self.agreement.end_times[FLAT.name], broken_by(self.physics): self.physics.diverged}
        first = min(ends, key=lambda name: ends[name])
        return (first, ends[first]) if math.isfinite(ends[first]) else None

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle, with the limits and implementation of this run."""
        return self.prediction.vehicle

    @property
    def controller(self) -> AnyController:
        """Returns the controller of the run."""
        return self.prediction.controller

    @property
    def road(self) -> Road:
        """The road."""
        return self.prediction.road

    @property
    def sampled(self) -> Response:
        """Response of the sampled loop: exact if that is linear, with characteristics that of RK4."""
        return self.prediction.sampled

    @property
    def continuous(self) -> Response:
        """Exact linear response of the continuous closed loop."""
        return self.prediction.continuous

    @cached_property
    def line_errors(self) -> Mapping[str, float]:
        """Largest difference of the linearisation at equilibrium from MuJoCo, over MuJoCo's peak, by signal.

        It is measured until linear analysis ends otherwise, and empty for a vehicle without characteristics, or without a sampled
        response. States of parts that bend at rest do not count.
        """
        if (line := self.prediction.linearised) is None or self.agreement.until <= 0:
            return {}
        line, physics = (one.until(self.agreement.until) for one in (line, self.physics))
        left_out = {one.name for fitted in self.vehicle.parts if fitted.part.kinked_at_rest for one in fitted.states}
        names = [name for name in self.agreement.signals if name not in left_out]
        with np.errstate(over="ignore", invalid="ignore"):  # of an unstable line
            apart = {name: float(np.max(np.abs(physics[name] - line[name]))) for name in names}
            return {name: one / (physics.scale(name) or 1.0) for name, one in apart.items()}

    @property
    def diverged(self) -> float:
        """Time at which the physics diverged [s]; infinite if it did not."""
        return self.physics.diverged

    @property
    def undecided(self) -> tuple[str, ...]:
        """Reasons for which the checks cannot confirm the run: a timestep that is too coarse, or a law that is not repeatable."""
        commands = self.agreement.commands
        coarse = self.agreement.coarse or (self.energy is not None and not self.energy.judged)
        return (*[COARSE] * coarse, *[NOT_REPEATABLE] * (commands is not None and not commands.repeatable))

    @property
    def agrees(self) -> bool | None:
        """True if physics agrees with its analysis, for as long as that applies; None if the run is `undecided`."""
        return None if self.agreement.agrees and self.undecided else self.agreement.agrees

    @property
    def warnings(self) -> Iterator[str]:
        """Remarks on the run and on its road."""
        yield from (f"controller {self.controller.name!r}: agrees is None, as {why}; {ADVICE[why]}" for why in self.undecided)
        yield from self.road.warnings

    @property
    def passed(self) -> bool:
        """Returns True if no check contradicts the analysis, and the energy balances, if that is known and judged."""
        return self.agreement.agrees and (self.energy is None or not self.energy.fails)
