"""Effect of exported code on a run, measured in MuJoCo: the difference from the same run with the law itself.

Linear analysis predicts the law. So the run with the law is compared with analysis, and the run with the code with that run. The
comparison of the code's own run with analysis allows for the measured difference, which must be small.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from models.common.printed import finite, table
from sim.response.response import Response
from synth.controller.controller import code_of

if TYPE_CHECKING:
    from sim.runs.prediction import Prediction
    from sim.runs.run import Run

MOST = 1e-2  # of a peak; code that moves a signal by more is not the law that linear analysis predicts


@dataclass(frozen=True, eq=False)
class CodeEffect:
    """Difference of a run with exported code from the run with the law itself.

    Attributes:
        peak: largest difference of each output signal until either run diverges, by name.
        rms: root mean square of the difference until then, by name.
        share: largest difference of any signal over its scale, while the comparison with analysis applies.
        signal: name of that signal.
        law_agrees: True if the run with the law itself agrees with analysis.
        clipped: readings that leave their range in fixed point, where the code clips them.
    """

    peak: Mapping[str, float]
    rms: Mapping[str, float]
    share: float
    signal: str
    law_agrees: bool
    clipped: tuple[str, ...] = ()

    @property
    def holds(self) -> bool:
        """Returns True if the law's run agrees with analysis, and the code's run with that of the law."""
        return self.law_agrees and self.share <= MOST


def with_code_effect(prediction: "Prediction", physics: Response, law_run: "Run") -> "Prediction":
    """Adds the effect of exported code to the prediction of its run. In numbers other than double, `spread` contains it.

    Args:
        physics: the run with the code.
        law_run: the run with the law itself.
    """
    law, names, spread = code_of(prediction.controller).law, prediction.vehicle.linear_model.outputs, prediction.spread
    both = physics, law_run.physics
    end = min(one.diverged for one in both)
    code, ours = (one.until(end) for one in both)
    apart = {name: np.abs(code[name] - ours[name]) for name in names}
    applies = law_run.physics.until(min(law_run.agreement.until, end))
    shares = {
        name: float(apart[name][: len(applies.time)].max()) / (float(applies.scale(name)) or 1.0) if len(applies.time) else 0.0
        for name in names
    }
    furthest = max(shares, key=lambda name: shares[name])
    clipped = ()
    if law.ranges is not None:
        measured = zip(prediction.controller.measured, law.ranges, strict=True)
        clipped = tuple(name for name, most in measured if code.peak(name) > most)
    if law.numbers != "double" and not prediction.played:
        rest = len(physics.time) - len(code.time)
        spread = {name: np.pad(far, (0, rest)) + spread.get(name, 0.0) for name, far in apart.items()}
    effect = CodeEffect(
        {name: float(far.max(initial=0.0)) for name, far in apart.items()},
        {name: float(np.sqrt(np.mean(far**2))) if len(far) else 0.0 for name, far in apart.items()},
        shares[furthest],
        furthest,
        law_run.agrees,
        clipped,
    )
    return replace(prediction, spread=spread, code_effect=effect)


def code_effect_object(run: "Run") -> dict[str, Any]:
    """Returns the effect of exported code as JSON has it; empty without such code."""
    effect = run.prediction.code_effect
    if effect is None:
        return {}
    return {"rounding": {name: {"rms": finite(rms), "most": finite(effect.peak[name])} for name, rms in effect.rms.items()}}


def code_line(run: "Run") -> str:
    """Returns a sentence on the exported code that drives a run and how far its run is from that of the law; empty without."""
    code, effect = code_of(run.controller), run.prediction.code_effect
    if code is None or effect is None:
        return ""
    line = f"compiled code in {code.law.numbers} drives it"
    if effect.clipped:
        return f"{line}; {effect.clipped[0]} leaves its range on this road and is clipped there: export with a larger --range"
    if not any(effect.peak.values()):
        return f"{line}; its run is that of the law, to the last bit"
    force = max(run.vehicle.linear_model.inputs, key=lambda name: effect.peak[name])
    return (
        f"{line}; {force} differs from that of the law by {effect.peak[force]:.2g} N at most and {effect.rms[force]:.2g} N rms, "
        f"and any signal by {effect.share:.1e} of its peak at most"
    )


def code_table(run: "Run") -> list[str]:
    """Returns a table of the difference of every signal from the run with the law itself; empty without code."""
    effect = run.prediction.code_effect
    if effect is None:
        return []
    kind = run.vehicle.kind
    rows = [(f"{name} [{kind.signal(name).unit}]", f"{effect.peak[name]:.2g}", f"{effect.rms[name]:.2g}") for name in effect.peak]
    return table([("code against law", "peak", "rms"), *rows])


def agrees_line(effect: CodeEffect | None, when: str, reference: str) -> str:
    """Returns a sentence on a run with exported code that agrees.

    Args:
        when: time for which the comparison applies, in words.
        reference: of the run with the law itself, in words.
    """
    assert effect is not None, "exported code drives the run"
    return (
        f"agrees {when}: the run with the law itself agrees with {reference}, and the run with the code differs from it by "
        f"{effect.share:.1e} of a peak at most ({effect.signal}; {MOST:g} is allowed)"
    )


def failure_lines(effect: CodeEffect | None) -> list[str]:
    """Returns the reasons for which exported code does not agree; empty if it agrees, or without code."""
    if effect is None:
        return []
    lines = [] if effect.law_agrees else ["DOES NOT AGREE: the run with the law itself does not agree with linear analysis"]
    if effect.share > MOST:
        lines.append(
            f"DOES NOT AGREE: the code moves {effect.signal} by {effect.share:.1e} of its peak, where {MOST:g} is allowed; "
            "export it in finer numbers, or with smaller ranges"
        )
    return lines
