"""`python -m synth --fragility`: gain errors that a controller tolerates, and the effect of rounded coefficients."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from models.common.printed import cell, percent
from models.document.document import Block, Table, notes
from models.document.field import Field
from models.vehicle.vehicle import Vehicle
from synth.analysis.certificate import Certificate
from synth.controller.controller import Controller
from synth.controller.report import NORM
from synth.design.uncertainty import fragility as errors
from synth.design.uncertainty.problem import scaled_gain


@dataclass(frozen=True, eq=False)
class FragilityReport:
    """Fragility of a controller: the gain errors that the controller tolerates, and the effect of rounding its coefficients.

    Attributes:
        fragility: gain errors that the controller tolerates.
        rounded_certificates: certificates of the controller with rounded coefficients, by number format.
        lines: lines of text about tolerated gain errors and rounded coefficients.
        record: tolerated gain errors and rounded coefficients as JSON.
    """

    fragility: errors.Fragility
    rounded_certificates: dict[str, Certificate]
    lines: list[str]
    record: dict[str, Any]


def fragility_report(vehicle: Vehicle, controller: Controller) -> FragilityReport | None:
    """Computes the fragility of a controller. Returns None if the controller has no gain or if its loop is unstable."""
    if not controller.law.acts or not controller.certificate.stable:
        return None
    problem, names = controller.problem(vehicle.without_integrals), (controller.measured, vehicle.linear_model.inputs)
    norms, gain = problem.of_heights is None, controller.law.continuous()
    found = errors.fragility(scaled_gain(problem.plant, gain), norms)
    rounding = errors.rounding(controller.law, problem.closed_loop, problem.plant) if norms else {}
    lines = [errors.fragility_text(found, *names), *filter(None, [errors.rounding_text(found.norm, rounding)])]
    return FragilityReport(found, rounding, lines, errors.record(found, rounding, *names))


def describe(reports: Mapping[str, FragilityReport]) -> list[Block]:
    """Returns the fragility of one controller as sentences, or the fragility of several controllers as a table."""
    if len(reports) < 2:
        return [*notes(*(line for one in reports.values() for line in one.lines), detail="brief")]
    first = min(reports.values(), key=lambda one: len(one.rounded_certificates))
    kinds = {one.fragility.stable.proof for one in reports.values()}
    fields: list[Field[tuple[str, FragilityReport]]] = [
        Field("errors [%]", lambda of: of[0]),
        Field("unstable", lambda of: _between(of[1].fragility.stable)),
        *([] if len(kinds) == 1 else [Field("proof", lambda of: of[1].fragility.stable.proof)]),
        *(
            Field(f"norm + {percent(to)}", lambda of, to=to: _between(of[1].fragility.within[to]))
            for to in first.fragility.within
        ),
        *(
            Field(name, lambda of, name=name: of[1].rounded_certificates[name].norm.value, NORM.form)
            for name in first.rounded_certificates
        ),
    ]
    kind = f" ({kinds.pop()})" if len(kinds) == 1 and all(kinds) else ""
    text = (
        f"Errors of all signals: largest error proved harmless{kind}, then smallest error found harmful. "
        "int16, float16: norm of the rounded law."
    )
    return [*notes(text, detail="brief"), Table.of("fragility", text, fields, reports.items(), detail="brief")]


def _between(margin: errors.ErrorMargin) -> str:
    """Formats the proved tolerance and the smallest error that was found to be harmful, both in percent; a dash stands for a
    missing value.
    """
    return ", ".join(cell(100 * value if value else None, ".3g") for value in (margin.proved_margin, margin.smallest_violation))
