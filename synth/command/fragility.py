"""`python -m synth --fragility`: the errors of measurements and forces that a controller tolerates, and the cost of rounding."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from models.common.printed import finite, percent, table, wrapped
from models.vehicle.vehicle import Vehicle
from synth.analysis.certificate import Certificate
from synth.controller.controller import Controller
from synth.design.uncertainty.fragility import Fragility, fragility, fragility_object, fragility_text, rounding, rounding_text
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

    found: Fragility
    rounding: dict[str, Certificate]
    measured: tuple[str, ...]
    forces: tuple[str, ...]

    @property
    def lines(self) -> list[str]:
        """In words."""
        return [fragility_text(self.found, self.measured, self.forces), rounding_text(self.found.norm, self.rounding)]

    @property
    def record(self) -> dict[str, Any]:
        """The fragility as JSON."""
        return fragility_object(self.found, self.rounding, self.measured, self.forces)


def fragility_report(vehicle: Vehicle, controller: Controller | None) -> FragilityReport | None:
    """Computes the fragility of a controller. Returns None without a controller, a gain or a stable loop."""
    if controller is None or not controller.law.acts or not controller.certificate.stable:
        return None
    posed = controller.problem(vehicle.without_integrals)
    borne = fragility(scaled_gain(posed.plant, posed.Cy, controller.law.continuous(), posed.Dyw, posed.feedthrough))
    forces = tuple(vehicle.linear_model.inputs)
    return FragilityReport(borne, rounding(controller.law, posed.closed_loop, posed.plant), controller.measured, forces)


def short_lines(reports: Mapping[str, FragilityReport]) -> list[str]:
    """Returns one controller's fragility in words, that of several as a table; empty without any."""
    if len(reports) < 2:
        return [line for one in reports.values() for line in one.lines]
    shares = [share for one in reports.values() for share in one.found.within]
    found = [f"norm + {percent(share)}" for share in dict.fromkeys(shares)]
    rows: list[tuple[str, ...]] = [("errors [%]: proved, found", "unstable", *found, *next(iter(reports.values())).rounding)]
    for name, one in reports.items():
        margins = (one.found.stable, *one.found.within.values())
        norms = (f"{each.norm.value:.5g}" if each.stable else "UNSTABLE" for each in one.rounding.values())
        rows.append((name, *(_between(each.proved_margin, each.smallest_violation) for each in margins), *norms))
    note = "each reading and force may be off by what is proved, not by what is found; "
    note += "int16, float16: the norm with numbers so rounded"
    return [*table(rows, indent=""), *wrapped(note, "  ", 2)]


def _between(proved: float, found: float) -> str:
    """Returns the errors that are proved to be borne and those that are found not to be [%]; a dash for none."""
    return ", ".join(f"{100 * value:.3g}" if value and finite(value) is not None else "-" for value in (proved, found))
