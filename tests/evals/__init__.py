"""Cases of the field: vehicles and data as engineers bring them, questions, and right answers that other routes gave.

The quarter-car here is NumPy's own: it shares no line with the product.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

GRAVITY = 9.81  # m/s2


@dataclass(frozen=True)
class Answer:
    """A right answer.

    Attributes:
        at: path of a number in the JSON object of the command, as `runs.0.metrics.dynamic_load.mujoco`.
        right: the number [in the unit of the JSON object].
        within: relative error that the source of the number allows.
        source: where the number comes from.
    """

    at: str
    right: float
    within: float
    source: str


@dataclass(frozen=True)
class Case:
    """A question that a command answers.

    Attributes:
        question: in the words of an engineer.
        command: its line, without `python -m`.
        answers: numbers of its JSON object.
        files: the texts of the files beside it, by name.
        says: texts of stdout or stderr.
        refused: parts of the one line that refuses bad input; the command runs if there are none.
    """

    question: str
    command: str
    answers: Sequence[Answer] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    says: Sequence[str] = ()
    refused: Sequence[str] = ()


def car(ms: float, mu: float, kt: float, ks: float | None = None, cs: float | None = None, more: str = "") -> str:
    """Returns a vehicle file: masses [kg], stiffnesses [N/m] and damping [N s/m]; None for what `more` has as curves."""
    given = {"sprung_mass": ms, "unsprung_mass": mu, "suspension_stiffness": ks, "suspension_damping": cs, "tyre_stiffness": kt}
    lines = [f"{name} = {float(value)}" for name, value in given.items() if value is not None]
    weights = "[performance]\nsprung_acceleration = 1.0\ncontrol_force = 1e-4\n"
    return "\n".join(['type = "quarter_car"', "[parameters]", *lines, weights, more])


def table(heading: str, *columns: NDArray) -> str:
    """Returns a CSV file."""
    return "\n".join([heading, *(",".join(f"{value:.14g}" for value in row) for row in zip(*columns, strict=True))]) + "\n"


def equations(ms: float, mu: float, ks: float, cs: float, kt: float) -> tuple[NDArray, NDArray]:
    """Returns A of shape (4, 4) and b of shape (4,) of x' = A x + b z_r, with x = [z_s, z_s', z_u, z_u'].

    z_s, z_u and z_r are the heights of the body, the wheel and the road [m].
    """
    A = np.array(
        [[0, 1, 0, 0], [-ks / ms, -cs / ms, ks / ms, cs / ms], [0, 0, 0, 1], [ks / mu, cs / mu, -(ks + kt) / mu, -cs / mu]]
    )
    return A, np.array([0.0, 0.0, 0.0, kt / mu])
