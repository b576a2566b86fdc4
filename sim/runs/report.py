"""Reports on runs: documents, and the events that logs contain. Only text and pages need this module; the module `record`
produces JSON.

`describe_run` describes, in sentences, the verdict on a run and the reasons for this verdict. Commands, reports, logs and
inspections print the sentences from `describe_run`.
"""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any

import numpy as np

from models.common.extensions import FEATURES
from models.common.printed import FEW, as_name, entry, percent
from models.document.document import Document, Statement, Table, notes
from models.document.field import Detail, Field
from models.kinds.at_wheels import ratio_notes
from models.kinds.kind import MOST_SQUEEZE
from models.vehicle.vehicle import Vehicle
from sim.drive.regime import (
    BUMP_STOP,
    COMMAND_LIMITED,
    CURVE,
    DEMAND_CLIPPED,
    FLAT,
    LAW_DIVERGED,
    LAW_OVERFLOW,
    LIFT_OFF,
    REGIME_ENDS,
    SATURATION,
    broken_by,
    departures,
)
from sim.drive.response import Response
from sim.observers.results import ALLOWED_DIFFERENCE, DIFFERENCE, JOULES, WHEN, Energy, LocalAgreement
from sim.runs.agreement import COARSEST, NO_REFERENCE, SMALL
from sim.runs.record import SIZES
from sim.runs.result import COARSE, NOT_REPEATABLE, RunResult
from synth.controller.controller import AnyController
from synth.controller.law_margins import law_margins
from synth.controller.report import (
    BOUND,
    NORM,
    PEAK,
    filter_lines,
    growth_lines,
    ideal_lines,
    named_gain,
    norm_if_implemented,
    study_notes,
)
from synth.controller.report import notes as controller_remarks

INVALID_EQUATIONS = "equations not valid"
NO_STATE = "a strut is shorter than 0.1 m, or the body turns by more than 29 degrees"
NUMBERS = re.compile(r"(until|at|off by) ([\d.e+-]+) (s\b|%)")
LEFT_OUT = re.compile(r"\.\.\.(?= (?:s\b|%))")

EXCHANGED = Field[Energy]("exchanged", attrgetter("turnover"), JOULES.form, unit="J", column="turned over [J]")
RESIDUAL = Field[Energy]("residual", attrgetter("residual"), "{:.1e}".format, column="left over")
ALLOWED = Field[Energy]("allowed", attrgetter("allowed"), "{:.1e}".format)
FAR_OFF = 100.0  # the linearised loop is unstable if its error exceeds this multiple of a peak; the error is then not printed
LENGTH = Field[float]("duration", float, ".3g", unit="s")
WHOLE = "signal, over the whole run"
CHANGE = Field[float]("change", float, "+.1f", 100.0)


def _proved(run: RunResult) -> Any:
    """Returns the controller's certificate if the loop is linear and stable, otherwise None."""
    controller: Any = run.controller
    return controller.certificate if controller.linear is not False and controller.certificate.stable else None


CHECKS: tuple[Field[RunResult], ...] = (
    Field("controller", lambda run: run.controller.name),
    NORM.of(_proved),
    PEAK.of(_proved, "at"),
    BOUND.of(_proved),
    Field("steps", lambda run: getattr(run.agreement.steps, "error", None), DIFFERENCE.form),
    Field("commands", lambda run: getattr(run.agreement.commands, "error", None), DIFFERENCE.form),
    Field("linear", lambda run: max((one.sampled for one in run.agreement.signals.values()), default=None), DIFFERENCE.form),
    RESIDUAL.of(lambda run: run.energy, "energy"),
)  # columns of `checks_table`


def line_words(run: RunResult) -> str:
    """Returns the error of the linearisation at equilibrium as text; empty for a vehicle without characteristics."""
    if not (errors := run.line_errors):
        return ""
    off = max(errors.values())
    return f"off by {percent(off)} of a peak" if off < FAR_OFF else f"off by more than {FAR_OFF:g} times a peak"


