"""Runs in words and numbers: the table on the terminal, the object for `--json`, the text and events in the logs."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from models.common.printed import cell, finite, json_object, percent, table, wrapped
from models.kinds.kind import MOST_SQUEEZE
from models.laws.python_law import Programmed
from models.laws.semi_active import SemiActive
from models.vehicle.vehicle import Vehicle
from sim.physics.energy import Energy
from sim.response.regime import (
    BUMP_STOP,
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
from sim.runs.agreement import COARSEST, PARTS, SLACK, SMALL, Agreement
from sim.runs.code_effect import code_object
from sim.runs.run import Reference, Run
from sim.runs.steps import StepAgreement
from synth.controller.controller import Controller, Driver, has_anti_windup
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
    return numbers | {"balances": energy.balances}


def energy_lines(run: Run) -> list[str]:
    """Returns a run's energy balance in a sentence; empty if it is not known."""
    energy = run.energy
    if energy is None:
        return []
    of = f"{energy.residual:.1e} of the {energy.turnover:.4g} J turned over"
    if energy.least is not None and energy.least < 0 and not energy.balances:
        return [f"energy DOES NOT BALANCE: an adjustable damper gave energy, {-energy.least:.1e} of the most that it took"]
    if energy.balances:
        sources = "road and actuators" if energy.loads is None else "road, loads and actuators"
        return [f"energy balances: the work of {sources} is stored or dissipated, all but {of}"]
    if run.physics.ran_away:
        return [f"energy is not judged: {of} is neither stored nor dissipated, with forces that the overflowing law throws about"]
    why = "a force does work that is none of the vehicle's, or the timestep is too coarse"
    return [f"energy DOES NOT BALANCE: {of} is neither stored nor dissipated, where {energy.allowed:.0e} is allowed: {why}"]


NO_CLAIM = "no linear claim: {kind}"
NO_CLAIM_OF_SWITCHING = "no linear claim: a law that sets adjustable dampers"
LOST = "beyond its equations"
NO_STATE = "a strut has no length left, or the body lies over"
NOT_GEOMETRY = 0.01  # share of a difference; a sentence leaves out smaller parts
STEP_BY_STEP = ", and step by step "
STEPS_TOO = f"{STEP_BY_STEP}throughout"
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
                    "geometry": None if signal.geometry is None else finite(signal.geometry),
                },
            }
            for name, signal in agreement.signals.items()
        },
        "until": finite(agreement.until),
        "lift_off": [list(interval) for interval in agreement.lift_off],
        "agrees": agreement.agrees,
        "steps": steps_object(agreement.steps),
        **_stops_object(run),
        **_dampers_object(run),
        **code_object(run.prediction.code_effect),
        **_margins_object(run),
    } | ({"energy": energy_object(run.energy)} if run.energy is not None else {})


def steps_object(steps: StepAgreement | None) -> dict[str, float | bool | None] | None:
    """Returns the comparison of single steps as a JSON object, or None for a vehicle type without exact equations."""
    if steps is None:
        return None
    return {"agrees": steps.agrees, **{name: finite(getattr(steps, name)) for name in ("error", "allowed", "since", "until")}}


def _margins_object(run: Run) -> dict[str, Any]:
    """Returns the windup and the small margins of a linear law as a JSON object; empty for any other driver."""
    one = run.controller
    return {"margins": law_margins(run.vehicle, one).record} if isinstance(one, Controller) else {}


def _stops_object(run: Run) -> dict[str, Any]:
    """Returns how far each bump stop is compressed under their own key; empty without stops."""
    if not run.vehicle.limits.stopped:
        return {}
    from sim.runs.stops import stops_object

    return {"stops": stops_object(run)}


def _stop_names(run: Run, when: float) -> str:
    """Returns the name of the stops that a run reaches at a time [s]."""
    from sim.runs.stops import stop_names

    return stop_names(run, when)


def _dampers_object(run: Run) -> dict[str, Any]:
    """Returns the results of adjustable dampers under their own key; empty without such dampers."""
    if not run.vehicle.dampers:
        return {}
    from sim.runs.dampers import dampers_object

    return {"dampers": dampers_object(run.prediction, run.physics)}


