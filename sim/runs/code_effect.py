"""Effect of exported code on a run: the difference from a MuJoCo run with the control law itself instead of the code.

The run with the control law must agree with the model, and the code may change no signal by more than `MOST` of its peak. A
separate check (`sim.observers.commands`) compares every command in the run with the command that the code computes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.document.document import Table
from models.document.field import Field, Record
from models.vehicle.vehicle import Vehicle
from sim.drive.response import Response
from sim.observers.results import DIFFERENCE
from synth.controller.controller import AnyController

OF_CODE = Field[str]("difference", str, ".2g")
# largest change of a signal due to exported code, relative to the signal's peak; code with a larger effect does not compute the
# law
MOST = 1e-2


@dataclass(frozen=True, eq=False)
class CodeEffect:
    """Difference between a run with exported code and a run with the control law itself.

    Attributes:
        numbers: number format in which the code computes, see `ExportedLaw`.
        apart: difference of each output signal between both runs at every sample, by name of the signal, until one of the runs
            diverges.
        share: largest difference among all signals, each relative to the signal's scale, as long as linear analysis applies.
        signal: name of the signal with the largest difference.
        law_agrees: True if the run with the law itself agrees with the model.
        clipped_readings: names of measurements that the code clips, because they exceed their fixed-point range.
    """

    numbers: str
    apart: Mapping[str, Array]
    share: float
    signal: str
    law_agrees: bool
    clipped_readings: tuple[str, ...]

    @property
    def agrees(self) -> bool:
        """True if the run with the law agrees with the model, and the run with the code is close to the run with the law."""
        return self.law_agrees and self.share <= MOST

    def peak(self, name: str) -> float:
        """Returns the largest difference of a signal between the run with the code and the run with the law."""
        return float(self.apart[name].max(initial=0.0))

    def rms(self, name: str) -> float:
        """Returns the root mean square of a signal's difference between the run with the code and the run with the law."""
        return float(np.sqrt(np.mean(self.apart[name] ** 2))) if len(self.apart[name]) else 0.0

    @property
    def failures(self) -> list[str]:
        """Messages with the reasons why the exported code does not agree with the control law; empty if the code agrees."""
        lines = [] if self.law_agrees else ["DOES NOT AGREE: the run with the control law itself does not agree with the model"]
        if self.share > MOST:
            lines.append(
                f"DOES NOT AGREE: exported code changes {self.signal} by {DIFFERENCE.digits(self.share)} of its peak, "
                f"but {MOST:g} is allowed; export the controller with a finer number format, or with smaller ranges"
            )
        return lines


def code_effect(
    driver: AnyController, physics: Response, law_physics: Response, names: Sequence[str], until: float, law_agrees: bool
) -> CodeEffect:
    """Returns the effect of exported code on a run.

    Args:
        driver: controller whose control law the code implements.
        physics, law_physics: simulated response with the exported code, and simulated response with the control law itself.
        names: names of the output signals.
        until: time until which linear analysis applies to the run with the law [s].
        law_agrees: True if the run with the law agrees with the model.
    """
    law, end = driver.code.law, min(physics.diverged, law_physics.diverged)
    code, ours, applies = physics.until(end), law_physics.until(end), law_physics.until(min(until, end))
    apart, shares = {name: np.abs(code[name] - ours[name]) for name in names}, dict.fromkeys(names, 0.0)
    if len(applies.time):
        shares = {name: float(apart[name][: len(applies.time)].max()) / (float(applies.scale(name)) or 1.0) for name in names}
    furthest = max(shares, key=lambda name: shares[name])
    ranges = [] if law.ranges is None else law.ranges
    clipped = tuple(name for name, most in zip(driver.measured, ranges, strict=False) if code.peak(name) > most)
    return CodeEffect(law.numbers, apart, shares[furthest], furthest, law_agrees, clipped)


def _differences(effect: CodeEffect) -> dict[str, Any]:
    return {name: {"peak": effect.peak(name), "rms": effect.rms(name)} for name in effect.apart}


# difference in each signal between the run with the exported code and the run with the law
DIFFERENCES = Record[CodeEffect](_differences)


def code_notes(effect: CodeEffect, vehicle: Vehicle) -> list[str]:
    """Returns a sentence that states how much exported code changes the signals compared with the control law."""
    line = f"the controller runs as compiled code in {effect.numbers}"
    if effect.clipped_readings:
        return [
            f"{line}; {effect.clipped_readings[0]} exceeds its range on this road, and is clipped: export with a larger --range"
        ]
    if not any(map(effect.peak, effect.apart)):
        return [f"{line}; the run is the same, bit for bit, as with the control law itself"]
    force = max(vehicle.linear_model.inputs, key=effect.peak)
    apart = f"at most {OF_CODE.digits(effect.peak(force))} N (rms {OF_CODE.digits(effect.rms(force))} N)"
    share = DIFFERENCE.digits(effect.share)
    return [f"{line}; with the control law itself, {force} differs by {apart}, and every signal by at most {share} of its peak"]


def code_table(effect: CodeEffect, vehicle: Vehicle) -> Table:
    """Returns a table of how much each signal differs from that in the run with the control law itself."""
    fields = (
        Field[str]("signal", lambda name: name.replace("_", " ")),
        Field[str]("unit", lambda name: vehicle.kind.signal(name).unit),
        replace(OF_CODE, label="rms", value=effect.rms),
        replace(OF_CODE, label="at most", value=effect.peak),
    )
    caption = "Difference between MuJoCo's runs with the exported code and with the control law itself, over the same road."
    return Table.of("exported-rounding", caption, fields, effect.apart, words=2, detail="full")
