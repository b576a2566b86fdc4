"""Entries of the gallery: published numbers of a source, read from `models/gallery/NAME/entry.toml`."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from models.common.errors import InputError, listing, quoted
from models.common.files import parse_toml
from models.kinds.kind import HERE
from synth.vehicle.paper import PRINTED

FOLDER = HERE / "gallery"
PAPER = "paper"
CAR = "car.toml"  # the usual vehicle file of an entry
SHORT = 1e-3  # relative: what the paper's solver stopped short by, in every number


@dataclass(frozen=True)
class PrintedNumber:
    """Number that a source prints.

    Attributes:
        what: type of the number, a key of `sim.studies.gallery.numbers.KINDS`.
        value: value as published, in `unit`.
        digits: decimals of the printed value.
        where: place in the source, or formula.
        vehicle: vehicle file in the entry's folder.
        controller: name in the vehicle file.
        signal: output signal.
        at: row and column of an entry of a matrix, from 0; empty for a scalar.
        hertz: frequency [Hz].
        road: a road's numbers by name, and its `type` out of `models.roads.obstacles.OBSTACLES`; without one it is a
            bump, or with an `edge` a step.
        duration, timestep: duration and timestep of the run [s].
        band: half the width of the band of a settling time, as in `sim.drive` [%].
        half_band: magnitude that a signal no longer exceeds after a recovery time, in its SI unit.
        grid: step of the samples of the source's response [s]; 0 if unknown.
        unit: unit of the value.
        scale: factor from SI units to `unit`.
        symbol: quantity of the paper.
        reason: reason of a difference; empty without one.
        within: the largest difference that the reason explains, relative.
        derived: True if the source prints data or a formula alone, from which the value follows as `where` says.
    """

    what: str
    value: float
    digits: int
    where: str
    vehicle: str = CAR
    controller: str = "passive"
    signal: str = ""
    at: tuple[int, ...] = ()
    hertz: float = 0.0
    road: Mapping[str, Any] = field(default_factory=dict)
    duration: float = 3.0
    timestep: float = 1e-3
    band: float = 2.0
    half_band: float = 0.0
    grid: float = 0.0
    unit: str = ""
    scale: float = 1.0
    symbol: str = ""
    reason: str = ""
    within: float = 0.0
    derived: bool = False

    @property
    def text(self) -> str:
        """Description in a few words."""
        name = self.symbol or f"{self.what} {self.signal or self.controller}"
        where = f"[{', '.join(map(str, self.at))}]" if self.at else ""
        vehicle = "" if self.symbol or self.vehicle == CAR else f", {self.vehicle.removesuffix('.toml')}"
        return f"{name}{where}{vehicle}"

    @property
    def shown(self) -> str:
        """The printed value with its digits and unit, in brackets if it is derived."""
        text = f"{self.value:.{max(self.digits, 0)}f}{f' {self.unit}' if self.unit else ''}"
        return f"({text})" if self.derived else text


@dataclass(frozen=True)
class MissingNumber:
    """Number of a source that no vehicle file can express.

    Attributes:
        what: the number, in words.
        why: reason for the missing number, in a line.
        source: entry of `SOURCES` without any number for this reason; empty if it has others.
    """

    what: str
    why: str
    source: str = ""


@dataclass(frozen=True)
class Entry:
    """Source and its numbers.

    Attributes:
        name: name of its folder.
        title: title of the publication.
        source: reference or address.
        licence: licence, and the parts that are copied here.
        printed: the numbers that can be compared.
        missing: numbers that cannot be compared.
        folder: folder of its vehicle files.
        about: description in a sentence.
        sources: entries of `SOURCES` with numbers in it.
    """

    name: str
    title: str
    source: str
    licence: str
    printed: tuple[PrintedNumber, ...]
    missing: tuple[MissingNumber, ...]
    folder: Path
    about: str = ""
    sources: tuple[str, ...] = ()


# Published results that the gallery is about. An entry says which it holds, with numbers or with the reason why there are none.
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


def names() -> list[str]:
    """Returns the names of all entries; the paper's is the first."""
    return [PAPER, *sorted(path.parent.name for path in FOLDER.glob("*/entry.toml"))]


def read_entry(name: str) -> Entry:
    """Returns an entry by its name.

    Raises:
        InputError: the entry does not exist, or its file has an unknown key.
    """
    if name not in names():
        raise InputError(f"unknown entry {name!r}; the gallery has {listing(names())}")
    if name == PAPER:
        return _paper()
    path = FOLDER / name / "entry.toml"
    tables = parse_toml(path.read_text(encoding="utf-8"))
    try:
        printed = tuple(PrintedNumber(**{**one, "at": tuple(one.get("at", ()))}) for one in tables.pop("printed", []))
        missing = tuple(MissingNumber(**one) for one in tables.pop("missing", []))
        sources = tuple(tables.pop("sources", ()))
        entry = Entry(name, printed=printed, missing=missing, folder=path.parent, sources=sources, **tables)
    except TypeError as error:
        raise InputError(f"{path.name} of {name}: {error}; give title, source, licence, printed and missing") from error
    if unknown := [one for one in (*sources, *(lack.source for lack in missing if lack.source)) if one not in SOURCES]:
        raise InputError(f"{path.name} of {name}: unknown source {quoted(unknown[0])}; one of {listing(SOURCES)}")
    return entry


def _paper() -> Entry:
    """Returns the paper's own numbers, from `synth.vehicle.paper`, as an entry like the others."""
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
        for one in PRINTED
    )
    title = "Static output-feedback H-infinity controllers for vehicle suspensions, equations (40) to (60)"
    source = "Palacios-Quinonero, Rubio-Massegu, Rossell and Karimi"
    about = "The paper that this project carries out: its gains, norms and bounds, each in its equation."
    return Entry(PAPER, title, source, "numbers alone are quoted", printed, (), HERE, about)
