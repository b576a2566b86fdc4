"""Pages of the site that are generated from the code: reference, gallery, notebook, drawings, and redirects of old addresses.

Nothing here repeats a list of the code. Commands come from their parsers, and keys from the tables of their readers. Signals,
roads and metrics come from the models, public names from `__all__`, and pictures from the pages that draw them.
"""

import argparse
import ast
import contextlib
import functools
import importlib
import inspect
import io
import json
import os
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

import models
import sim
import synth
from models.characteristics.adjustable_range import ActuatorSection
from models.characteristics.curve_reading import DamperTable, SpringTable
from models.characteristics.ratio_table import RatioSection
from models.common import schema
from models.common.command import Parser
from models.common.extensions import METRICS
from models.document.sketch import sketch_svg
from models.kinds import signals
from models.kinds.seat import Seat
from models.kinds.seated_kind import SIGNALS as SEAT_SIGNALS
from models.laws.combinations import COMMANDS as OPTIONS
from models.laws.combinations import DEMANDS, KEYS, KINDS, refusal
from models.laws.goals import BOUNDS, Minimise
from models.laws.law_structure import PidSection
from models.parts.element import PartSite, element_kinds
from models.roads.iso8608 import Iso8608
from models.roads.loads.load import LOADS
from models.roads.obstacles import OBSTACLES
from models.roads.profile import Profile
from models.roads.profile_file import TableSettings
from models.roads.rig import Rig
from models.roads.rig_file import RigSettings
from models.roads.road import Bump
from models.vehicle.controller_section import ControllerSection
from models.vehicle.limits_and_implementation import ImplementationSection, LimitsSection
from models.vehicle.names import LOAD_SYNTAX, ROAD_SYNTAX
from models.vehicle.payload import PayloadSection
from models.vehicle.sketch import vehicle_sketch
from models.vehicle.vehicle import kind, kinds, read_vehicle
from models.vehicle.weights import WeightSection
from sim.__main__ import COMMANDS, VERBS
from sim.campaign.file import CampaignFile
from sim.campaign.samples import SamplesSection
from sim.studies.ride import metrics

HERE = Path(__file__).parent
PACKAGES = (models, synth, sim)
GUIDES = ("how-to/*.md", "built-in-vehicles.md", "tutorials/your-own-car.md")  # pages that show keys of a vehicle file
SIDES = "front|rear|left|right"  # of a vehicle, in names of keys
DRAWN = ("quarter_car", "half_car", "half_car_roll", "full_car")  # vehicles on the page of conventions

# Pages that have moved: old address -> new address, below `docs/` without suffix.
MOVED = {
    "explanation/agrees-and-ended": "explanation/why-mujoco",
    "explanation/energy-balance": "explanation/why-mujoco",
    "explanation/sampled-and-continuous": "explanation/why-mujoco",
    "how-to/a-discrete-plant": "how-to/any-linear-plant",
    "how-to/a-law-from-matlab": "how-to/import-controllers",
    "how-to/a-law-in-python": "how-to/python-control-laws",
    "how-to/a-road-in-python": "how-to/custom-roads",
    "how-to/a-template-for-comfort": "how-to/weights",
    "how-to/adjustable-dampers": "how-to/semi-active-dampers",
    "how-to/any-controller": "how-to/any-linear-plant",
    "how-to/any-plant": "how-to/any-linear-plant",
    "how-to/bands-and-families": "how-to/any-linear-plant",
    "how-to/controllers-with-states": "how-to/dynamic-controllers",
    "how-to/curves": "how-to/springs-and-dampers",
    "how-to/designs-with-filters": "how-to/weights",
    "how-to/errors-by-frequency": "how-to/robustness",
    "how-to/gallery": "explanation/verification",
    "how-to/limits-and-implementation": "how-to/limits-and-actuators",
    "how-to/many-vehicles": "how-to/any-linear-plant",
    "how-to/proofs-of-goals": "explanation/how-goals-are-proved",
    "how-to/python-control": "how-to/import-controllers",
    "how-to/record-and-open": "how-to/record-and-view",
    "how-to/roll-centres": "how-to/suspension-kinematics",
    "how-to/semi-active-laws": "how-to/semi-active-dampers",
    "how-to/the-sampled-loop": "how-to/sampled-data-design",
    "how-to/vehicles-that-ship": "built-in-vehicles",
    "how-to/weights-by-frequency": "how-to/weights",
    "how-to/what-is-in-a-log": "reference/logs",
    "how-to/your-own-kind": "how-to/custom-vehicle-type",
    "how-to/your-own-vehicle": "tutorials/your-own-car",
}


