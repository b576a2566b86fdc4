"""Answer at the top of a report, sentence by sentence, and its overall state."""

import math
from collections.abc import Sequence

from models.common.printed import as_name, percent
from models.document.document import Statement
from models.document.text import joined, names_text
from sim.linear.dampers import is_linear
from sim.report.scope import Scope, at_most, percents
from sim.response.regime import REGIME_ENDS
from sim.runs.dampers import shortfalls
from sim.runs.report import NO_STATE
from sim.runs.run import Run
from sim.studies.validity.regime_end import RegimeEnd
from synth.controller.controller import Controller

HALF = 0.5  # of the force: where more is left out, linear claims say little of the ride


def loops(scope: Scope) -> list[Statement]:
    """Returns statements on the two loops of the page, on loops that are unstable or stable only as the ideal one, and on missed
    goals.
    """
    statements = []
    if not scope.is_ideal:
        statements.append(
            Statement(
                "Two loops are meant on this page. The ideal loop is continuous, with no limits and no computer; designs and "
                f"certificates are of it. MuJoCo runs the loop as built: {scope.implementation_text}.",
                "holds",
            )
        )
    for one in scope.controllers:
        who = as_name(one.name)
        if not one.certificate.stable and one in scope.stable:
            text = (
                f"{who} is stable as built, and UNSTABLE as the ideal loop, without its computer: it has no ideal norm and "
                "no margins."
            )
            statements.append(Statement(text, "holds"))
        elif not one.certificate.stable:
            statements.append(Statement(f"The loop of {who} is UNSTABLE, so only its bump is reported.", "ends"))
        elif one not in scope.stable:
            text = f"{who} is stable ideally and UNSTABLE as built, so only its design and its bump are reported."
            statements.append(Statement(text, "ends"))
        if broken := [promise for promise in one.specifications if not promise.holds]:
            more = f", and {len(broken) - 1} more" if len(broken) > 1 else ""
            text = f"{who} DOES NOT KEEP the goals that the vehicle file has for it: {broken[0].text}{more}."
            statements.append(Statement(text, "ends"))
    if scope.laws:
        statements.append(
            Statement(
                f"Linear analysis does not apply to {names_text(one.name for one in scope.laws)}, as "
                f"{'each' if len(scope.laws) > 1 else 'it'} is {scope.kind_of_laws}: there is no norm, bound or margin, and no "
                f"height up to which analysis is true. MuJoCo's steps and commands are checked all the same. {_reference(scope)}",
                "holds",
            )
        )
    return statements


def _reference(scope: Scope) -> str:
    """Describes the sampled response for laws to which linear analysis does not apply."""
    if scope.vehicle.dampers:
        return "There is no sampled response, because setting semi-active dampers is not linear."
    return "'Sampled' is the linear vehicle's response to the forces of the law."


def norms(scope: Scope) -> list[Statement]:
    """Returns a statement on the H-infinity norms of the ideal and of the implemented loop."""
    values = {one.name: one.certificate.norm.value for one in scope.controllers if one.certificate.stable}
    if not values:
        return []
    least = min(values, key=lambda name: values[name])
    passive = scope.designer.design("passive").certificate.norm.value
    each = ", ".join(f"{as_name(name)} {value:.4g}" for name, value in values.items())
    text = f"H-infinity norms of the ideal loop{scope.loop_qualifier}: {each}."
    if ahead := [one.name for one in scope.controllers if one.preview is not None and one.name in values]:
        text += f" That of {names_text(ahead)} is of the feedback alone, without the road ahead."
    if least != "passive" and math.isfinite(passive):
        share = values[least] / passive - 1
        change = f"{percents(share)} % {'below' if share < 0 else 'above'}"
        text += f" The least is that of {as_name(least)}, {change} the passive suspension's."
    if scope.built_norms:
        built = ", ".join(f"{as_name(name)} {value.value:.4g}" for name, value in scope.built_norms.items())
        text += f" As built{scope.noise_qualifier}, at a step of {1e3 * scope.timestep:g} ms: {built}."
    return [Statement(text, "holds")]


