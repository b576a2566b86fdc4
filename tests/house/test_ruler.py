"""The ruler `python -m tests.same_numbers` covers every key, and it finds what differs."""

import json
import re
import tomllib
from itertools import chain
from pathlib import Path

import pytest

from docs.generate import key_sections
from models.characteristics.curve_reading import StopTableSection
from models.common import schema
from models.laws import semi_active
from models.laws.combinations import DEMANDS, KINDS
from models.roads.loads.load import LOADS
from models.vehicle.names import ROAD_KINDS
from models.vehicle.vehicle import SECTIONS, Vehicle, read_vehicle, shipped_vehicles
from sim.campaign.samples import DISTRIBUTIONS, METHODS
from tests import same_numbers
from tests.same_numbers import RULER, Answer, compare, lines_of

OF_FMUS = {"fmu", "inputs", "outputs"}  # an FMU runs only with the extra [fmi]
MORE = {  # keys within the values of documented ones
    "[controllers.NAME]": {"force"},
    "[limits]": {*schema.keys(StopTableSection), "bump", "rebound"},
    "[samples] of a campaign file": {*DISTRIBUTIONS, "relative"},
}
TEXT = "\n".join(lines_of(RULER / "commands.txt"))
WRITTEN = {"saved.toml", "ecu"}  # by a command


def keys(value) -> set[str]:
    """All keys at and below a value of a TOML file."""
    values = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return set(value if isinstance(value, dict) else ()).union(*map(keys, values))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return same_numbers.filled(tmp_path_factory.mktemp("ruler") / "files")


@pytest.fixture(scope="module")
def campaigns(folder) -> list[dict]:
    return [tomllib.loads((folder / name).read_text()) for name in re.findall(r"sim\.campaign (\S+)", TEXT)]


@pytest.fixture(scope="module")
def cars(folder, campaigns) -> list[Vehicle]:
    """The vehicles of all commands, as far as a command does not write them."""
    named = {*re.findall(r"(?:--vehicle|--check) (\S+)", TEXT), *chain(*(one["vehicles"] for one in campaigns)), "quarter_car"}
    return [read_vehicle(name if name in shipped_vehicles() else folder / name) for name in named - WRITTEN]


def test_every_key_is_used(cars, campaigns):
    """A documented key of a vehicle file or of a campaign file is in a file of the ruler."""
    files = [tomllib.loads(Path(car.source).read_text()) for car in cars]
    laws = [one for file in files for one in file.get("controllers", {}).values()]
    values = [one for law in laws for key, one in law.items() if key not in ("certificate", "bounds")]
    used = {f"[{name}]": keys([file.get(name) for file in files]) for name in SECTIONS[2:]}
    for name in {car.kind.name for car in cars}:
        mine = [file for car, file in zip(cars, files, strict=True) if car.kind.name == name]
        used[f"[parameters] of a {name}"] = {*chain(*(chain(file["parameters"], file.get("curves", ())) for file in mine))}
    used["[controllers.NAME]"] = keys(values).union(*laws)
    used |= {f"{key} of a controller": used["[controllers.NAME]"] for key in ("minimise", "pid")}
    used["bounds of a controller"] = keys([law.get("bounds") for law in laws])
    elements = [one for file in files for one in file.get("parts", {}).values()]
    used["[parts.NAME]"] = {key for one in elements for key in one}
    for one in elements:
        used.setdefault(f'[parts.NAME] with kind = "{one["kind"]}"', set()).update(one)
    used["a campaign file"] = used["[samples] of a campaign file"] = keys(campaigns)
    documented = {section: {key for key, _, _ in rows} | MORE.get(section, set()) for section, rows in key_sections().items()}
    missing = {section: sorted(every - used.get(section, set()) - OF_FMUS) for section, every in documented.items()}
    assert {section: some for section, some in missing.items() if some} == {}
    assert {one["samples"].get("method", METHODS[0]) for one in campaigns if "samples" in one} == {*METHODS}


def test_every_kind_is_run(cars, campaigns):
    """Every kind of law and demand on it, of semi-active law, road and load is run by a command of the ruler."""
    entries = [entry for car in cars for entry in car.controllers.values()]
    parts = set().union(*(entry.parts for entry in entries))
    measured = {signal for entry in entries for signal in entry.measured}
    assert {*KINDS, *DEMANDS} - parts - {"force"} == set()
    assert "control_force" in measured
    assert {*semi_active.LAWS} == {entry.source.record.get("semi_active") for entry in entries} - {None}
    roads = TEXT + " ".join(road for one in campaigns for road in one["roads"])
    assert [
        kind for kind in ROAD_KINDS if not re.search(rf"\b{kind}\b|--class" if kind == "iso8608" else rf"\b{kind}\b", roads)
    ] == []
    assert [load for load in LOADS if f"{load}:" not in roads] == []


