"""Effect of exported code on a run, measured in MuJoCo: the difference from the same run with the law itself.

The run with the law must agree, and the code may move no signal of it by more than `MOST` of its peak. That every command of the
run is that of the code is a check of its own (`sim.runs.commands`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.printed import finite
from models.document.document import Table
from models.document.field import Field
from models.vehicle.vehicle import Vehicle
from sim.response.response import Response
from sim.runs.steps import DIFFERENCE
from synth.controller.controller import AnyController, code_of

MOST = 1e-2  # of a peak; code that moves a signal by more is not that of the law
SIZE = Field[str]("difference", str, ".2g")


@dataclass(frozen=True, eq=False)
class CodeEffect:
    """Difference of a run with exported code from the run with the law itself.

    Attributes:
        numbers: numbers of the code, see `ExportedLaw`.
        apart: difference of each output signal at every sample until either run diverges, by name.
        share: largest difference of any signal over its scale, while linear analysis applies.
        signal: name of that signal.
        law_agrees: True if the run with the law itself agrees.
        clipped: readings that leave their range in fixed point, where the code clips them.
    """

    numbers: str
    apart: Mapping[str, Array]
    share: float
    signal: str
    law_agrees: bool
    clipped: tuple[str, ...]

    @property
    def holds(self) -> bool:
        """Returns True if the law's run agrees, and the code's run is close to that of the law."""
        return self.law_agrees and self.share <= MOST

    def peak(self, name: str) -> float:
        """Returns the largest difference of a signal."""
        return float(self.apart[name].max(initial=0.0))

    def rms(self, name: str) -> float:
        """Returns the root mean square of the difference of a signal."""
        return float(np.sqrt(np.mean(self.apart[name] ** 2))) if len(self.apart[name]) else 0.0

    @property
    def failures(self) -> list[str]:
        """Returns the reasons for which exported code does not agree; empty if it agrees."""
        lines = [] if self.law_agrees else ["DOES NOT AGREE: the run with the law itself does not agree"]
        if self.share > MOST:
            lines.append(
                f"DOES NOT AGREE: the code moves {self.signal} by {DIFFERENCE.digits(self.share)} of its peak, allowed {MOST:g}; "
                "export it in finer numbers, or with smaller ranges"
            )
        return lines


def code_effect(
    driver: AnyController, physics: Response, law_physics: Response, names: Sequence[str], until: float, law_agrees: bool
) -> CodeEffect:
    """Returns the effect of exported code on a run.

    Args:
        driver: the controller that the code drives.
        physics, law_physics: the run with the code, and the run with the law itself.
        names: output signals.
        until: time before which linear analysis applies to the run with the law [s].
        law_agrees: True if that run agrees.
    """
    law, end = code_of(driver).law, min(physics.diverged, law_physics.diverged)
    code, ours, applies = physics.until(end), law_physics.until(end), law_physics.until(min(until, end))
    apart, shares = {name: np.abs(code[name] - ours[name]) for name in names}, dict.fromkeys(names, 0.0)
    if len(applies.time):
        shares = {name: float(apart[name][: len(applies.time)].max()) / (float(applies.scale(name)) or 1.0) for name in names}
    furthest = max(shares, key=lambda name: shares[name])
    ranges = [] if law.ranges is None else law.ranges
    clipped = tuple(name for name, most in zip(driver.measured, ranges, strict=False) if code.peak(name) > most)
    return CodeEffect(law.numbers, apart, shares[furthest], furthest, law_agrees, clipped)


def code_object(effect: CodeEffect | None) -> dict[str, Any]:
    """Returns the effect of exported code for JSON; empty without such code."""
    if effect is None:
        return {}
    apart = {name: {"peak": finite(effect.peak(name)), "rms": finite(effect.rms(name))} for name in effect.apart}
    return {"code_difference": apart}


def code_notes(effect: CodeEffect | None, vehicle: Vehicle) -> list[str]:
    """Returns a sentence on the exported code that drives a run and its distance from the run of the law; none without code."""
    if effect is None:
        return []
    line = f"compiled code in {effect.numbers} drives it"
    if effect.clipped:
        return [f"{line}; {effect.clipped[0]} leaves its range on this road and is clipped there: export with a larger --range"]
    if not any(map(effect.peak, effect.apart)):
        return [f"{line}; its run equals that of the law bit for bit"]
    force = max(vehicle.linear_model.inputs, key=effect.peak)
    apart = f"{SIZE.digits(effect.peak(force))} N at most and {SIZE.digits(effect.rms(force))} N rms"
    return [
        f"{line}; {force} differs from that of the law by {apart}, and any signal by {DIFFERENCE.digits(effect.share)} of its "
        "peak at most"
    ]


def code_table(effect: CodeEffect, vehicle: Vehicle) -> Table:
    """Returns the difference of every signal from the run with the law itself."""
    fields = (
        Field[str]("signal", lambda name: name.replace("_", " ")),
        Field[str]("unit", lambda name: vehicle.kind.signal(name).unit),
        replace(SIZE, label="rms", value=effect.rms),
        replace(SIZE, label="at most", value=effect.peak),
    )
    caption = "Difference of MuJoCo's run with the code from its run with the law itself, over the same road."
    return Table.of("exported-rounding", caption, fields, effect.apart, words=2, detail="full")
