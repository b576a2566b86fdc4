"""Designs in words and numbers: the table on the terminal and the object for `--json`."""

import math
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from models.common.printed import WIDTH, command, finite, option, percent, table, wrapped
from models.document.field import cells, json_object, titles
from models.laws.linear import FEWER
from models.vehicle.names import without_copies
from models.vehicle.vehicle import Vehicle
from synth.analysis.certificate import LmiProof
from synth.analysis.lower_bound import SampledBound
from synth.analysis.record import SAMPLED_BOUND, bound_record, to_record
from synth.analysis.specification import SampledNorm
from synth.analysis.stability import MARGINAL
from synth.controller.controller import Controller
from synth.controller.law_margins import LawMargins
from synth.controller.report import (
    BOUND,
    FEEDBACK_ALONE,
    GAP,
    LOWER_BOUND,
    NORM,
    PEAK,
    SLOWEST_POLE,
    gain_lines,
    growth_lines,
    growth_object,
    heading_lines,
    norm_lines,
    norm_object,
    norm_record,
    pid_line,
    preview_lines,
    sign_note,
)

if TYPE_CHECKING:
    from synth.command.cross_check import CrossCheck
    from synth.command.fragility import FragilityReport


LONGEST = 20  # letters of a name beside which a line has room
WORSE = 1.005  # times the passive suspension's ride: less is within the digits shown


@dataclass(frozen=True, eq=False)
class Row:
    """A line of the table.

    Attributes:
        name: name of the controller.
        controller: controller of the row; None if its design failed.
        notes: notes on the controller.
        failures: claims that do not hold, or the reason of a failed design.
        worth: relative decrease of the norm that `--refine` reaches at least; 0 if it is negligible.
        witness: result of a second solver, if requested.
        sampled: the norm as implemented, if the vehicle file has an implementation.
        sampled_below: lower bound on that norm for any controller with these measurements, if designed for the sampled loop.
        fragile: the tolerated errors, if requested.
        answers: sentences that options requested; the notes contain them, too.
        ride: expected weighted acceleration on an average road [m/s2], or None.
        refined: True for a controller that was refined, whose gain is the answer.
        margins: the stability of its law by itself, and its small margins; None if there is no law.
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
    def sampled_gap(self) -> float | None:
        """Relative distance of the sampled norm from its lower bound; None without either."""
        if self.sampled is None or self.sampled_below is None or not self.sampled.stable:
            return None
        return self.sampled.value / self.sampled_below.level - 1


def row_object(row: Row) -> dict[str, Any]:
    """Returns a row as a JSON object: SI units, None for infinite or missing values."""
    if row.controller is None:
        return {"name": row.name, "reason": "; ".join(row.failures)}
    controller, certificate = row.controller, row.controller.certificate
    return {
        "name": row.name,
        "measured": list(controller.measured),
        **controller.law.record,
        **_hardware_object(controller),
        "designed": controller.designed,
        **({"design": "sampled"} if controller.sampled else {}),
        **json_object((BOUND, NORM), certificate),
        **norm_object(row.sampled),
        **({SAMPLED_BOUND: row.sampled_below.level, "sampled_gap": row.sampled_gap} if row.sampled_below is not None else {}),
        "routes_gap": certificate.norm.gap if certificate.stable else None,
        **json_object((PEAK,), certificate),
        "poles": [[float(pole.real), float(pole.imag)] for pole in certificate.poles],
        **json_object((LOWER_BOUND, GAP), certificate),
        "expected_ride": row.ride,
        "stability": certificate.stability.verdict,
        **growth_object(controller),
        **({"margins": row.margins.record} if row.margins is not None else {}),
        "lmi": _lmi_object(certificate.proof),
        "certificate": to_record(certificate) | norm_record(row.sampled) | bound_record(row.sampled_below),
        "notes": [*row.notes, *certificate.remarks],
        "failures": list(row.failures),
        "refine_lowers_by_at_least": row.worth or None,
        **({"promises": [promise.record for promise in controller.specifications]} if controller.specifications else {}),
        "cross_check": _witness_object(row.witness) if row.witness is not None else None,
        **({"fragility": row.fragile.record} if row.fragile is not None else {}),
    }


def _hardware_object(controller: Controller) -> dict[str, Any]:
    """Returns noise, loads and lag of a norm as JSON; empty without any."""
    hardware = controller.hardware
    noise = {"noise": dict(zip(controller.measured, hardware.noise, strict=True))} if hardware.noise else {}
    noise |= {"loads": dict(hardware.loads)} if hardware.loads else {}
    return noise | ({"actuator_bandwidth": hardware.bandwidth} if hardware.bandwidth is not None else {})


def table_lines(rows: Sequence[Row]) -> list[str]:
    """Returns one line for each controller; norms as implemented replace columns that are printed in full above."""
    built, bounded = any(row.sampled is not None for row in rows), any(row.sampled_below is not None for row in rows)
    before, after = (BOUND, NORM), (PEAK, LOWER_BOUND, *(() if built else (GAP,)), SLOWEST_POLE)
    of_sampled = ("sampled",) if built else ()
    if bounded:  # a lower bound stands behind each of the two norms
        before, after, of_sampled = (BOUND, NORM, LOWER_BOUND), (), ("sampled", LOWER_BOUND.title, GAP.title)
    headings = (*titles(before), *of_sampled, *titles(after))
    lines: list[tuple[str, ...] | str] = [("controller", *headings)]
    longest = max(len("controller"), *(len(row.name) for row in rows if len(row.name) <= LONGEST), 0)
    empty = ("",) * (len(headings) - 1)
    for row in rows:
        certificate = row.controller.certificate if row.controller is not None else None
        if certificate is None:
            lines.append(f"{row.name:{longest}}  NOT DESIGNED")  # a cell would be wider than all numbers
        elif not certificate.stable and (row.sampled is None or not row.sampled.stable):
            lines.append((row.name, certificate.stability.verdict.upper(), *empty))
        else:
            [(bound, norm, *below)], [others] = cells(before, [certificate]), cells(after, [certificate])
            norm = norm if certificate.stable else certificate.stability.verdict.upper()
            sampled = (_sampled(row.sampled),) if built else ()
            sampled += _sampled_bound(row) if bounded else ()
            lines.append((row.name, bound, norm, *below, *sampled, *others))
    return table(lines, indent="")


def _sampled(norm: SampledNorm | None) -> str:
    """Returns the cell of the norm as implemented."""
    return "-" if norm is None else f"{norm.value:.7g}" if norm.stable else "UNSTABLE"


def _sampled_bound(row: Row) -> tuple[str, str]:
    """Returns the cells of the sampled loop's lower bound and of the gap to it."""
    bound, gap = row.sampled_below, row.sampled_gap
    return f"{bound.level:.7g}" if bound is not None else "-", percent(gap) if gap is not None else "-"