def controller_notes(vehicle: Vehicle, controller: AnyController) -> list[str]:
    """Returns one sentence each on a controller's control law, on its norm and bound, and on remarks."""
    if controller.linear is False:
        forced = ["the columns sampled and continuous are linear responses to the forces that the control law requested"]
        forced = [
            one + "; the column sampled also includes the nonlinear characteristics" * vehicle.parts.nonlinear for one in forced
        ]
        return [controller.text, claims(controller), *forced[: not vehicle.dampers]]
    certificate = controller.certificate
    built = None if certificate.stable else norm_if_implemented(vehicle, controller)
    return [
        named_gain(vehicle, controller) if controller.law.acts and not controller.law.states else controller.text,
        *([claims(controller)] if certificate.stable else []),
        *ideal_lines(vehicle, [controller]),
        *ratio_notes(vehicle.kind, vehicle.parameters),
        *filter_lines(vehicle),
        *growth_lines(vehicle, controller),
        *controller_remarks(controller),
        *certificate.remarks,
        *(
            certificate.loop_failures
            if built is None
            else FEATURES.load("norms of sampled loops").remarks_on_sampled_loop(vehicle, certificate, built)
        ),
    ]


def claims(controller: AnyController) -> str:
    """Returns the norm and the bound of a controller as text, or the reason why it has no norm and bound."""
    if controller.linear is False:
        return f"linear analysis does not apply ({controller.kind})"
    certificate = controller.certificate
    if not certificate.stable:
        return f"ideal loop {certificate.own.words}"
    if math.isinf(certificate.norm.value):
        return "no finite norm"
    where = f" at {PEAK.text(certificate.norm.peak_frequency)}" if math.isfinite(certificate.norm.peak_frequency) else ""
    bound = f", bound {BOUND.cell(certificate)}" if certificate.bound is not None else ""
    return f"norm {NORM.cell(certificate)}{where}{bound}{', without preview' * (controller.preview is not None)}"


def verdict(run: RunResult) -> Statement:
    """Returns a short verdict on a run: the checks, the range of linear analysis, and the energy balance."""
    agreement, energy, words = run.agreement, run.energy, list[str]()
    steps, commands, code = agreement.steps, agreement.commands, agreement.code_effect
    if run.physics.law_diverged and not run.passed:
        overflow = f"LAW OVERFLOW at {WHEN.text(run.diverged)}: rounding decides the forces; the run is not evaluated"
        return Statement(overflow, "fails", "brief")
    if steps is not None and not steps.agrees:
        words.append(f"MuJoCo DOES NOT AGREE with the equations of motion from {WHEN.text(steps.since)} on ({steps.signal})")
    if commands is not None and not commands.agrees:
        words.append(f"COMMANDS DO NOT AGREE with the control law from {WHEN.text(commands.since)} on ({commands.signal})")
    if code is not None and not code.agrees:
        words.append("exported code DOES NOT AGREE with the control law")
    if not agreement.follows_linear:
        words.append(f"MuJoCo DOES NOT AGREE with {run.prediction.reference} {_when(run)}")
    if not words and not agreement.agrees:
        words.append("NOTHING WAS COMPARED with the model")
    if not words:
        reference = f"{run.prediction.reference} applies {_when(run)}" if run.prediction.is_linear else NO_REFERENCE
        if run.prediction.is_linear and agreement.until <= 0:
            reference = f"there is no comparison with {run.prediction.reference}, which applies only {_when(run)}"
        words += ["MuJoCo agrees with the model", reference]
        words += [f"its linearisation at equilibrium is {off}"] if (off := line_words(run)) else []
    if commands is not None and not commands.repeatable:
        words.append("no command is compared, because the control law is not repeatable")
    if agreement.coarse or (energy is not None and not energy.judged):
        words.append(COARSE)
    if energy is not None:
        words.append(f"energy {energy.verdict}")
    if run.broke_off is not None and not run.prediction.is_linear:
        words.append(f"{run.broke_off[0]} at {WHEN.text(run.broke_off[1])}")
    elif run.physics.law_diverged and run.diverged > agreement.until:
        words.append(f"{LAW_OVERFLOW} at {WHEN.text(run.diverged)}")
    radius = run.prediction.radius
    loop = "UNSTABLE loop; " if radius > 1 else "marginal loop; " if radius == 1 else ""
    ends = radius > 1 or run.broke_off is not None or (run.prediction.is_linear and math.isfinite(agreement.until))
    return Statement(f"{loop}{'; '.join(words)}", "fails" if not run.passed else "ends" if ends else "holds", "brief")


