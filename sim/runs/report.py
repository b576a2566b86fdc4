"""Runs in words and numbers: the table on the terminal, the object for `--json`, the text and events in the logs."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from models.common.printed import cell, finite, percent, table, wrapped
from models.document.field import json_object
from models.kinds.kind import MOST_SQUEEZE
from models.laws.python_law import Programmed
from models.laws.semi_active import SemiActive
from models.vehicle.vehicle import Vehicle
from sim.physics.energy import Energy
from sim.response.regime import (
    BUMP_STOP,
    COMMAND_LIMITED,
    CURVE,
    DEMAND_CLIPPED,
    FLAT,
    LAW_OVERFLOW,
    LIFT_OFF,
    RAN_AWAY,
    REGIME_ENDS,
    SATURATION,
    broken_by,
    departures,
)
from sim.runs.agreement import COARSEST, NO_REFERENCE, SMALL, Agreement
from sim.runs.code_effect import code_object
from sim.runs.commands import CommandAgreement
from sim.runs.run import Reference, Run
from sim.runs.steps import StepAgreement
from synth.controller.controller import AnyController, Controller, has_anti_windup
from synth.controller.law_margins import law_margins
from synth.controller.report import (
    BOUND,
    NORM,
    PEAK,
    failures_of_sampled_loop,
    filter_lines,
    growth_lines,
    growth_object,
    heading_lines,
    ideal_lines,
    norm_if_implemented,
    notes,
    notes_on_sampled_loop,
)


def energy_object(energy: Energy) -> dict[str, float | bool | None]:
    """Returns an energy balance for JSON [J]; its residual is a share of `turnover`."""
    numbers = {
        name: finite(value) for name, value in asdict(energy).items() if name not in ("least", "loads") or value is not None
    }
    return numbers | {"balances": energy.balances if energy.judged else None}


def energy_lines(run: Run) -> list[str]:
    """Returns a run's energy balance in a sentence; empty if it is not known."""
    energy = run.energy
    if energy is None:
        return []
    of = f"{energy.residual:.1e} of the {energy.turnover:.4g} J turned over"
    if energy.least is not None and energy.least < 0 and energy.fails:
        return [f"energy DOES NOT BALANCE: a semi-active damper supplied energy, {-energy.least:.1e} of the most that it took"]
    if energy.balances:
        sources = "road and actuators" if energy.loads is None else "road, loads and actuators"
        return [f"energy balances: the work of {sources} is stored or dissipated, except {of}"]
    if not energy.judged:
        return [f"energy is not evaluated, because the timestep is too coarse: {of} is neither stored nor dissipated"]
    if run.physics.ran_away:
        return [f"energy is not evaluated, because the law overflows: {of} is neither stored nor dissipated"]
    why = "the timestep is too coarse, or MuJoCo applies a force that the vehicle does not have"
    return [f"energy DOES NOT BALANCE: {of} is neither stored nor dissipated, allowed {energy.allowed:.0e}: {why}"]


NO_CLAIM = "no linear claim: {kind}"
NO_CLAIM_OF_SWITCHING = "no linear claim: a law that sets semi-active dampers"
LOST = "beyond its equations"
NO_STATE = "a strut is shorter than 0.1 m, or the body turns by more than 29 degrees"
FEW = 3  # controllers with a line of their own; from more on, the answer would not fit a terminal
WHEN = re.compile(r"(until|at) ([\d.e+-]+) s\b")
MOST_FLIGHTS = 4  # flights of a run that are listed one by one