def detail_lines(row: Row, vehicle: Vehicle) -> list[str]:
    """Returns the lines of a controller in full."""
    if row.controller is None:
        return [f"controller {row.name}", *(f"  NOT DESIGNED: {failure}" for failure in row.failures)]
    controller, certificate = row.controller, row.controller.certificate
    lines = heading_lines(controller)
    own = certificate.own
    lines += _pole_lines(np.where(own.on_axis, 1j * np.imag(own.poles), own.poles))
    if certificate.stable:
        lines.append(f"  norm by level sets and by a sweep, {certificate.norm.gap:.0e} apart")
    if certificate.proof is not None:
        # What is not proved stands among the failures, in words: a number here would read as if it were.
        parts = {"X > 0": certificate.proof.positive, "LMI (20) < 0": certificate.proof.negative}
        proved = {name: part for name, part in parts.items() if part.proved}
        if proved:
            by = " and ".join(f"{name} by {part.smallest:.1e}" for name, part in proved.items())
            rounding = " and ".join(f"{part.rounding:.0e}" for part in proved.values())
            lines.append(f"  {by}, {'both ' * (len(proved) > 1)}balanced; rounding is at most {rounding}")
    if certificate.gap is not None:
        lines.append(f"  norm {percent(certificate.gap)} above the lower bound")
    for promise in controller.specifications:
        lines += wrapped(promise.text, "  promise: ", 4)
    free = undamped(controller)
    lines += [f"  {line}" for line in ([certificate.stability.words] if free else norm_lines(vehicle, controller, row.sampled))]
    if row.sampled_gap is not None and row.sampled_below is not None:
        lines.append(
            f"  sampled norm {percent(row.sampled_gap)} above {row.sampled_below.level:.7g}, which no controller with these "
            "measurements beats at this rate"
        )
    if row.witness is not None:
        lines.append(f"  {row.witness.text}")
    if row.fragile is not None:
        lines += [f"  {line}" for line in row.fragile.lines]
    notes = (*growth_lines(vehicle, controller), *row.notes, *certificate.remarks)
    return [*lines, *(f"  {note}" for note in notes), *(f"  FAILS: {failure}" for failure in _failures(row))]


def undamped(controller: Controller) -> bool:
    """Returns True for a vehicle without control that does not damp some motion: a property of the vehicle, not a failure."""
    return not controller.measured and controller.certificate.stability.verdict == MARGINAL