def half_step_object(run: Run) -> dict[str, Any] | None:
    """Returns the change by half the step after a lift-off as a JSON object, or None if it is unknown."""
    half_step = run.half_step
    return {"difference": finite(half_step.difference), "signal": half_step.signal} if half_step else None


def controller_object(controller: Driver) -> dict[str, Any]:
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


def controller_lines(vehicle: Vehicle, controller: Driver) -> list[str]:
    """Returns lines on a controller and its claims."""
    if not isinstance(controller, Controller):
        heading = [f"controller {controller.name}: measures {', '.join(controller.measured)}", f"  {controller.text}"]
    else:
        heading = heading_lines(controller)
    return [*heading, *(f"  {sentence}" for sentence in _found(vehicle, controller))]


def claims(controller: Driver) -> str:
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


def _found(vehicle: Vehicle, controller: Driver) -> list[str]:
    """Returns sentences on a controller beside its gain."""
    if isinstance(controller, SemiActive):
        return [NO_CLAIM_OF_SWITCHING, "sampled and continuous are the exact response of the system that it switches at samples"]
    if not isinstance(controller, Controller):
        what = "with the coefficients" if vehicle.dampers else "under the forces"
        return [
            NO_CLAIM.format(kind=controller.kind),
            f"sampled and continuous are the linear vehicle's {what} that the law asked for",
        ]
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
    """Returns the verdict on physics against analysis, and the energy balance, in a few words."""
    agreement = run.agreement
    if math.isfinite(agreement.until):
        ended = [name for name, when in agreement.ended.items() if when == agreement.until]
        ended = [_stop_names(run, agreement.until) if name == BUMP_STOP.name else name for name in ended]
        other = LOST if agreement.lost else broken_by(run.physics) if run.diverged == agreement.until else LIFT_OFF.name
        why = ended or [other]
        when = f"until {agreement.until:.4g} s ({' and '.join(why)})"
    else:
        why, when = [], "throughout"
    order = " to first order" if any(signal.small is not None for signal in agreement.signals.values()) else ""
    words = f"agrees{order} {when}" if agreement.agrees else f"DOES NOT AGREE {when}"
    if agreement.agrees and agreement.steps is not None and agreement.steps.until > agreement.until:
        words += f"{STEP_BY_STEP}{_end(agreement.steps)}"
    elif not agreement.step_by_step:
        words = "DOES NOT AGREE step by step"
    if agreement.until <= 0:
        words = f"NOTHING COMPARED: it ended at once ({' and '.join(why)})"
    if run.physics.ran_away and not run.passed:
        return f"LAW OVERFLOW at {run.diverged:.4g} s: rounding decides the forces of this law; the physics is not judged"
    if run.energy is not None:
        words += f"; energy {'balances' if run.energy.balances else 'DOES NOT BALANCE'}"
    later = run.physics.ran_away and run.diverged > agreement.until
    return f"{words}; {LAW_OVERFLOW} at {run.diverged:.4g} s" if later else words


def summary_lines(runs: Sequence[Run], short: bool = False) -> list[str]:
    """Returns the verdict on every run, a line each; runs of more than `FEW` controllers with the same verdict share a line.

    Args:
        short: True for shared lines without what is the same of all good runs: that single steps agree and energy balances.
    """
    width = max(len(run.controller.name) for run in runs)
    verdicts = [(run.controller.name, f"{_unstable(run)}{verdict(run)}") for run in runs]
    if short:
        verdicts = [(name, words.removesuffix("; energy balances").replace(STEPS_TOO, "")) for name, words in verdicts]
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
    """Returns the times at which tyres are off the road, or, if they are many, their number and total duration."""
    if len(lift_off) > MOST_FLIGHTS:
        longest = max(end - start for start, end in lift_off)
        start, end = lift_off[0]
        return [
            f"lift-off: {len(lift_off)} times a tyre is off the road, first from {start:.4g} s to {end:.4g} s "
            f"({end - start:.3g} s), for {longest:.3g} s at most"
        ]
    return [
        f"lift-off: a tyre is off the road from {start:.4g} s to {end:.4g} s ({end - start:.3g} s)" for start, end in lift_off
    ]