@np.errstate(over="ignore")  # an unstable loop's squares overflow; infinite values are None
def run_object(run: Run) -> dict[str, Any]:
    """Returns a run as a JSON object: SI units, None for infinite or missing values."""
    responses = {"mujoco": run.physics, "sampled": run.sampled, "continuous": run.continuous}
    agreement = run.agreement
    return {
        "controller": controller_object(run.controller),
        "signals": {
            name: {
                "unit": run.vehicle.kind.signal(name).unit,
                "peak": {key: finite(response.peak(name)) for key, response in responses.items()},
                "rms": {key: finite(response.rms(name)) for key, response in responses.items()},
                "error": {
                    "sampled": finite(signal.sampled),
                    "continuous": finite(signal.continuous),
                },
            }
            for name, signal in agreement.signals.items()
        },
        "until": finite(agreement.until),
        "lift_off": [list(interval) for interval in agreement.lift_off],
        "agrees": agreement.agrees,
        "steps": steps_object(agreement.steps),
        "commands": commands_object(agreement.commands),
        "cause": agreement.cause,
        **_parts_object(run),
        **code_object(run.prediction.code_effect),
        **({"margins": law_margins(run.vehicle, run.controller).record} if isinstance(run.controller, Controller) else {}),
        **({"energy": energy_object(run.energy)} if run.energy is not None else {}),
    }


def steps_object(steps: StepAgreement | None) -> dict[str, float | bool | None] | None:
    """Returns the comparison of single steps as a JSON object, or None for a vehicle type without exact equations."""
    if steps is None:
        return None
    return {"agrees": steps.agrees, **{name: finite(getattr(steps, name)) for name in ("error", "allowed", "since", "until")}}


def commands_object(commands: CommandAgreement | None) -> dict[str, float | bool | None] | None:
    """Returns the comparison of commands with the control law as a JSON object, or None if the law is not known."""
    if commands is None:
        return None
    numbers = {name: finite(getattr(commands, name)) for name in ("error", "allowed", "since")}
    return {"agrees": commands.agrees, "repeatable": commands.repeatable, **numbers}


def _parts_object(run: Run) -> dict[str, Any]:
    """Returns the results of bump stops and semi-active dampers, each under its own key; empty without such parts."""
    parts = {}
    if run.vehicle.limits.stopped:
        from sim.runs.stops import stops_object

        parts["stops"] = stops_object(run)
    if run.vehicle.dampers:
        from sim.runs.dampers import dampers_object

        parts["dampers"] = dampers_object(run.vehicle, run.physics)
    return parts


def half_step_object(run: Run) -> dict[str, Any] | None:
    """Returns the change by half the step after a lift-off as a JSON object, or None if it is unknown."""
    half_step = run.half_step
    return {"difference": finite(half_step.difference), "signal": half_step.signal} if half_step else None


def controller_object(controller: AnyController) -> dict[str, Any]:
    """Returns a controller for JSON; the linear claims of a law in Python are None."""
    if not isinstance(controller, Controller):
        return controller.record | dict.fromkeys(("bound", "norm", "peak_frequency", "stability"))
    certificate = controller.certificate
    return {
        **controller.record,
        **json_object((BOUND, NORM, PEAK), certificate),
        "stability": certificate.stability.verdict,
        **growth_object(controller),
    }


def controller_lines(vehicle: Vehicle, controller: AnyController) -> list[str]:
    """Returns lines on a controller and its claims."""
    if not isinstance(controller, Controller):
        heading = [f"controller {controller.name}: measures {', '.join(controller.measured)}", f"  {controller.text}"]
    else:
        heading = heading_lines(controller)
    return [*heading, *(f"  {sentence}" for sentence in _found(vehicle, controller))]


def claims(controller: AnyController) -> str:
    """Returns norm and bound of a controller in a line, or why it has none."""
    if isinstance(controller, SemiActive):
        return NO_CLAIM_OF_SWITCHING
    if not isinstance(controller, Controller):
        return NO_CLAIM.format(kind=controller.kind)
    certificate, norm = controller.certificate, controller.certificate.norm
    if not certificate.stable:
        return f"ideal loop {certificate.own.words}"
    where = f" at {norm.peak_frequency:.5g} rad/s" if math.isfinite(norm.peak_frequency) else ""
    alone = ", of its feedback alone" if controller.preview is not None else ""
    return f"norm {norm.value:.7g}{where}{f', bound {certificate.bound:.7g}' if certificate.bound is not None else ''}{alone}"


