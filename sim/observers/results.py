"""Results of the optional observers of a run: checks of steps and commands, and the energy balance."""

from dataclasses import dataclass, replace

from models.common.printed import difference
from models.document.document import Document
from models.document.field import Field
from models.document.text import ShownResult, facts

WHEN = Field[float]("time", float, ".4g", unit="s")
DIFFERENCE = Field[float]("difference", float, ".1e")  # difference of a signal, relative to the signal's peak
ALLOWED_DIFFERENCE = Field[float]("allowed", float, ".0e")  # largest difference at which a check passes
JOULES = Field[float]("energy", float, ".5g", unit="J")
# Largest residual of an energy balance, relative to the turnover, if a force has a kink. RK4 then causes residuals of 5e-5 at 1
# ms and 6e-4 at 4 ms for every built-in vehicle and controller over two bumps. A damper that is wrong by 1 % causes a residual
# of at least 3e-3.
BALANCE_TOLERANCE = 1e-3
# A fault causes the same residual at every step size, but RK4 causes a residual that decreases at least with the square of the
# step. If the residual is too large, the run is therefore repeated at half the step, and `FALLS` times the observed decrease is
# allowed in addition. If the error of RK4 is of second order, this error is 4 / 3 of the observed decrease. A wheel of 7 kg on
# a tyre of 430 kN/m that is often in the air causes residuals of 2.6e-3 at 1 ms and 5.7e-4 at 0.5 ms.
FALLS, COARSEST = 1.5, 0.1  # factor for the decrease of the residual, and largest residual at which a balance can be confirmed
# if the turnover is below this multiple of the energy in equilibrium, the residual is a rounding error
ROUNDING = 1e-8


@dataclass(frozen=True)
class LocalAgreement:
    """Result of a local check, which is a check either of steps or of commands.

    Attributes:
        error: the difference that is largest compared with its allowed difference; given relative to the peak of its signal.
        allowed: allowed difference of the signal `signal`, relative to the peak of the same signal.
        signal: name of the signal, command or state of the law that has the difference `error`.
        since: time of the first step or sample at which a difference exceeds the allowed difference [s]; infinity if none
            exceeds it.
    """

    error: float
    allowed: float
    signal: str
    since: float

    @property
    def agrees(self) -> bool:
        """True if no difference exceeds its allowed difference."""
        return self.error <= self.allowed


@dataclass(frozen=True)
class StepAgreement(LocalAgreement):
    """Differences between the simulation and the vehicle's exact equations, over single steps and at the starts of the steps.

    Attributes:
        until: time before which a step must begin to be compared [s]; infinite if all steps are compared.
        equations_invalid: True if the equations of motion are not valid for the state at the time `until`.
    """

    until: float
    equations_invalid: bool = False


@dataclass(frozen=True)
class CommandAgreement(LocalAgreement):
    """Differences between a run and its control law: measurements, commands and states of the law.

    Attributes:
        repeatable: False if the law was started again twice and gave different commands for the same measurements. The commands
            of a law that is not repeatable are not compared.
    """

    repeatable: bool = True


@dataclass(frozen=True, repr=False)
class Energy(ShownResult):
    """Energy balance of a run, from its start to its end, or to the time at which the run became invalid.

    Attributes:
        road: work done by the road on the vehicle [J].
        actuators: work done by the actuators on the vehicle [J].
        stored: change of the kinetic and potential energy [J].
        dissipated: energy that the dampers dissipate [J].
        turnover: sum of the energy that the dampers dissipate, the energy that the actuators supply and absorb, and the largest
            kinetic energy [J].
        loads: work done by the loads on the body [J]; None if no loads act.
        allowed: largest residual that the error of the integrator can explain: the residual of RK4 if no force has a kink,
            otherwise `BALANCE_TOLERANCE`. The allowed residual is larger if the run at half the step has a smaller residual.
        residual: largest magnitude over time of the work done minus the stored and dissipated energy, relative to `turnover`.
        least: smallest power that a semi-active damper dissipates at any sample, relative to the largest power; negative if the
            damper supplied energy. The power is None if the vehicle has no semi-active dampers.
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
        """Document that contains the verdict and the energies of the balance."""
        parts = {name: getattr(self, name) for name in ("road", "actuators", "loads", "stored", "dissipated")}
        title = (
            f"energy {self.verdict}: the residual is {difference(self.residual)} of the {JOULES.text(self.turnover)} exchanged"
        )
        return facts(title, {name: JOULES.text(one) for name, one in parts.items() if one is not None})

    @property
    def fails(self) -> bool:
        """True if the residual exceeds the error of the integrator, or a damper supplied energy."""
        return not self.residual <= self.allowed or (self.least is not None and self.least < -ROUNDING)

    @property
    def judged(self) -> bool:
        """False if the error of the integrator explains the residual, but is too large to confirm a balance."""
        return self.fails or self.allowed <= COARSEST

    @property
    def balances(self) -> bool:
        """True if the residual is within the error of the integrator, and no damper supplied energy."""
        return self.judged and not self.fails

    @property
    def verdict(self) -> str:
        """Verdict on the energy balance, as text."""
        return "DOES NOT BALANCE" if self.fails else "balances" if self.judged else "is not evaluated"

    @property
    def doubtful(self) -> bool:
        """True if the residual of the energy balance is larger than usual. A run at half the step then shows whether the
        residual is an error of RK4 or a fault.
        """
        return self.residual > self.allowed

    def with_half_step(self, finer: "Energy") -> "Energy":
        """Returns the energy balance with an allowed residual that is based on the same run at half the step."""
        falls = max(0.0, self.residual - finer.residual)
        return replace(self, allowed=min(self.allowed + FALLS * falls, max(self.allowed, self.residual, COARSEST)))
