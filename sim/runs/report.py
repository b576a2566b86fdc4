"""Reports on runs: documents, objects for `--json`, and the events of their logs.

`describe_run` describes the verdict on a run and its reasons in sentences. Commands, reports, logs and inspections print these
sentences.
"""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from models.common.extensions import FEATURES
from models.common.printed import as_name, entry, percent
from models.document.document import Document, Statement, Table, notes
from models.document.field import OMITTED_KEY, Detail, Field, Record, if_any
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
from sim.runs.result import COARSE, NOT_REPEATABLE, RunResult
from synth.controller.controller import AnyController
from synth.controller.law_margins import law_margins
from synth.controller.report import (
    BOUND,
    GROWTH,
    NORM,
    PEAK,
    failures_of_sampled_loop,
    filter_lines,
    growth_lines,
    ideal_lines,
    named_gain,
    norm_if_implemented,
    notes_on_sampled_loop,
    study_notes,
)
from synth.controller.report import notes as controller_remarks

if TYPE_CHECKING:
    from sim.runs.code_effect import CodeEffect

INVALID_EQUATIONS = "equations not valid"
NO_STATE = "a strut is shorter than 0.1 m, or the body turns by more than 29 degrees"
FEW = 3  # largest number of controllers with separate statements; for more, the output would not fit into a terminal
NUMBERS = re.compile(r"(until|at|off by) ([\d.e+-]+) (s\b|%)")
LEFT_OUT = re.compile(r"\.\.\.(?= (?:s\b|%))")

ENERGY: tuple[Field[Energy], ...] = (
    *(Field(name, attrgetter(name), JOULES.form, unit="J") for name in ("road", "actuators", "stored", "dissipated")),
    TURNOVER := Field("exchanged", attrgetter("turnover"), JOULES.form, unit="J", column="turned over [J]"),
    RESIDUAL := Field("residual", attrgetter("residual"), "{:.1e}".format, column="left over"),
    Field("allowed", attrgetter("allowed"), "{:.1e}".format),
)
FAR_OFF = 100.0  # multiple of a peak; if the error of a linearisation is larger, its loop is unstable
HALF = 0.5  # share of the requested force; if more is missing, linear analysis does not describe the run
COEFFICIENT = Field[float]("coefficient", float, ".4g", unit="N s/m")
OF_CODE = Field[str]("difference", str, ".2g")
LENGTH = Field[float]("duration", float, ".3g", unit="s")
CHANGE = Field[float]("change", float, "+.1f", 100.0)
SIZE = Field[float]("size", float, ".5g")  # of a signal
SIZES: tuple[Field[tuple[RunResult, str]], ...] = tuple(  # peak and rms of a signal of a run
    Field(f"{what}, {name}", lambda of, get=attrgetter(f"{source}.{what}"): float(get(of[0])(of[1])), SIZE.form, key=name.lower())
    for what in ("peak", "rms")
    for name, source in {"MuJoCo": "physics", "sampled": "sampled", "continuous": "continuous"}.items()
)


BALANCE = Record[Energy](
    lambda one: {key: value for key, value in asdict(one).items() if key not in ("least", "loads") or value is not None},
    balances=lambda one: one.balances if one.judged else None,
)  # energy balance [J]; the residual is a share of `turnover`


def _local_check(where: str, *names: str) -> Callable[[RunResult], dict[str, Any] | None]:
    """Returns a function that returns the result of a local check for JSON; None if the check is not made."""
    return Record(**{name: lambda one, name=name: getattr(one, name, None) for name in ("agrees", *names)}).all(where)


def _worst_line(run: RunResult) -> dict[str, Any] | None:
    """Returns the largest error of the linearisation at equilibrium for JSON; None if nothing is compared."""
    if not (errors := run.line_errors):
        return None
    worst = max(errors, key=errors.__getitem__)
    return {"error": errors[worst], "signal": worst, "over": "peak in MuJoCo"}


def _shortfall(run: RunResult) -> dict[str, Any]:
    """Returns for JSON the force that semi-active dampers did not supply; empty if there are no such dampers."""
    if not run.vehicle.dampers:
        return {}
    return {"shortfall": FEATURES.load("forces that dampers lack").shortfalls(run.vehicle, run.physics)}


def _decay(run: RunResult) -> dict[str, Any]:
    """Returns the modes of a free decay for JSON; empty if the run does not start from a given state."""
    if not run.vehicle.start:
        return {}
    return FEATURES.load("decay").record(run)


