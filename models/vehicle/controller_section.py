"""All keys of `[controllers.NAME]`: goals, dynamic controllers, Python laws and semi-active laws."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from models.common.errors import InputError, list_names
from models.common.printed import size
from models.common.schema import SI, Choice, ReadBy, Text
from models.laws.design_methods import DESIGNS, PATTERNS, PREVIEW
from models.laws.filter import Filter
from models.laws.law_structure import StructureSection
from models.laws.linear import MATRICES, LinearLaw
from models.laws.python_law import ProgramSection
from models.laws.semi_active import SemiActiveSection
from models.laws.weighted_errors import WeightedErrors
from models.vehicle.controllers import ROWS, GivenSection, matrix_rows
from models.vehicle.limits_and_implementation import LONGEST_PERIOD


def _matrix(value: Any, context: Mapping[str, Any]) -> tuple[tuple[float, ...], ...]:
    """Returns the rows of one of the matrices of the control law."""
    return matrix_rows(value, "give a list of rows")


@dataclass(frozen=True, kw_only=True)
class ControllerSection(ProgramSection, SemiActiveSection, StructureSection, GivenSection):
    """Section `[controllers.NAME]` of a vehicle file, with all keys that the section may have."""

    A: Annotated[Any, ReadBy("state matrix of the law x_c' = A x_c + B y, u = C x_c + D y", _matrix, allowed=ROWS)] = None
    B: Annotated[Any, ReadBy("input matrix of the law", _matrix, allowed=ROWS)] = None
    C: Annotated[Any, ReadBy("output matrix of the law", _matrix, allowed=ROWS)] = None
    D: Annotated[Any, ReadBy("feedthrough of the law", _matrix, allowed=ROWS)] = None
    sample_period: Annotated[float, SI("s", "sample period of a discrete law", high=LONGEST_PERIOD)] | None = None
    file: Annotated[str, Text("MATLAB file with the law, next to the vehicle file")] | None = None
    design: Annotated[str, Choice("method of design instead of the two-step design", DESIGNS)] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.file is not None:
            raise InputError(
                "the key file refers to a file next to the vehicle file, but this vehicle is read from text; give the matrices "
                "instead of file"
            )
        matrices = [key for key in (*MATRICES, "sample_period") if getattr(self, key) is not None]
        if matrices and self.pid is not None:
            raise InputError(f"has both pid and {matrices[0]}, but a controller can have only one law; omit one of these keys")
        if matrices and (missing := [key for key in MATRICES if key not in matrices]):
            raise InputError(
                f"{list_names(missing)} is missing, but x_c' = A x_c + B y, u = C x_c + D y needs all four matrices; "
                "give A, B, C and D"
            )
        GivenSection.__post_init__(self)
        if self.preview is not None and self.law is None and self.design != PREVIEW:
            raise InputError(
                f'preview needs a law in Python or design = "{PREVIEW}", because only these receive the road ahead; '
                'omit preview, or give a law, as in law = "my_law.py:step"'
            )
        if self.preview is None and self.design == PREVIEW:
            raise InputError(
                f'design = "{PREVIEW}" needs a preview time (the range of the road sensor divided by the speed); give '
                "the preview time in seconds, as in preview = 0.5"
            )

    @property
    def given(self) -> bool:
        """True if the section contains the numbers of a linear law: a gain, matrices, or PID gains."""
        return self.gain is not None or self.A is not None or (self.pid is not None and self.structure not in PATTERNS)

    @property
    def errors(self) -> WeightedErrors | None:
        """Uncertainties of measurements and forces with a frequency-dependent weight; None for a section without these
        uncertainties.
        """
        weights = {name: one for name, one in self.tolerance.items() if isinstance(one, Filter)}
        return WeightedErrors(weights) if weights else None

    def linear_law(self, measured: Sequence[str], corners: Mapping[str, str]) -> LinearLaw | None:
        """Returns the linear law in the section; None if the section does not contain the numbers of a linear law."""
        if self.gain is not None:
            return super().linear_law(measured, corners)
        if self.A is None:
            return self.pid_law(measured, corners)
        k, m, q = len(self.A) if any(self.A) else 0, len(corners), len(measured)
        shapes = {"A": (k, k), "B": (k, q), "C": (m, k), "D": (m, q)}
        for key, (rows, columns) in shapes.items():
            there = getattr(self, key)
            if not any(there) and not rows * columns:
                continue  # if a law has no states, its empty matrices may have any shape
            if len(there) != rows or any(len(row) != columns for row in there):
                raise InputError(
                    f"{key} has {size(there)}; give {rows} row(s) of {columns} number(s), because A has {k} row(s), this vehicle "
                    f"has {m} actuator(s), and the controller measures {q} signal(s)"
                )
        matrices = (np.array(getattr(self, key), dtype=float).reshape(shape) for key, shape in shapes.items())
        return LinearLaw(*matrices, sample_period=self.sample_period)