OLD = {
    "norm": 7.25,
    "gain": [[1e4, -1e-6]],
    "holds": True,
    "verdict": "agrees",
    "signals": {"travel": {"peak": {"mujoco": 0.1, "sampled": 1e-9}, "error": {"sampled": 1e-7}}},
    "phase": {"predicted": 31.0},
    "steps": {"error": 1e-9, "allowed": 1e-8, "agrees": True},
    "count": 3,
}


def changed(**new) -> dict:
    return json.loads(json.dumps(OLD)) | new


def signals(mujoco: float, sampled: float, error: float = 1e-7) -> dict:
    return {"travel": {"peak": {"mujoco": mujoco, "sampled": sampled}, "error": {"sampled": error}}}


@pytest.mark.parametrize(
    ("new", "exact", "within"),
    [
        ({}, [], []),
        ({"norm": 7.25 * (1 + 1e-10)}, [".norm"], []),
        ({"norm": 7.25 * (1 + 1e-8)}, [".norm"], [".norm"]),
        ({"gain": [[1e4, -2e-6]]}, [".gain.0.1"], []),
        ({"gain": [[1e4, -1e-4]]}, [".gain.0.1"], [".gain.0.1"]),
        ({"holds": False}, [".holds"], [".holds"]),
        ({"verdict": "agrees "}, [".verdict"], [".verdict"]),
        ({"signals": signals(0.1, 1e-9 + 1e-13)}, [".signals.travel.peak.sampled"], []),
        ({"signals": signals(0.1 + 1e-10, 1e-9)}, [".signals.travel.peak.mujoco"], [".signals.travel.peak.mujoco"]),
        ({"signals": signals(0.1, 1e-9, 2e-7)}, [".signals.travel.error.sampled"], []),
        ({"phase": {"predicted": 31.0 + 1e-7}}, [".phase.predicted"], []),
        ({"phase": {"predicted": 31.0 + 1e-6}}, [".phase.predicted"], [".phase.predicted"]),
        ({"steps": {"error": 8e-9, "allowed": 1e-8, "agrees": True}}, [".steps.error"], []),
        ({"steps": {"error": 2e-8, "allowed": 1e-8, "agrees": True}}, [".steps.error"], [".steps.error"]),
        ({"count": 4}, [".count"], [".count"]),
        ({"count": 3.0}, [], []),
        ({"norm": None}, [".norm"], [".norm"]),
        ({"norm": float("nan")}, [".norm"], [".norm"]),
    ],
)
def test_what_differs(new, exact, within):
    """A number differs beyond the tolerance of its kind alone, and all else whenever it is another."""
    for tolerant, places in ((False, exact), (True, within)):
        found = list(compare(OLD, changed(**new), tolerant))
        assert [(kind, place) for kind, place, _ in found] == [("differs", place) for place in places]


def test_keys_that_are_missing_or_new():
    new = changed(more=1.0)
    del new["holds"]
    assert [found[:2] for found in compare(OLD, new)] == [("differs", ".holds"), ("new", ".more")]
    assert [found[:2] for found in compare([OLD], [OLD, OLD])] == [("differs", "")]


def test_numbers_that_rounding_moves():
    """A number agrees within 100 times the effect of another rounding on it or its matrix; what is no number is then listed."""
    shaken = changed(gain=[[1e4 + 1e-3, -1e-6]], verdict="off", count=4)
    new = changed(gain=[[1e4, 0.09]], verdict="gone", count=5, norm=7.3)
    kinds = {place: kind for kind, place, _ in compare(OLD, new, True, shaken)}
    assert kinds == {".norm": "differs", ".verdict": "shaken", ".count": "shaken"}
    assert [place for _, place, _ in compare(OLD, changed(gain=[[1e4, 0.2]]), True, shaken)] == [".gain.0.1"]


@pytest.mark.parametrize(("allow", "code"), [("", 1), ("sim.bump * .norm\n", 0), ("sim.bump * .phase.*\n", 1)])
def test_command(allow, code, tmp_path, capsys, monkeypatch):
    """The command fails for a planted difference, unless the list of allowed changes has it, and it names entries without use."""
    old, new = tmp_path / "old", tmp_path / "new"
    (tmp_path / "allow.txt").write_text(allow)

    def answer(checkout: Path, folder: Path, line: str, shaken: bool = False) -> Answer:
        folder.mkdir(parents=True)
        planted = changed(norm=7.25 * (1 + 1e-10), more=1) if checkout == new else changed()
        return Answer(folder, [(0, planted)])

    monkeypatch.setattr(same_numbers, "answer", answer)
    arguments = [str(old), str(new), "--only", "sim.bump --controller all", "--allow", str(tmp_path / "allow.txt")]
    assert same_numbers.main(arguments) == code
    printed = capsys.readouterr().out
    assert ("allowed .norm" in printed) == (code == 0)
    assert ("UNUSED" in printed) == ("phase" in allow)
    assert "new .more" in printed
    assert same_numbers.main([*arguments, "--within"]) == 0
