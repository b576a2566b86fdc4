"""Output of stability margins: printed documents, JSON objects, and the section of the report."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from models.common.printed import as_name, finite
from models.document.document import NOTE, Document, Pivot, Statement, Table, apart, notes
from models.document.field import Field, Record, if_any
from models.document.text import names_text
from models.parts.lines import lines_at_rest
from models.vehicle.vehicle import Vehicle
from sim.linear.nonlinear_elements import bent_at_rest
from sim.studies.stability.edge import SLOWEST, StabilityEdge
from sim.studies.stability.figure import SIZE, margins_figure
from sim.studies.stability.margin_search import GainMargin, LoopMargins
from sim.studies.stability.margins import StabilityMargins
from synth.analysis.specification import FREQUENCY
from synth.controller.law_margins import TURN, decibels
from synth.controller.stability_margins import LARGEST_FACTOR

IMPLEMENTED_MARGINS = "gain", "phase", "disk"  # names of the margins that are given for the implemented loop
AGREES = {True: "agrees", False: "DOES NOT AGREE"}
UNDECIDED_NOTE = "undecided: the slowest mode hardly changes"


NO_LIMIT = "no limit"


def number(value: float) -> str:
    """Returns a margin as text: `no limit` for infinity, `-` for NaN."""
    return NO_LIMIT if math.isinf(value) else SIZE.digits(value)


class Row(NamedTuple):
    """A margin in a table.

    Attributes:
        margin: name of the margin, followed by the unit.
        predicted: predicted value of the margin.
        found: value of the margin found in MuJoCo; NaN if the margin is only predicted, or if the runs are not decisive.
        note: remark on the margin, which is printed in the last column of the table.
        extrapolated: True if `found` was extrapolated to a timestep of 0.
        extra: True if the row is omitted when several controllers are compared.
        usual: predicted value of the margin in dB or degrees; None for a margin in any other unit.
    """

    margin: str
    predicted: float
    found: float = math.nan
    note: str = ""
    extrapolated: bool = False
    extra: bool = False
    usual: str | None = None


def _decibels(factor: float) -> str | None:
    return decibels(factor) if 0 < factor < math.inf else None


def _degrees(angle: float) -> str | None:
    return TURN.digits(angle) if math.isfinite(angle) else None


MARGIN = Field[Row]("margin", lambda row: row.margin)
PREDICTED_MARGIN = Field[Row]("predicted", lambda row: row.predicted, number)
USUAL = Field[Row]("dB or °", lambda row: row.usual)
MUJOCO_MARGIN = Field[Row]("MuJoCo", lambda row: row.found, number)
MARGINS = (
    MARGIN,
    PREDICTED_MARGIN,
    USUAL,
    MUJOCO_MARGIN,
    Field[Row](NOTE, lambda row: _join_notes("extrapolated" * row.extrapolated, row.note)),
)
Value = Callable[[LoopMargins], float]


def _margin(label: str, predicted: Value, found: Value, scale: float = 1.0, unit: str = "") -> tuple[Field[LoopMargins], ...]:
    """Returns two fields for a margin: the predicted value, and the value found in MuJoCo."""
    return Field(label, predicted, number, scale, "predicted", unit), Field("in MuJoCo", found, number, scale, "found", unit)


GAIN = _margin("gain", lambda of: of.predicted.gain, lambda of: of.gain.found)
LOWER = _margin("lower gain", lambda of: of.predicted.gain_lower, lambda of: of.found_gain_lower)
PHASE = _margin("phase", lambda of: of.predicted.phase, lambda of: of.found_phase)
DELAY = _margin("delay", lambda of: of.predicted.delay, lambda of: of.found_delay, 1e3, "ms")
PERIOD = _margin("sample period", lambda of: of.predicted.sample_period, lambda of: of.found_sample_period, 1e3, "ms")
LOOPS: tuple[Field[tuple[str, LoopMargins]], ...] = (
    Field("loop, with the others closed", lambda of: of[0]),
    *(one.of(lambda of: of[1]) for one in (*GAIN, *DELAY)),
)
COMPARED_MARGINS: tuple[Field[tuple[str, Row]], ...] = (
    Field("controller", lambda of: of[0]),
    MARGIN.of(lambda of: of[1]),
    PREDICTED_MARGIN.of(lambda of: of[1]),
    USUAL.of(lambda of: of[1]),
    Field("MuJoCo", lambda of: MUJOCO_MARGIN.cell(of[1]) + " (extrapolated)" * of[1].extrapolated),
)
FACTOR = Field[float]("factor", float, ".3g")


SAMPLED_MARGIN = Record[tuple[float, StabilityEdge]](
    timestep=lambda tried: tried[1].timestep, predicted=lambda tried: tried[0], found=lambda tried: tried[1].found
)  # the margin belongs to the sampled loop at one timestep of the simulation
LOOP = Record[LoopMargins](
    gain=Record(
        *GAIN,
        lower=Record(**{one.key: lambda of, one=one: finite(one.value(of)) or None for one in LOWER}),
        extrapolated="gain.extrapolated",
        sampled=SAMPLED_MARGIN.all("gain.tried"),
    ),
    phase=Record(
        *PHASE,
        frequency="predicted.frequency",
        smallest_lag="predicted.smallest_phase",
        lead=Record(predicted=lambda of: of.predicted.lead, frequency=lambda of: of.predicted.lead_frequency),
        smallest=lambda of: min(of.predicted.smallest_phase, of.predicted.lead),
    ),
    disk=Record(
        margin="predicted.disk.size",
        gain="predicted.disk.gain",
        phase="predicted.disk.phase",
        frequency="predicted.disk.frequency",
    ),
    delay=Record(*DELAY),
    sample_period=Record(*PERIOD),
)


def _loop(found: StabilityMargins, name: str) -> dict[str, Any]:
    """Returns the JSON object with the margins of a loop. If there is an implemented loop, the gain, phase and disk margins of
    this loop come first.
    """
    ideal, *built = (LOOP(of[name]) for of in (found.loops, found.implemented_loops) if name in of)
    first = [{key: one[key] for key in IMPLEMENTED_MARGINS} for one in (*built, ideal)]
    return {**ideal, **first[0], "ideal": first[1]} if built else ideal


RECORD = Record[StabilityMargins](
    loops=lambda found: {name: _loop(found, name) for name in found.loops if name},
    weighted_errors=if_any(lambda found: [promise.record for promise in found.controller.robustness]),
    loop=lambda found: " ".join(loop_texts(found.vehicle)) or None,
)


def record(found: StabilityMargins) -> dict[str, Any]:
    """Returns the margins of a controller as a JSON object in SI units.

    If the implemented loop differs from the ideal loop, the key `ideal` contains the margins of the ideal loop.
    """
    return {"controller": found.controller.name, **_loop(found, ""), **RECORD(found)}


def describe(found: StabilityMargins) -> Document:
    """Returns the document about the stability margins of one controller."""
    vehicle, controller = found.vehicle, found.controller
    loops = [(f"{name}, implemented", one) for name, one in found.implemented_loops.items() if name]
    loops += [(f"{name}, ideal" if found.implemented_loops else name, one) for name, one in found.loops.items() if name]
    texts = loop_texts(vehicle)
    if _fixed_period(found):
        texts.append(
            "The law is discrete. The margins are those of the continuous law that Tustin's transform turns into this discrete "
            "law."
        )
    texts += ["The margins are those of the feedback; preview does not change them."] * (controller.preview is not None)
    blocks: list[Table | Document] = [Table.of("margins", "Margins.", MARGINS, _rows(found))]
    blocks += [Table.of("loops", "Margins of each loop.", LOOPS, loops)] if loops else []
    for name, one in loops:
        table = Table.of(name, "", MARGINS, _loop_rows(found, one))
        blocks.append(Document(f"{name}, with the other loops closed", (table,), "full" if one.agrees else "normal"))
    blocks += [Document("", notes(*(one.text for one in controller.robustness)))] if controller.robustness else []
    return Document("", apart(*notes(*filter(None, [" ".join(texts)])), *blocks, *verdicts([found])))


def compare(found: Sequence[StabilityMargins]) -> Document:
    """Returns the document about the stability margins of several controllers for a vehicle, with figures."""
    vehicle, timestep = found[0].vehicle, found[0].loops[""].timestep
    texts = [
        "Each margin applies to all actuators together. It is predicted from the loop transfer function, and found in MuJoCo "
        f"from the derivative of a step of {1e3 * timestep:g} ms. Two runs confirm the margin: one decays, and one grows.",
        "Phase lead and disk margin are only predicted. The disk margin d allows simultaneous changes of gain and phase: each "
        "force may have any complex factor f with |f - 1| / |f + 1| < d/2.",
        "Phase and delay have no limit if no eigenvalue of the loop transfer function L has magnitude 1 at any frequency. "
        f"A gain has no limit if the loop is stable up to factor {LARGEST_FACTOR:g}.",
        *loop_texts(vehicle),
        *(f"{as_name(one.controller.name)}: {promise.text}." for one in found for promise in one.controller.robustness),
    ]
    rows = [(one.controller.name, row) for one in found for row in _rows(one) if not row.extra]
    caption = "Largest change of each quantity before the loop is unstable: predicted, and found in MuJoCo."
    pivot = Pivot(("margin",), "controller", ("predicted", "dB or °", "MuJoCo"))
    table = Table.of("margins", caption, COMPARED_MARGINS, rows, 2, pivot)
    figures = (replace(margins_figure(one), name=f"margins-{one.controller.name}") for one in found)
    return Document("Stability margins", (*verdicts(found), *notes(*texts), *figures, table))


def verdicts(found: Sequence[StabilityMargins]) -> list[Statement]:
    """Returns statements about whether MuJoCo agrees with the predicted margins of controllers."""
    agreed, statements = [one for one in found if one.agrees], list[Statement]()
    if agreed:
        loops = [loop for one in agreed for loop in one.loops.values()]
        edges = [
            each for one in loops for each in (one.gain.found, one.found_gain_lower, one.found_delay, one.found_sample_period)
        ]
        decided = ", where its runs are decisive" if any(map(math.isnan, edges)) else ""
        names = names_text(one.controller.name for one in agreed)
        statements.append(Statement(f"MuJoCo agrees with the predicted margins of {names}{decided}.", "holds"))
    for one in (one for one in found if not one.agrees):
        text = f"MuJoCo DOES NOT AGREE with the predicted margins of {as_name(one.controller.name)}: {'; '.join(one.wrong)}."
        statements.append(Statement(f"{text} Try a smaller timestep.", "fails"))
    return statements


def loop_texts(vehicle: Vehicle) -> list[str]:
    """Returns sentences that define which loop was analysed: actuator lag, delay, noise, dampers and linearised
    characteristics.
    """
    texts, how = [], vehicle.implementation
    if not vehicle.ideal or vehicle.dampers:
        lag = "has no actuator lag" if vehicle.limits.actuator_bandwidth is None else "includes the lag of its actuators"
        texts.append(f"The loop {lag}.")
        texts += [] if how.undelayed else ["Delay and sample period are totals, which include those of the vehicle file."]
        texts += [f"The loop does not include {how.noise_text}."] if how.has_measurement_noise else []
        which = "dampers of [actuators]" if all(one.replaces for one in vehicle.dampers.values()) else "semi-active dampers"
        texts += [f"Margins require that the {which} give the commanded force."] if vehicle.dampers else []
        texts.append("Norms are those of the ideal loop.")
    if slopes := lines_at_rest(vehicle.parts.with_curve):
        texts.append(f"[curves] are replaced by their linearisation at equilibrium: {slopes}.")
    if bent_at_rest(vehicle):
        texts.append("MuJoCo uses this linearisation, too, because a curve with a kink at equilibrium has no derivative there.")
    return texts


def _fixed_period(found: StabilityMargins) -> float | None:
    """Returns the sample period of a discrete-time law [s]; None for a continuous-time law or a static gain."""
    law = found.controller.law
    return law.sample_period if law.states else None


def _rows(found: StabilityMargins) -> list[Row]:
    """Returns the table rows for the loop that is cut at all actuators: first the implemented loop, if there is one, then the
    ideal loop.
    """
    rows = _loop_rows(found, found.implemented_loops[""]) if found.implemented_loops else []
    return [*rows, *_loop_rows(found, found.loops[""], ", ideal loop" * bool(found.implemented_loops))]


def _loop_rows(found: StabilityMargins, one: LoopMargins, of: str = "") -> list[Row]:
    """Returns the table rows with the margins of a loop.

    Args:
        found: margins of all loops of the controller.
        one: margins of the loop that the rows describe.
        of: text such as ", ideal loop", which follows the name of a margin if the implemented loop has the same kind of margin.
    """
    predicted, h, gain = one.predicted, one.timestep, one.gain
    lower, high = predicted.gain_lower or one.found_gain_lower, predicted.gain
    below = f"no crossover: {'eigenvalues of L' if len(found.vehicle.linear_model.inputs) > 1 else '|L|'} < 1 at all frequencies"
    note = _join_notes(
        UNDECIDED_NOTE * math.isnan(gain.found),
        f"stable up to factor {LARGEST_FACTOR:g}" * math.isinf(high),
        "" if lower else "stable down to factor 0",
    )
    usual = _decibels(high)
    rows = [
        Row(f"gain{of}, factor", *_values(GAIN, one), note=note, extrapolated=gain.extrapolated, usual=usual),
        *_sampled_rows(gain),
    ]
    if lower:
        seen = UNDECIDED_NOTE * math.isnan(one.gain_lower.found), one.gain_lower.extrapolated
        usual = _decibels(predicted.gain_lower)
        rows.append(Row(f"lower gain{of}, factor", *_values(LOWER, one), *seen, extra=True, usual=usual))
        rows += _sampled_rows(one.gain_lower, -1)
    note = f"at {FREQUENCY.text(predicted.frequency)}" if predicted.crossovers else below
    rows.append(Row(f"phase lag{of} [rad]", *_values(PHASE, one), note, usual=_degrees(predicted.phase)))
    if (least := predicted.smallest_phase) < predicted.phase * (1 - 1e-9):
        note = "at a different crossover than the delay"
        rows.append(Row(f"smallest phase lag{of} [rad]", least, note=note, extra=True, usual=_degrees(least)))
    note = f"at {FREQUENCY.text(predicted.lead_frequency)}" if predicted.leading else below
    rows.append(Row(f"phase lead{of} [rad]", predicted.lead, note=note, usual=_degrees(predicted.lead)))
    least, most = predicted.disk.gain
    factors = f"{FACTOR.text(least)} to {FACTOR.text(most)}" if math.isfinite(most) else "without limit"
    note = f"gain {factors}"
    rows.append(Row(f"disk margin{of}", predicted.disk.size, note=note, usual=_degrees(predicted.disk.phase)))
    total = one.sample_period.searched
    if (delay := one.delay).searched:
        known = delay.decided and math.isfinite(delay.unstable)
        samples = f"{round(delay.stable / h)} steps decay, {round(delay.unstable / h)} grow" if known else ""
        samples = samples or below * (not predicted.crossovers)
        note = _noted_time(delay, one.found_delay, samples)
        times = 1e3 * one.predicted_delay, _values(DELAY, one)[1]
        rows.append(Row("delay [ms]" if total else "more delay [ms]", *times, note, extra=not total))
    if total:
        fixed = f"fixed by the law: {1e3 * (_fixed_period(found) or 0):g} ms" if _fixed_period(found) else ""
        settles = "stable at every period, as the vehicle settles between two samples" * math.isinf(predicted.sample_period)
        more = fixed, "all forces sampled" * predicted.all_sampled, settles
        note = _noted_time(one.sample_period, one.found_sample_period, *more)
        rows.append(Row("sample period [ms]", *_values(PERIOD, one), note))
    return rows


def _values(margin: Sequence[Field[LoopMargins]], one: LoopMargins) -> tuple[float, float]:
    """Returns the predicted and the found value of a margin in the unit in which the margin is printed."""
    predicted, found = (field.scale * field.value(one) for field in margin)
    return predicted, found


def _sampled_rows(gain: GainMargin, power: int = 1) -> list[Row]:
    """Returns a row for each timestep with the margin of the sampled loop; no rows if no finer searches ran.

    Args:
        gain: upper or lower gain margin of the loop.
        power: 1 for an upper margin; -1 for a lower margin, which is stored as the inverse of the gain factor.
    """
    return [
        Row(f"  sampled every {1e3 * search.timestep:g} ms", at**power, search.found**power, extra=True)
        for at, search in gain.tried
        if gain.finer.searched
    ]


def _join_notes(*texts: str) -> str:
    return "; ".join(filter(None, texts))


def _noted_time(edge: StabilityEdge, found: float, *texts: str) -> str:
    """Returns the note on a delay or a sample period, which contains a reason if the runs are not decisive.

    Args:
        edge: finished search for the delay or the sample period.
        found: delay or sample period found in MuJoCo [s]; NaN if the runs are not decisive.
        texts: additional notes on the delay or the sample period.
    """
    reason = f"stable up to {edge.stable:g} s; above {SLOWEST:g} s only predicted" * math.isnan(found)
    missed = "unstable there for less than a timestep" * (edge.unstable > edge.expected + 2 * edge.multiple)
    return _join_notes(*texts, missed, reason if edge.decided else UNDECIDED_NOTE)