def _when(run: RunResult) -> str:
    """Returns a text that states until which time linear analysis applies, and which event ends the validity of this analysis."""
    agreement = run.agreement
    if not math.isfinite(agreement.until):
        return "over the whole run"
    ended = [name for name, when in agreement.end_times.items() if when == agreement.until]
    if BUMP_STOP.name in ended:
        ended[ended.index(BUMP_STOP.name)] = FEATURES.load("stops that a run reaches").stop_names(run, agreement.until)
    other = (
        INVALID_EQUATIONS
        if agreement.equations_invalid
        else broken_by(run.physics)
        if run.diverged == agreement.until
        else LIFT_OFF.name
    )
    return f"until {WHEN.text(agreement.until)} ({' and '.join(ended or [other])})"


def verdicts(runs: Iterable[RunResult], where: str = "") -> tuple[Statement, ...]:
    """Returns the verdicts on runs, preceded by the text `where`. Runs with the same verdict are combined in one statement."""
    return share_statements(((run.controller.name, verdict(run)) for run in runs), where)


def share_statements(said: Iterable[tuple[str, Statement]], where: str = "") -> tuple[Statement, ...]:
    """Returns statements about several controllers. Statements that are equal except for times are merged, and the merged
    statement contains the range of the times.

    Args:
        said: pairs of the name of a controller and a statement about this controller.
        where: text that precedes each statement.
    """
    pairs, alike = list(said), dict[Statement, list[tuple[str, list[str]]]]()
    few = len({name for name, _ in pairs}) <= FEW
    for name, one in pairs:
        times = [] if few else [number for _, number, _ in NUMBERS.findall(one.text)]
        pattern = one if few else replace(one, text=NUMBERS.sub(r"\1 ... \3", one.text))
        alike.setdefault(pattern, []).append((name, times))
    statements = []
    for one, some in alike.items():
        text = one.text
        for times in zip(*(times for _, times in some), strict=True):
            first, last = min(times, key=float), max(times, key=float)
            text = LEFT_OUT.sub(first if first == last else f"{first} to {last}", text, count=1)
        statements.append(replace(one, text=f"{where}{joined_names([name for name, _ in some])}: {text}"))
    return tuple(statements)


def joined_names(names: Sequence[str]) -> str:
    """Returns the names of several runs as text for a statement.

    Names of the form `VEHICLE:CONTROLLER` are grouped by vehicle.
    """
    by_vehicle: dict[str, list[str]] = {}
    for name in names:
        vehicle, _, controller = name.rpartition(":")
        by_vehicle.setdefault(vehicle, []).append(as_name(controller.replace(", no", " without")))
    return "; ".join(f"{f'{vehicle}: ' if vehicle else ''}{', '.join(some)}" for vehicle, some in by_vehicle.items())


def reasons(run: RunResult, full: bool = True) -> tuple[Statement, ...]:
    """Returns sentences on a run: its events, checks, differences from linear analysis, and energy balance.

    If a run passes all checks and remains in the linear range, all sentences about this run count as details.

    Args:
        full: False to omit the details, because the linear responses would have to be computed for them.
    """
    detail: Detail = "full" if run.passed and math.isinf(run.diverged) and not run.prediction.radius >= 1 else "normal"
    contact = FEATURES.load("stops that a run reaches").stop_note(run) if run.vehicle.parts.strokes else ""
    stops = notes(*filter(None, [contact]))
    if not full and detail == "full":
        return stops
    said = [*notes(*_events(run)), *(FEATURES.load("forces that dampers lack").damper_notes(run) if run.vehicle.dampers else [])]
    if not run.physics.law_diverged or run.passed:  # after the law has diverged, rounding determines its forces
        said += [*_checks(run), *_distance(run)]
    said += _balance(run)
    return (*stops, *(replace(one, detail=detail) for one in said))


