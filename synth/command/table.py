"""Rows of the design table of a vehicle file, and their output as a document (for the terminal or a report) or as JSON."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from models.common.errors import list_names
from models.common.printed import WIDTH, as_name, percent
from models.document.document import Block, Document, Statement, Table, notes, statements
from models.document.field import OMITTED_KEY, Field, Record, if_any
from models.laws.linear import FEWER, gain_text
from models.vehicle.controllers import NOMINAL
from models.vehicle.names import without_copies
from models.vehicle.vehicle import Vehicle
from synth.analysis.certificate import Certificate, LmiProof
from synth.analysis.lower_bounds.invariant_point import UNCHANGED_NORM, is_pole, without_control
from synth.analysis.lower_bounds.lower_bound import LowerBound, SampledBound
from synth.analysis.record import SAMPLED_BOUND, bound_record, to_record
from synth.analysis.specification import SampledNorm
from synth.analysis.stability import MARGINAL
from synth.controller.controller import Controller
from synth.controller.design_notes import pid_line, sign_note, twist_lines
from synth.controller.law_margins import LawMargins
from synth.controller.report import (
    BOUND,
    FEEDBACK_ALONE,
    GAP,
    GROWTH,
    LOWER_BOUND,
    NORM,
    PEAK,
    SLOWEST_POLE,
    filter_lines,
    growth_lines,
    ideal_lines,
    judged_lines,
    named_gain,
    norm_record,
    study_notes,
)
from synth.controller.sampled_report import (
    NORM_AS_IMPLEMENTED,
    PROVED_NORM,
    REACHED_GAIN,
    SAME,
    built_words,
    notes_on_sampled_loop,
)
from synth.plant.generalized import Plant

if TYPE_CHECKING:
    from synth.command.cross_check import CrossCheck
    from synth.command.fragility import FragilityReport

GAIN_WIDTH = WIDTH - 20  # a gain whose text has more characters than this is printed only with `-v`


@dataclass(frozen=True, eq=False)
class Row:
    """Row of the design table.

    Attributes:
        name: name of the controller.
        controller: controller that the row describes; None if its design failed.
        notes: sentences about the design of the controller and about its results.
        failures: texts of the claims that do not hold, or the reason why the design failed.
        worth: low estimate of the relative amount by which `--refine` would reduce the norm; 0 if this amount is negligible.
        witness: result of the cross-check with the solver Clarabel; None if no cross-check was requested.
        sampled: norm of the sampled-data loop; None if the vehicle file describes no implementation.
        sampled_below: lower bound on `sampled` for all controllers with the same measurements; None if the controller is not
            designed for the sampled-data loop.
        fragile: gain errors that the controller tolerates; None if this result was not requested.
        answers: sentences with the results that the user requested by options; `notes` also contains these sentences.
        ride: expected weighted acceleration on a road of average quality [m/s2]; None if no expected ride is defined.
        refined: True if the controller was refined; the short output then contains the gain of the controller, too.
        margins: stability of the law itself, and the stability margins of the closed loop if they are small; None if there is
            no law.
    """

    name: str
    controller: Controller | None
    notes: tuple[str, ...]
    failures: tuple[str, ...]
    worth: float = 0.0
    witness: "CrossCheck | None" = None
    sampled: SampledNorm | None = None
    sampled_below: SampledBound | None = None
    fragile: "FragilityReport | None" = None
    answers: tuple[str, ...] = ()
    ride: float | None = None
    refined: bool = False
    margins: LawMargins | None = None

    @property
    def certificate(self) -> Certificate | None:
        """Certificate of the controller; None if its design failed."""
        return self.controller.certificate if self.controller is not None else None

    @property
    def measures(self) -> str:
        """Names of the measured signals, joined in one text."""
        return ", ".join(self.controller.measured) or "nothing" if self.controller is not None else ""

    @property
    def sampled_gap(self) -> float | None:
        """Relative gap between the sampled-data norm and its lower bound; None if the norm or the bound is missing, or if the
        loop is unstable.
        """
        if self.sampled is None or self.sampled_below is None or not self.sampled.stable:
            return None
        return self.sampled.value / self.sampled_below.level - 1


def _of_stable_loop(row: Row, field: Field[Certificate]) -> Any:
    """Returns the value of a field that exists only for stable loops; if the loop is not stable, returns the stability verdict
    as text.
    """
    if row.certificate is None:
        return "NOT DESIGNED"
    value = field.value(row.certificate) if row.certificate.stable else row.certificate.stability.verdict.upper()
    return "infinite" if value == math.inf else value


CERTIFICATE = attrgetter("certificate")  # certificate of the row's controller
CONTROLLER = Field[Row]("controller", lambda row: row.name)
MEASURES = Field[Row]("measures", lambda row: row.measures.replace("_", " "), detail="full")
NORM_OR_VERDICT = Field[Row](NORM.label, lambda row: _of_stable_loop(row, NORM), NORM.form)
POLE_OR_VERDICT = Field[Row](
    SLOWEST_POLE.label, lambda row: _of_stable_loop(row, SLOWEST_POLE), SLOWEST_POLE.form, unit=SLOWEST_POLE.unit, detail="full"
)
BUILT_NORM: Field[Row] = NORM_AS_IMPLEMENTED.of(attrgetter("sampled"))
LEVEL = Field[Row](
    "its lower bound", lambda row: row.sampled_below.level if row.sampled_below is not None else None, LOWER_BOUND.form
)
ABOVE_LEVEL = Field[Row]("above that", lambda row: row.sampled_gap, percent)


def describe(vehicle: Vehicle, rows: Sequence[Row], limit: LowerBound, plant: Plant, apart: bool = False) -> Document:
    """Returns a document with the table of designs, the limit that holds for every design, and notes about the loops.

    Args:
        vehicle: vehicle of the controllers.
        rows: rows of the table, one for each controller.
        limit: part of the norm that no control force can change, which is a lower bound for all controllers.
        plant: generalized plant for which `limit` holds.
        apart: True if the norms of sampled-data loops are shown only in a separate table.
    """
    controllers = [row.controller for row in rows if row.controller is not None]
    built, bounded = any(row.sampled is not None for row in rows), any(row.sampled_below is not None for row in rows)

    def certificate(row: Row) -> str:
        cured = notes_on_sampled_loop(vehicle, row.certificate, row.sampled) if row.certificate is not None else ()
        return "; ".join(row.failures or cured) or "holds"

    held = Field[Row]("certificate", certificate, detail="full")
    others = [field.of(CERTIFICATE) for field in (PEAK, LOWER_BOUND, GAP)]
    if bounded:  # a terminal is too narrow for both these columns and the column with the lower bound of the sampled-data loop
        others = [replace(field, detail="full") for field in others]
    sampled = [*[BUILT_NORM] * (built and not apart), *[LEVEL, ABOVE_LEVEL] * bounded]
    fields = [CONTROLLER, MEASURES, BOUND.of(CERTIFICATE), NORM_OR_VERDICT, *sampled, *others, POLE_OR_VERDICT, held]
    said = [(row.name, text) for row in rows if row.controller is not None for text in judged_lines(row.controller)]
    blocks: list[Block] = [Statement(limit_text(limit, plant), detail="brief")]
    blocks.append(
        Table.of("designs", "Norms, bounds and certificates of all controllers.", fields, rows, words=2, detail="brief")
    )
    blocks += notes(*ideal_lines(vehicle, controllers))
    if not (apart or vehicle.implementation.undelayed):
        text = "Column 'sampled' is the norm of the sampled-data loop, including the motion between samples"
        blocks += notes(f"{text}: {built_words(vehicle)}.")
    blocks += notes(*filter_lines(vehicle), *twist_lines(vehicle), *_unlimited_forces(vehicle, controllers))
    blocks += statements([(one.name, text) for one in controllers for text in study_notes(vehicle, one)], "brief")
    blocks += statements([one for one in said if one[1] == FEEDBACK_ALONE])
    blocks += statements([one for one in said if one[1] != FEEDBACK_ALONE], detail="full")
    blocks += notes(EXPLANATION, detail="full")
    if built:
        caption = f"The norm of the ideal loop, and of the sampled-data loop with {built_words(vehicle)}."
        sampled_rows = [row for row in rows if row.sampled is not None]
        blocks.append(Table.of("norms", caption, NORMS, sampled_rows, detail="normal" if apart else "full"))
    return Document("Designs and certificates", tuple(blocks))


def _unlimited_forces(vehicle: Vehicle, controllers: Sequence[Controller]) -> list[str]:
    """Returns a note about forces that no weight limits, if the table contains a controller that the command designed."""
    given = {"passive", *(name for name, entry in vehicle.controllers.items() if entry.law is not None)}
    free = [force for force in vehicle.linear_model.inputs if not any(force in one.terms for one in vehicle.weighted)]
    text = f"No weight limits {list_names(free)}, so gains can become very large: add {{}} = 1e-4 to [performance], for example."
    return [text.format(free[0])] if free and not given.issuperset(one.name for one in controllers) else []


def limit_text(limit: LowerBound, plant: Plant) -> str:
    """Describes the lower bound on the norm, which is the part of the norm that no control force can change.

    If a mode must be stabilised, the lower bound holds only for controllers that stabilise this mode. At an invariant point,
    the norm without control may equal the lower bound.
    """
    if limit.limit_at is None:
        return "Limit: none. At every frequency, control forces can change the whole response of z to the road."
    lowest, where = f"Limit: no controller has a norm below {LOWER_BOUND.digits(limit.gamma)}", PEAK.text(limit.limit_at)
    if is_pole(plant, limit.limit_at):  # the forces may change the whole response except this mode
        return f"{lowest}, because control must stabilise the mode at {where}, which does not decay by itself."
    free = without_control(plant, limit.limit_at)
    if free <= limit.gamma * (1 + UNCHANGED_NORM):
        return f"{lowest}: no force changes z at {where}."
    return (
        f"{lowest}: at {where}, no controller lowers the gain to z further. Without control, this gain is "
        f"{LOWER_BOUND.digits(free)}."
    )


EXPLANATION = (
    "LMI (20) proves the bound, and two other methods compute the norm. No controller with the same measurements, of any "
    "order, has "
    "a norm below the lower bound."
)


def _difference(row: Row) -> str:
    """Formats the difference between the norms of the ideal and the sampled-data loop; "-" if the norms cannot be compared."""
    one, norm = row.controller, row.sampled
    if one is None or one.hardware != NOMINAL or not one.certificate.stable or norm is None or not norm.stable:
        return "-"
    share = norm.value / one.certificate.norm.value - 1
    return "equal to" if abs(share) <= SAME else f"{percent(abs(share))} {'below' if share < 0 else 'above'}"


NORMS: tuple[Field[Row], ...] = (
    CONTROLLER,
    replace(NORM_OR_VERDICT, label="norm, ideal loop"),
    replace(BUILT_NORM, label="norm, as built"),
    Field("that is", _difference),
    REACHED_GAIN.of(lambda row: row.sampled),
)


def answers(rows: Sequence[Row], gains: bool, checked: bool = False) -> list[Statement]:
    """Describes each controller: its gain or first specification, the results that options request, and failures.

    Args:
        rows: rows of the table, one for each controller.
        gains: False to omit gains and specifications, except the gains of refined controllers.
        checked: True to describe the result of `--check`, too.
    """
    own = without_copies(row.name for row in rows)
    shown = [
        row for row in rows if row.controller is not None and (not row.refined or row.name in own)
    ]  # copies of the same controller are refined to the same gain
    promised = any(row.controller is not None and row.controller.specifications for row in rows)
    said = []
    for row in shown:
        said += [(row.name, text) for text in _first(row, gains and not promised) if gains or row.refined]
    said += [(row.name, text) for row in shown for text in _requested_notes(row, checked)]
    failed = [
        Statement(f"{as_name(row.name)} {'FAILS' if row.controller is not None else 'NOT DESIGNED'}: {text}", "fails", "brief")
        for row in rows
        for text in failures_of(row)
    ]
    return [*statements(said, "brief"), *failed]


def _first(row: Row, gains: bool) -> Iterator[str]:
    """Describes a controller by its first specification, by its gain if the text is short, or otherwise by undamped natural
    frequencies.
    """
    controller = row.controller
    assert controller is not None
    if lacks_damping(controller):
        damped = [(pole, f" (damping {DAMPING.cell(pole)})" if pole.real else "") for pole in _poles(controller)]
        motions = ", ".join(f"{HERTZ.text(abs(pole))}{damping}" for pole, damping in damped)
        yield f"undamped without control; natural frequencies {motions}"
    elif controller.specifications:
        first, *others = controller.specifications
        kept = sum(one.holds for one in others)
        rest = f"; {kept} of {len(others)} other goals hold" if others else ""
        yield f"{replace(first, where='').text}{rest}"
    elif (gains or row.refined) and controller.designed:
        text = pid_line(controller) if controller.law.states else f"gain {gain_text(controller.law.D)}"
        yield from [text] if text and (controller.law.states or len(text) <= GAIN_WIDTH) else []
    if controller.preview is not None:
        yield f"also uses the road {controller.ahead:g} s ahead (preview)"


def _requested_notes(row: Row, checked: bool) -> Iterator[str]:
    assert row.controller is not None
    yield from (part for remark in row.controller.remarks for part in remark.split("; ") if part.startswith(FEWER))
    yield from row.answers
    if row.witness is not None:
        yield row.witness.text
    if checked:
        yield from row.notes[-1:]


def failures_of(row: Row) -> list[str]:
    """Describes the failures of the controller in a row. If wrong signs of the gains may have caused the failures, the first
    description mentions the signs.
    """
    first, *others = [*row.failures] or [""]
    return [f"{first}{sign_note(row.controller) if row.controller is not None else ''}", *others] if first else []


def lacks_damping(controller: Controller) -> bool:
    """Returns True for a vehicle without control if some motion is undamped; such a motion does not count as a failure."""
    return not controller.measured and controller.certificate.stability.verdict == MARGINAL


def _poles(controller: Controller) -> list[complex]:
    """Returns the poles of a loop, sorted by natural frequency, with one pole of each conjugate pair.

    For poles on the imaginary axis, rounding errors in the real part are removed.
    """
    own = controller.certificate.own
    poles = np.where(own.on_axis, 1j * np.imag(own.poles), own.poles)
    poles = np.where(np.abs(poles) > own.rounding, poles, 0.0)
    return sorted((complex(pole) for pole in poles if pole.imag >= 0), key=abs)


HERTZ = Field[complex]("frequency", abs, ".3g", 1 / (2 * math.pi), unit="Hz")
DAMPING = Field[complex]("damping", lambda pole: abs(pole.real) / abs(pole) if pole else 0.0, ".2g")


def _goals(row: Row) -> str | None:
    specifications = row.controller.specifications if row.controller is not None else ()
    return f"{sum(one.holds for one in specifications)} of {len(specifications)}" if specifications else None


def _least_damped(row: Row) -> complex | None:
    """Returns the pole with the smallest damping ratio of a loop."""
    return min(_poles(row.controller), key=DAMPING.value, default=None) if row.controller is not None else None


LOOPS: tuple[Field[Row], ...] = (
    CONTROLLER,
    POLE_OR_VERDICT.of(lambda row: row),
    DAMPING.of(_least_damped, "least damping"),
    HERTZ.of(_least_damped, "at"),
    Field("states of the law", lambda row: str(row.controller.law.states) if row.controller is not None else None),
    Field("goals reached", _goals),
)  # columns of `loop_table`


def loop_table(rows: Sequence[Row]) -> Table:
    """Returns a table of the poles of all loops, for controllers whose details do not fit on a screen."""
    return Table.of("loops", "Poles of all loops.", [replace(one, detail="normal") for one in LOOPS], rows, detail="full")


NOT_SHOWN = "shown only with --controller NAME -v, or --json: gains, other poles and goals"
INSIDE = "the sampled norm is reached within one sample period: no controller at this rate has a smaller norm"


def details(vehicle: Vehicle, row: Row) -> Document:
    """Returns all information about a controller: its law, poles, specifications, notes and failures."""
    if row.controller is None:
        return Document(f"controller {row.name}", notes(*(f"NOT DESIGNED: {failure}" for failure in row.failures), detail="full"))
    controller, certificate = row.controller, row.controller.certificate
    said = [
        *([named_gain(vehicle, controller)] if controller.measured else ["no control force"]),
        *([f"poles [1/s]: {'; '.join(map(pole_words, _poles(controller)))}"] if len(_poles(controller)) else []),
        *([certificate.stability.words] if lacks_damping(controller) else []),
        *(f"specification: {one.text}" for one in controller.specifications),
        *([row.witness.text] if row.witness is not None else []),
        *(row.fragile.lines if row.fragile is not None else []),
        *growth_lines(vehicle, controller),
        *(note for note in (*row.notes, *certificate.remarks) if note not in judged_lines(controller)),
        *([INSIDE] if row.sampled is not None and row.sampled.inside else []),
        *(f"FAILS: {failure}" for failure in failures_of(row)),
    ]
    law, *others = said
    if law.startswith("gain: "):  # the printed gain shows the names of its signals
        return Document(f"controller {row.name}, {law}", notes(*others, detail="full"), "full")
    return Document(f"controller {row.name}: measures {row.measures}", notes(*said, detail="full"), "full")


def pole_words(pole: complex) -> str:
    """Returns a pole as text; if the mode oscillates, the text includes its natural frequency and damping ratio."""
    if not pole.imag:
        return SLOWEST_POLE.digits(pole.real)
    place = f"{SLOWEST_POLE.digits(pole.real)} +- {SLOWEST_POLE.digits(pole.imag)}j"
    return f"{place} ({HERTZ.text(abs(pole))}, damping {DAMPING.cell(pole)})"


def _hardware(controller: Controller) -> dict[str, Any]:
    """Returns, for JSON, the sensor noise, loads and actuator lag that a norm takes into account; empty if there are none."""
    hardware = controller.hardware
    noise = {"noise": dict(zip(controller.measured, hardware.noise, strict=True))} if hardware.noise else {}
    noise |= {"loads": dict(hardware.loads)} if hardware.loads else {}
    return noise | ({"actuator_bandwidth": hardware.bandwidth} if hardware.bandwidth is not None else {})


# the computed smallest eigenvalue, and the value that this eigenvalue must exceed for a proof
EIGENVALUE = Record("smallest", "rounding")
LMI = Record[LmiProof](proved="holds", X=EIGENVALUE.all("positive"), minus_20=EIGENVALUE.all("negative"))
CLAIMS = Record[Certificate](
    Record(routes_gap=lambda one: one.norm.gap if one.stable else None), PEAK, Record("poles"), LOWER_BOUND, GAP
)
DESIGN_RECORD = Record[Any](  # JSON object for a controller whose design succeeded
    Record("name", measured="controller.measured"),
    lambda row: row.controller.law.record,
    lambda row: _hardware(row.controller),
    Record(designed="controller.designed", design=lambda row: "sampled" if row.controller.sampled else OMITTED_KEY),
    *(one.of(CERTIFICATE) for one in (BOUND, NORM)),
    lambda row: PROVED_NORM(row.sampled) if row.sampled is not None else {},
    lambda row: {SAMPLED_BOUND: row.sampled_below.level, "sampled_gap": row.sampled_gap} if row.sampled_below is not None else {},
    lambda row: CLAIMS(row.certificate),
    Record(expected_ride="ride", stability="certificate.stability.verdict"),
    lambda row: GROWTH(row.controller),
    margins=lambda row: row.margins.record if row.margins is not None else OMITTED_KEY,
    lmi=LMI.all("certificate.proof"),
    certificate=lambda row: to_record(row.certificate) | norm_record(row.sampled) | bound_record(row.sampled_below),
    notes=lambda row: [*row.notes, *row.certificate.remarks],
    failures="failures",
    refine_lowers_by_at_least=lambda row: row.worth or None,
    promises=if_any(lambda row: [promise.record for promise in row.controller.specifications]),
    cross_check=lambda row: row.witness.record if row.witness is not None else None,
    fragility=lambda row: row.fragile.record if row.fragile is not None else OMITTED_KEY,
)


def record(row: Row) -> dict[str, Any]:
    """Returns a row of the table as a JSON object in SI units: either the design, or the reason why the design failed."""
    return DESIGN_RECORD(row) if row.controller is not None else {"name": row.name, "reason": "; ".join(row.failures)}
