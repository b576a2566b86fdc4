"""Writes the result of an identification as a document, as JSON and as a vehicle file."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from models.common.errors import list_names
from models.common.files import parse_toml
from models.common.printed import digits, entry, percent, rough
from models.common.toml_edit import Replacement, section_lines, with_replacements
from models.document.document import Document, Statement, Table, notes
from models.document.field import Field, Record, at_most
from models.document.figure import Curve, Figure, Panel
from models.document.outputs import IDENTIFIED
from models.vehicle.in_place import with_sections
from sim.studies.identification.allowed_result import ALLOWED, WORST_BOUND, AllowedResult
from sim.studies.identification.diagnosis import Cause
from sim.studies.identification.estimation.estimate import Estimate
from sim.studies.identification.estimation.search import NORMAL
from sim.studies.identification.experiment import signal_units
from sim.studies.identification.identification import Identification, element_numbers
from sim.studies.identification.plan import PLANS, ChirpPlan
from sim.studies.identification.spectra.random_road import ROAD_UNITS
from sim.studies.identification.spectra.spectral_estimate import spectral_figure, spectral_statement
from sim.studies.identification.spectra.spectral_residuals import SpectralResiduals

SCALE = (
    "motion alone never determines the scale of masses, stiffnesses and dampings; give a corner weight below [known], a log with "
    "a known payload, or a measured force"
)
SILENT = "no measured signal depends on it"
SHARE = Field[float]("deviation", float, ".2g", 100, unit="%")
FAR_APART = 50.0  # a wide interval is reported if its ends differ by a larger factor than this: 7 up and 7 down
MOST_POINTS = 2000  # largest number of points of a drawn curve
SECTION = "identified"


@dataclass(frozen=True)
class ParameterRow:
    """A row of the parameter table: estimated value, initial value, and a confidence interval or the reason why the interval is
    missing.
    """

    name: str
    unit: str
    first: float
    value: float | None
    low: float | None
    high: float | None
    note: str


@dataclass(frozen=True)
class SensorRow:
    """A sensor in an experiment, with the sensor's fit, noise, delay and whiteness."""

    experiment: str
    signal: str
    unit: str
    fit: float
    noise: float
    delay: float
    probability: float
    outside: float


NAME = Field[ParameterRow]("parameter", lambda row: row.name, key="name")
UNIT = Field[ParameterRow]("unit", lambda row: row.unit, key="unit")
FIRST = Field[ParameterRow]("first", lambda row: row.first, ".5g", key="first")
VALUE = Field[ParameterRow]("value", lambda row: row.value, ".5g", key="value")
LOW = Field[ParameterRow]("95 % from", lambda row: row.low, ".5g", key="low")
HIGH = Field[ParameterRow]("to", lambda row: row.high, ".5g", key="high")
NOTE = Field[ParameterRow]("note", lambda row: row.note, key="note")
PARAMETERS = (NAME, UNIT, FIRST, VALUE, LOW, HIGH, NOTE)
FIT = Field[SensorRow]("fit", lambda row: row.fit, ".1f", 100, key="fit", unit="%")
NOISE = Field[SensorRow]("noise rms", lambda row: row.noise, ".3g", key="noise")
DELAY = Field[SensorRow]("delay", lambda row: row.delay, ".3g", 1e3, key="delay", unit="ms")
WHITE = Field[SensorRow]("white: p", lambda row: row.probability, ".2g", key="probability")
SENSORS = (
    Field[SensorRow]("experiment", lambda row: row.experiment, key="experiment"),
    Field[SensorRow]("signal", lambda row: row.signal, key="signal"),
    Field[SensorRow]("unit", lambda row: row.unit, key="unit"),
    FIT,
    NOISE,
    DELAY,
    WHITE,
    Field[SensorRow]("outside", lambda row: row.outside, ".0f", 100, key="outside", unit="%", detail="full"),
)
PARAMETER_RECORD, SENSOR_RECORD = Record[ParameterRow](*PARAMETERS), Record[SensorRow](*SENSORS)