def _events(run: RunResult) -> Iterator[str]:
    """Yields sentences on the events of a run: instability, lift-off, and limits that were reached."""
    agreement, times, radius, vehicle = run.agreement, run.agreement.end_times, run.prediction.radius, run.vehicle
    if radius > 1:
        how = ", by direct feedback of its own force" if law_margins(vehicle, run.controller).own_force else ""
        yield f"unstable: the sampled loop grows by a factor of {entry(radius)} every step{how}"
    elif radius == 1:
        yield "marginal: a mode of the sampled loop neither grows nor decays, within rounding"
    if run.physics.law_diverged:
        yield f"{LAW_OVERFLOW}: {LAW_DIVERGED.format(when=WHEN.text(run.diverged))}"
    elif math.isfinite(run.diverged):
        yield f"diverged: MuJoCo was stopped at {WHEN.text(run.diverged)}"
    if agreement.lift_off:
        yield _flights(agreement.lift_off)
    if (half := run.half_step) is not None:
        known = math.isfinite(half.difference)
        change = f"half the timestep changes {half.signal} by {DIFFERENCE.digits(half.difference)} of its peak"
        yield f"accuracy: {change if known else 'at half the timestep, the run diverges'}"
    elif agreement.lift_off and run.prediction.is_blurred and run.broke_off is None:
        yield f"accuracy: unknown, as half the timestep changes the {vehicle.implementation.noise_text}"
    said = {end: end.verdict for end in REGIME_ENDS if end.verdict}
    if vehicle.limits.actuator_bandwidth is not None and run.controller.has_anti_windup:
        said[SATURATION] = DEMAND_CLIPPED
    elif vehicle.limits.actuator_bandwidth is not None and vehicle.limits.limits_commands:
        said[SATURATION] = COMMAND_LIMITED
    if math.isfinite(when := times[BUMP_STOP.name]):
        stops = FEATURES.load("stops that a run reaches").stop_names(run, when)
        said[BUMP_STOP] = said[BUMP_STOP].replace(BUMP_STOP.name, stops, 1)
    yield from (line.format(when=WHEN.text(times[end.name])) for end, line in said.items() if math.isfinite(times[end.name]))
    left = departures(vehicle, run.physics) if math.isfinite(times[CURVE.name]) else {}
    yield from (
        f"{name} differs from its linearisation by up to {percent(one)} of its largest force" for name, one in left.items()
    )
    if times[FLAT.name] == agreement.until < math.inf:
        when = f"{WHEN.text(agreement.until)}; no later step is compared"
        yield f"flat: a tyre is compressed by more than {MOST_SQUEEZE} m at {when}"
    if agreement.equations_invalid:
        yield f"{INVALID_EQUATIONS} from {WHEN.text(agreement.until)} on: {NO_STATE}; no later step is compared"


def _flights(lift_off: Sequence[tuple[float, float]]) -> str:
    """Returns a sentence on how often tyres leave the ground, with the first interval and the longest duration."""
    (start, end), longest = lift_off[0], LENGTH.text(max(end - start for start, end in lift_off))
    often = f"{len(lift_off)} times, first" if len(lift_off) > 1 else "once,"
    return f"lift-off: {often} from {WHEN.text(start)} to {WHEN.text(end)}; the longest lasts {longest}"


def _checks(run: RunResult) -> Iterator[Statement]:
    """Yields a sentence on each of the two checks: steps compared with equations, and commands compared with the control law."""
    steps, commands, code = run.agreement.steps, run.agreement.commands, run.agreement.code_effect
    if steps is None:
        small = any(signal.small is not None for signal in run.agreement.signals.values())
        first_order = f"; the run is compared with {run.prediction.reference} to first order" if small else ""
        yield Statement(
            f"time steps are not compared with equations of motion, because this vehicle type has none (`motion`){first_order}"
        )
    elif steps.until > 0:
        wrong = f"DOES NOT AGREE from {WHEN.text(steps.since)} on: not every MuJoCo step"
        end = f", until {WHEN.text(steps.until)}" if math.isfinite(steps.until) else ""
        model = "model" if steps.agrees else "vehicle's equations of motion from the same state"
        what = f"equals one RK4 step of the {model}{end}"
        yield _check("every MuJoCo step" if steps.agrees else wrong, what, steps)
    if commands is not None and not commands.repeatable:
        yield Statement(NOT_REPEATABLE, "note" if commands.agrees else "fails")
    elif commands is not None:
        subject = "every command" if commands.agrees else "COMMANDS DO NOT AGREE: not every command"
        yield _check(subject, "equals the control law", commands)
    yield from (Statement(text, "fails") for text in (code.failures if code is not None else ()))


def _check(subject: str, what: str, one: LocalAgreement) -> Statement:
    error = DIFFERENCE.digits(one.error) if one.error else "0"
    if one.agrees:
        return Statement(f"{subject} {what}, to {error} of a peak")
    allowed = ALLOWED_DIFFERENCE.digits(one.allowed)
    return Statement(f"{subject} {what}: largest error {error} of a peak ({one.signal}); at most {allowed} is allowed", "fails")


