"""Suspensions: names of their parts, and non-linear elements: curves of dampers and springs, adjustable dampers, bump stops."""

from collections.abc import Mapping
from dataclasses import dataclass

from models.common.checks import Checked, Name

STOP_KEYS = ("suspension_stroke", "stop_stiffness")  # keys of bump stops
STOP = "stop"  # another name of the second one, for tables and files
STOP_NAMES = (*STOP_KEYS, STOP)

PART = "part_"  # begins the name of the motor of parts that MuJoCo has no element for, after the prefix and before the tendon
RATIO = "ratio"  # column of a motion ratio over travel
LEAVES = 0.1  # deviation from its line at which a curve has left it, over its largest force
DEFLECTION = "suspension_deflection"  # the signal of a single suspension, or its beginning at a corner


@dataclass(frozen=True)
class SuspensionParts(Checked):
    """Names of the parts of a suspension.

    Attributes:
        deflection: signal of its extension.
        tendon: name of the MJCF tendon; the bump stop is parallel to it.
        force: input that pushes along it; empty for a passive one.
        stiffness, damping: parameters of its spring and its damper, which curves can replace; empty if it has no such part.
        ratio: parameter of its motion ratio, travel of all its elements per wheel travel; empty for elements at the wheel. The
            equations of the kind are for elements at the wheel: `VehicleKind.at_wheels` converts.
    """

    deflection: Name
    tendon: Name
    force: str = ""
    stiffness: str = ""
    damping: str = ""
    ratio: str = ""

    def motion_ratio(self, parameters: Mapping[str, float]) -> float:
        """Returns its motion ratio."""
        return parameters.get(self.ratio, 1.0)

    @property
    def ending(self) -> str:
        """Suffix of the names at its corner."""
        return self.deflection.removeprefix(DEFLECTION)

    @property
    def corner(self) -> str:
        """Name of its corner; empty for a single suspension."""
        return self.ending.removeprefix("_")
