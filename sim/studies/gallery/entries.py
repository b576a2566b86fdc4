"""Entries of the gallery of published numbers. An entry contains the published numbers of one source, which are read from
`models/gallery/NAME/entry.toml`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from models.common.errors import InputError, list_names, short_repr
from models.common.files import parse_toml
from models.common.schema import HERE, LARGEST, SI, Choice, Flag, Integer, ListedValues, ReadBy, Section, Subsection, Text, read
from models.kinds import kind
from models.roads.description import read_road
from models.roads.road import Bump, Road
from synth.vehicle.paper import PRINTED_NUMBERS

FOLDER = kind.HERE / "gallery"
PAPER = "paper"
CAR = "car.toml"  # name of an entry's vehicle file if the entry gives no other
PAPER_BUMP = Bump()  # bump of the reference paper, which is the default road
SHORT = 1e-3  # largest relative error of the numbers in the reference paper; its solver stopped before the optimum


# Published sources that the gallery considers. Each entry lists its sources. Each source has published numbers, or a reason why
# it has no usable numbers.
SOURCES = (
    "MathWorks, H-infinity",
    "MathWorks, robust",
    "CTMS bus",
    "control-lab bus",
    "Quanser rig",
    "Ulsoy, Peng and Cakmakci",
    "Thompson",
    "Simulink half-car",
    "AFC replication",
    "Na et al.",
    "eFMI M06",
    "INTO-CPS",
    "ACADO",
    "Herber and Allison",
    "Adams co-simulation",
    "opty",
    "robust regret",
    "one mass, LQ",
)


def _road(value: Any, context: Mapping[str, Any]) -> Road:
    """Returns the road that is defined by a TOML table. Without the key `type`, a table with `edge` is a step, and any other
    table is a bump.
    """
    if not isinstance(value, Mapping):
        raise InputError(f"{HERE} = {short_repr(value)} is not a table; give a table, as in {{ height = 0.05, length = 2.5 }}")
    return read_road(HERE, {"type": "step" if "edge" in value else "bump", **value})


@dataclass(frozen=True)
class PrintedNumber(Section):
    """A published number, with the vehicle, controller, signal and run to which it refers."""

    what: Annotated[str, Text("type of the number, a key of `sim.studies.gallery.numbers.KINDS`")]
    value: Annotated[float, SI("", "value as published, in `unit`", -LARGEST)]
    digits: Annotated[int, Integer("decimals of the printed value", -20, 20)]
    where: Annotated[str, Text("place in the source, or formula")]
    vehicle: Annotated[str, Text("vehicle file in the entry's folder")] = CAR
    controller: Annotated[str, Text("name of a controller of the vehicle file")] = "passive"
    signal: Annotated[str, Text("output signal")] = ""
    at: Annotated[
        tuple[int, ...], ListedValues("row and column of an entry of a matrix, from 0; a scalar has none", Integer())
    ] = ()
    hertz: Annotated[float, SI("Hz", "frequency", 0.0)] = 0.0
    road: Annotated[Road, ReadBy("a road; without `type` it is a bump, or a step if `edge` is given", _road)] = PAPER_BUMP
    duration: Annotated[float, SI("s", "duration of the run")] = 3.0
    timestep: Annotated[float, SI("s", "timestep of the run")] = 1e-3
    band: Annotated[float, SI("%", "half the width of the band of a settling time, as in `roadproof drive`")] = 2.0
    half_band: Annotated[float, SI("", "magnitude that a signal no longer exceeds after a recovery time, in SI units", 0.0)] = 0.0
    grid: Annotated[float, SI("s", "step of the samples of the source's response; 0 if unknown", 0.0)] = 0.0
    unit: Annotated[str, Text("unit of the value")] = ""
    scale: Annotated[float, SI("", "factor from SI units to `unit`", -LARGEST)] = 1.0
    symbol: Annotated[str, Text("quantity of the paper")] = ""
    reason: Annotated[str, Text("reason for a difference; empty if there is no difference")] = ""
    within: Annotated[float, SI("", "largest relative difference that the reason explains", 0.0)] = 0.0
    derived: Annotated[bool, Flag("true if the source prints only data or a formula from which the value follows")] = False

    @property
    def text(self) -> str:
        """Short name of the published number, such as `peak sprung_acceleration`."""
        name = self.symbol or f"{self.what} {self.signal or self.controller}"
        where = f"[{', '.join(map(str, self.at))}]" if self.at else ""
        vehicle = "" if self.symbol or self.vehicle == CAR else f", {self.vehicle.removesuffix('.toml')}"
        return f"{name}{where}{vehicle}"

    @property
    def shown(self) -> str:
        """Published value with its digits and unit; in brackets if the value follows from data or a formula of the source."""
        text = f"{self.value:.{max(self.digits, 0)}f}{f' {self.unit}' if self.unit else ''}"
        return f"({text})" if self.derived else text


@dataclass(frozen=True)
class MissingNumber(Section):
    """A published number that is not compared, for example because no vehicle file can express the model of the source."""

    what: Annotated[str, Text("description of the number")]
    why: Annotated[str, Text("reason for the missing number, in a line")]
    source: Annotated[str, Choice("entry of `SOURCES` that has no numbers at all for this reason", SOURCES)] = ""


NUMBERS, REASONS = (Subsection("", (one,), "a table in double brackets") for one in (PrintedNumber, MissingNumber))


@dataclass(frozen=True)
class Entry(Section):
    """An entry of the gallery: a source and the numbers that were published in this source."""

    name: Annotated[str, Text("name of its folder")]
    title: Annotated[str, Text("title of the publication")]
    source: Annotated[str, Text("reference or address")]
    licence: Annotated[str, Text("licence, and the parts that are copied here")]
    printed: Annotated[tuple[PrintedNumber, ...], ListedValues("the numbers that can be compared", NUMBERS, least=0)] = ()
    missing: Annotated[tuple[MissingNumber, ...], ListedValues("numbers that cannot be compared", REASONS, least=0)] = ()
    about: Annotated[str, Text("description in a sentence")] = ""
    sources: Annotated[tuple[str, ...], ListedValues("entries of `SOURCES` with numbers in it", Choice("", SOURCES))] = ()

    @property
    def folder(self) -> Path:
        """Folder that contains the vehicle files of the entry."""
        return FOLDER / self.name


def names() -> list[str]:
    """Returns the names of all gallery entries. The entry about the paper is the first."""
    return [PAPER, *sorted(path.parent.name for path in FOLDER.glob("*/entry.toml"))]


def read_entry(name: str) -> Entry:
    """Returns the gallery entry with this name.

    Raises:
        InputError: the entry does not exist, or its file has an unknown key.
    """
    if name not in names():
        raise InputError(f"unknown entry {name!r}; the gallery has {list_names(names())}")
    if name == PAPER:
        return _paper()
    path = FOLDER / name / "entry.toml"
    return read(f"{path.name} of {name}:", Entry, {**parse_toml(path.read_text(encoding="utf-8")), "name": name})


def _paper() -> Entry:
    """Returns the entry about the paper, whose numbers are in `synth.vehicle.paper`."""
    printed = tuple(
        PrintedNumber(
            what="paper",
            value=one.value,
            digits=max(0, round(-math.log10(one.digit))),
            where=f"equation {one.equation}",
            vehicle="quarter_car",
            at=() if one.entry is None else one.entry,
            symbol=one.quantity,
            reason=one.reason,
            within=SHORT * bool(one.reason),
        )
        for one in PRINTED_NUMBERS
    )
    title = "Static output-feedback H-infinity controllers for vehicle suspensions, equations (40) to (60)"
    source = "Palacios-Quinonero, Rubio-Massegu, Rossell and Karimi"
    about = "The paper that this project implements: its gains, norms and bounds, each with the number of its equation."
    return Entry(PAPER, title, source, "only numbers are quoted", printed, about=about)