def answer_lines(rows: Sequence[Row], checked: bool = False) -> list[str]:
    """Returns the requested answers about several controllers, equal answers in one sentence, and the failures."""
    alike = dict[str, list[str]]()
    own = without_copies(row.name for row in rows)
    shown = [row for row in rows if not row.refined or row.name in own]  # refined, a printed copy comes to what the other does
    for row in shown:
        for each in _answers(row, checked) if row.controller is not None else []:
            alike.setdefault(each, []).append(row.name)
    if ahead := [row.name for row in rows if row.controller is not None and row.controller.preview is not None]:
        alike.setdefault(FEEDBACK_ALONE, []).extend(ahead)
    lines = [line for row in shown if row.refined and row.controller is not None for line in _gain(row.controller)]
    lines += [line for each, names in alike.items() for line in wrapped(each, f"{', '.join(names)}: ", 4)]
    return [*lines, *(line for row in rows for line in _failure_lines(row))]


def _gain(controller: Controller) -> list[str]:
    """Returns the line of a designed gain, empty where no line holds it, or the gains of a designed PI or PID law."""
    if controller.designed and controller.law.states:
        pid = pid_line(controller)
        return wrapped(pid, f"{controller.name}: ", 4) if pid else []
    gain = gain_lines(controller.law.D, f"{controller.name}: gain ") if controller.designed else []
    return gain if len(gain) == 1 and len(gain[0]) <= WIDTH else []


def _answers(row: Row, checked: bool) -> list[str]:
    remarks = row.controller.remarks if row.controller is not None else ()
    return [
        *(part for remark in remarks for part in remark.split("; ") if part.startswith(FEWER)),
        *row.answers,
        *([row.witness.text] if row.witness is not None else []),
        *(row.notes[-1:] if checked else []),
    ]


def _failure_lines(row: Row) -> list[str]:
    return [f"{row.name} {'FAILS' if row.controller is not None else 'NOT DESIGNED'}: {failure}" for failure in _failures(row)]


def _failures(row: Row) -> list[str]:
    """Returns what fails, the first with a note on the signs of a law if they may be why."""
    first, *others = [*row.failures] or [""]
    return [f"{first}{sign_note(row.controller) if row.controller is not None else ''}", *others] if first else []


def short_lines(row: Row, gains: bool = True, checked: bool = False) -> list[str]:
    """Returns the first specification of a controller with goals, or a short designed gain, requested answers, and failures.

    Args:
        gains: False to omit the gains.
        checked: True for a line on what was checked.
    """
    if row.controller is None:
        return _failure_lines(row)
    if undamped(row.controller):
        return [*_undamped_lines(row.controller), *_failure_lines(row)]
    promises = row.controller.specifications
    if promises:
        kept = sum(promise.holds for promise in promises[1:])
        first = replace(promises[0], where="")  # at which frequency, and of which vehicle, is told by `-v`
        lines = wrapped(f"{first.text}{f'; {kept} more kept' if kept else ''}", f"{row.name}: ", 4)
    else:
        lines = _gain(row.controller) if gains else []
    if row.controller.preview is not None:
        lines += [*preview_lines(row.controller, f"{row.name}: "), *wrapped(FEEDBACK_ALONE, f"{row.name}: ", 4)]
    lines += [part for each in _answers(row, checked) for part in wrapped(each, f"{row.name}: ", 4)]
    return [*lines, *_failure_lines(row)]


def _undamped_lines(controller: Controller) -> list[str]:
    """Returns the natural frequencies of an undamped vehicle, with the damping ratios of motions that decay."""
    own, motions = controller.certificate.own, []
    for pole, free in sorted(zip(own.poles, own.on_axis, strict=True), key=lambda one: abs(one[0])):
        if pole.imag >= 0:
            damping = "" if free else f" (damping {-pole.real / abs(pole):.2g})"
            motions.append(f"{abs(pole) / (2 * math.pi) if abs(pole) > own.rounding else 0.0:.4g} Hz{damping}")
    return wrapped(f"undamped without control; natural frequencies {', '.join(motions)}", f"{controller.name}: ", 4)


def semi_active_lines(vehicle: Vehicle) -> list[str]:
    """Returns a line that lists the laws to which linear analysis does not apply; empty without any."""
    names = [name for name in vehicle.controller_names if name not in vehicle.linear_names]
    return [f"no linear claim, so not in this table: {', '.join(names)}; sim.drive and sim.campaign run them"] if names else []


