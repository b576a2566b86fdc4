"""Every key of every section of a file: wrong types, ranges, units and spellings are refused in a line with section and key."""

import itertools
import math
import pickle
import re

import pytest

from models.characteristics.adjustable_range import ActuatorSection
from models.characteristics.curve_reading import DamperTable, SpringTable, SurfaceTable
from models.characteristics.ratio_table import RatioSection
from models.common.schema import (
    SI,
    AnyTable,
    BySignal,
    Choice,
    Flag,
    Integer,
    Key,
    ListedValues,
    Section,
    keys,
    read,
    required_keys,
)
from models.kinds.seat import Seat
from models.laws.design_request import DesignRequest
from models.laws.filter import FilterSection
from models.laws.goals import DecayBound, EnergyBound, GainBound, Minimise, NormBound, PeakBound
from models.laws.law_structure import PidSection
from models.parts.element import PartSite, element_kinds
from models.parts.stops.section import StopSection
from models.roads.choice import choose_road
from models.roads.iso8608 import Iso8608
from models.roads.loads.choice import choose_load
from models.roads.loads.load import LOADS
from models.roads.obstacles import OBSTACLES
from models.roads.profile_file import TableSettings
from models.roads.rig_file import RigSettings
from models.roads.sinusoids import Multisine
from models.vehicle.controller_section import ControllerSection
from models.vehicle.limits_and_implementation import ImplementationSection, Limits, LimitsSection
from models.vehicle.payload import PayloadSection
from models.vehicle.vehicle import VehicleFile, kind, kinds, parse_vehicle, read_vehicle
from models.vehicle.weights import WeightSection
from sim.campaign.file import CampaignFile
from sim.campaign.samples import SamplesSection
from sim.studies.gallery.entries import Entry, MissingNumber, PrintedNumber
from tests.support.commands import refused

CONTEXT = {
    "signals": {"sprung_velocity": "m/s"}, "measurable": ["sprung_velocity"], "heights": [], "corners": {"control_force": ""},
    "parameters": {"sprung_mass": "1"}, "loads": {"heave_load": "N"}, "outputs": ["sprung_velocity", "tyre_deflection"],
}  # fmt: skip
IN_PYTHON = [*OBSTACLES.values(), *LOADS.values(), Iso8608]  # which also check themselves
ELEMENTS = {
    one: {key: max(each.low, 1.0) for key, each in keys(one).items() if isinstance(each, SI)} for one in element_kinds().values()
}
EXCLUSIVE = ("load", "pressure")  # of a gas spring, as the first or the second is given
for _right in ELEMENTS.values():
    if {*EXCLUSIVE} <= {*_right}:
        del _right[EXCLUSIVE[1]]
