"""Effect of exported code on a run, measured in MuJoCo: the difference from the same run with the law itself.

The run with the law must agree, and the code may move no signal of it by more than `MOST` of its peak. That every command of the
run is that of the code is a check of its own (`sim.observers.commands`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.document.field import Record
from sim.drive.response import Response
from sim.observers.results import DIFFERENCE
from synth.controller.controller import AnyController

MOST = 1e-2  # of a peak; code that moves a signal by more is not that of the law


@dataclass(frozen=True, eq=False)
class CodeEffect:
    """Difference of a run with exported code from the run with the law itself.

    Attributes:
        numbers: numbers of the code, see `ExportedLaw`.
        apart: difference of each output signal at every sample until either run diverges, by name.
        share: largest difference of any signal over its scale, while linear analysis applies.
        signal: name of that signal.
        law_agrees: True if the run with the law itself agrees.
        clipped_readings: readings that leave their range in fixed point, where the code clips them.
    """

    numbers: str
    apart: Mapping[str, Array]
    share: float
    signal: str
    law_agrees: bool
    clipped_readings: tuple[str, ...]

    @property
    def agrees(self) -> bool:
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
        lines = [] if self.law_agrees else ["DOES NOT AGREE: the run with the control law itself does not agree with the model"]
        if self.share > MOST:
            lines.append(
                f"DOES NOT AGREE: exported code changes {self.signal} by {DIFFERENCE.digits(self.share)} of its peak, "
                f"but {MOST:g} is allowed; export the controller with finer numbers, or with smaller ranges"
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


DIFFERENCES = Record[CodeEffect](_differences)  # of a run with exported code from that with the law, by signal