def _found(vehicle: Vehicle, controller: AnyController) -> list[str]:
    """Returns sentences on a controller beside its gain."""
    if isinstance(controller, SemiActive):
        return [NO_CLAIM_OF_SWITCHING]
    if not isinstance(controller, Controller):
        forced = ["sampled and continuous are the linear responses to the forces that the law requested"]
        return [NO_CLAIM.format(kind=controller.kind), *forced[: not vehicle.dampers]]
    certificate = controller.certificate
    norm, lines = certificate.norm, []
    built = None if certificate.stable else norm_if_implemented(vehicle, controller)
    if certificate.stable:
        proof = f"bound {certificate.bound:.7g}, " if certificate.bound is not None else ""
        where = f" at {norm.peak_frequency:.5g} rad/s" if math.isfinite(norm.peak_frequency) else ""
        lines += [f"{proof}norm {norm.value:.7g}{where}", certificate.own.words]
    return [
        *lines,
        *ideal_lines(vehicle, [controller]),
        *filter_lines(vehicle),
        *growth_lines(vehicle, controller),
        *notes(controller),
        *certificate.remarks,
        *notes_on_sampled_loop(vehicle, certificate, built),
        *failures_of_sampled_loop(vehicle, certificate, certificate.failures, built),
    ]


def verdict(run: Run) -> str:
    """Returns the verdict on physics, the range of linear analysis, and the energy balance, in a few words."""
    agreement, words = run.agreement, []
    if run.physics.ran_away and not run.passed:
        return f"LAW OVERFLOW at {run.diverged:.4g} s: rounding decides the forces of this law; the run is not evaluated"
    if not agreement.step_by_step and agreement.steps is not None:
        words.append(f"DOES NOT AGREE step by step from {agreement.steps.since:.4g} s on ({agreement.steps.signal})")
    if not agreement.commanded and agreement.commands is not None:
        words.append(f"COMMANDS ARE NOT THE LAW'S from {agreement.commands.since:.4g} s on ({agreement.commands.signal})")
    if agreement.code_effect is not None and not agreement.code_effect.holds:
        words.append("DOES NOT AGREE with the law of its code")
    if not agreement.follows_linear:
        words.append(f"DOES NOT AGREE with linear analysis {_when(run)}")
    if not words and not agreement.agrees:
        words.append("NOTHING COMPARED")
    if not words:
        words += ["agrees", f"linear analysis applies {_when(run)}" if run.prediction.is_linear else NO_REFERENCE]
    if agreement.coarse or (run.energy is not None and not run.energy.judged):
        words.append("the timestep is too coarse for accurate numbers")
    if run.energy is not None:
        words.append(f"energy {run.energy.verdict}")
    if run.broke_off is not None and not run.prediction.is_linear:
        words.append("{} at {:.4g} s".format(*run.broke_off))
    elif run.physics.ran_away and run.diverged > agreement.until:
        words.append(f"{LAW_OVERFLOW} at {run.diverged:.4g} s")
    return "; ".join(words)


def _when(run: Run) -> str:
    """Returns the time until which linear analysis applies, and what ends it."""
    agreement = run.agreement
    if not math.isfinite(agreement.until):
        return "throughout"
    ended = [name for name, when in agreement.ended.items() if when == agreement.until]
    if BUMP_STOP.name in ended:
        from sim.runs.stops import stop_names

        ended[ended.index(BUMP_STOP.name)] = stop_names(run, agreement.until)
    other = LOST if agreement.lost else broken_by(run.physics) if run.diverged == agreement.until else LIFT_OFF.name
    return f"until {agreement.until:.4g} s ({' and '.join(ended or [other])})"


def summary_lines(runs: Sequence[Run], short: bool = False) -> list[str]:
    """Returns the verdict on every run, a line each; runs of more than `FEW` controllers with the same verdict share a line.

    Args:
        short: True for shared lines without what is the same of all good runs: that single steps agree and energy balances.
    """
    width = max(len(run.controller.name) for run in runs)
    verdicts = [(run.controller.name, f"{_unstable(run)}{verdict(run)}") for run in runs]
    if short:
        verdicts = [(name, words.removesuffix("; energy balances")) for name, words in verdicts]
        return [
            *shared_lines(verdicts),
            *["energy balances in every run"] * all(run.energy and run.energy.balances for run in runs),
        ]
    if len(runs) <= FEW:
        return [line for name, words in verdicts for line in wrapped(words, f"{name:{width}}  ", 4)]
    return shared_lines(verdicts)