HALF_STEP = Record("difference", "signal")  # change of the response after a lift-off if the time step is halved
SIGNAL = Record[tuple[RunResult, str]](
    unit=lambda of: of[0].vehicle.kind.signal(of[1]).unit,
    peak=Record(*SIZES[:3]),
    rms=Record(*SIZES[3:]),
    error=Record(
        sampled=lambda of: of[0].agreement.signals[of[1]].sampled,
        continuous=lambda of: of[0].agreement.signals[of[1]].continuous,
        linearisation=lambda of: of[0].line_errors.get(of[1], OMITTED_KEY),
    ),
)


def controller_record(controller: AnyController) -> dict[str, Any]:
    """Returns a controller for JSON. Linear results of a Python control law are None."""
    if controller.linear is False:
        return controller.record | dict.fromkeys(("bound", "norm", "peak_frequency", "stability"))
    claims = Record(BOUND, NORM, PEAK, stability=lambda one: one.stability.verdict)
    return {**controller.record, **claims(controller.certificate), **GROWTH(controller)}


RUN = np.errstate(over="ignore")(  # the squares of an unstable loop's signals overflow; infinite values are written as None
    Record[RunResult](
        Record(
            controller=lambda run: controller_record(run.controller),
            signals=SIGNAL.all(lambda run: {name: (run, name) for name in run.agreement.signals}),
            until="agreement.until",
            lift_off="agreement.lift_off",
            agrees="agreement.agrees",
            steps=_local_check("agreement.steps", "error", "allowed", "since", "until"),
            commands=_local_check("agreement.commands", "repeatable", "error", "allowed", "since"),
            cause="agreement.cause",
            reference=lambda run: run.prediction.reference if run.prediction.linearised else OMITTED_KEY,
            linearisation=lambda run: _worst_line(run) if run.prediction.linearised else OMITTED_KEY,
            stops=lambda run: FEATURES.load("stops that a run reaches").STOPS(run) if run.vehicle.limits.stopped else OMITTED_KEY,
            dampers=if_any(_shortfall),
        ),
        _decay,
        code_difference=lambda run: (
            FEATURES.load("effect of exported code").DIFFERENCES(run.agreement.code_effect)
            if run.agreement.code_effect
            else OMITTED_KEY
        ),
        margins=lambda run: law_margins(run.vehicle, run.controller).record if run.controller.linear else OMITTED_KEY,
        energy=BALANCE.all(lambda run: run.energy or OMITTED_KEY),
    )
)


def line_words(run: RunResult) -> str:
    """Returns the error of the linearisation at equilibrium as text; empty for a vehicle without characteristics."""
    if not (errors := run.line_errors):
        return ""
    off = max(errors.values())
    return f"off by {percent(off)} of a peak" if off < FAR_OFF else f"off by more than {FAR_OFF:g} times a peak"


def energy_table(runs: Sequence[RunResult], where: str) -> Table:
    """Returns the table of the energy balances of all runs."""
    known = [(run.controller.name, run.energy) for run in runs if run.energy is not None]
    name, get = Field[tuple[str, Energy]]("controller", lambda of: of[0]), lambda of: of[1]
    fields = (name, *(field.of(get) for field in ENERGY))
    return Table.of("energy", f"Energy balance over {where}.", fields, known)


def controller_notes(vehicle: Vehicle, controller: AnyController) -> list[str]:
    """Returns the control law of a controller, its norm and bound, and remarks, one sentence each."""
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
        *([claims(controller), certificate.own.words] if certificate.stable else []),
        *ideal_lines(vehicle, [controller]),
        *ratio_notes(vehicle.kind, vehicle.parameters),
        *filter_lines(vehicle),
        *growth_lines(vehicle, controller),
        *controller_remarks(controller),
        *certificate.remarks,
        *notes_on_sampled_loop(vehicle, certificate, built),
        *failures_of_sampled_loop(vehicle, certificate, certificate.loop_failures, built),
    ]


def claims(controller: AnyController) -> str:
    """Returns the norm and the bound of a controller as text, or the reason why there are none."""
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
    """Returns the time until which linear analysis applies, and the event that ends it, as text."""
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
    """Returns the verdicts on runs, preceded by the text `where`. Runs with the same verdict share a statement."""
    return share_statements(((run.controller.name, verdict(run)) for run in runs), where)