def _witness_object(witness: "CrossCheck") -> dict[str, Any]:
    """Returns a cross-check as a JSON object."""
    return {**asdict(witness), "apart": witness.apart, "above": witness.above}


def refine_lines(rows: Sequence[Row], vehicle: str, whole: bool) -> list[str]:
    """Returns the norms that `--refine` lowers by more than the table's last digit; empty if none.

    Args:
        vehicle: argument of `--vehicle`.
        whole: True for the command below it.
    """
    worth = [row for row in rows if row.worth]
    if not worth:
        return []
    shares = ", ".join(f"{row.name} by {_at_least(row.worth)} or more" for row in worth)
    named = [option("--controller", row.name) for row in worth]
    if not whole:
        return [f"refine: --refine lowers the norm of {shares}"]
    return [
        f"refine: --refine lowers the norm of {shares}:",
        *command(["python -m synth", option("--vehicle", vehicle), *named, "--refine"]),
    ]


def ride_lines(rows: Sequence[Row], passive: float | None, road: str, given: str) -> list[str]:
    """Returns the expected ride of every controller, and those that ride worse than the passive suspension; empty if unknown.

    Args:
        passive: ride of the passive suspension [m/s2], or None.
        given: assumption on the forces, in words after a comma, or empty.
    """
    rides = {row.name: row.ride for row in rows if row.ride is not None}
    if not rides:
        return []
    rides = ({"passive": passive} if passive is not None else {}) | rides
    changes = {name: "" if not passive or name == "passive" else f" ({_change(ride / passive)})" for name, ride in rides.items()}
    listed = ", ".join(f"{name} {ride:.3g}{changes[name]}" for name, ride in rides.items())
    lines = [f"ride: expected weighted acceleration, {road}, of the ideal loop{given} [m/s2]: {listed}"]
    worse = [name for name, ride in rides.items() if passive and ride > WORSE * passive]
    lines += [f"ride: WORSE than passive: {', '.join(worse)}; the norm weighs other things than comfort"] if worse else []
    return lines


def _change(ratio: float) -> str:
    return f"{100 * (ratio - 1):+.0f} %"


def verdict_lines(rows: Sequence[Row]) -> list[str]:
    """Returns the verdict: the controllers with claims that fail, and those that are unstable as implemented."""
    wrong = [f"{row.name} {'is not designed' if row.controller is None else 'FAILS'}" for row in rows if row.failures]
    verdict = f"every claim holds, of {len(rows)} controller{'s' * (len(rows) != 1)}"
    verdict = f"not every claim holds: {', '.join(wrong)}" if wrong else verdict
    judged = [row for row in rows if row.controller is not None and not undamped(row.controller)]
    lost = [row.name for row in judged if row.sampled is not None and not row.sampled.stable]
    if lost:
        verdict += f"; UNSTABLE as the computer runs it: {', '.join(lost)}"
    grow = [row.name for row in rows if row.margins is not None and row.margins.growth]
    if grow:
        verdict += f"; a law UNSTABLE by itself: {', '.join(grow)}"
    return [verdict]


def _at_least(share: float) -> str:
    """A share in percent, cut after two digits."""
    percents = 100 * share
    digit = 10.0 ** (math.floor(math.log10(percents)) - 1)
    return f"{math.floor(percents / digit) * digit:.2g} %"


def _pole_lines(poles: Collection[complex]) -> list[str]:
    """Returns lines on poles: pairs with undamped natural frequency and damping ratio, a line each, and real ones on one."""
    start, pairs = "  poles ", [pole for pole in poles if pole.imag > 0]
    numbers = [f"{pole.real:.4g} +- {pole.imag:.4g}j" for pole in pairs]
    width = max(map(len, numbers), default=0)
    lines = [
        f"{number:{width}}  {abs(pole) / (2 * math.pi):.3g} Hz, damping {0.0 - pole.real / abs(pole):.2g}"
        for number, pole in zip(numbers, pairs, strict=True)
    ]
    lines += wrapped("  ".join(f"{pole.real:.4g}" for pole in poles if not pole.imag), "", 0)
    return [f"{start if not i else ' ' * len(start)}{line}" for i, line in enumerate(filter(None, lines))]


def _lmi_object(proof: LmiProof | None) -> dict[str, Any] | None:
    """Smallest eigenvalues of X and of minus (20), balanced, with what each must exceed, and whether both are proved."""
    if proof is None:
        return None
    parts = {"X": proof.positive, "minus_20": proof.negative}
    return {"proved": proof.holds} | {
        name: {"smallest": finite(part.smallest), "rounding": finite(part.rounding)} for name, part in parts.items()
    }
