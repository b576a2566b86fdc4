"""`python -m synth --fragility`: the errors of measurements and forces that a controller tolerates, and the cost of rounding."""

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
    """The fragility of a controller.

    Attributes:
        found: the errors that it tolerates.
        rounding: certificates with rounded coefficients, by number format.
        measured: names of the measured signals.
        forces: names of the vehicle's forces.
    """

    found: errors.Fragility
    rounding: dict[str, Certificate]
    measured: tuple[str, ...]
    forces: tuple[str, ...]

    @property
    def lines(self) -> list[str]:
        """In words."""
        return [
            errors.fragility_text(self.found, self.measured, self.forces),
            *filter(None, [errors.rounding_text(self.found.norm, self.rounding)]),
        ]

    @property
    def record(self) -> dict[str, Any]:
        """The fragility as JSON."""
        return errors.fragility_object(self.found, self.rounding, self.measured, self.forces)


def fragility_report(vehicle: Vehicle, controller: Controller | None) -> FragilityReport | None:
    """Computes the fragility of a controller. Returns None without a controller, a gain or a stable loop."""
    if controller is None or not controller.law.acts or not controller.certificate.stable:
        return None
    posed = controller.problem(vehicle.without_integrals)
    norms, gain = posed.of_heights is None, controller.law.continuous()
    borne = errors.fragility(scaled_gain(posed.plant, posed.Cy, gain, posed.Dyw, posed.feedthrough), norms)
    forces = tuple(vehicle.linear_model.inputs)
    rounded = errors.rounding(controller.law, posed.closed_loop, posed.plant) if norms else {}
    return FragilityReport(borne, rounded, controller.measured, forces)


def describe(reports: Mapping[str, FragilityReport]) -> list[Block]:
    """Returns one controller's fragility in sentences, that of several as a table; empty without any."""
    if len(reports) < 2:
        return [*notes(*(line for one in reports.values() for line in one.lines), detail="brief")]
    first = min(reports.values(), key=lambda one: len(one.rounding))
    fields: list[Field[tuple[str, FragilityReport]]] = [Field("errors [%]", lambda of: of[0])]
    fields.append(Field("unstable", lambda of: _between(of[1].found.stable)))
    for share in first.found.within:
        fields.append(Field(f"norm + {percent(share)}", lambda of, to=share: _between(of[1].found.within[to])))
    for name in first.rounding:
        fields.append(Field(name, lambda of, to=name: of[1].rounding[to].norm.value, NORM.form))
    text = "Errors that each measurement and force may have: proved harmless, found harmful. int16, float16: the norm so rounded."
    return [*notes(text, detail="brief"), Table.of("fragility", text, fields, reports.items(), detail="brief")]


def _between(margin: errors.ErrorMargin) -> str:
    """Returns the errors that are proved to be harmless and those that are found not to be; a dash for none."""
    return ", ".join(cell(100 * value if value else None, ".3g") for value in (margin.proved_margin, margin.smallest_violation))