def _unstable(run: Run) -> str:
    """Returns the words before the verdict on a run whose loop is unstable or marginal, else an empty text."""
    radius = run.prediction.radius
    return "UNSTABLE loop; " if radius > 1 else "marginal loop; " if radius == 1 else ""


def shared_lines(said: Iterable[tuple[str, str]]) -> list[str]:
    """Returns sentences about several controllers; controllers with the same sentence share a line, with the span of times.

    Args:
        said: names with what is said of each.
    """
    alike: dict[str, list[tuple[str, list[str]]]] = {}
    for name, words in said:
        alike.setdefault(WHEN.sub(r"\1 ... s", words), []).append((name, [when for _, when in WHEN.findall(words)]))
    lines = []
    for words, some in alike.items():
        for times in zip(*(times for _, times in some), strict=True):
            first, last = min(times, key=float), max(times, key=float)
            words = words.replace("... s", f"{first} s" if first == last else f"{first} to {last} s", 1)
        lines += wrapped(f"{joined_names([name for name, _ in some])}: {words}", hang=4)
    return lines


def joined_names(names: Sequence[str]) -> str:
    """Returns the names of runs on a line; those of several vehicles, `VEHICLE:CONTROLLER`, by vehicle."""
    by_vehicle: dict[str, list[str]] = {}
    for name in names:
        vehicle, _, controller = name.rpartition(":")
        by_vehicle.setdefault(vehicle, []).append(controller.replace(", no", " without"))
    return "; ".join(f"{f'{vehicle}: ' if vehicle else ''}{', '.join(some)}" for vehicle, some in by_vehicle.items())


def _flights(lift_off: Sequence[tuple[float, float]]) -> list[str]:
    """Returns the times at which tyres are off the road, or, if they are many, their number and the longest."""
    spans = [f"from {start:.4g} s to {end:.4g} s ({end - start:.3g} s)" for start, end in lift_off]
    if len(lift_off) > MOST_FLIGHTS:
        longest = max(end - start for start, end in lift_off)
        return [f"lift-off: a tyre leaves the road {len(lift_off)} times, first {spans[0]}; the longest takes {longest:.3g} s"]
    return [f"lift-off: a tyre is off the road {span}" for span in spans]


def verdict_lines(run: Run) -> list[str]:
    """Returns the events of a run, its two checks, and its distance from linear analysis, a sentence each."""
    if run.physics.ran_away and not run.passed:  # rounding decides the forces of the law
        return _event_lines(run)
    return [*_event_lines(run), *_check_lines(run), *_linear_lines(run)]


