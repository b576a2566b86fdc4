"""Statements of a report's answer that no study makes itself: on its loops and their norms, and on claimed heights."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from models.common.printed import as_name
from models.document.document import Statement
from models.document.document import statements as statements_on
from models.document.text import names_text
from sim.report.scope import Scope
from sim.runs.run import Run
from sim.studies.validity.regime_end import RegimeEnd
from synth.controller.controller import Controller
from synth.controller.report import study_notes


def loops(scope: Scope) -> list[Statement]:
    """Returns statements on the two loops, on unstable ones, on missed goals, and on laws without linear analysis."""
    statements = []
    if not scope.is_ideal:
        text = f"Designs and certificates describe the ideal loop. MuJoCo runs the loop as built: {scope.implementation_text}."
        statements.append(Statement(text, "holds"))
    for one in scope.controllers:
        who, stable = f"The loop of {as_name(one.name)}", one in scope.stable
        if not one.certificate.stable:
            ideal = "is stable as built and UNSTABLE as the ideal loop, so it has no ideal norm and no margins"
            text = ideal if stable else "is UNSTABLE, so only its run is reported"
            statements.append(Statement(f"{who} {text}.", "holds" if stable else "ends"))
        elif not stable:
            text = f"{who} is stable ideally and UNSTABLE as built, so only its design and its run are reported."
            statements.append(Statement(text, "ends"))
        if broken := [promise for promise in one.specifications if not promise.holds]:
            more = f", and {len(broken) - 1} more" if len(broken) > 1 else ""
            text = f"{as_name(one.name)} DOES NOT KEEP the goals of the vehicle file: {broken[0].text}{more}."
            statements.append(Statement(text, "ends"))
    studied = [(one.name, f"{text}.") for one in scope.driven for text in study_notes(scope.vehicle, one)]
    statements += [replace(one, state="holds") for one in statements_on(studied)]
    if scope.laws:
        names = names_text(one.name for one in scope.laws)
        text = f"Linear analysis does not apply to {names} ({scope.kind_of_laws}), so that there is no norm, bound or margin."
        statements.append(Statement(text, "holds"))
    return statements


def norms(scope: Scope) -> list[Statement]:
    """Returns a statement on the H-infinity norms of the ideal and of the implemented loop."""
    ideal = {one.name: one.certificate.norm.value for one in scope.controllers if math.isfinite(one.certificate.norm.value)}
    if not ideal:
        return []
    text = f"H-infinity norms of the ideal loop{scope.loop_qualifier}: {_listed(ideal)}."
    if ahead := [one.name for one in scope.controllers if one.preview is not None and one.name in ideal]:
        text += f" That of {names_text(ahead)} is of the feedback alone, without the road ahead."
    if scope.built_norms:
        built = _listed({name: norm.value for name, norm in scope.built_norms.items()})
        text += f" As built{scope.noise_qualifier}, at a step of {1e3 * scope.timestep:g} ms: {built}."
    return [Statement(text, "holds")]


def _listed(norms: Mapping[str, float]) -> str:
    return ", ".join(f"{as_name(name)} {value:.4g}" for name, value in norms.items())


def left_out(scope: Scope) -> list[Statement]:
    """Returns a statement on the controllers of the vehicle file that are not on the page."""
    names = [name for name in scope.vehicle.controller_names if name not in {one.name for one in scope.driven}]
    return [Statement(f"Not on this page, though in the vehicle file: {names_text(names)}.", "holds")] if names else []


def unclaimed(ends: Sequence[tuple[Controller, RegimeEnd | None]], runs: Sequence[Run]) -> list[str]:
    """Returns the controllers without a claimed height, because their runs do not agree over the road."""
    wrong = {run.controller.name for run in runs if not run.agreement.agrees}
    return [one.name for one, _ in ends if one.name in wrong]