def pages() -> dict[str, str]:
    """Returns the Markdown of every generated page but the log's, by path below `docs/` without suffix."""
    return {
        "gallery": gallery(),
        "examples": examples_page(),
        "tutorials/notebook": notebook(HERE / "tutorials" / "notebook.ipynb"),
        "reference/commands": commands(),
        "reference/vehicle-file": vehicle_file(),
        "reference/what-goes-together": together(),
        "reference/signals": signal_tables(),
        "reference/roads": roads(),
        "reference/metrics": metric_tables(),
        "reference/messages": messages(),
        **{f"reference/{package.__name__}": names(package) for package in PACKAGES},
    }


def kept_files(made: Mapping[str, str]) -> dict[str, str]:
    """Returns the files for readers on GitHub, which the repository keeps: most generated pages, drawings and notebooks."""
    kept = {f"{name}.md": made[name] for name in ("examples", *(name for name in made if name.startswith("reference/")))}
    del kept["reference/messages.md"]  # ten times as long as the other pages, and changed by every new message
    return kept | drawings() | example_notebooks()


def redirects() -> dict[str, str]:
    """Returns an HTML page for every address that has moved, by file below the site's folder. It leads to the new address."""
    return {f"{old}.html": _redirect(os.path.relpath(f"{new}.html", Path(old).parent)) for old, new in MOVED.items()}


def _redirect(to: str) -> str:
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>Moved</title><link rel="canonical" href="{to}">'
        f'<meta http-equiv="refresh" content="0; url={to}"></head><body>This page has moved to <a href="{to}">{to}</a>.</body>'
        "</html>\n"
    )


