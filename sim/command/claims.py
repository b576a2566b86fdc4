"""Claims of a vehicle file about its gains that are not true: said wherever they are driven, and judged by `synth --check`."""

from collections.abc import Iterable

from models.common.command import complain
from models.damping.laws import SemiActive
from models.own.python_law import Programmed
from synth.controller import Controller


def say_false_claims(controllers: Iterable[Controller | Programmed | SemiActive]) -> None:
    """One line on stderr for every controller whose certificate does not hold: it is driven all the same."""
    for one in controllers:
        if isinstance(one, Controller) and one.false_claims:
            first, *others = one.false_claims
            more = f"; and {len(others)} more" if others else ""
            complain(
                f"the certificate of controller {one.name!r} in the vehicle file does not hold ({first}{more}): its gain is "
                "taken as it is; python -m synth --check says more"
            )