def _event_lines(run: Run) -> list[str]:
    """Returns sentences on what happens in a run: instability, lift-offs, limits."""
    agreement, lines, radius, vehicle = run.agreement, list[str](), run.prediction.radius, run.vehicle
    if radius > 1:
        lines.append(f"unstable: the sampled loop grows by a factor of {radius:.6g} every step")
    elif radius == 1:
        lines.append("marginal: a mode of the sampled loop neither grows nor decays, to rounding")
    if run.physics.ran_away:
        lines.append(f"{LAW_OVERFLOW}: {RAN_AWAY.format(when=run.diverged)}")
    elif math.isfinite(run.diverged):
        lines.append(f"diverged: MuJoCo was stopped at {run.diverged:.4g} s")
    lines += _flights(agreement.lift_off)
    if run.half_step is not None:
        size, signal = run.half_step.difference, run.half_step.signal
        change = f"{signal} changes by {size:.1e} of its peak" if math.isfinite(size) else "the run diverges"
        lines.append(f"accuracy after the lift-off: at half the timestep, {change}")
    elif agreement.lift_off and run.prediction.is_blurred and run.broke_off is None:
        lines.append(f"accuracy after the lift-off: unknown, as {vehicle.implementation.noise_text} differs at half the timestep")
    times = agreement.ended
    said = {end: end.verdict for end in REGIME_ENDS if end.verdict}
    if vehicle.limits.actuator_bandwidth is not None and has_anti_windup(run.controller):
        said[SATURATION] = DEMAND_CLIPPED
    elif vehicle.limits.actuator_bandwidth is not None and vehicle.limits.limits_commands:
        said[SATURATION] = COMMAND_LIMITED
    stops: list[str] = []
    if vehicle.limits.stopped:
        from sim.runs.stops import run_stop_lines, stop_names

        stops = run_stop_lines(run)
        if math.isfinite(when := times[BUMP_STOP.name]):
            said[BUMP_STOP] = said[BUMP_STOP].replace(BUMP_STOP.name, stop_names(run, when), 1)
    lines += [line.format(when=times[end.name]) for end, line in said.items() if math.isfinite(times[end.name])]
    lines += stops
    left = departures(vehicle, run.physics) if math.isfinite(times[CURVE.name]) else {}
    lines += [f"{name} differs from its linearisation by up to {percent(one)} of its largest force" for name, one in left.items()]
    if vehicle.dampers:
        from sim.runs.dampers import damper_lines

        lines += damper_lines(vehicle, run.physics)
    if times[FLAT.name] == agreement.until < math.inf:
        when = f"{agreement.until:.4g} s; no later step is compared"
        lines.append(f"flat: a tyre is compressed by more than {MOST_SQUEEZE} m at {when}")
    if agreement.lost:
        lines.append(f"{LOST}: from {agreement.until:.4g} s on, {NO_STATE}; no later step is compared")
    return lines


def _check_lines(run: Run) -> list[str]:
    """Returns a sentence on each of the two checks: steps against equations, and commands against the control law."""
    agreement, lines = run.agreement, []
    steps, commands, code = agreement.steps, agreement.commands, agreement.code_effect
    if steps is None:
        first_order = "; the run is compared to first order" if _first_order(agreement) else ""
        lines.append(f"no step is compared, because this vehicle type has no equations of motion (`motion`){first_order}")
    elif steps.until > 0:
        verb = "every MuJoCo step" if steps.agrees else f"DOES NOT AGREE from {steps.since:.4g} s on: not every MuJoCo step"
        end = f", until {steps.until:.4g} s" if math.isfinite(steps.until) else ""
        what = f"equals one RK4 step of the vehicle's equations of motion from the same state{end}"
        lines.append(f"{verb} {what}: {_largest(steps)}")
    if commands is not None and not commands.repeatable:
        lines.append("no command is compared: the control law is not repeatable, as its answers to the same measurements differ")
    elif commands is not None:
        verb = "every command" if commands.agrees else "COMMANDS ARE NOT THE LAW'S: not every command"
        lines.append(f"{verb} equals the control law evaluated on the run's measurements: {_largest(commands)}")
    return lines + (code.failures if code is not None else [])


def _largest(one: StepAgreement | CommandAgreement) -> str:
    """Returns the largest error of a check, in words."""
    error = f"{one.error:.1e}" if one.error else "0"
    return f"largest error {error} of a peak ({one.signal}), allowed {one.allowed:.0e}"


def _first_order(agreement: Agreement) -> bool:
    """Returns True if the run was repeated at a share of its road's height."""
    return any(signal.small is not None for signal in agreement.signals.values())


def _linear_lines(run: Run) -> list[str]:
    """Returns sentences on the distance from linear analysis, and its cause."""
    agreement, signals = run.agreement, run.agreement.signals
    if not run.prediction.is_linear:
        return [f"{NO_REFERENCE}: setting semi-active dampers is not linear, even at small amplitudes"]
    if agreement.until <= 0:
        return [f"linear analysis applies {_when(run)}: nothing is compared with it"]
    wrong = [name for name, signal in signals.items() if not signal.agrees]
    worst = max(wrong or signals, key=lambda name: signals[name].excess if wrong else signals[name].sampled)
    signal = signals[worst]
    what = "the exact linear response to the forces of the law" if isinstance(run.controller, Programmed) else "linear analysis"
    small = ""
    if signal.small is not None:
        small = f", and {signal.small:.1e} at {SMALL:g} of this road's height{' and loads' * run.road.loaded}"
    if wrong:
        size = f"{signal.sampled:.1e} of a peak{small} ({worst}), allowed {signal.allowed:.1e}"
        lines = [f"DOES NOT AGREE with {what} {_when(run)}: the largest difference is {size}"]
    else:
        size = f"{signal.sampled:.1e} of every peak{small} {_when(run)}"
        lines = [f"{what} is within {size}; the cause is {agreement.cause} (worst: {worst})"]
    if agreement.coarse:
        lines.append(f"the timestep is too coarse: RK4's own error is more than {percent(COARSEST)} of a peak; use a smaller one")
    return lines