SECTIONS = {  # each with a table that is right
    ImplementationSection: {"sample_period": 0.01},
    LimitsSection: {"actuator_force": 100.0},
    StopSection: {"suspension_stroke": 0.1, "stop_stiffness": 1e5},
    ActuatorSection: {"kind": "damper", "c_min": 100.0, "c_max": 1e3},
    PayloadSection: {"mass": 100.0},
    Seat: {"mass": 80.0, "stiffness": 15e3, "damping": 400.0},
    ControllerSection: {"measured": ["sprung_velocity"]},
    Minimise: {"band": [4.0, 8.0]},
    NormBound: {"norm": 8.6},
    PeakBound: {"peak": "sprung_velocity", "at_most": 0.09},
    EnergyBound: {"energy_peak": "sprung_velocity", "at_most": 0.09},
    DecayBound: {"decay": 1.2},
    GainBound: {"gain": 2e4},
    PidSection: {"kp": -8000.0},
    DamperTable: {"velocity": [-1.0, 1.0], "force": [-9.0, 9.0], "friction": 5.0, "friction_velocity": 0.1},
    SpringTable: {"deflection": [-0.1, 0.1], "force": [-9.0, 9.0]},
    SurfaceTable: {"velocity": [-1.0, 1.0], "deflection": [-0.1, 0.1], "force": [[-9.0, -8.0], [9.0, 8.0]]},
    RatioSection: {"deflection": [-0.1, 0.1], "ratio": [0.6, 0.7]},
    VehicleFile: {"type": "quarter_car", "parameters": {}, "performance": {}},
    PartSite: {"kind": "hydraulic_stop"},
    **ELEMENTS,
    FilterSection: {"numerator": [1.0], "denominator": [2.0, 1.0]},
    WeightSection: {"weight": 2.0, "numerator": [1.0], "denominator": [2.0, 1.0]},
    CampaignFile: {"vehicles": ["quarter_car"], "controllers": ["passive"], "roads": ["bump"], "speeds": [10.0]},
    SamplesSection: {"count": 3, "parameters": {}},
    Multisine: {"omega": [1.0, 3.0], "amplitudes": [0.1, 0.2], "phases": [0.0, -1.0]},
    PrintedNumber: {"what": "peak", "value": 1.0, "digits": 1, "where": "page 1", "road": {"edge": 0.1}},
    MissingNumber: {"what": "a peak", "why": "no units"},
    Entry: {"name": "mine", "title": "a title", "source": "a source", "licence": "none"},
    **{section: {} for section in (*IN_PYTHON, TableSettings, RigSettings)},
}


def sections(base: type = Section) -> list[type]:
    """The sections of the project that no other section is made of."""
    return [each for one in base.__subclasses__() for each in sections(one)] or [base]


def of_each(key: Key) -> list[Key]:
    """The key, and those of the values that it holds."""
    held = [value for value in vars(key).values() if isinstance(value, Key)]
    return [key, *(one for value in held for one in of_each(value))]


KEYS = [(section, name, key) for section in SECTIONS for name, key in keys(section).items()]
NUMBERS = [row for row in KEYS if any(isinstance(one, SI | Integer) for one in of_each(row[2]))]


def names(rows: list) -> list[str]:
    return [f"{section.__name__}-{name}" for section, name, _ in rows]


def wrapped(key: Key, value: object) -> object:
    """A value as the key holds it: in a list, if the key is one."""
    return [wrapped(key.each, value)] * key.least if isinstance(key, ListedValues) else value


def table(section: type, name: str, value: object) -> dict[str, object]:
    """The right table of a section with another value of a key, without the key that excludes it."""
    out = EXCLUSIVE if name in EXCLUSIVE else ()
    return {**{other: each for other, each in SECTIONS[section].items() if other not in out}, name: value}


def test_every_section_is_here():
    """Every section is in the table, but for what is made in Python alone, and a map of logs (`tests/sim/test_identify.py`)."""
    every = {one for one in sections() if not one.__module__.startswith(("tests", "sim.studies.identification"))}
    assert every - {*SECTIONS} == {DesignRequest, Limits}


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.__name__)
def test_a_section(section):
    """A right table is read, and is the same after it was pickled; an unknown key is refused, with the known ones."""
    given = read("[here]", section, SECTIONS[section], **CONTEXT)
    assert pickle.loads(pickle.dumps(given)) == given
    for others in (SECTIONS[section], {}):
        with refused(match=r"^\[here\] unknown key 'colour'; known keys: \w+"):
            read("[here]", section, {**others, "colour": 1}, **CONTEXT)
    with refused(match=r"^\[here\] = 3 is not a section; write \[here\]"):
        read("[here]", section, 3)
    for key in required_keys(section):
        left = {name: value for name, value in SECTIONS[section].items() if name != key}
        with refused(match=rf"^\[here\] {key} is missing; give {key}.*: \w+"):
            read("[here]", section, left, **CONTEXT)


