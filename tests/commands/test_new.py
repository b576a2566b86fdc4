"""`sim.new` writes a vehicle file with which the best design is best as implemented."""

import functools
import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from docs.generate import key_sections
from models.vehicle.vehicle import read_vehicle
from sim.new import TEMPLATES, TYPES
from synth.controller.law_margins import LEAST_DISK, law_fault
from synth.controller.loop_of import loop_of
from synth.controller.sampled_report import norm_or_failure
from synth.controller.stability_margins import margins
from synth.vehicle.designer import Designer, design_controllers
from synth.vehicle.expected_ride import expected_ride
from tests.same_numbers import RULER
from tests.support.commands import attacks, main_of, refused
from tests.support.pages import ROOT


@pytest.mark.parametrize("name", TYPES)
def test_it_writes_a_template(tmp_path, capsys, name):
    """Each type has a template, which reads without questions about units; a file that exists is left as it is."""
    path = tmp_path / "my car.toml"
    assert main_of("sim.new")([str(path), "--type", name]) == 0
    assert f"roadproof synth --vehicle '{path}'\n" in capsys.readouterr().out
    assert path.read_bytes() == (TEMPLATES / f"{name}.toml").read_bytes()
    vehicle = read_vehicle(path)
    assert vehicle.kind.name == name
    assert list(vehicle.controllers) == ["comfort", "travel", "skyhook"]
    path.write_text("mine", encoding="utf-8")
    with refused(match=r"my car\.toml already exists; give a different name, or remove this file$"):
        main_of("sim.new")([str(path)])
    assert path.read_text(encoding="utf-8") == "mine"
    assert main_of("sim.new")([str(tmp_path / "b.toml"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"file": str(tmp_path / "b.toml"), "type": "quarter_car"}


def parsed(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text(encoding="utf-8"))


@functools.cache
def shipped() -> list[tuple[Path, dict[str, Any]]]:
    """Returns every vehicle file of the project, with its content."""
    return [(path, parsed(path)) for path in (*(ROOT / "models").rglob("*.toml"), *RULER.rglob("*.toml"))]


@pytest.mark.parametrize("name", TYPES)
def test_a_schema_for_editors(tmp_path, capsys, name):
    """The schema, which the template names, accepts every shipped file of its type, refuses mistakes, and explains every key."""
    jsonschema = pytest.importorskip("jsonschema", reason="needs the extra [test]")
    path = tmp_path / "car.toml"
    assert main_of("sim.new")([str(path), "--type", name, "--schema", "--json"]) == 0
    beside = tmp_path / f"{name}.schema.json"
    assert json.loads(capsys.readouterr().out) == {"file": str(path), "schema": str(beside), "type": name}
    assert path.read_text(encoding="utf-8").startswith(f"#:schema ./{beside.name}\n")
    schema = jsonschema.Draft202012Validator(json.loads(beside.read_text(encoding="utf-8")))
    if name == TYPES[0]:  # types differ in names of keys alone, and jsonschema looks at each key for long
        schema.check_schema(schema.schema)
    for file, data in ((path, parsed(path)), *shipped()):
        if "_".join(filter(None, (data.get("type"), data.get("plane")))) == name:
            assert not [*schema.iter_errors(data)], file
    for section, right in parsed(path).items():
        of_section = schema.evolve(schema=schema.schema["properties"][section])
        assert of_section.is_valid(right)
        assert not of_section.is_valid(3), section
        if section not in ("type", "plane"):
            assert not of_section.is_valid({**right, "colour": "red"}), section
    assert not schema.is_valid(parsed(path) | {"colours": 3})
    text = beside.read_text(encoding="utf-8")
    for documented, keys in key_sections().items():
        if (
            "campaign" not in documented
            and "entry.toml" not in documented
            and ("[param" not in documented or documented.endswith(f" {name}"))
        ):
            missing = [key for key, unit, _ in keys if f'"{key}": {{' not in text or unit not in text]
            # Not every body turns, and a state of a vehicle with several wheels has another name.
            others = {"[seat]": {"x", "y"}, "[start]": {"suspension_deflection"}, "[identified]": {*missing}}.get(
                documented, set()
            )
            assert {*missing} <= others, documented


def test_only_a_schema(tmp_path, monkeypatch, capsys):
    """Without a file the schema alone is written, again if there is an old one."""
    monkeypatch.chdir(tmp_path)
    assert main_of("sim.new")(["--schema"]) == 0
    assert main_of("sim.new")(["--schema"]) == 0
    assert "wrote quarter_car.schema.json; a vehicle file refers to it in its first line" in capsys.readouterr().out
    assert [one.name for one in tmp_path.iterdir()] == ["quarter_car.schema.json"]


@pytest.mark.parametrize("others", [("skyhook",), *attacks([(("travel", "skyhook", "state", "passive"),)])], ids=len)
def test_the_best_design_is_best_as_implemented(others):
    """With the quarter-car template `comfort` has the best ride, and a disk margin that may be starred."""
    designer = Designer(read_vehicle(TEMPLATES / "quarter_car.toml"))
    designed = {name: designer.design(name) for name in ("comfort", *others)}
    rides = {name: expected_ride(designer.vehicle, one) for name, one in designed.items()}
    assert all(ride is not None for ride in rides.values())
    assert min(rides, key=lambda name: rides[name] or np.inf) == "comfort"
    comfort = designed["comfort"]
    assert margins(loop_of(designer.vehicle, comfort, 1e-3)).disk.size >= LEAST_DISK
    # A full order design is to come within 0.1 %, and a trade for a proof on the accelerometer alone costs a little more.
    norm, _ = norm_or_failure(designer.vehicle, comfort)
    assert norm is not None
    assert norm.value < 1.002 * designer.beyond_control.gamma


@pytest.mark.attack  # minutes for the full car; the test above has the quarter-car
@pytest.mark.parametrize("name", TYPES)
def test_the_designs_of_a_template_are_robust(name):
    """Every designed controller of a template has a disk margin that is not small, in the ideal and in the implemented loop."""
    vehicle = read_vehicle(TEMPLATES / f"{name}.toml")
    designed = design_controllers(vehicle, ["comfort", "travel"])
    assert [law_fault(vehicle, one) for one in designed] == ["", ""]
    for one in designed:
        assert margins(loop_of(vehicle, one, 1e-3)).disk.size >= LEAST_DISK  # at 1 ms, with sample period, delay and lag
