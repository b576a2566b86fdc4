"""The loop of an exported controller with the numbers of its code, beside the ideal one."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from models.common.arrays import Array
from models.common.printed import finite, table
from models.laws.linear import LinearLaw
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller
from synth.controller.export.c_law import ExportedLaw
from synth.controller.export.rounding import rounded_law, steady_rounding
from synth.controller.implementation_norm import norm_as_implemented
from synth.controller.open_loop import LoopModel
from synth.controller.sampled_margins import SampledMargins, sampled_margins
from synth.vehicle.designer import Designer


def with_numbers(vehicle: Vehicle, controller: Controller, law: ExportedLaw) -> Controller:
    """Returns a controller with the coefficients of its code, judged as it is, by the goals of its section.

    Args:
        controller: a controller without adjustable dampers.
    """
    _, held = rounded_law(law)
    own = replace(_law(law, held), anti_windup=controller.law.anti_windup)
    entry = vehicle.controllers.get(controller.name)
    if entry is None:  # `state`
        return Designer(vehicle, search=False).certify(controller.name, controller.measured, own, controller.hardware)
    given = replace(entry, law=own, certificate=None, design="", structure=None, sampled=False)
    beside = replace(vehicle, controllers={**vehicle.controllers, controller.name: given})
    return Designer(beside, search=False).design(controller.name)


def numbers_object(vehicle: Vehicle, controller: Controller, law: ExportedLaw, timestep: float) -> dict[str, Any]:
    """Returns norm, margins and promises of the loop, ideal and with the code's coefficients, and what rounding does to forces.

    Args:
        controller: a controller without adjustable dampers.
        timestep: sample period of a vehicle without one; delays are multiples of it [s].
    """
    loops = {}
    for name, judged in (("ideal", controller), (law.numbers, with_numbers(vehicle, controller, law))):
        kept = [promise.holds for promise in judged.specifications]
        norm = norm_as_implemented(vehicle, judged, timestep).value
        margins = _margins_object(sampled_margins(vehicle, judged, timestep))
        loops[name] = {"norm": finite(norm), "promises": len(kept), "kept": sum(kept), "margins": margins}
    loop = LoopModel(vehicle, controller, vehicle.implementation.sample_period or timestep)
    effect = steady_rounding(loop, law)
    rounding = None if effect is None else {"rms_share": effect.rms, "most": effect.most}
    why = "the loop is not stable, and rounding grows with everything" if effect is None else None
    return {"loops": loops, "rounding": rounding, "why": why}


def _margins_object(margins: SampledMargins | None) -> dict[str, float | None] | None:
    """Returns margins as a JSON object, None for any amount; None for a loop that is not stable."""
    if margins is None:
        return None
    return {
        "gain": finite(margins.gain),
        "gain_lower": margins.gain_lower or None,
        "phase": finite(margins.phase),
        "phase_lead": finite(margins.lead),
        "delay": finite(margins.delay),
    }


def _law(law: ExportedLaw, matrix: Array) -> LinearLaw:
    """Returns the law of a matrix [D, C; B, A]."""
    q, m = law.readings, len(law.outputs)
    A, B, C, D = matrix[m:, q:], matrix[m:, :q], matrix[:m, q:], matrix[:m, :q]
    return LinearLaw(A, B, C, D, law.period if law.states else None)


MARGINS = {
    "gain": ("gain margin, factor", 1.0),
    "gain_lower": ("lower gain margin", 1.0),
    "phase": ("phase lag margin, degrees", math.degrees(1)),
    "phase_lead": ("phase lead margin, degrees", math.degrees(1)),
    "delay": ("delay margin, ms", 1e3),
}


CHANGE, ROUNDING = "change", "rounding"


def numbers_rows(about: Mapping[str, Any]) -> list[tuple[str, str, str, str]]:
    """Returns the rows of a table: what, ideal, with the numbers of the code, and the relative change."""
    ideal, coded = about["loops"].values()
    norms = [one["norm"] for one in (ideal, coded)]
    words = [f"{norm:.7g}" if norm is not None else "infinite" for norm in norms]
    rows = [("norm as implemented", words[0], words[1], _change(*norms))]
    if ideal["margins"] is not None and coded["margins"] is not None:
        for key, (name, scale) in MARGINS.items():
            both = ideal["margins"][key], coded["margins"][key]
            if key == "gain_lower" and both == (None, None):
                continue
            cells = ["any" if value is None else f"{scale * value:.6g}" for value in both]
            rows.append((name, cells[0], cells[1], _change(*both)))
    if ideal["promises"]:
        kept = [f"{one['kept']} of {one['promises']}" for one in (ideal, coded)]
        rows.append(("promises kept", kept[0], kept[1], ""))
    effect = about["rounding"]
    if effect is not None:
        rows.append((f"{ROUNDING}, rms", "0", f"{effect['rms_share']:.1e}", ""))
        rows.append((f"{ROUNDING}, at most, N", "0", f"{effect['most']:.2g}", ""))
    return rows


def _change(before: float | None, after: float | None) -> str:
    return f"{after / before - 1:+.1e}" if before and after else ""


def _brief(about: Mapping[str, Any]) -> str:
    """Returns the numbers of the code in a sentence: every row whose change shows, and rounding."""
    (_, numbers), effect, changed = about["loops"], about["rounding"], list[str]()
    for name, before, after, _ in numbers_rows(about):
        what, _, unit = name.partition(", ")
        if what != ROUNDING and before != after:
            changed.append(f"{what} {after}{f' {unit}' if unit != 'factor' and unit else ''}, not {before}")
    text = f"in {numbers}: {'; '.join(changed) or 'norm and margins are those of the law itself'}"
    most = about["why"] if effect is None else f"rounding moves a force by {effect['most']:.2g} N at most, up to 1 m/s"
    return f"{text}; {most}"


def numbers_notes(about: Mapping[str, Any]) -> list[str]:
    """Returns the sentences below the rows."""
    if about["rounding"] is None:
        return [about["why"]]
    return [
        "rounding of a force: rms as a share of its own, on roads whose velocity is white noise; the worst case for up to 1 m/s"
    ]


def numbers_lines(about: Mapping[str, Any], full: bool) -> list[str]:
    """Returns the same as a table with its sentences, or in one sentence what changes most."""
    if not full:
        return [_brief(about)]
    return [*table([("", *about["loops"], CHANGE), *numbers_rows(about)]), *numbers_notes(about)]