@pytest.mark.parametrize(("section", "name", "key"), KEYS, ids=names(KEYS))
def test_a_key(section, name, key):
    """A key has a meaning, and a value of a wrong type is refused in a line with section, key, value and what is allowed."""
    assert key.meaning
    held = of_each(key)

    def line(wrong, match):
        with refused(match=match):
            read("[here]", section, table(section, name, wrong), **CONTEXT)

    others = [1.5] if isinstance(key, Flag) else [] if "boolean" in str(key.json) else [True]
    for wrong in ([[]], *others, *[{"colour": []}] * (not isinstance(key, AnyTable))):
        line(wrong, rf"^\[here.*{name}")
    if any(isinstance(one, Choice) for one in held):
        line(wrapped(key, "blue"), rf"^\[here\] {name}\S* = 'blue' is not allowed; give '\w+")
    if isinstance(key, ListedValues) and key.least:
        line([], rf"^\[here\] {name} = \[\] is not allowed; give a list of at least \w+ value")
    if type(key) is AnyTable:
        line(1.0, rf"^\[here\] {name} = 1.0 is not a table; write the name of the table in single brackets")
    if isinstance(key, BySignal):
        (signal, *_) = CONTEXT[key.names]
        line({"colour": 1.0}, rf"^\[here\] {name}: unknown \w+ 'colour'; give one of {signal}")
        for wrong in (key.low - 1, math.nan, True, "3 cd"):
            line({signal: wrong}, rf"^\[here.{name}\] {signal} = .*(give a number from|is expected)")


@pytest.mark.parametrize(("section", "name", "key"), NUMBERS, ids=names(NUMBERS))
def test_numbers(section, name, key):
    """A number has a range, which the message names, and may have its unit; no other value, and no other unit, is read."""
    (number,) = [one for one in of_each(key) if isinstance(one, SI | Integer)]
    unit = f" {number.unit}" if number.unit not in ("", "1") else ""
    ways = [(r"^\[here\] ", lambda wrong: read("[here]", section, table(section, name, wrapped(key, wrong)), **CONTEXT))]
    if section in IN_PYTHON:
        ways.append((r"^\w+ ", lambda wrong: section(**{name: wrong})))
    numbers = [number.low - max(1, -number.low), math.nan, 10**400, -math.inf]
    numbers += [number.high + max(1, number.high)] * math.isfinite(number.high)
    cases = [(wrong, rf"{name}\S* = \S+ is not allowed; give an? \w+ from \S+ to \S+{re.escape(unit)}") for wrong in numbers]
    cases.append(("a\nb", rf"{name}\S* = 'a\\nb' is not (allowed; give an? |a number; give a )\w+"))
    if "boolean" not in str(key.json):
        cases.append((True, rf"{name}\S* = True is not (allowed; give an? |a number; give a )\w+"))
    if isinstance(number, SI) and number.unit:
        expected = f"a {f'unit of {re.escape(number.unit)}' if unit else 'pure number'} is expected"
        cases.append(("3 cd", rf"{name}\S* = '3 cd' has the unknown unit 'cd', but {expected}"))
        cases.append(("0,5 A", rf"{name}\S* = '0,5 A' has a decimal comma; write a decimal point"))
    if unit:
        cases.append(("3", rf"{name}\S* = '3' has no unit, .*; add the unit, as in \"1.5{re.escape(unit)}\", or omit the quotes"))
        value = max(number.low, min(1.5, number.high))
        assert key.read(wrapped(key, f"{value!r}{unit}"), CONTEXT) == key.read(wrapped(key, value), CONTEXT)
        if section in IN_PYTHON and math.isfinite(usual := getattr(section(), name) or math.inf):
            assert section(**{name: f"{usual!r}{unit}"}) == section()
    for (where, make), (wrong, said) in itertools.product(ways, cases):
        with refused(match=where + said):
            make(wrong)


