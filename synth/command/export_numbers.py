"""The loop of an exported controller with the numbers of its code, beside the ideal one."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from models import USUAL_TIMESTEP
from models.common.arrays import Array
from models.common.printed import finite, table
from models.laws.linear import LinearLaw
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller
from synth.controller.export.c_law import ExportedLaw
from synth.controller.export.rounding import rounded_law, steady_rounding
from synth.controller.implementation_norm import norm_as_implemented
from synth.controller.open_loop import LoopModel, readings_of_road
from synth.vehicle.designer import Designer


def numbers_object(vehicle: Vehicle, controller: Controller, law: ExportedLaw) -> dict[str, Any]:
    """Returns norm and promises of the loop, ideal and with the coefficients of the code, and what rounding does to forces.

    Args:
        vehicle: whose file has the controller's law.
        controller: without adjustable dampers.
        law: as exported.
    """
    loops = {}
    for name, matrix in zip(("ideal", law.numbers), rounded_law(law), strict=True):
        own = replace(_law(law, matrix), anti_windup=controller.law.anti_windup)
        entry = replace(vehicle.controllers[controller.name], law=own, certificate=None)
        judged = Designer(replace(vehicle, controllers={**vehicle.controllers, controller.name: entry}), search=False).design(
            controller.name
        )
        kept = [promise.holds for promise in judged.specifications]
        norm = norm_as_implemented(vehicle, judged).value
        loops[name] = {"norm": finite(norm), "promises": len(kept), "kept": sum(kept)}
    loop = LoopModel(vehicle, controller, vehicle.implementation.sample_period or USUAL_TIMESTEP)
    if np.any(readings_of_road(loop.open_loop, controller)):
        return {
            "loops": loops,
            "rounding": None,
            "why": "a reading has the road's velocity in it, of which no bound on rounding is computed",
        }
    effect = steady_rounding(loop, law)
    rounding = None if effect is None else {"rms_share": effect.rms, "most": effect.most}
    why = "the loop is not stable, and rounding grows with everything" if effect is None else None
    return {"loops": loops, "rounding": rounding, "why": why}


def _law(law: ExportedLaw, matrix: Array) -> LinearLaw:
    """Returns the law of a matrix [D, C; B, A]."""
    q, m = law.readings, len(law.outputs)
    A, B, C, D = matrix[m:, q:], matrix[m:, :q], matrix[:m, q:], matrix[:m, :q]
    return LinearLaw(A, B, C, D, law.period if law.states else None)


def numbers_lines(about: Mapping[str, Any]) -> list[str]:
    """Returns the same as a table, with its sentences."""
    rows, (ideal, coded) = [("", *about["loops"])], about["loops"].values()
    norms = [one["norm"] for one in (ideal, coded)]
    change = f", {norms[1] / norms[0] - 1:+.1e}" if all(norms) else ""
    words = [f"{norm:.7g}" if norm is not None else "infinite" for norm in norms]
    rows.append(("norm as implemented", words[0], words[1] + change))
    if ideal["promises"]:
        rows.append(("promises kept", *(f"{one['kept']} of {one['promises']}" for one in (ideal, coded))))
    effect = about["rounding"]
    if effect is None:
        return [*table(rows), about["why"]]
    rows += [("rounding, of a force", "0", f"{effect['rms_share']:.1e} rms"), ("", "0", f"{effect['most']:.2g} N at most")]
    return [
        *table(rows),
        "rms as a share of the force's, on roads whose velocity is white noise; the worst case for velocities up to 1 m/s",
    ]
