"""Maps of logs (TOML files), which state the column and the sensor of each signal, and the inputs of the vehicle."""

# road = "logged"                      # or "flat", "unknown", or a road as `roadproof drive --road` takes it, with a speed
# start = "estimated"                  # or "rest"
#
# [signals.sprung_acceleration]
# column = "AccZ [g]"                  # heading of the column
# sign = -1                            # if the sensor is mounted upside down
# delay = "10 ms"                      # or "estimate"
# offset = "estimate"                  # or a number
# noise = "estimate"                   # or its rms
#
# [known]
# corner_weight = { value = "5560 N", deviation = "20 N" }
#
# [logs."payload.csv"]
# added = { sprung_mass = "40.8 kg" }  # keys of the map for this log alone, and what the vehicle carries in it

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any

from models.common.errors import InputError, alike, short_repr
from models.common.files import parse_toml, read_text
from models.common.schema import HERE, SI, AnyTable, BySignal, Choice, Integer, ReadBy, Section, Text, read
from models.vehicle.vehicle import Vehicle
from sim.studies.identification.estimation.problem import Known
from sim.studies.identification.experiment import signal_units

ESTIMATE = "estimate"
LOGGED, FLAT, UNKNOWN = "logged", "flat", "unknown"
ROADS = (LOGGED, FLAT, UNKNOWN)
REST, ESTIMATED = "rest", "estimated"
STRAIGHT, HELD = "straight", "held"
CORNER_WEIGHT = "corner_weight"


def _number_or_estimate(low: float) -> Callable[[Any, Mapping[str, Any]], float | None]:
    def number(value: Any, context: Mapping[str, Any]) -> float | None:
        return None if value == ESTIMATE else SI(context["unit"], low=low).number(HERE, value)

    return number


def _sign(value: Any, context: Mapping[str, Any]) -> int:
    if value not in (1, -1) or isinstance(value, bool):
        raise InputError(f"{HERE} = {short_repr(value)} is not allowed; give 1 or -1")
    return int(value)


def _delay(value: Any, context: Mapping[str, Any]) -> float | None:
    return None if value == ESTIMATE else SI("s", low=0.0, high=10.0).number(HERE, value)


@dataclass(frozen=True)
class SensorSection(Section):
    """[signals.NAME]: a signal of the vehicle and the sensor that measures this signal. The value None means that the quantity
    is estimated.
    """

    column: Annotated[str, Text("heading of the column, with the unit in brackets if the file gives none")] = ""
    sign: Annotated[int, ReadBy("1, or -1 for a sensor that counts the other direction as positive", _sign)] = 1
    delay: Annotated[float | None, ReadBy("delay of the sensor, or estimate", _delay, "s")] = 0.0
    offset: Annotated[float | None, ReadBy("constant offset, or estimate", _number_or_estimate(-1e12))] = None
    noise: Annotated[float | None, ReadBy("rms of the noise, or estimate", _number_or_estimate(1e-12))] = None


@dataclass(frozen=True)
class LogKeys(Section):
    """Keys of a map file, which apply either to all logs or to one log."""

    road: Annotated[str, Text("logged, flat, unknown, or a road as for roadproof drive; a random road is not measured")] = LOGGED
    speed: Annotated[float, SI("m/s", "speed on that road", 0.0)] = 0.0
    start: Annotated[str, Choice("state at the first sample", (ESTIMATED, REST))] = ESTIMATED
    forces: Annotated[str, Choice("forces between samples", (STRAIGHT, HELD))] = STRAIGHT
    heights: Annotated[str, Choice("heights of the road between samples", (STRAIGHT, HELD))] = STRAIGHT
    part: Annotated[str, Text("part of the vehicle that was tested alone on a dynamometer")] = ""
    first: Annotated[float, SI("s", "time of the first sample that is used", -1e9)] = -1e9
    last: Annotated[float, SI("s", "time of the last sample that is used", -1e9)] = 1e12
    rate: Annotated[float, SI("1/s", "samples per second of a log without times", 0.0)] = 0.0
    every: Annotated[int, Integer("use only one of so many samples; 1 uses all", 1)] = 1
    added: Annotated[Mapping[str, float], BySignal("values added to parameters in this log", "parameters", -1e9, 1e9)] = field(
        default_factory=dict[str, float]
    )