def parameter_rows(of: Identification) -> list[ParameterRow]:
    """Returns the table rows of all parameters that were free."""
    estimate, rows = of.estimate, list[ParameterRow]()
    units = {one.name: one.unit for one in of.vehicle.kind.parameters}
    units |= {name: key.unit for name, (_, key) in element_numbers(of.vehicle).items()} | dict(ROAD_UNITS)
    for name, first in estimate.problem.first.items():
        if one := of.intervals.get(name):
            note = one.method + ", open below" * (one.low is None) + ", open above" * (one.high is None)
            rows.append(ParameterRow(name, units.get(name, ""), first, estimate.values[name], one.low, one.high, note))
            continue
        if name in estimate.structure.held:
            note = "not determined: see the products"
        elif name in estimate.structure.silent:
            note = SILENT
        else:
            note = f"only {product_words(estimate.ratios[name])}"
        rows.append(ParameterRow(name, units.get(name, ""), first, None, None, None, note))
    return rows


def product_words(powers: Mapping[str, float]) -> str:
    """Returns the text of a product of parameter powers, such as unsprung_mass / sprung_mass."""
    above = [_power(name, power) for name, power in powers.items() if power > 0]
    below = [_power(name, -power) for name, power in powers.items() if power < 0]
    return " ".join(above or ["1"]) + "".join(f" / {one}" for one in below)


def _power(name: str, power: float) -> str:
    return name if power == 1 else f"{name}^{rough(power)}"


def sensor_rows(of: Identification) -> list[SensorRow]:
    """Returns the table rows of all sensors of all experiments."""
    estimate, units, rows = of.estimate, signal_units(of.vehicle.kind), list[SensorRow]()
    for one, fits, tests in zip(estimate.problem.experiments, estimate.fits, estimate.whiteness, strict=True):
        for channel in one.channels:
            name, test = channel.signal, tests[channel.signal]
            noise, delay = estimate.noise[name], estimate.delays.get(name, channel.delay)
            rows.append(SensorRow(one.name, name, units[name], fits[name], noise, delay, test.probability, test.outside))
    return rows


def products(of: Estimate) -> Iterator[tuple[str, float, float, float]]:
    """Yields the products of parameters that the logs determine, each as text, value and ends of the 95 % confidence interval."""
    for powers in of.ratios.values():
        if len(powers) > 1:
            value, deviation = of.combination(powers)
            width = NORMAL * deviation
            yield product_words(powers), value, value * float(np.exp(-width)), value * float(np.exp(width))


Product = tuple[str, float, float, float]
PRODUCTS = (
    Field[Product]("product", lambda row: row[0], key="product"),
    Field[Product]("value [SI]", lambda row: row[1], ".5g", key="value"),
    Field[Product]("95 % from", lambda row: row[2], ".5g", key="low"),
    Field[Product]("to", lambda row: row[3], ".5g", key="high"),
)