def verdict_lines(run: Run) -> list[str]:
    """Returns the verdict on physics against analysis in sentences."""
    agreement, blur, lines = run.agreement, run.prediction.blur_text, []
    noise = run.vehicle.implementation.noise_text
    if run.prediction.radius > 1:
        lines.append(f"unstable: the sampled loop grows by a factor of {run.prediction.radius:.6g} every step")
    elif run.prediction.radius == 1:
        lines.append("marginal: to rounding, something in the sampled loop neither grows nor decays")
    if run.physics.ran_away:
        lines.append(f"{LAW_OVERFLOW}: {RAN_AWAY.format(when=run.diverged)}")
    elif math.isfinite(run.diverged):
        lines.append(f"diverged: MuJoCo was stopped at {run.diverged:.4g} s; there is no vehicle any more")
    lines += _flights(agreement.lift_off)
    if run.half_step is not None and math.isfinite(run.half_step.difference):
        size, signal = run.half_step.difference, run.half_step.signal
        lines.append(
            f"after lift-off the physics is good to about {size:.1e} of a peak: half the step changes {signal} by so much"
        )
    elif run.half_step is not None:
        lines.append("after lift-off the physics is good for nothing: at half the step it diverges")
    elif agreement.lift_off and agreement.blurred:
        lines.append(f"how good the physics is after lift-off is not said: at half the step its {blur} would be another")
    times = agreement.ended
    said = {end: end.verdict for end in REGIME_ENDS if end.verdict}
    if run.vehicle.limits.actuator_bandwidth is not None and has_anti_windup(run.controller):
        said[SATURATION] = DEMAND_CLIPPED
    if math.isfinite(when := times[BUMP_STOP.name]):
        said[BUMP_STOP] = said[BUMP_STOP].replace(BUMP_STOP.name, _stop_names(run, when), 1)
    lines += [line.format(when=times[end.name]) for end, line in said.items() if math.isfinite(times[end.name])]
    if run.vehicle.limits.stopped:
        from sim.runs.stops import run_stop_lines

        lines += run_stop_lines(run)
    left = departures(run.vehicle, run.physics) if math.isfinite(times[CURVE.name]) else {}
    lines += [f"{name} is off its line at rest by up to {percent(share)} of its largest force" for name, share in left.items()]
    if run.vehicle.dampers:
        from sim.runs.dampers import damper_lines

        lines += damper_lines(run.prediction, run.physics, agreement.until)
    when = "throughout"
    if times[FLAT.name] == agreement.until < math.inf:
        lines.append(
            f"flat: a tyre is squeezed by more than {MOST_SQUEEZE} m at {times[FLAT.name]:.4g} s, its hub is in the road; "
            "no model of it holds from there"
        )
    if agreement.lost:
        lines.append(f"{LOST}: from {agreement.until:.4g} s on {NO_STATE}; what MuJoCo does there is compared with nothing")
    if math.isfinite(agreement.until):
        why = (
            ""
            if agreement.lost or agreement.until in (*times.values(), run.diverged)
            else ": within a step, a tyre may leave the road there"
        )
        lines.append(f"the linear comparison does not apply from {agreement.until:.4g} s on{why}")
        when = f"until {agreement.until:.4g} s"
    if agreement.until <= 0:
        return [*lines, "NOTHING COMPARED: there is no time at which the linear comparison applies"]
    worst = max(agreement.signals, key=lambda name: agreement.signals[name].excess)
    error = agreement.signals[worst]
    difference, allowed = error.judged
    small = f"{SMALL:g} of this road's height{' and loads' * run.road.loaded}"
    where = "" if error.small is None else f" at {small}"
    numbers = f"worst {worst}, {difference:.1e} of its peak{where}; {allowed:.1e} is allowed"
    if agreement.agrees and error.small is not None:
        worst = max(agreement.signals, key=lambda name: agreement.signals[name].sampled - agreement.signals[name].allowed / SLACK)
        error = agreement.signals[worst]
        geometry = f"geometry and {blur} make" if agreement.blurred else "geometry makes"
        with_it, is_it = (f" and {noise}", "is within") if noise else ("", f"follows {_reference(run)} to")
        off = error.sampled - (0.0 if agreement.blurred else error.allowed / SLACK)
        lines.append(
            f"agrees to first order {when}: {geometry} up to {off:.1e} of a peak ({worst}); at "
            f"{small}{with_it} MuJoCo {is_it} {error.small:.1e} of it"
        )
    elif agreement.agrees and run.prediction.rounding_text:
        assert agreement.code_effect is not None, "code drives the run"
        law = f"the run with the law itself agrees with {_reference(run)}"
        lines.append(f"agrees {when}: {law}, and {agreement.code_effect.agreement}")
    elif agreement.agrees and agreement.blurred:
        lines.append(f"agrees {when}: MuJoCo stays within the spread that is predicted of its measurements' {noise} ({numbers})")
    elif agreement.agrees:
        lines.append(f"agrees {when}: MuJoCo follows {_reference(run)} to within RK4's own error ({numbers})")
    elif error.excess > 1:
        why = "; the timestep is too coarse, give a smaller one" if allowed >= COARSEST and not agreement.blurred else ""
        lines.append(f"DOES NOT AGREE {when} with {_reference(run)} ({numbers}{why})")
    if agreement.code_effect is not None:
        lines += agreement.code_effect.failures
    return [*lines, *_no_geometry(agreement), *_step_lines(run)]