def over_the_bump(scope: Scope, runs: Sequence[Run]) -> list[Statement]:
    """Returns statements on the agreement of runs over the road, and on how long linear analysis applies to each."""
    built = "" if scope.is_ideal else " of the loop as built"
    which, statements = f"{scope.analysis}{built}", []
    right = [run for run in runs if run.agreement.agrees]
    linear = [run for run in right if run.prediction.is_linear]
    if right:
        names = names_text(run.controller.name for run in right)
        text = f"Over {scope.where}, MuJoCo agrees with the vehicle's equations and the control laws for {names}."
        statements.append(Statement(text, "holds"))
    if throughout := [run for run in linear if math.isinf(run.agreement.until)]:
        off = at_most(max(signal.sampled for run in throughout for signal in run.agreement.signals.values()))
        names = names_text(run.controller.name for run in throughout)
        text = f"{which[0].upper()}{which[1:]} is within {off} of every peak throughout the {scope.duration:g} s for {names}."
        statements.append(Statement(text, "holds"))
    for run in linear:
        if (until := run.agreement.until) < math.inf:
            text = f"For {as_name(run.controller.name)}, {which} applies until {until:.3g} s of {scope.duration:g} s"
            statements.append(Statement(f"{text}: {what_ended(run)}.", "ends"))
    wrong = [run.controller.name for run in runs if not run.agreement.agrees]
    if wrong:
        text = f"Over {scope.where} MuJoCo DOES NOT AGREE for {names_text(wrong)}: see the lines on its runs."
        statements.append(Statement(text, "fails"))
    unbalanced = [run.controller.name for run in runs if run.energy is not None and run.energy.fails]
    if unbalanced:
        text = f"Over {scope.where} energy DOES NOT BALANCE{built} for {names_text(unbalanced)}: see the table of energy."
        statements.append(Statement(text, "fails"))
    return statements


def left_short(scope: Scope, runs: Sequence[Run]) -> list[Statement]:
    """Returns statements on the force that adjustable dampers leave out of the requests of linear controllers, and its
    consequences.
    """
    missing, most = {}, 0.0
    for run in runs:
        if isinstance(run.controller, Controller) and not is_linear(scope.vehicle, run.controller):
            share = max((one.rms for one in shortfalls(run.vehicle, run.physics).values()), default=0.0)
            if share > 0:
                missing[run.controller.name] = percent(share)
                most = max(most, share)
    if not missing:
        return []
    text = (
        f"Over {scope.where} semi-active dampers do not give this share (rms) of the requested force: "
        f"{joined([f'{share} with {as_name(name)}' for name, share in missing.items()])}. Norms, frequency responses and "
        "margins assume that every force is given, so they do not describe these rides."
    )
    return [Statement(text, "ends" if most > HALF else "holds")]


def left_out(scope: Scope) -> list[Statement]:
    """Returns a statement on the controllers of the vehicle file that are not on the page."""
    names = [name for name in scope.vehicle.controller_names if name not in {one.name for one in scope.driven}]
    return [Statement(f"Not on this page, though in the vehicle file: {names_text(names)}.", "holds")] if names else []


def what_ended(run: Run) -> str:
    """Describes the event from which linear analysis does not apply to a run."""
    one = run.agreement
    broken = "the states of the law overflow" if run.physics.ran_away else "the run diverges"
    causes = {end.happens: one.ended[end.name] for end in REGIME_ENDS} | {broken: run.diverged}
    if one.lost:
        return NO_STATE
    return next((text for text, when in causes.items() if when == one.until), "within a step, a tyre may leave the road")


def unclaimed(ends: Sequence[tuple[Controller, RegimeEnd | None]], runs: Sequence[Run]) -> list[str]:
    """Returns the controllers without a claimed height, because their runs do not agree over the road."""
    wrong = {run.controller.name for run in runs if not run.agreement.agrees}
    return [one.name for one, _ in ends if one.name in wrong]