def statements(of: Identification) -> Iterator[Statement]:
    """Yields statements about the quality of the estimate, and about parameters that the logs do not determine."""
    estimate = of.estimate
    if estimate.structure.directions:
        scale = any({round(power, 6) for power in one.values()} == {1.0} for one in estimate.structure.directions)
        advice = f": {SCALE}" if scale else "; fix one of them, or measure another signal"
        held = list_names(estimate.structure.held)
        yield Statement(f"The logs cannot determine {held} together with all other parameters{advice}.", "ends")
    for name in estimate.structure.silent:
        yield Statement(f"No measured signal depends on {name}; it keeps its initial value.", "ends")
    for name in estimate.undetermined:
        one = of.intervals.get(name)
        if one and (one.low is None or one.high is None):
            yield Statement(
                f"{name} is not determined in practice: its confidence interval has no lower end or no upper end.", "ends"
            )
        elif one and one.low is not None and one.high is not None and one.high > FAR_APART * one.low:
            factor = rough(one.high / one.low)
            yield Statement(
                f"{name} is not determined in practice: the ends of its confidence interval differ by a factor of {factor}.",
                "ends",
            )
    if of.mirror:
        values = ", ".join(f"{name} {entry(of.mirror[name])}" for name in of.mirror if name in estimate.free)
        yield Statement(
            f"Another vehicle fits equally well: {values}. These signals cannot distinguish the suspension from the tyre; "
            "measure the motion of the hub.",
            "ends",
        )
    if estimate.noiseless:
        largest = at_most(max(estimate.noiseless.values()))
        words = "fits to {} of its" if len(estimate.noiseless) == 1 else "fit to {} of their"
        yield Statement(f"{list_names(estimate.noiseless)} {words.format(largest)} rms, so there is no noise to test.", "holds")
    if isinstance(estimate.residuals, SpectralResiduals):
        yield spectral_statement(estimate)
        return
    noisy = {*estimate.problem.signals} - {*estimate.noiseless}
    if noisy and estimate.white:
        yield Statement("The residuals are white: the vehicle explains all that the sensors show beyond their noise.", "holds")
    elif noisy:
        yield Statement(
            "The residuals are not white: the vehicle model lacks something that the logs contain. The intervals account "
            "for coloured residuals, but not for a bias that the missing part causes.",
            "fails",
        )
    for cause in of.causes[:3]:
        yield Statement(
            f"The residuals contain {cause.words}. This explains {percent(cause.share)} of the sum of squared residuals.", "ends"
        )


def describe(of: Identification) -> Document:
    """Describes the result of an identification: parameters with confidence intervals, sensors, and parameters that the logs do
    not determine.
    """
    rows, ratios = parameter_rows(of), list(products(of.estimate))
    caption = "values and 95 % intervals of the free parameters"
    blocks: list[Any] = [Table.of("parameters", caption, PARAMETERS, rows, words=2)]
    if ratios:
        blocks.append(Table.of("products", "combinations of parameters that the logs do determine", PRODUCTS, ratios))
    caption = "fit: share of a signal's rms that the vehicle explains; p below 0.001: residuals are not white"
    blocks.append(Table.of("sensors", caption, SENSORS, sensor_rows(of), words=3))
    blocks += [*statements(of)]
    for name, fits in of.held_out:
        text = ", ".join(f"{signal} {rough(100 * fit)} %" for signal, fit in fits.items())
        blocks.append(Statement(f"Hold-out log {name}: fit of {text}."))
    if of.in_mujoco:
        worst = max(of.in_mujoco, key=lambda name: of.in_mujoco[name])
        blocks.append(
            Statement(f"MuJoCo differs from the prediction by at most {at_most(of.in_mujoco[worst])} of a peak ({worst}).")
        )
    if of.allowed:
        caption = (
            f"controllers on {of.allowed[0].vehicles} vehicles: the estimated vehicle, and the vehicles at the ends of "
            "the axes of the 95 % confidence ellipse"
        )
        blocks.append(Table.of("controllers", caption, ALLOWED, of.allowed))
        for one in of.allowed:
            if one.worst_bound is not None:
                blocks.append(
                    Statement(
                        f"`{one.name}` has a proved norm below {WORST_BOUND.digits(one.worst_bound)} on each of these vehicles.",
                        "holds",
                    )
                )
    blocks += notes(*of.remarks)
    return Document("Identification", tuple(blocks))


def describe_plans(each: Sequence[ChirpPlan]) -> Document:
    """Describes plans of a rig test: the chirps, and the standard deviation of each parameter with the best chirp."""
    best = each[0]
    rows = [f"{name} {SHARE.text(one)}" if one < inf else f"{name} not determined" for name, one in best.deviations.items()]
    caption = (
        "chirps for the posts of a rig; for each chirp, the relative standard deviation of the parameter that the chirp "
        "determines worst"
    )
    return Document(
        "Plan",
        (
            Table.of("plans", caption, PLANS, each),
            *notes(f"Relative standard deviations of the parameters with the first chirp: {', '.join(rows)}."),
        ),
    )