@dataclass(frozen=True)
class MapFile(LogKeys):
    """Content of a map file: keys that apply to all logs, followed by tables for signals, known values and single logs."""

    signals: Annotated[Mapping[str, Any], AnyTable("signals by name")] = field(default_factory=dict[str, Any])
    known: Annotated[Mapping[str, Any], AnyTable("known parameters")] = field(default_factory=dict[str, Any])
    logs: Annotated[Mapping[str, Any], AnyTable("keys of single logs, by file")] = field(default_factory=dict[str, Any])


@dataclass(frozen=True, eq=False)
class LogMap:
    """Content of a map file after reading.

    Attributes:
        keys: keys that apply to all logs.
        sensors: section of each signal in the map, by name of the signal.
        known: combinations of parameters whose values are known from other sources.
        of_logs: keys that apply only to a single log, by file name of the log.
        source: path of the map file; empty if there is no map file.
    """

    keys: LogKeys = field(default_factory=LogKeys)
    sensors: Mapping[str, SensorSection] = field(default_factory=dict[str, SensorSection])
    known: tuple[Known, ...] = ()
    of_logs: Mapping[str, LogKeys] = field(default_factory=dict[str, LogKeys])
    source: str = ""

    def of(self, log: Path) -> LogKeys:
        """Returns the keys of the map file that apply to a log."""
        return self.of_logs.get(log.name, self.keys)


def read_map(path: Path | None, vehicle: Vehicle) -> LogMap:
    """Reads a map. Without a path, the function returns a map for logs whose column headings are names of signals.

    Raises:
        InputError: the file is not a valid map for this vehicle.
    """
    if path is None:
        return LogMap()
    give = "give a TOML file with a section [signals.NAME] for each signal, as roadproof identify --columns writes it"
    data = parse_toml(read_text(path, "map of logs", give))
    units = {one.name: one.unit for one in vehicle.kind.parameters}
    whole = read("", MapFile, data, parameters=units)
    shared = {one.name: getattr(whole, one.name) for one in fields(LogKeys)}
    names = signal_units(vehicle.kind)
    sensors = dict[str, SensorSection]()
    for name, table in whole.signals.items():
        if name not in names:
            raise InputError(f"[signals.{name}]: this vehicle has no signal {short_repr(name)}; give one of {alike(name, names)}")
        sensors[name] = read(f"[signals.{name}]", SensorSection, table, unit=names[name])
    known = tuple(_known(name, table, vehicle, units) for name, table in whole.known.items())
    own = {key for one in fields(LogKeys) if (key := one.name) in data}
    of_logs = {
        name: replace(read(f'[logs."{name}"]', LogKeys, table, parameters=units), **{k: shared[k] for k in own if k not in table})
        for name, table in whole.logs.items()
    }
    return LogMap(LogKeys(**shared), sensors, known, of_logs, str(path))


@dataclass(frozen=True)
class _KnownSection(Section):
    """A known value with its standard deviation."""

    value: Annotated[float, ReadBy("value", lambda value, context: SI(context["unit"], low=-1e12).number(HERE, value))]
    deviation: Annotated[
        float, ReadBy("standard deviation", lambda value, context: SI(context["unit"], low=1e-9).number(HERE, value))
    ]


def _known(name: str, table: Any, vehicle: Vehicle, units: Mapping[str, str]) -> Known:
    weights = corner_weights(vehicle)
    if name not in units and name not in weights:
        raise InputError(
            f"[known] {short_repr(name)} is not a quantity of this vehicle; give one of {alike(name, [*weights, *units])}"
        )
    given = read(f"[known] {name}", _KnownSection, table, unit=units.get(name, "N"))
    if name in units:
        return Known(name, lambda one: one.parameters[name], given.value, given.deviation)
    return Known(name, lambda one: corner_weights(one)[name], given.value, given.deviation)


def corner_weights(vehicle: Vehicle) -> dict[str, float]:
    """Returns the static load of each tyre [N]; each name is `corner_weight` followed by the suffix of the corner."""
    model, p = vehicle.kind, vehicle.parameters
    compressions, loads = model.static_tyre_deflection(p), dict[str, float]()
    for tyre, compression in compressions.items():
        ending = tyre.removeprefix("tyre_deflection")
        stiffness = p.get(model.of_corner("tyre_stiffness", ending), p.get(f"tyre_stiffness{ending}"))
        if stiffness is not None:
            loads[f"{CORNER_WEIGHT}{ending}"] = abs(compression) * stiffness
    return loads
