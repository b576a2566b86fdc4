"""Fragility in words, and as JSON has it."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from models.common.numbers import finite, percent
from synth.certificate.certificate import Certificate
from synth.tolerance.fragility import Borne, Fragility

NOTHING = 1e-12  # of an error that is none
SAME = 1e-9  # relative, of two norms: two ways to one are as far apart


def fragility_object(
    found: Fragility, rounding: Mapping[str, Certificate], measured: Sequence[str], forces: Sequence[str]
) -> dict[str, Any]:
    """Fragility as JSON has it: errors relative, None for what is infinite.

    Args:
        found: of a law.
        rounding: of the same.
        measured: its q signals.
        forces: m of them.
    """

    def borne(one: Borne) -> dict[str, Any]:
        return {
            "proved": one.proved,
            "bound": finite(one.bound),
            "found": finite(one.found),
            "readings": dict(zip(measured, one.readings.tolist(), strict=True)),
            "forces": dict(zip(forces, one.forces.tolist(), strict=True)),
        }

    return {
        "norm": found.norm,
        "stable": borne(found.stable),
        "within": [{"share": share, **borne(one)} for share, one in found.within.items()],
        "rounding": {name: {"norm": finite(one.norm.value), "bound": one.bound} for name, one in rounding.items()},
    }


def whose(found: Fragility) -> str:
    """What is off."""
    return "readings and forces" if len(found.stable.forces) > 1 else "readings"


def errors_text(one: Borne, measured: Sequence[str], forces: Sequence[str]) -> str:
    """The errors that do more than they may, in percent."""
    named = zip((*measured, *forces), (*one.readings, *one.forces), strict=True)
    return ", ".join(f"{name} {100 * error:+.4g} %" for name, error in named if abs(error) > NOTHING) or "none"


def fragility_text(found: Fragility, measured: Sequence[str], forces: Sequence[str]) -> str:
    """How fragile a law is, in a sentence."""
    stable, text = found.stable, "fragile: "
    if math.isfinite(stable.found):
        text += f"unstable with {whose(found)} off by {100 * stable.found:.4g} % ({errors_text(stable, measured, forces)}); "
    else:
        text += f"no errors of {whose(found)} up to 100 % were found that make it unstable; "
    return text + proved_text(found)


def proved_text(found: Fragility) -> str:
    """What is proved of errors, and what they are not."""
    stable = found.stable
    text = "that it is stable with errors is not proved"
    if stable.proved:
        text = f"stable with each off by up to {100 * stable.proved:.4g} %, which is proved"
    for share, one in found.within.items():
        beyond = f", and not at {100 * one.found:.4g} %" if math.isfinite(one.found) else ""
        text += f"; the norm within {100 * share:g} % "
        text += f"up to {100 * one.proved:.4g} %{beyond}" if one.proved else f"of errors is not proved{beyond}"
    return text


def rounding_text(norm: float, rounding: Mapping[str, Certificate]) -> str:
    """What rounding a law's numbers does to its norm, in a sentence."""
    said = []
    for name, one in rounding.items():
        if not one.stable:
            said.append(f"{name} UNSTABLE")
            continue
        bound = f", proved below {one.bound:.7g}" if one.bound is not None else ""
        share = one.norm.value / norm - 1
        change = f"{percent(abs(share))} {'higher' if share > 0 else 'lower'}" if abs(share) > SAME else "unchanged"
        said.append(f"{name} {one.norm.value:.7g} ({change}{bound})")
    return f"norm with the law's numbers as {'; as '.join(said)}"