def _no_geometry(agreement: Agreement) -> list[str]:
    """Returns a sentence on a difference from the linear response that is not due to geometry, if there is one."""
    rest = {name: each.sampled - each.geometry for name, each in agreement.signals.items() if each.geometry is not None}
    if agreement.agrees or not rest:
        return []
    worst = max(rest, key=lambda name: rest[name])
    signal = agreement.signals[worst]
    if rest[worst] <= NOT_GEOMETRY * signal.sampled:
        return []
    return [
        f"DOES NOT AGREE: MuJoCo is {signal.sampled:.1e} of a peak off the linear response ({worst}), where geometry makes "
        f"about {signal.geometry:.1e}"
    ]


def _step_lines(run: Run) -> list[str]:
    """Returns a sentence on single steps, if they add to the linear comparison."""
    steps, agreement = run.agreement.steps, run.agreement
    turned = any(signal.small is not None for signal in agreement.signals.values())
    if steps is None and turned:
        heights = " and ".join(f"{share:g}" for share in PARTS)
        return [
            "step by step nothing is compared, for this kind of vehicle has no `motion`: what geometry makes is foretold from "
            f"{heights} of this road's height"
        ]
    if steps is None or steps.until <= 0:
        return []
    numbers = f"{steps.error:.1e} of a peak ({steps.signal}), where {steps.allowed:.0e} is allowed"
    if not steps.agrees and run.physics.ran_away:
        return [
            f"step by step nothing is claimed from {steps.since:.4g} s on: the law's states grow, and rounding decides its forces"
        ]
    if not steps.agrees:
        return [
            f"DOES NOT AGREE step by step: from {steps.since:.4g} s on, MuJoCo's steps leave those of the vehicle's nonlinear "
            f"equations of motion by up to {numbers}"
        ]
    if steps.until <= agreement.until and not turned:
        return []
    return [
        f"agrees step by step {_end(steps)}: each step of MuJoCo is that of the vehicle's nonlinear equations of motion "
        f"to {numbers}"
    ]


def _end(steps: StepAgreement) -> str:
    """Returns the time until which single steps are compared, in words."""
    return f"until {steps.until:.4g} s" if math.isfinite(steps.until) else "throughout"


def _reference(run: Run) -> str:
    """Describes the reference of the physics."""
    if isinstance(run.controller, Programmed):
        return "the exact linear response to the forces of the law"
    return "the exact sampled response"


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
