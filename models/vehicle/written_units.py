"""Numbers with units in a vehicle file, `sprung_mass = "380 kg"`: the unit of every key, and the conversion to it."""

from collections.abc import Mapping
from typing import Any

from models.common.units import in_unit
from models.kinds.kind import VehicleKind
from models.kinds.signals import PITCH_LOAD, ROLL_LOAD

SKY = ("sky_damping", "ground_damping", "heave_damping", "pitch_damping", "roll_damping")


def in_si(controllers: Mapping[str, Any], kind: VehicleKind) -> dict[str, Any]:
    """Returns `[controllers]` with SI numbers instead of numbers with units.

    Args:
        kind: kind of the vehicle, whose signals have units.

    Raises:
        InputError: a unit is unknown, or of another dimension than its key.
    """
    signals = {name: one.unit for name, one in kind.possible.items()}

    def bound(given: Any) -> dict[str, Any]:
        signal = next((given[key] for key in ("peak", "energy_peak") if key in given), "") if isinstance(given, Mapping) else ""
        most = signals.get(signal) if isinstance(signal, str) else None
        return {"band": "Hz", "speed": "m/s", "energy": "m2/s", "decay": "rad/s", "at_most": most}

    controller = {
        **dict.fromkeys(SKY, "N s/m"), "crossover": "rad/s", "sample_period": "s", "preview": "s", "anti_windup": "1/s",
        "loads": {"*": "N", PITCH_LOAD.name: "N m", ROLL_LOAD.name: "N m"}, "pid": {"filter": "s"}, "tolerance": "1",
        "minimise": {"band": "Hz"}, "bounds": bound, "fastest_pole": "rad/s",
    }  # fmt: skip
    return _in_si(controllers, {"*": controller}, ("controllers",))


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
