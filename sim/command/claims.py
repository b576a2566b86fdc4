"""What a vehicle file claims of its controllers and is not true: said wherever they are driven, and judged by `synth`."""

from collections.abc import Iterable, Sequence

from models.common.command import complain
from models.damping.laws import SemiActive
from models.own.python_law import Programmed
from synth.controller import Controller


def say_false_claims(controllers: Iterable[Controller | Programmed | SemiActive]) -> None:
    """One line on stderr for every controller whose certificate does not hold, and for one that does not keep its goals.

    It is driven all the same.
    """
    for one in controllers:
        if isinstance(one, Controller) and one.false_claims:
            complain(
                f"the certificate of controller {one.name!r} in the vehicle file does not hold ({_first(one.false_claims)}): its "
                "gain is taken as it is; python -m synth --check says more"
            )
        if isinstance(one, Controller) and one.broken:
            missed = [promise.text for promise in one.promises if not promise.holds]
            complain(
                f"controller {one.name!r} does not keep the goals that the vehicle file has for it ({_first(missed)}): it is "
                "taken as it is; python -m synth says more"
            )


def _first(claims: Sequence[str]) -> str:
    """The first of some claims, and how many more there are."""
    return f"{claims[0]}; and {len(claims) - 1} more" if len(claims) > 1 else claims[0]