def table(heading: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Returns a Markdown table."""
    lines = [heading, ["---"] * len(heading), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines) + "\n"


def attributes(owner: type) -> dict[str, str]:
    """Returns the entries of a class's docstring on its attributes, by name."""
    text = (inspect.getdoc(owner) or "").partition("Attributes:\n")[2].partition("\n\n")[0]
    entries = re.split(r"^    (?=\w[\w, ]*: )", text, flags=re.M)
    parts = [entry.partition(": ") for entry in entries if entry.strip()]
    return {name: " ".join(said.split()) for some, _, said in parts for name in some.split(", ")}


# Commands, from their parsers


class _MadeError(Exception):
    """Signal that a command has made its parser."""


def parser_of(command: str) -> Parser:
    """Returns the parser of a command without running the command."""
    made: list[Parser] = []

    def stop(parser: Parser, *_: object) -> None:
        made.append(parser)
        raise _MadeError

    package, _, study = command.partition(" ")
    if study:  # a command without a module of its own
        main = partial(importlib.import_module(f"{package}.command.study").main, study)
    else:
        module = importlib.import_module(command)
        main = getattr(module, "main", None) or importlib.import_module(f"{command}.__main__").main
    with mock.patch.object(Parser, "parse_args", stop), contextlib.suppress(_MadeError):
        main([])
    return made[0]


def commands() -> str:
    """Returns the page of all commands and their options."""
    parsers = {name: parser_of(name) for name, _, _ in COMMANDS}
    many = Counter(row for parser in parsers.values() for row in _options(parser))
    common = [row for row, count in many.items() if count > 1]
    text = (
        "# Commands\n\n`roadproof bump` is the same as `python -m sim.bump`; the other commands have both forms, too.\n\n"
        f"## Common options\n\n{table(('option', 'meaning'), common)}"
    )
    for verb, (name, purpose, _) in zip(VERBS, COMMANDS, strict=True):
        parser = parsers[name]
        entries = _options(parser)
        rows = [row for row in entries if row not in common]
        page = parser.page.removeprefix("docs/")
        text += f"\n## roadproof {verb}\n\nPurpose: [{purpose}](../{page})\n\n{table(('option', 'meaning'), rows)}"
        shared = code(option for row in entries if row in common for option in re.findall(r"`([^ `]+)[^`]*`", row[0]))
        text += f"\nCommon options: {shared}.\n"
    return text


def _options(parser: Parser) -> list[tuple[str, str]]:
    """Returns the options of a parser, each with its meaning, except hidden ones."""
    return [_option(action) for action in parser._actions if action.help != argparse.SUPPRESS]


LISTED = {ROAD_SYNTAX: "roads", LOAD_SYNTAX: "loads"}  # texts in the help of options that a page explains in more detail


def _option(action: argparse.Action) -> tuple[str, str]:
    """Returns an option as it is written, and its meaning."""
    value = action.metavar if action.nargs != 0 and isinstance(action.metavar, str) else ""
    options = ", ".join(f"`{' '.join(filter(None, (option, value)))}`" for option in action.option_strings)
    meaning = re.sub(r"python -m (sim[. ])?", "roadproof ", (action.help or "").replace("%%", "%"))
    for choices, name in LISTED.items():
        meaning = meaning.replace(f": {choices}", f"; see \0{name}\0")
    return options or f"`{value or action.dest}`", re.sub(r"\0(\w+)\0", r"[\1](../how-to/\1.md)", cell(meaning))


def cell(text: str) -> str:
    """Returns a text in which Markdown shows every character literally, and options as code."""
    parts = re.split(r"(`[^`]*`|(?<![\w-])--[a-z][a-z-]*)", " ".join(text.split()))
    parts[1::2] = [f"`{code.strip('`')}`" for code in parts[1::2]]
    parts[::2] = [re.sub(r"([\[\]*_<>`])", r"\\\1", plain) for plain in parts[::2]]
    return "".join(parts)


# Vehicle files, from the tables of their readers


@functools.cache
def guides() -> list[tuple[Path, str]]:
    """Returns the pages that show keys of a vehicle file, each with its text."""
    return [(path, path.read_text(encoding="utf-8")) for glob in GUIDES for path in sorted(HERE.glob(glob))]


def shown_in(key: str, section: str = "") -> dict[Path, int]:
    """Returns how often each page shows a key of a vehicle file as code, for pages that contain a text of its section."""
    there = re.compile(rf"`{key}\b|^{key} = |[{{,] *{key} = |^\[{key}[\].]|\b{key} \[", re.M)
    counts = {path: len(there.findall(text)) for path, text in guides() if key in text and section in text}
    return {path: count for path, count in counts.items() if count}


def links(paths: Iterable[Path]) -> str:
    """Returns links to pages, with commas."""
    names = {path: path.stem.replace("-", " ").replace("semi ", "semi-").replace("built in", "built-in") for path in paths}
    return ", ".join(f"[{name}](../{path.relative_to(HERE).as_posix()})" for path, name in names.items())


def explained_in(section: str, keys: Iterable[str]) -> list[Path]:
    """Returns the pages that show most keys of a section: the first page, and pages with at least three more keys each."""
    pages: list[Path] = []
    left = [shown for key in keys if (shown := shown_in(key, section))]
    while left:
        best = max((path for path, _ in guides()), key=lambda page: sum(page in shown for shown in left))
        rest = [shown for shown in left if best not in shown]
        if pages and len(left) - len(rest) < 3:
            break
        pages, left = [*pages, best], rest
    return pages


def section_keys(section: type[schema.Section]) -> list[tuple[str, str, str]]:
    """Returns the keys of a section with their units and meanings; the meaning of a choice lists its texts."""
    rows = []
    for name, key in schema.keys(section).items():
        texts = ", ".join(f"`{one}`" for one in getattr(key, "texts", ()) if f"`{one}`" not in key.meaning)
        rows.append((name, key.unit, f"{key.meaning}: {texts}".removesuffix(": ")))
    return rows


def key_sections() -> dict[str, list[tuple[str, str, str]]]:
    """Returns the keys of every section of a vehicle file, each with its unit and its meaning, empty where a page has it."""
    sections = {
        f"{PARAMETERS}{name}": [(one.name, one.unit, one.meaning + default(one)) for one in kind(name).parameters]
        for name in kinds()
    }
    sections["[performance]"] = [("road", "", "filter from the disturbance w to the road velocity under every wheel")]
    sections["[performance]"] += section_keys(WeightSection)
    sections[CONTROLLER] = section_keys(ControllerSection)
    sections["minimise of a controller"] = section_keys(Minimise)
    bounds = [row for one in BOUNDS for row in section_keys(one)]
    sections["bounds of a controller"] = [*dict.fromkeys(bounds)]
    sections["pid of a controller"] = section_keys(PidSection)
    sections["[limits]"] = section_keys(LimitsSection)
    sections["[implementation]"] = section_keys(ImplementationSection)
    tables = (DamperTable, SpringTable, RatioSection)
    sections["[curves]"] = list({row[0]: row for section in tables for row in section_keys(section)}.values())
    sections["[actuators]"] = section_keys(ActuatorSection)
    sections["[payload]"] = section_keys(PayloadSection)
    sections["[seat]"] = section_keys(Seat)
    sections["[start]"] = [
        ("height", "m", "height by which the whole vehicle is lifted above the road at the start of a run"),
        ("suspension_deflection", "m", "this state of the linear model at the start of a run; so for its other states"),
    ]
    sections["[parts.NAME]"] = section_keys(PartSite)
    sections["[identified]"] = [
        ("intervals", "", "95 % interval of each identified parameter [SI]; information only, as all keys of this section"),
        ("fixed", "", "parameters that kept their first values, with the reason"),
        ("correlations", "", "correlations of the identified parameters"),
        ("white", "", "true if the residuals are white"),
        ("logs", "", "SHA-256 of each log"),
    ]
    sections |= {f'{PARTS}"{name}"': section_keys(one) for name, one in element_kinds().items()}
    sections["a campaign file"] = section_keys(CampaignFile)
    sections["[samples] of a campaign file"] = section_keys(SamplesSection)
    return sections


def default(parameter: Any) -> str:
    """Returns the default of a parameter in words; empty if a vehicle file must give it."""
    if parameter.optional:
        return "; optional"
    return f"; default {parameter.usual:g}" if parameter.usual is not None else ""


PARAMETERS = "[parameters] of a "
PARTS = "[parts.NAME] with kind = "
ALIKE = {PARAMETERS: "[parameters] of several vehicle types", PARTS: "[parts.NAME] with one of several kinds"}  # their headings
CONTROLLER = "[controllers.NAME]"
COLUMNS = "key", "unit", "meaning"


def vehicle_file() -> str:
    """Returns the page of all keys of a vehicle file, and of a campaign file."""
    text = '# Keys of a vehicle file\n\nNumbers are in SI units, or in quotes with their unit, as in `"22 N/mm"`.\n'
    sections = key_sections()
    written = {
        section: [
            (code(names), unit, cell(meaning) if "`" not in meaning else meaning, *used_in(section, names[0]))
            for names, unit, meaning in of_both_sides(keys)
        ]
        for section, keys in sections.items()
    }
    for section, rows in written.items():
        if prefix := next((prefix for prefix in ALIKE if section.startswith(prefix)), ""):
            alike = {name.removeprefix(prefix): rows for name, rows in written.items() if name.startswith(prefix)}
            shared = of_several(alike)
            if rows is next(iter(alike.values())):
                some = see(prefix.partition("]")[0], [key for name in alike for key, *_ in sections[f"{prefix}{name}"]])
                text += f"\n## {ALIKE[prefix]}\n\n{some}{table((*COLUMNS, 'types'), shared.values())}"
            if rows := [row for row in rows if without_sides(row) not in shared]:
                text += f"\n## {section}\n\n{table(COLUMNS, rows)}"
        elif section == CONTROLLER:
            text += f"\n## {section}\n\n{table((*COLUMNS, 'used in'), rows)}"
        else:
            words = "[controllers" if "controller" in section else (re.findall(r"^\[\w+", section) or [""])[0]
            text += f"\n## {section}\n\n{see(words, (key for key, *_ in sections[section]))}{table(COLUMNS, rows)}"
    return text


def of_several(alike: Mapping[str, list[tuple[str, ...]]]) -> dict[tuple[str, ...], tuple[str, ...]]:
    """Returns the rows of keys that several types have with the same meaning, each with the keys of all types, and the types."""
    types: dict[tuple[str, ...], dict[str, list[str]]] = {}
    for name, rows in alike.items():
        for row in rows:
            types.setdefault(without_sides(row), {})[name] = row[0].split(", ")
    return {
        row: (", ".join(dict.fromkeys(one for names in of.values() for one in names)), *row[1:], code(of))
        for row, of in types.items()
        if len(of) > 1
    }


def without_sides(row: tuple[str, ...]) -> tuple[str, ...]:
    """Returns the row of a key without its side, as in `motion_ratio`, in place of one key or more with their sides."""
    return re.sub(f"_({SIDES})(?=`)", "", row[0].partition(",")[0]), *row[1:]


def used_in(section: str, key: str) -> tuple[str, ...]:
    """Returns a link to the page that shows a key of a controller most often; no cell for other sections."""
    if section != CONTROLLER:
        return ()
    counts = shown_in(key, "[controllers")
    return (links([max(counts, key=lambda page: counts[page])] if counts else []),)


def see(section: str, keys: Iterable[str]) -> str:
    """Returns a line with links to the pages that explain a section; empty if there is no such page."""
    pages = explained_in(section, keys)
    return f"See {links(pages)}.\n\n" if pages else ""


def of_both_sides(keys: Iterable[tuple[str, str, str]]) -> Iterator[tuple[list[str], str, str]]:
    """Yields keys with their unit and meaning; keys that differ only in front and rear, or left and right, are together."""
    rows: dict[tuple[str, ...], list[tuple[str, str]]] = {}
    for key, unit, meaning in keys:
        stem = re.sub(f"_({SIDES})$", "", key)
        same = re.sub(rf",? ?\b({SIDES})\b", "", meaning).lstrip(", ") if stem != key else meaning
        rows.setdefault((stem, unit, same), []).append((key, meaning))
    for (_, unit, same), members in rows.items():
        yield [key for key, _ in members], unit, same if len(members) > 1 else members[0][1]


def together() -> str:
    """Returns the page of the keys that can be combined in a controller's section."""
    rows = {**KINDS, **{part: name for part, name in DEMANDS.items() if part != "force"}}
    text = (
        f"# Compatible options\n\nThe first {len(KINDS)} rows are control laws and designs. A controller's section has one of "
        'them. The other rows are keys that a section can have in addition. "✓" means that a row and a column can be combined. '
        "If a section has several keys, each pair of them must be compatible. Roadproof refuses other combinations and prints "
        "the reason.\n\n"
        '- "Goals" are all keys of [goals](../how-to/goals.md).\n'
        "- `control_force` is a measured signal here, of an actuator without `lag`.\n"
        "- The options belong to `roadproof synth`. `--rates` computes the norms of every linear controller. It designs a "
        "controller again if the table allows that.\n"
        "- LQG always uses the sensor noise of the vehicle file, without the key `noise`.\n"
    )
    for columns in (KEYS, tuple(OPTIONS)):
        marks = [
            (name, *("" if row == column else "-" if refusal(row, column) else "✓" for column in columns))
            for row, name in rows.items()
        ]
        text += f"\n{table(('', *({**DEMANDS, **OPTIONS}[column] for column in columns)), marks)}"
    return text


# Signals, roads, metrics


def signal_tables() -> str:
    """Returns the page of all signals: their meanings, and their names on each vehicle type."""
    known = [value for value in vars(signals).values() if isinstance(value, signals.Signal)]
    rows = [(f"`{one.name}`", one.symbol, one.unit, one.meaning) for one in known]
    text = "# Signals\n\nSignals are in SI units, and zero in equilibrium. See also [Conventions](../conventions.md).\n\n"
    text += table(("name", "symbol", "unit", "meaning"), rows)
    text += "\nOn a vehicle with several wheels, the name of a signal ends with the wheel, as in `tyre_deflection_rear`. "
    text += "The states of a controller are `controller_1`, `controller_2` and so on.\n"
    for name in kinds():
        listed, measured = [one.name for one in kind(name).signals], read_vehicle(name).linear_model.measurable
        text += f"\n## {name}\n\nControllers may measure {code(measured)}.\n\n"
        text += f"Other signals: {code(one for one in listed if one not in measured)}.\n"
    return f"{text}\n## A vehicle with a seat\n\nWith `[seat]` every vehicle also has {code(one.name for one in SEAT_SIGNALS)}.\n"


def code(names: Iterable[str]) -> str:
    """Returns names as code, with commas."""
    return ", ".join(f"`{name}`" for name in names)


NUMBERS = "number", "default", "unit", "allowed", "meaning"


def numbers(section: type) -> list[tuple[str, ...]]:
    """Returns the numbers of a road or load, with their defaults."""
    return [
        (f"`{one.name}`", "" if one.default in (None, MISSING, ()) else f"{one.default}", key.unit, allowed(key), key.meaning)
        for one, key in zip(fields(section), schema.keys(section).values(), strict=True)
    ]


def allowed(key: schema.Key) -> str:
    """Returns the allowed values of a number or a text; empty for others."""
    if isinstance(key, schema.SI):
        return f"{key.low:g} to {key.high:g}"
    return ", ".join(key.texts) if isinstance(key, schema.Choice) else ""


def first(owner: Any) -> str:
    """Returns the first paragraph of a docstring."""
    return " ".join((inspect.getdoc(owner) or "").partition("\n\n")[0].split())


def roads() -> str:
    """Returns the page of roads and loads."""
    text = (
        "# Roads and loads\n\nWrite a road as in `--road pothole:depth=0.06:length=1.5`, and a load as in `--load brake:g=0.5`. "
        "Add loads to a road with `+`: `--road 'bump + brake:g=0.5'`.\n"
    )
    settings = {Rig: RigSettings, Profile: TableSettings}
    for name, owner in {"iso8608": Iso8608, **OBSTACLES, "rig": Rig, "from a file": Profile}.items():
        text += f"\n## Road {name}\n\n{first(owner)}\n\n{table(NUMBERS, numbers(settings.get(owner, owner)))}"
    loads = {name: {(row[0], *row[2:]): row[1] for row in numbers(owner)} for name, owner in LOADS.items()}
    shared = [row for row in next(iter(loads.values())) if all(row in rows for rows in loads.values())]
    for name, owner in LOADS.items():
        own = [row for row in numbers(owner) if (row[0], *row[2:]) not in shared]
        text += f"\n## Load {name}\n\n{first(owner)}\n\n{table(NUMBERS, own)}"
    common = [(row[0], _defaults({name: rows[row] for name, rows in loads.items()}), *row[1:]) for row in shared]
    return f"{text}\n## Start and end of a load\n\n{table(NUMBERS, common)}"


def _defaults(values: Mapping[str, str]) -> str:
    """Returns the default of a number: the value of most loads, and the values of the other loads."""
    ((usual, _),) = Counter(values.values()).most_common(1)
    others = [f"{value} for `{name}`" for name, value in values.items() if value != usual]
    return ", ".join([usual, *others])


def metric_tables() -> str:
    """Returns the page of metrics: what all share, their definitions, and their names for the quarter-car under loads."""
    about, _, formulas = (inspect.getdoc(metrics) or "").partition("\n\n")
    headings = ("name", "unit", "in `--best`", "over runs", "expectation", "definition")
    names = {kind: name for name, kind in METRICS.load_all().items()}
    rows = [
        (
            f"`{one.name}`",
            one.unit,
            f"`{names[type(one)]}`",
            one.over_runs.words,
            "none" if type(one).expected is metrics.Metric.expected else "approximate" if one.approximate else "exact",
            first(type(one)),
        )
        for one in metrics.metrics_of(read_vehicle("quarter_car"), True)
    ]
    wheels = [re.sub(f"(front|rear)_({SIDES})", "WHEEL", one.name) for one in metrics.metrics_of(read_vehicle("full_car"), True)]
    return (
        f"# Metrics\n\n{about}\n\n```text\n{formulas}\n```\n\n## Metrics of a quarter-car\n\n"
        f"{table(headings, rows)}\n## Metrics of a full car\n\n`WHEEL` is a wheel, as in `front_left`.\n\n"
        f"{code(dict.fromkeys(wheels))}.\n"
    )


# Messages, from the calls that raise them


def told(node: ast.expr) -> str:
    """Returns the text of a message's expression, with <names> for inserted values; empty if the text is made elsewhere."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    if isinstance(node, ast.JoinedStr):
        return "".join(map(told, node.values))
    if isinstance(node, ast.FormattedValue):
        of = node.value
        return f"<{of.id if isinstance(of, ast.Name) else of.attr}>" if isinstance(of, ast.Name | ast.Attribute) else "..."
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return "".join(told(side) or "..." for side in (node.left, node.right))
    if isinstance(node, ast.IfExp):
        return told(node.body) or told(node.orelse)
    return ""


def raised(path: Path) -> list[tuple[str, str]]:
    """Returns the function and the text of every message that a file raises as an InputError, in its order."""
    found: list[tuple[int, str, str]] = []
    source = path.read_text(encoding="utf-8")
    lines = [number for number, line in enumerate(source.splitlines(), start=1) if "InputError(" in line]
    if not lines:
        return []

    def search(node: ast.AST, function: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.stmt) and not any(child.lineno <= line <= (child.end_lineno or 0) for line in lines):
                continue
            inside = child.name if isinstance(child, ast.FunctionDef | ast.ClassDef) else ""
            if isinstance(child, ast.Call) and isinstance(child.func, ast.Name) and child.func.id == "InputError" and child.args:
                found.append((child.lineno, function, " ".join(told(child.args[0]).split())))
            search(child, ".".join(filter(None, (function, inside))))

    search(ast.parse(source), "")
    return [(function, text) for _, function, text in sorted(found) if len(re.findall("[a-z]{2,}", text)) > 2]


def messages() -> str:
    """Returns the page of all messages, a section for each room."""
    text = (
        "---\norphan: true\n---\n\n"
        "# Messages\n\nFor invalid input, a command prints one of these lines and ends with exit code 2. The line contains what "
        "was found, what is allowed, and what to do. `<name>` and `...` are placeholders for values. A function of the library "
        "raises an `InputError` with the same text.\n"
    )
    rooms: dict[str, list[tuple[str, str]]] = {}
    for package in PACKAGES:
        root = Path(inspect.getfile(package)).parent
        for path in sorted(root.rglob("*.py")):
            place = path.relative_to(root.parent)
            room = ".".join(place.parent.parts) if len(place.parts) > 2 else place.with_suffix("").as_posix().replace("/", ".")
            rooms.setdefault(room, []).extend(
                (f"`{place.stem}.{function}`" if function else f"`{place.stem}`", said) for function, said in raised(path)
            )
    for room, rows in sorted(rooms.items()):
        if rows:
            parts = [(*said.rpartition("; ")[::2], at) if "; " in said else (said, "", at) for at, said in rows]
            listed = table(
                ("problem, and what is allowed", "what to do", "raised in"), [(cell(one), cell(do), at) for one, do, at in parts]
            )
            text += f"\n## {room}\n\n{cell(first(importlib.import_module(room)))}\n\n{listed}"
    return text


# Logs, from one that is written now


TOPICS = {
    "mujoco": "the simulation",
    "linear": "its exact sampled response",
    "continuous": "response of the paper's continuous loop",
    "difference": "simulation minus sampled response, as a share of each signal's peak",
    "loads": "forces and moments on the body, the sum and each one, held over a step",
    "dampers": "forces of semi-active dampers, and of springs and dampers with characteristics, and their limits",
    "measured": "measured log of `--beside`, at its own times; NaN in gaps",
    "events": "lift-offs, landings, bump stops and other events",
    "transforms": "motion of the vehicle, 60 frames a second",
    "shapes": "solids of the vehicle",
    "scene": "struts, tyres and control forces, 60 frames a second",
}
LOGS = (
    """# Logs

A log is an MCAP file, which the `mcap` libraries of many languages read. [Record and view runs](../how-to/record-and-view.md)
lists the viewers. Time counts from the start of the run.

## Topics
""",
    """
- With several controllers, a topic begins with the name of its controller, as in `/I/mujoco`. `/loads` exists if loads act.
- Fields have the names of the [signals](signals.md). Metadata of the channel and comments in the schema contain their units.
- The states of a dynamic controller are `controller_1` and so on, in its own coordinates, each as at the last sample. Viewers
  plot the six states that contribute most to the forces. The state of a control law in Python is not recorded.

## Fields of quarter_car_semi_active

Other vehicles have their own signals.
""",
)
ATTACHED = {
    "vehicle.toml": "the vehicle file",
    "model.xml": "the MJCF of the run",
    "result.json": "output of `--json`, except `compared` and paths",
}


def log_page() -> str:
    """Returns the page of a log's channels, claims and attachments: those of a run that is recorded here."""
    from mcap.reader import make_reader

    from sim.bump import main

    with tempfile.TemporaryDirectory() as folder:
        with contextlib.redirect_stdout(io.StringIO()):
            main(["--vehicle", "quarter_car_semi_active", "--controller", "I", "--duration", "0.1", "--logs", folder, "--brief"])
        (path,) = Path(folder).glob("*.mcap")
        with path.open("rb") as file:
            reader = make_reader(file)
            summary = reader.get_summary()
            assert summary is not None
            claims = {one.name: one.metadata for one in reader.iter_metadata()}
            attached = [(f"`{one.name}`", one.media_type, ATTACHED[one.name]) for one in reader.iter_attachments()]
    there = {one.topic: (summary.schemas[one.schema_id].name, one.metadata) for one in summary.channels.values()}
    rows = [(f"`/{name}`", there.get(f"/{name}", ("roadproof.Signals", ()))[0], content) for name, content in TOPICS.items()]
    fields = [(f"`{name}`", ", ".join(f"`{one}`" for one in each)) for name, (_, each) in sorted(there.items()) if each]
    text = f"{LOGS[0]}\n{table(('topic', 'schema', 'content'), rows)}{LOGS[1]}\n{table(('topic', 'fields'), fields)}"
    for name, values in claims.items():
        text += f"\n## Metadata {name}\n\n{', '.join(f'`{key}`' for key in values)}.\n"
    return text + f"\n## Attachments\n\n{table(('name', 'type', 'content'), attached)}"


# Public names


def names(package: Any) -> str:
    """Returns the page of a package's public names, for autodoc."""
    title = f"Python API: {package.__name__}"
    rows = [(f"`{name}`", first(getattr(package, name))) for name in package.__all__ if callable(getattr(package, name))]
    lines = [f"# {title}", "", first(package), "", table(("name", "summary"), rows), "```{eval-rst}"]
    for name in package.__all__:
        value = getattr(package, name)
        directive = "autoclass" if inspect.isclass(value) else "autofunction" if callable(value) else "automodule"
        if inspect.ismodule(value) or callable(value):
            lines += [f".. {directive}:: {value.__name__ if inspect.ismodule(value) else f'{package.__name__}.{name}'}", ""]
            if inspect.isclass(value) and issubclass(value, schema.Section):
                lines += ["   The arguments are the numbers in :doc:`roads`.", ""]
        else:
            lines += [f".. py:data:: {package.__name__}.{name}", "", f"   {value!r}", ""]
    return "\n".join([*lines, "```", ""])


# Pictures and the notebook


def drawings() -> dict[str, str]:
    """Returns a drawing of each vehicle type with its symbols, by file below `docs/`: its last view, in the text colour."""
    style = '<svg style="display: block; max-width: 100%; height: auto; margin: 1rem 0" '
    views = {name: vehicle_sketch(read_vehicle(name), computer=False).single[-1] for name in DRAWN}
    return {f"reference/{name}.svg": sketch_svg(view).replace("<svg ", style, 1) + "\n" for name, view in views.items()}


def car() -> str:
    """Returns the picture of the home page, `.github/pictures/car.svg`: the built-in half-car over the paper's bump."""
    bump = Bump()
    middle = bump.length / 2  # under the front wheel
    high = 280  # units of the drawing per metre of height, four times those per metre of length

    def road(place: float) -> float:
        return high * float(bump.displacement(np.array((place + middle) / bump.speed)))

    return sketch_svg(vehicle_sketch(read_vehicle("half_car"), computer=False), road, alone=True) + "\n"


def drawn() -> list[tuple[str, str, str, Path]]:
    """Returns every picture that a command on a page draws: its file, what it shows, the command, the page."""
    pictures = []
    for path in sorted(path for part in ("how-to", "explanation") for path in (HERE / part).glob("*.md")):
        text = path.read_text(encoding="utf-8")
        shown = dict((name, alt) for alt, name in re.findall(r"!\[([^\]]*)\]\([^)]*/([^/)]+)\)", text))
        for line in re.findall(r"^roadproof .*--picture \S+.*$", text, re.M):
            (name,) = re.findall(r"--picture (\S+)", line)
            if name in shown:
                pictures.append((name, shown.pop(name), line, path))
        for line in re.findall(r"^roadproof .*--figures \S+.*$", text, re.M):  # draws whatever else the page shows
            pictures += [(name, alt, line, path) for name, alt in shown.items()]
    return pictures


def gallery() -> str:
    """Returns the page of pictures, with the command that draws each."""
    text = "# Gallery of pictures\n\nThe command below each picture draws it.\n"
    for name, alt, line, path in drawn():
        page = path.relative_to(HERE).as_posix()
        text += f"\n![{alt}](../.github/pictures/{name})\n\n[{alt}]({page}).\n\n```text\n{line}\n```\n"
    return text


# Examples: scripts in docs/examples/, from which a page, notebooks and pictures are made

EXAMPLES = (
    *("own_car", "hump", "skyhook", "preview", "full_order", "campaign"),
    *("measured_road", "code_in_the_loop", "trade_off", "margins", "inerter", "hysteresis"),
)
STYLE: Any = {
    "font.size": 12,
    "savefig.dpi": 130,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.3,
}
COLOURS = 48  # of a picture, so that its file is small
CODE_IN_PAGE = re.compile(r'"""(?P<title>[^\n]*)\.\n\n(?P<text>.*?)\n"""\n\n(?P<code>.*)', re.S)


def example(name: str) -> tuple[str, str, str]:
    """Returns title, explanation and code of an example."""
    found = CODE_IN_PAGE.fullmatch((HERE / "examples" / f"{name}.py").read_text(encoding="utf-8"))
    assert found, f"docs/examples/{name}.py does not begin with a title, an explanation and code"
    return found["title"], found["text"], found["code"]


def example_notebooks() -> dict[str, str]:
    """Returns the notebooks of the examples, by path below `docs/`."""
    return {f"examples/{name}.ipynb": example_notebook(name) for name in EXAMPLES}


def examples_page() -> str:
    """Returns the page of the examples: thumbnails, then each picture with its code."""
    names = EXAMPLES
    titles = {name: example(name)[0] for name in names}
    anchors = {name: re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for name, title in titles.items()}
    thumbnails = [f"[![{titles[name]}](examples/{name}.png)](#{anchors[name]})" for name in names]
    rows = [thumbnails[i : i + 3] for i in range(0, len(names), 3)]
    text = (
        "# Examples to copy\n\nEach example is a complete script. A notebook has the same code. Scripts need the extra `report`: "
        "`pip install -e '.[report]'`. Notebooks also need Jupyter: `pip install jupyter`.\n\n"
        f"{table(rows[0], rows[1:])}"
    )
    for name in names:
        title, said, code = example(name)
        links = f"[Script](examples/{name}.py), [notebook](examples/{name}.ipynb)."
        text += f"\n## {title}\n\n{said} {links}\n\n![{title}](examples/{name}.png)\n\n```python\n{code}```\n"
    return text


def example_notebook(name: str) -> str:
    """Returns an example as a notebook, without outputs."""
    title, said, code = example(name)
    parts = [("markdown", f"# {title}\n\n{said}"), ("code", code.rstrip())]
    cells: list[dict[str, Any]] = [
        {"cell_type": kind, "id": f"{name}-{i}".replace("_", "-"), "metadata": {}, "source": text.splitlines(keepends=True)}
        for i, (kind, text) in enumerate(parts)
    ]
    cells[1] |= {"execution_count": None, "outputs": []}
    kernel = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    return json.dumps({"cells": cells, "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}, indent=1) + "\n"


def draw_example(name: str, folder: Path) -> Path:
    """Runs an example in a folder, and reduces its picture there to a few colours; returns the picture."""
    import matplotlib

    with matplotlib.rc_context(STYLE, fname=None), contextlib.chdir(folder):
        matplotlib.use("agg")
        exec(compile(example(name)[2], f"docs/examples/{name}.py", "exec"), {"__name__": "__main__"})
    from PIL import Image

    path = folder / f"{name}.png"
    with Image.open(path) as picture:
        picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


def cells(path: Path) -> list[Mapping[str, Any]]:
    """Returns the cells of a notebook."""
    return json.loads(path.read_text(encoding="utf-8"))["cells"]


def notebook(path: Path) -> str:
    """Returns a notebook as a page, with the printed output of its cells."""
    text = ""
    for one in cells(path):
        source = "".join(one["source"])
        if one["cell_type"] == "markdown":
            text += f"{source}\n\n"
            continue
        ast.parse(source)
        text += f"```python\n{source}\n```\n\n"
        said = "".join("".join(output.get("text", [])) for output in one["outputs"])
        text += f"```text\n{said.rstrip()}\n```\n\n" if said else ""
    return text


def main(arguments: Sequence[str]) -> None:
    """Writes the generated files that are kept in the repository, and the pictures of the examples that are named."""
    for name, text in {**kept_files(pages()), "reference/logs.md": log_page()}.items():
        (HERE / name).parent.mkdir(exist_ok=True)
        (HERE / name).write_text(text, encoding="utf-8", newline="\n")
    for name in arguments:
        with tempfile.TemporaryDirectory() as folder:
            (HERE / "examples" / f"{name}.png").write_bytes(draw_example(name, Path(folder)).read_bytes())


if __name__ == "__main__":
    main(sys.argv[1:])