def _distance(run: RunResult) -> Iterator[Statement]:
    """Yields sentences on a run's differences from linear analysis, and on the cause of these differences."""
    agreement, signals = run.agreement, run.agreement.signals
    if not run.prediction.is_linear:
        yield Statement(f"{NO_REFERENCE}: a law that sets semi-active dampers is not linear, even at small amplitudes")
        return
    if agreement.until <= 0:
        yield Statement(f"there is no comparison with {run.prediction.reference}, which applies only {_when(run)}")
        return
    wrong = [name for name, signal in signals.items() if not signal.agrees]
    worst = max(wrong or signals, key=lambda name: signals[name].excess if wrong else signals[name].sampled)
    signal, small = signals[worst], ""
    what, curved = run.prediction.reference, run.vehicle.parts.nonlinear
    if run.controller.user_code:
        what = f"the {'nonlinear' if curved else 'exact linear'} response to the forces of the law"
    size = DIFFERENCE.digits(signal.sampled)
    if signal.small is not None:
        small = f", and {DIFFERENCE.digits(signal.small)} at {SMALL:g} of this road's height{' and loads' * run.road.loaded}"
    if wrong:
        size, own = f"{size} of a peak{small} ({worst})", DIFFERENCE.digits(signal.allowed)
        if agreement.follows_linear:  # the verdict then follows from the checks of steps and commands
            yield Statement(
                f"MuJoCo differs from {what} {_when(run)} by up to {size}; RK4's own error and rounding account for {own}"
            )
        else:
            wrong_by = f"the largest difference is {size}, but at most {own} is allowed"
            yield Statement(f"MuJoCo DOES NOT AGREE with {what} {_when(run)}: {wrong_by}", "fails")
    else:
        yield Statement(
            f"{what} is within {size} of every peak{small} {_when(run)}; "
            f"the difference comes from {agreement.cause} (worst: {worst})"
        )
    if off := line_words(run):
        name = max(run.line_errors, key=run.line_errors.__getitem__)
        yield Statement(
            "norm, margins and designs are based on the linearisation at equilibrium; compared with MuJoCo, this linearisation "
            f"is {off} {_when(run)} (worst: {name})"
        )
    if agreement.coarse:
        yield Statement(
            f"the timestep is too coarse: RK4's own error is more than {percent(COARSEST)} of a peak; use a smaller timestep"
        )


def _balance(run: RunResult) -> Iterator[Statement]:
    """Yields a sentence on the energy balance of a run if this balance was computed."""
    energy = run.energy
    if energy is None:
        return
    of = f"{RESIDUAL.cell(energy)} of the {EXCHANGED.text(energy.turnover)} exchanged"
    if energy.least is not None and energy.least < 0 and energy.fails:
        given = f"a semi-active damper supplied energy, {RESIDUAL.digits(-energy.least)} of the largest energy that it absorbed"
        yield Statement(f"energy DOES NOT BALANCE: {given}", "fails")
    elif energy.balances:
        yield Statement(f"energy balances, to {of}{'' if energy.loads is None else ', work of loads included'}")
    elif not energy.judged or run.physics.law_diverged:
        why = "the law overflows" if energy.judged else "the timestep is too coarse"
        yield Statement(f"energy is not evaluated, because {why}: {of} is neither stored nor dissipated")
    else:
        why = "the timestep is too coarse, or MuJoCo applies a force that the vehicle does not have"
        more = f"{of} is neither stored nor dissipated, but at most {ALLOWED.cell(energy)} is allowed"
        yield Statement(f"energy DOES NOT BALANCE: {more}: {why}", "fails")


@np.errstate(over="ignore")  # squares of an unstable loop's signals overflow; "-" is shown for infinite values
def describe_run(run: RunResult, passive: Response | None = None) -> Document:
    """Describes a run as a document: verdict, norm and bound of the controller, signals, and the reasons for the verdict.

    Args:
        passive: MuJoCo's response of the passive vehicle, with which the signals are compared; None to omit this comparison.
    """
    code = run.agreement.code_effect
    tables = [signal_table(run, passive)]
    if code is not None:
        tables.append(FEATURES.load("effect of exported code").code_table(code, run.vehicle))
    return Document(
        f"controller {run.controller.name}: measures {', '.join(run.controller.measured) or 'nothing'}",
        (*sentences(run), *tables),
    )