@pytest.mark.parametrize(("kind", "choose"), [*((one, choose_road) for one in OBSTACLES), *((one, choose_load) for one in LOADS)])
def test_a_text(kind, choose):
    """In a text, as on a command line, a number may have its unit; what is wrong with a setting is a line that names the text."""
    section = {**OBSTACLES, **LOADS}[kind]
    with refused(match=rf"^(road|load) '{kind}:colour=1': the name 'colour' in 'colour=1' is unknown; give one of \w+"):
        choose(f"{kind}:colour=1")
    for name, key in keys(section).items():
        if isinstance(key, SI) and (name != "speed" or kind == "flat"):
            a_number = re.escape(f"a number from {key.low:g} to {key.high:g} {key.unit}")
            for value, said in (
                ("deep", f"= 'deep' is not a number; give a number in {key.unit}, or a number with its unit"),
                ("-1e9", f"= -1000000000.0 is not allowed; give {a_number}"),
                ("3 cd", f"= '3 cd' has the unknown unit 'cd', but a unit of {key.unit} is expected"),
                (f"1:{name}=2", "is given twice, as '1' and as '2'; give it once"),
            ):
                with refused(match=rf"^(road|load) '{kind}:{name}=.*': {name} {said}"):
                    choose(f"{kind}:{name}={value}")


@pytest.mark.parametrize("name", kinds())
def test_a_parameter(name):
    """Every parameter of a built-in type is read with its unit, and refused with another unit or type, or out of its range."""
    known, right = kind(name), dict(read_vehicle(name).parameters)
    with refused(match=rf"^unknown parameter 'wheelbase'; a {name} has .*, \w+_\w+"):
        known.check_each({**right, "wheelbase": 2.5})
    for one in known.parameters:
        value = right.get(one.name, one.number.high)
        assert known.check_each({**right, one.name: f"{value!r} {one.unit}"})[one.name] == value
        for wrong in (True, [value], math.nan, one.number.low - 1, 2 * one.number.high, 10**400, "3 cd", "a\nb"):
            allowed = rf"give a number (from|in)|but a (pure number|unit of {one.unit}) is expected"
            with refused(match=rf"^{one.name} = .*({allowed})"):
                known.check_each({**right, one.name: wrong})


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("[limits]\nactuator_force = 3.5 kN # so", 'write a number with its unit in quotes, as in "3.5 kN"'),
        ("[limits]\nsuspension_stroke = { bump = 3 mm, rebound = 4 }", 'as in "3 mm"'),
        ("[limits]\nactuator_force = 1\nactuator_force = 2", "a key or a section appears twice, so omit one of the two"),
        ('[implementation]\nsample_period = "5 ms"\ndelay = "2 sample periods"', "unit of s is expected"),
        ("[payload]\nmass = 1\n[payload.driver]\nmass = 80", "move mass into a section [payload.NAME] of its own"),
        ('[controllers]\nmeasured = ["sprung_velocity"]', "into a section [controllers.NAME]"),
        ('[controllers.x]\nmeasured = ["sprung_velocity"]\nbounds = [{ norm = "8 mm" }]', "omit unit and quotes, as in 8"),
        ('[controllers.x]\nmeasured = ["sprung_velocity"]\nbounds = [{ norm = "8" }]', "unit may be in quotes; omit the quotes"),
        ("[limits]\nsuspension_stroke_front = 0.1", "write suspension_stroke in a section [limits.front]"),
        ("[limits]\nsuspension_stroke = 0.1\nstop = { rebound = { note = 3 } }", "[limits.stop.rebound] note = 3 is not"),
    ],
)
def test_advice(more, said):
    """What users often write instead of the right thing has the right thing in its message."""
    text = read_vehicle("quarter_car").text.partition("[controllers")[0]
    with refused(said):
        parse_vehicle(text + more)


def test_a_delay_in_samples(paper):
    """A delay may have its unit as a word, and a file without a type is told where it belongs."""
    text = '\n[implementation]\nsample_period = "5 ms"\ndelay = "2 samples"\n'
    assert parse_vehicle(paper.text + text).implementation.delay == 2
    with refused('type is missing; give type: vehicle type, above the first section: `type = "quarter_car"`'):
        parse_vehicle(paper.text.replace('type = "quarter_car"', ""))