@np.errstate(over="ignore")
def run_lines(run: Run, passive: Run | Reference | None) -> list[str]:
    """Returns the table of a run: peak and rms of every signal in physics and sampled, errors, and the change against passive."""
    rows: list[tuple[str, ...] | str] = [("signal", "MuJoCo", "sampled", "continuous", "error", "to cont.", "vs passive")]
    if math.isfinite(run.agreement.until):
        rows.append(f"(error and to cont.: until {run.agreement.until:.4g} s; peak and rms: of the whole run)")
    for name, signal in run.agreement.signals.items():
        rows.append(f"{name} [{run.vehicle.kind.signal(name).unit}]")
        # A signal that symmetry keeps at zero, or any signal on a flat road, is rounding in the physics without control.
        silent = passive is not None and (
            float(passive.physics.peak(name)) < passive.physics.scale(name) or not passive.sampled.peak(name)
        )
        for kind in ("peak", "rms"):
            values = [float(getattr(response, kind)(name)) for response in (run.physics, run.sampled, run.continuous)]
            reference = float(getattr(passive.physics, kind)(name)) if passive else 0.0
            change = cell(100 * (values[0] / reference - 1), "+.1f", " %") if reference and not silent else "-"
            errors = (cell(signal.sampled, ".1e"), cell(signal.continuous, ".1e")) if kind == "peak" else ("", "")
            # After MuJoCo's numbers overflow, the linear response no longer describes the vehicle.
            numbers = ("-" if math.isfinite(run.diverged) else cell(value, ".6g") for value in values)
            rows.append((f"  {kind}", *numbers, *errors, change))
    return table(rows)


def events(run: Run) -> tuple[tuple[float, str], ...]:
    """Returns lift-offs, landings, the first bump stop and saturation, divergence and overflow, by time [s]."""
    happened = [(start, LIFT_OFF.event) for start, _ in run.agreement.lift_off]
    happened += [(end, "landing") for _, end in run.agreement.lift_off]
    if math.isfinite(run.diverged):
        happened.append((run.diverged, LAW_OVERFLOW if run.physics.ran_away else "diverged"))
    others = [(run.agreement.ended[end.name], end.event) for end in REGIME_ENDS if end.event and end is not LIFT_OFF]
    happened += [(when, event) for when, event in others if math.isfinite(when)]
    return tuple(sorted(happened))


def summary(run: Run) -> str:
    """Returns design and verdict as Markdown."""
    lines = [f"# {run.controller.name}", ""]
    lines += [f"- {line}" for line in [run.controller.text, *_found(run.vehicle, run.controller)]]
    lines += [f"- measures {', '.join(run.controller.measured) or 'nothing'}", "", "## Verdict", ""]
    lines += [f"- {line}" for line in [*verdict_lines(run), *energy_lines(run)]]
    until = f" until {run.agreement.until:.4g} s" if math.isfinite(run.agreement.until) else ""
    lines += ["", f"| signal | peak MuJoCo | peak sampled | error{until} |", "|---|---|---|---|"]
    for name, signal in run.agreement.signals.items():
        unit = run.vehicle.kind.signal(name).unit
        physics, sampled = float(run.physics.peak(name)), float(run.sampled.peak(name))
        lines.append(f"| {name} [{unit}] | {physics:.6g} | {sampled:.6g} | {signal.sampled:.1e} |")
    return "\n".join(lines) + "\n"
