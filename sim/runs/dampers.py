"""Missing force in a run: the part of the requested forces that semi-active dampers could not supply."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from models.common.printed import percent
from models.document.document import Statement, notes
from models.document.field import Field
from models.parts.damper_range import range_of
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.drive.regime import MISSING_FORCE
from sim.drive.response import Response
from sim.linear.dampers import closing_velocities, commands_of, squarable
from sim.runs.result import RunResult

# if more than this fraction of the requested force is missing, linear analysis does not describe the run
HALF = 0.5
COEFFICIENT = Field[float]("coefficient", float, ".4g", unit="N s/m")


@dataclass(frozen=True)
class Shortfall:
    """Requested force that a semi-active damper did not supply, at the samples of the controller.

    Attributes:
        rms: rms of the missing force relative to the rms of the requested force; 0 if no force was requested.
        time: fraction of the samples at which part of the requested force is missing.
        softest, hardest: smallest and largest damping coefficient [N s/m], or smallest and largest voltage [V].
        late: value of `rms` that also includes the force missing due to the lag of the valve; None if the valve has no lag.
    """

    rms: float
    time: float
    softest: float
    hardest: float
    late: float | None = None


def shortfalls(vehicle: Vehicle, physics: Response) -> Mapping[str, Shortfall]:
    """Returns the missing force of each semi-active damper until the run diverges, by name of the force."""
    whole = physics.until(physics.diverged)
    if not vehicle.dampers or len(whole.time) < 2:
        return {}
    commands, how = commands_of(vehicle, whole), vehicle.implementation
    period = steps_per_sample(how, float(whole.time[1]))
    late = round(how.delay * period)
    decided = np.arange(0, len(whole.time) - late, period)
    closing, m = closing_velocities(vehicle, whole), len(vehicle.linear_model.inputs)
    given = range_of([vehicle]).forces(commands[decided + late, None, :m], closing[decided, None])[:, 0]
    by_force = {}
    for one in vehicle.parts.adjustable:
        j = vehicle.linear_model.inputs.index(one.force)
        missing = squarable(commands[decided + late, m + j])
        requested, c = missing + given[:, j], whole[one.coefficient]
        most = float(np.sqrt(np.mean(requested**2)))
        share = float(np.sqrt(np.mean(missing**2))) / most if most else 0.0
        kept = None
        if one.damper.bandwidth is not None:
            kept = float(np.sqrt(np.mean((requested - whole[one.force][decided + late]) ** 2))) / most if most else 0.0
        by_force[one.force] = Shortfall(
            share, float(np.mean(np.abs(missing) > MISSING_FORCE)), float(c.min()), float(c.max()), kept
        )
    return by_force


def damper_notes(run: RunResult) -> list[Statement]:
    """Returns sentences on the force that semi-active dampers did not supply, and on the consequence for linear analysis."""
    names, texts, most = {one.force: one.coefficient for one in run.vehicle.parts.adjustable}, list[str](), 0.0
    delayed = ["delay"] * bool(run.vehicle.implementation.delay)
    delayed += ["valve lag"] * any(one.bandwidth is not None for one in run.vehicle.dampers.values())
    if delayed:
        of_voltage = not all(one.replaces for one in run.vehicle.dampers.values())
        what = "the voltage" if of_voltage else "the damping coefficient"
        acts = f"{' and '.join(delayed)} act{'s' * (len(delayed) == 1)} on {what}"
        texts.append(f"{acts}, not on the force, which follows the present suspension velocity")
    for force, one in shortfalls(run.vehicle, run.physics).items():
        most = max(most, one.rms)
        if one.late:
            texts.append(f"{names[force]}: the valve's lag removes {percent(one.late)} (rms) of the requested force")
        if one.time:
            setting = replace(COEFFICIENT, unit=run.vehicle.kind.signal(names[force]).unit)
            texts.append(
                f"{names[force]} is between {setting.digits(one.softest)} and {setting.text(one.hardest)}; "
                f"{percent(one.rms)} (rms) of the requested force is missing, at {percent(one.time)} of the samples"
            )
    if most > HALF and run.controller.linear:
        text = "norms and margins do not describe this run: a semi-active damper cannot supply "
        text += f"{percent(most)} of the requested force"
        return [*notes(*texts), Statement(text, "ends")]
    return [*notes(*texts)]
