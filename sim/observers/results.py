"""Results of the observers that a run can do without: checks of its steps and commands, and its energy balance."""

from dataclasses import dataclass, replace

from models.common.printed import difference
from models.document.document import Document
from models.document.field import Field
from models.document.text import ShownResult, facts

WHEN = Field[float]("time", float, ".4g", unit="s")
DIFFERENCE = Field[float]("difference", float, ".1e")  # of a signal, over its peak
ALLOWED_DIFFERENCE = Field[float]("allowed", float, ".0e")  # of a check
JOULES = Field[float]("energy", float, ".5g", unit="J")
# Largest residual if a force has a kink, relative to the turnover. There RK4 leaves 5e-5 at 1 ms and 6e-4 at 4 ms (every
# vehicle and controller that ships, over two bumps); a damper that is 1 % off leaves 3e-3 and more.
BALANCE_TOLERANCE = 1e-3
# A fault leaves as much at any step, and what RK4 leaves falls with the second power of the step, or a higher one. So a run that
# leaves more is driven at half the step, too, and this times the fall is allowed on top: 4 / 3 of it is the error of the second
# power. A wheel of 7 kg on a tyre of 430 kN/m, often in the air, leaves 2.6e-3 at 1 ms and 5.7e-4 at half of it.
FALLS, COARSEST = 1.5, 0.1  # and the largest residual that confirms a balance; a larger one is not evaluated
ROUNDING = 1e-8  # smallest turnover, relative to the energy at rest: below it the residual is rounding


@dataclass(frozen=True)
class LocalAgreement:
    """Result of one of the two local checks.

    Attributes:
        error: the difference with the largest ratio to its allowed value, over the signal's peak.
        allowed: the allowed value of that signal, over its peak.
        signal: name of that signal, command or law state.
        since: time of the first step or sample that differs by more than is allowed [s], or infinity.
    """

    error: float
    allowed: float
    signal: str
    since: float

    @property
    def agrees(self) -> bool:
        """Returns True if every step or command is right."""
        return self.error <= self.allowed


@dataclass(frozen=True)
class StepAgreement(LocalAgreement):
    """Differences of the physics from the vehicle's exact equations over single steps, and at their starts.

    Attributes:
        until: steps that begin before this time are compared [s]; infinite for all.
        equations_invalid: True if the equations do not take the state at that time.
    """

    until: float
    equations_invalid: bool = False


@dataclass(frozen=True)
class CommandAgreement(LocalAgreement):
    """Differences of a run's measurements, commands and law states from its control law.

    Attributes:
        repeatable: False if the law gave two answers to the same measurements when it was started again twice. Its commands are
            then not compared.
    """

    repeatable: bool = True


@dataclass(frozen=True, repr=False)
class Energy(ShownResult):
    """Energy balance of a run, from its start to its end or to the time at which it broke off.

    Attributes:
        road: work of the road [J].
        actuators: work of the actuators [J].
        stored: change of the kinetic and potential energy [J].
        dissipated: energy taken by the dampers [J].
        turnover: energy taken by the dampers, moved by the actuators either way, and the largest kinetic energy [J].
        loads: work of the loads on the body [J], or None if there are no loads.
        allowed: largest residual that the integrator explains: RK4's own if no force has a kink, else `BALANCE_TOLERANCE`; more
            if half the step leaves less.
        residual: largest magnitude at any time of works less stored and dissipated energy, over `turnover`.
        least: least power taken by an adjustable damper at any sample, over the largest; below 0 if it gave energy. None if the
            vehicle has no adjustable dampers.
    """

    road: float
    actuators: float
    stored: float
    dissipated: float
    turnover: float
    residual: float
    least: float | None = None
    loads: float | None = None
    allowed: float = BALANCE_TOLERANCE

    @property
    def summary(self) -> Document:
        """Returns whether it balances, and the energies."""
        parts = {name: getattr(self, name) for name in ("road", "actuators", "loads", "stored", "dissipated")}
        title = (
            f"energy {self.verdict}: the residual is {difference(self.residual)} of the {JOULES.text(self.turnover)} exchanged"
        )
        return facts(title, {name: JOULES.text(one) for name, one in parts.items() if one is not None})

    @property
    def fails(self) -> bool:
        """Returns True if the residual is more than the integrator's error, or a damper gave energy."""
        return not self.residual <= self.allowed or (self.least is not None and self.least < -ROUNDING)

    @property
    def judged(self) -> bool:
        """Returns False if the integrator's error explains the residual, but is too large to confirm a balance."""
        return self.fails or self.allowed <= COARSEST

    @property
    def balances(self) -> bool:
        """Returns True if the residual is within the integrator's error, and no damper gave energy."""
        return self.judged and not self.fails

    @property
    def verdict(self) -> str:
        """The verdict, in words."""
        return "DOES NOT BALANCE" if self.fails else "balances" if self.judged else "is not evaluated"

    @property
    def doubtful(self) -> bool:
        """Returns True if more is left over than is usual: half the step tells an error of RK4 from a fault."""
        return self.residual > self.allowed

    def with_half_step(self, finer: "Energy") -> "Energy":
        """Returns the balance with its allowed residual, given the same run at half the step."""
        falls = max(0.0, self.residual - finer.residual)
        return replace(self, allowed=min(self.allowed + FALLS * falls, max(self.allowed, self.residual, COARSEST)))
