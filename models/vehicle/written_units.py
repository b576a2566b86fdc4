"""Numbers with units in a vehicle file, `sprung_mass = "380 kg"`: the unit of every key, and the conversion to it."""

from collections.abc import Mapping
from typing import Any

from models.common.units import in_unit
from models.kinds.kind import VehicleKind


def in_si(data: Mapping[str, Any], kind: VehicleKind) -> dict[str, Any]:
    """Returns the data of a vehicle file with SI numbers instead of numbers with units.

    Args:
        kind: kind of the vehicle, whose parameters and signals have units.

    Raises:
        InputError: a unit is unknown, or of another dimension than its key.
    """
    units = {
        "parameters": {parameter.name: parameter.unit for parameter in kind.parameters},
    }
    return {name: _in_si(section, units.get(name), (name,)) for name, section in data.items()}


def _in_si(value: Any, units: Any, path: tuple[str, ...]) -> Any:
    """Returns a value of a vehicle file in SI units.

    Args:
        units: units of the value, see above, or a function from the value to them; None for a value without unit.
        path: names of its sections, and its key.
    """
    units = units(value) if callable(units) and not isinstance(value, list) else units
    if isinstance(value, Mapping):
        each = units if isinstance(units, Mapping) else {"*": units}
        return {key: _in_si(one, each.get(key, each.get("*")), (*path, key)) for key, one in value.items()}
    if isinstance(value, list):
        return [_in_si(one, units, path) for one in value]
    unit = None if isinstance(units, Mapping) else units
    return value if unit is None else in_unit(value, unit, f"[{'.'.join(path[:-1])}] {path[-1]}")