def record(of: Identification) -> dict[str, Any]:
    """Returns the result of an identification as a JSON object."""
    estimate = of.estimate
    return {
        "parameters": [PARAMETER_RECORD(row) for row in parameter_rows(of)],
        "products": [Record[Product](*PRODUCTS)(row) for row in products(estimate)],
        "correlations": _correlations(estimate),
        "sensors": [SENSOR_RECORD(row) for row in sensor_rows(of)],
        "white": estimate.white,
        "causes": [Record[Cause]("words", "share", "deviations")(one) for one in of.causes],
        "mirror": dict(of.mirror),
        "hold_out": [{"experiment": name, "fits": dict(fits)} for name, fits in of.held_out],
        "in_mujoco": dict(of.in_mujoco),
        "controllers": [Record[AllowedResult](*ALLOWED)(one) for one in of.allowed],
        "remarks": list(of.remarks),
    }


def _correlations(of: Estimate) -> dict[str, dict[str, float]]:
    deviations = np.sqrt(np.diag(of.spread))
    matrix = of.spread / np.outer(deviations, deviations)
    rows = ({name: round(float(value), 4) for name, value in zip(of.free, row, strict=True)} for row in matrix)
    return dict(zip(of.free, rows, strict=True))


def figure(of: Identification) -> Figure:
    """Returns a figure of the measured and predicted signals of the first experiment, and of the residuals."""
    estimate = of.estimate
    if isinstance(estimate.residuals, SpectralResiduals):
        return spectral_figure(estimate)
    one, predicted = estimate.problem.experiments[0], estimate.predicted[0]
    every = slice(None, None, max(1, len(one.road) // MOST_POINTS))
    panels = []
    for channel, values in zip(one.channels, predicted.T, strict=True):
        unit = signal_units(of.vehicle.kind)[channel.signal]
        curves = (
            Curve(one.time[every], channel.values[every], "measured", "#9a9a9a", "none", "o"),
            Curve(one.time[every], values[every], "identified vehicle", "#0b5fa5"),
        )
        panels.append(Panel(channel.signal, "time [s]", f"[{unit}]", curves))
    return Figure("identification", f"Measured signals of {one.name} and the identified vehicle.", tuple(panels), columns=1)


def vehicle_text(of: Identification, logs: Sequence[Path]) -> str:
    """Returns the vehicle file with the identified values, and with a section that states how these values were obtained."""
    vehicle, estimate = of.vehicle, of.estimate
    start, rows = estimate.problem.vehicle, parameter_rows(of)
    tables = [name for name in vehicle.curves if name in estimate.values]
    written, parts = (parse_toml(start.text).get(section, {}) for section in ("parameters", "parts"))
    values = {name: float(digits(estimate.values[name])) for name in estimate.free if name not in tables}
    replaced = [Replacement(("parameters", name), {name: value}) for name, value in values.items() if name in written]
    paths = [(part, key) for part, table in parts.items() for key in table if f"{part}.{key}" in values]
    replaced += [Replacement(("parts", part, key), {key: values[f"{part}.{key}"]}) for part, key in paths]
    text = with_replacements(start.text, replaced)
    intervals = {row.name: [row.low or 0.0, row.high or 0.0] for row in rows if row.value is not None}
    held = {
        name: "not determined: the logs give only products of this parameter with other parameters"
        for name in estimate.structure.held
    }
    held |= {name: SILENT for name in estimate.structure.silent}
    content: dict[str, Any] = {
        "intervals": intervals,
        "fixed": held,
        "correlations": _correlations(estimate),
        "white": estimate.white,
        "logs": {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in logs},
    }
    return with_sections(text, section_lines((SECTION,), content, IDENTIFIED))