def share_statements(said: Iterable[tuple[str, Statement]], where: str = "") -> tuple[Statement, ...]:
    """Returns statements about several controllers. Equal statements are merged; if their times differ, the range is given.

    Args:
        said: pairs of a controller's name and a statement.
        where: text before each statement.
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
    """Returns the names of runs for a statement. Names of several vehicles, `VEHICLE:CONTROLLER`, are grouped by vehicle."""
    by_vehicle: dict[str, list[str]] = {}
    for name in names:
        vehicle, _, controller = name.rpartition(":")
        by_vehicle.setdefault(vehicle, []).append(as_name(controller.replace(", no", " without")))
    return "; ".join(f"{f'{vehicle}: ' if vehicle else ''}{', '.join(some)}" for vehicle, some in by_vehicle.items())


def reasons(run: RunResult, full: bool = True) -> tuple[Statement, ...]:
    """Returns sentences on a run: its events, checks, differences from linear analysis, and energy balance.

    If a run passes and remains in the linear range, all its sentences are details.

    Args:
        full: False to omit details, which need the linear responses.
    """
    detail: Detail = "full" if run.passed and math.isinf(run.diverged) and not run.prediction.radius >= 1 else "normal"
    contact = FEATURES.load("stops that a run reaches").stop_note(run) if run.vehicle.parts.strokes else ""
    stops = notes(*filter(None, [contact]))
    if not full and detail == "full":
        return stops
    said = [*notes(*_events(run)), *(_damper_notes(run) if run.vehicle.dampers else [])]
    if not run.physics.law_diverged or run.passed:  # otherwise, the forces of the law are only rounding errors
        said += [*_checks(run), *_distance(run)]
    said += _balance(run)
    return (*stops, *(replace(one, detail=detail) for one in said))


def _events(run: RunResult) -> Iterator[str]:
    """Yields sentences on the events of a run: instability, lift-off, and limits."""
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
        change = f"{half.signal} changes by {DIFFERENCE.digits(half.difference)} of its peak" if known else "the run diverges"
        yield f"accuracy after the lift-off: at half the timestep, {change}"
    elif agreement.lift_off and run.prediction.is_blurred and run.broke_off is None:
        yield f"accuracy after the lift-off: unknown, as half the timestep changes the {vehicle.implementation.noise_text}"
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
    return f"lift-off: a tyre leaves the ground {often} from {WHEN.text(start)} to {WHEN.text(end)}; the longest lasts {longest}"


def _checks(run: RunResult) -> Iterator[Statement]:
    """Yields a sentence on each of the two checks: steps compared with equations, and commands compared with the control law."""
    steps, commands, code = run.agreement.steps, run.agreement.commands, run.agreement.code_effect
    if steps is None:
        small = any(signal.small is not None for signal in run.agreement.signals.values())
        first_order = f"; the run is compared with {run.prediction.reference} to first order" if small else ""
        yield Statement(f"no time step is compared, because this vehicle type has no equations of motion (`motion`){first_order}")
    elif steps.until > 0:
        wrong = f"DOES NOT AGREE from {WHEN.text(steps.since)} on: not every MuJoCo step"
        end = f", until {WHEN.text(steps.until)}" if math.isfinite(steps.until) else ""
        what = f"equals one RK4 step of the vehicle's equations of motion from the same state{end}"
        yield _check("every MuJoCo step" if steps.agrees else wrong, what, steps)
    if commands is not None and not commands.repeatable:
        yield Statement(NOT_REPEATABLE, "note" if commands.agrees else "fails")
    elif commands is not None:
        subject = "every command" if commands.agrees else "COMMANDS DO NOT AGREE: not every command"
        yield _check(subject, "equals the control law evaluated on the run's measurements", commands)
    yield from (Statement(text, "fails") for text in (code.failures if code is not None else ()))


def _check(subject: str, what: str, one: LocalAgreement) -> Statement:
    error = DIFFERENCE.digits(one.error) if one.error else "0"
    text = (
        f"{subject} {what}: largest error {error} of a peak ({one.signal}); at most "
        f"{ALLOWED_DIFFERENCE.digits(one.allowed)} is allowed"
    )
    return Statement(text, "note" if one.agrees else "fails")


def _distance(run: RunResult) -> Iterator[Statement]:
    """Yields sentences on the differences from linear analysis and their cause."""
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
        if agreement.follows_linear:  # the checks of steps and commands determine the verdict
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
            f"norm, margins and designs are based on the linearisation at equilibrium, which is {off} in MuJoCo {_when(run)} "
            f"(worst: {name})"
        )
    if agreement.coarse:
        yield Statement(
            f"the timestep is too coarse: RK4's own error is more than {percent(COARSEST)} of a peak; use a smaller timestep"
        )


def _balance(run: RunResult) -> Iterator[Statement]:
    """Yields a sentence on the energy balance of a run if it is known."""
    energy = run.energy
    if energy is None:
        return
    of = f"{RESIDUAL.cell(energy)} of the {TURNOVER.text(energy.turnover)} exchanged"
    if energy.least is not None and energy.least < 0 and energy.fails:
        given = f"a semi-active damper supplied energy, {RESIDUAL.digits(-energy.least)} of the largest energy that it absorbed"
        yield Statement(f"energy DOES NOT BALANCE: {given}", "fails")
    elif energy.balances:
        sources = "road and actuators" if energy.loads is None else "road, loads and actuators"
        yield Statement(f"energy balances: all work of {sources} is stored or dissipated, to within {of}")
    elif not energy.judged or run.physics.law_diverged:
        why = "the law overflows" if energy.judged else "the timestep is too coarse"
        yield Statement(f"energy is not evaluated, because {why}: {of} is neither stored nor dissipated")
    else:
        why = "the timestep is too coarse, or MuJoCo applies a force that the vehicle does not have"
        more = f"{of} is neither stored nor dissipated, but at most {ENERGY[-1].cell(energy)} is allowed"
        yield Statement(f"energy DOES NOT BALANCE: {more}: {why}", "fails")


@np.errstate(over="ignore")  # the squares of an unstable loop's signals overflow; infinite values are shown as "-"
def describe_run(run: RunResult, passive: Response | None = None) -> Document:
    """Describes a run as a document: verdict, norm and bound of the controller, signals, and the reasons for the verdict.

    Args:
        passive: MuJoCo's response of the passive vehicle, with which the signals are compared; None for no comparison.
    """
    code, until = run.agreement.code_effect, run.agreement.until
    ended = f"errors are measured until {WHEN.text(until)}; peak and rms are those of the whole run"
    tables = (signal_table(run, passive), *([] if code is None else [code_table(code, run.vehicle)]))
    return Document(
        f"controller {run.controller.name}: measures {', '.join(run.controller.measured) or 'nothing'}",
        (
            *sentences(run),
            Document("Signals", (*notes(*[ended] * math.isfinite(until), detail="full"), *tables), "full"),
        ),
    )


def sentences(run: RunResult, full: bool = True) -> tuple[Statement, ...]:
    """Returns sentences on the verdict, the controller, its free decay, and the reasons for the verdict; see `reasons`."""
    controller, code = run.controller, run.agreement.code_effect
    margins = law_margins(run.vehicle, controller)
    warning = margins.instability or margins.own_force or margins.small
    studied = study_notes(run.vehicle, controller)
    claimed = [] if len(studied) > 1 else [claims(controller)]
    marked = "WARNING: small " * (full and warning == margins.small) + warning
    first = [*claimed, *studied, *[marked] * bool(warning), *code_notes(code, run.vehicle)]
    every = [text for text in controller_notes(run.vehicle, controller) if not text.startswith(tuple(first))]
    others = [text for text in every if not (any(one.startswith(text) for one in first) or (warning and warning in text))]
    return (
        verdict(run),
        *notes(*first),
        *notes(*others, detail="full"),
        *notes(*_decay_words(run)),
        *reasons(run, full),
    )


def _decay_words(run: RunResult) -> list[str]:
    """Returns a sentence on the free decay of a run from a given start; empty if there is no given start."""
    if not run.vehicle.start:
        return []

    return [words] if (words := FEATURES.load("decay").decay_words(run)) else []


def signal_table(run: RunResult, passive: Response | None = None) -> Table:
    """Returns the table of peak and rms of all signals, their differences from linear analysis, and changes from passive."""
    rows, on = [], run.prediction.input
    # On a flat road, all motion is due to rounding errors
    still = not on.heights.any() and not on.held_inputs.any() and not run.vehicle.start
    for name, signal in run.agreement.signals.items():
        was = None if still else passive
        if was is not None and was.peak(name) < was.scale(name):
            was = None  # if symmetry keeps a signal at zero, it contains only rounding errors
        for kind, sizes in (("peak", SIZES[:3]), ("rms", SIZES[3:])):
            numbers = ["-" if math.isfinite(run.diverged) else field.cell((run, name)) for field in sizes]
            apart = [DIFFERENCE.digits(one) if kind == "peak" else "" for one in (signal.sampled, signal.continuous)]
            before = 0.0 if was is None else float(getattr(was, kind)(name))
            change = CHANGE.digits(float(getattr(run.physics, kind)(name)) / before - 1) if before else "-"
            label = f"{name} [{run.vehicle.kind.signal(name).unit}]" if kind == "peak" else ""
            rows.append((label, kind, *numbers, *apart, change))
    headings = ("signal", "of", "MuJoCo", "sampled", "continuous", "error", "cont. error", "change %")[: 8 if passive else 7]
    shown = tuple(row[: len(headings)] for row in rows)
    return Table("signals", "Peak and rms of every signal, and the change from the passive vehicle.", headings, shown)


def _damper_notes(run: RunResult) -> list[Statement]:
    """Returns sentences on the force that semi-active dampers did not supply, and its consequence for linear analysis."""
    shortfalls = FEATURES.load("forces that dampers lack").shortfalls
    names, texts, most = {one.force: one.coefficient for one in run.vehicle.parts.adjustable}, list[str](), 0.0
    delayed = ["delay"] * bool(run.vehicle.implementation.delay)
    delayed += ["valve lag"] * any(one.bandwidth is not None for one in run.vehicle.dampers.values())
    if delayed:
        of_voltage = not all(one.replaces for one in run.vehicle.dampers.values())
        what = "the voltage" if of_voltage else "the damping coefficient"
        acts = f"{' and '.join(delayed)} act{'s' * (len(delayed) == 1)} on {what}"
        texts.append(f"{acts}, not on the force, which follows the current suspension velocity")
    for force, one in shortfalls(run.vehicle, run.physics).items():
        most = max(most, one.rms)
        if one.late:
            texts.append(f"{names[force]}: the valve's lag removes {percent(one.late)} (rms) of the requested force")
        if one.time:
            setting = replace(COEFFICIENT, unit=run.vehicle.kind.signal(names[force]).unit)
            texts.append(
                f"{names[force]} is between {setting.digits(one.softest)} and {setting.text(one.hardest)}; "
                f"{percent(one.rms)} (rms) of the requested force is missing, at {percent(one.time)} of the samples"
            )
    if most > HALF and run.controller.linear:
        text = "norms and margins do not describe this run: a semi-active damper cannot supply "
        text += f"{percent(most)} of the requested force"
        return [*notes(*texts), Statement(text, "ends")]
    return [*notes(*texts)]


def code_notes(effect: "CodeEffect | None", vehicle: Vehicle) -> list[str]:
    """Returns a list with a sentence on how exported code differs from the control law; empty without exported code."""
    if effect is None:
        return []
    line = f"the controller runs as compiled code in {effect.numbers}"
    if effect.clipped_readings:
        return [
            f"{line}; {effect.clipped_readings[0]} exceeds its range on this road, and is clipped: export with a larger --range"
        ]
    if not any(map(effect.peak, effect.apart)):
        return [f"{line}; the run is the same, bit for bit, as with the control law itself"]
    force = max(vehicle.linear_model.inputs, key=effect.peak)
    apart = f"at most {OF_CODE.digits(effect.peak(force))} N (rms {OF_CODE.digits(effect.rms(force))} N)"
    share = DIFFERENCE.digits(effect.share)
    return [f"{line}; with the control law itself, {force} differs by {apart}, and every signal by at most {share} of its peak"]


def code_table(effect: "CodeEffect", vehicle: Vehicle) -> Table:
    """Returns the table of differences of all signals from the run with the law itself."""
    fields = (
        Field[str]("signal", lambda name: name.replace("_", " ")),
        Field[str]("unit", lambda name: vehicle.kind.signal(name).unit),
        replace(OF_CODE, label="rms", value=effect.rms),
        replace(OF_CODE, label="at most", value=effect.peak),
    )
    caption = "Difference between MuJoCo's runs with the exported code and with the control law itself, over the same road."
    return Table.of("exported-rounding", caption, fields, effect.apart, words=2, detail="full")


def events(run: RunResult) -> tuple[tuple[float, str], ...]:
    """Returns lift-offs, landings, the first bump stop and saturation, divergence and overflow, with their times [s]."""
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
