"""Keys of bump stops in `[limits]` and in its sections for corners; `models.parts.stops.stop` explains their meaning."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from models.characteristics import SIDES, STOP, STOP_KEYS
from models.common.errors import InputError, short_repr
from models.common.extensions import FEATURES
from models.common.schema import HERE, SI, SMALLEST, Key, Section, below, json_schema

MOST = 3  # largest number of coefficients of a stop; MuJoCo's polynomial springs also have three


@dataclass(frozen=True)
class StopPair:
    """Values that a key of a bump stop has for bump and for rebound. The value is None for a side without a stop."""

    bump: Any
    rebound: Any


@dataclass(frozen=True)
class OfSides(Key):
    """One value for both sides of a suspension, or a table { bump = ..., rebound = ... } with a value for each side.

    If a side is omitted, it has no stop.
    """

    one: Key
    meaning: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "unit", self.one.unit)

    def read(self, value: Any, context: Mapping[str, Any]) -> Any:
        """Returns the value that both sides of a suspension share, or a `StopPair`."""
        if not isinstance(value, Mapping) or {"force", "file"} & set(value):
            return self.one.read(value, context)
        # In a log, a side without a stop has the value null
        given = {side: one for side, one in value.items() if one is not None}
        if not given or not set(given) <= set(SIDES):
            raise InputError(
                f"{HERE} = {short_repr(dict(value))} has neither bump nor rebound; give {{ bump = ..., rebound = ... }}, "
                "a table with only one of these keys, or a number"
            )
        return StopPair(*(below(f".{side}", self.one, given[side], context) if side in given else None for side in SIDES))

    @property
    def json(self) -> Mapping[str, Any]:
        """The JSON schema of one value for both sides of a suspension, or of a table with a value for each side."""
        one = dict(self.one.json)
        return {"anyOf": [one, {"type": "object", "properties": dict.fromkeys(SIDES, one), "additionalProperties": False}]}


@dataclass(frozen=True)
class StopStiffness(Key):
    """Stiffness of a stop, a list of up to three coefficients, or a table of force against compression."""

    meaning: str = ""
    unit: str = "N/m"

    def read(self, value: Any, context: Mapping[str, Any]) -> Any:
        """Returns the stiffness of a stop, a tuple of coefficients, or a `StopTable`."""
        if isinstance(value, Mapping):
            return FEATURES.load("stops").read_stop_table(value)
        if not isinstance(value, (list, tuple)):
            return SI("N/m").number(HERE, value)
        if not 1 <= len(value) <= MOST:
            raise InputError(
                f"{HERE} = {short_repr(list(value))} has {len(value)} coefficients, but 1 to {MOST} are allowed; give "
                "coefficients of the force k_1 x + k_2 x^2 + k_3 x^3, where x is the compression of the stop"
            )
        units = zip(value, ("N/m", "N/m2", "N/m3"), (SMALLEST, 0.0, 0.0), strict=False)
        return tuple(SI(unit, low=low).number(f"{HERE}[{i}]", k) for i, (k, unit, low) in enumerate(units))

    @property
    def json(self) -> Mapping[str, Any]:
        """The JSON schema of the stiffness of a stop: a number, a list of coefficients, or a table."""
        number = SI(self.unit).json
        several = {"type": "array", "items": SI(self.unit, low=0.0).json, "minItems": 1, "maxItems": MOST}
        table = json_schema(FEATURES.load("curves in files").StopTableSection)
        # The value may also be the name of a file
        return {"anyOf": [number, several, table, {"type": "string", "pattern": r"\.\w+$"}]}


@dataclass(frozen=True)
class StopSection(Section):
    """Keys of bump stops in `[limits]`, and in `[limits.CORNER]`."""

    by_place: ClassVar[bool] = True
    hints: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("actuator_force", "actuator_bandwidth", "force_rate", "limit"), "applies to all suspensions; move it to [limits]"
    )

    suspension_stroke: Annotated[Any, OfSides(SI("m"), "travel to the bump stop in each direction")] = None
    stop_stiffness: Annotated[Any, OfSides(StopStiffness(), "stiffness of the stop, up to three coefficients, or a table")] = None
    stop: Annotated[Any, OfSides(StopStiffness(), "the same as `stop_stiffness`")] = None

    def __post_init__(self) -> None:
        if self.stop is not None and self.stop_stiffness is not None:
            raise InputError(f"has both {STOP} and {STOP_KEYS[1]}, which are two names of the same key; omit one of the two")
        if self.stop is not None:
            object.__setattr__(self, STOP_KEYS[1], self.stop)
            object.__setattr__(self, STOP, None)