def sentences(run: RunResult, full: bool = True) -> tuple[Statement, ...]:
    """Returns sentences on the verdict, the controller, a free decay, and the reasons for the verdict; see `reasons`."""
    controller, code = run.controller, run.agreement.code_effect
    margins = law_margins(run.vehicle, controller)
    warning = margins.instability or margins.own_force or margins.small
    studied = study_notes(run.vehicle, controller)
    claimed = [] if len(studied) > 1 else [claims(controller)]
    marked = "WARNING: small " * (full and warning == margins.small) + warning
    first = [*claimed, *studied, *[marked] * bool(warning)]
    first += FEATURES.load("effect of exported code").code_notes(code, run.vehicle) if code else []
    every = [text for text in controller_notes(run.vehicle, controller) if not text.startswith(tuple(first))]
    others = [text for text in every if not (any(one.startswith(text) for one in first) or (warning and warning in text))]
    return (
        verdict(run),
        *notes(*first),
        *notes(*others, detail="full"),
        *notes(*filter(None, [FEATURES.load("decay").decay_words(run)] if run.vehicle.start else [])),
        *reasons(run, full),
    )


def signal_table(run: RunResult, passive: Response | None = None) -> Table:
    """Returns the table of all signals: peak and rms in MuJoCo, changes from the passive vehicle, and errors of linear analysis.

    Peak and rms of a signal refer to the whole run. Errors of linear analysis are measured as long as the analysis applies,
    relative to the signal's peak. On pages and in logs, the table also contains peak and rms of the linear responses.
    """
    rows, on = [], run.prediction.input
    # On a flat road, only rounding errors cause motion
    still = not on.heights.any() and not on.held_inputs.any() and not run.vehicle.start
    for name, signal in run.agreement.signals.items():
        was = None if still else passive
        if was is not None and was.peak(name) < was.scale(name):
            was = None  # None, because symmetry keeps the signal at zero, apart from rounding errors
        numbers = {field.label: "-" if math.isfinite(run.diverged) else field.cell((run, name)) for field in SIZES}
        cells = {WHOLE: f"{name} [{run.vehicle.kind.signal(name).unit}]"}
        for kind in ("peak", "rms"):
            cells[kind] = numbers.pop(f"{kind}, MuJoCo")
            if passive is not None:
                before = 0.0 if was is None else float(getattr(was, kind)(name))
                change = CHANGE.digits(float(getattr(run.physics, kind)(name)) / before - 1) if before else "-"
                cells[f"{kind} change [%]"] = change
        cells["error to sampled"], cells["error to continuous"] = map(DIFFERENCE.digits, (signal.sampled, signal.continuous))
        rows.append(cells | numbers)
    caption = "Peak and rms of every signal, and largest errors relative to its peak, as long as linear analysis applies."
    headings, linear = tuple(rows[0]), tuple(field.label for field in SIZES if not field.label.endswith("MuJoCo"))
    return Table("signals", caption, headings, tuple(tuple(row.values()) for row in rows), detail="full", wide=linear)


def checks_table(runs: Sequence[RunResult]) -> Table:
    """Returns the table of norms, bounds and checks, with a row for each run."""
    caption = (
        "Difference of MuJoCo from one RK4 step of the model, from the control law and from linear analysis, relative to peaks; "
        "residual of the energy balance."
    )
    return Table.of("checks", caption, CHECKS, runs, detail="full")


def events(run: RunResult) -> tuple[tuple[float, str], ...]:
    """Returns the events of a run with their times [s]: lift-offs, landings, the first bump stop and saturation, divergence,
    and overflow.
    """
    happened = [(start, LIFT_OFF.event) for start, _ in run.agreement.lift_off]
    happened += [(end, "landing") for _, end in run.agreement.lift_off]
    if math.isfinite(run.diverged):
        happened.append((run.diverged, LAW_OVERFLOW if run.physics.law_diverged else "diverged"))
    others = [(run.agreement.end_times[end.name], end.event) for end in REGIME_ENDS if end.event and end is not LIFT_OFF]
    happened += [(when, event) for when, event in others if math.isfinite(when)]
    return tuple(sorted(happened))


def run_statements(runs: Sequence[RunResult], where: str) -> tuple[Statement, ...]:
    """Returns the verdicts on runs, preceded by the text `where`, followed by the reasons for each verdict."""
    said = [(run.controller.name, one) for run in runs for one in reasons(run)]
    return (*verdicts(runs, where), *(replace(one, detail="full") for one in share_statements(said)))
