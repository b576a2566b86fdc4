"""`sim.new` writes a vehicle file with which the best design is best as implemented."""

import json

import pytest

from models.vehicle.vehicle import read_vehicle
from sim.new import TEMPLATES, TYPES
from tests.support.commands import main_of, refused


@pytest.mark.parametrize("name", TYPES)
def test_it_writes_a_template(tmp_path, capsys, name):
    """Each type has a template, which reads without questions about units; a file that exists is left as it is."""
    path = tmp_path / "my car.toml"
    assert main_of("sim.new")([str(path), "--type", name]) == 0
    assert f"python -m synth --vehicle '{path}'\n" in capsys.readouterr().out
    assert path.read_bytes() == (TEMPLATES / f"{name}.toml").read_bytes()
    vehicle = read_vehicle(path)
    assert vehicle.kind.name == name
    assert list(vehicle.controllers) == ["both", "travel", "skyhook"]
    path.write_text("mine", encoding="utf-8")
    with refused(match=r"my car\.toml already exists; give another name, or remove this file$"):
        main_of("sim.new")([str(path)])
    assert path.read_text(encoding="utf-8") == "mine"
    assert main_of("sim.new")([str(tmp_path / "b.toml"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"file": str(tmp_path / "b.toml"), "type": "quarter_car"}


def test_the_best_design_is_best_as_implemented(capsys):
    """With the quarter-car template `both`, which counts all that is built, has the least norm as implemented."""
    assert main_of("synth")(["--vehicle", str(TEMPLATES / "quarter_car.toml"), "--json"]) == 0
    printed = capsys.readouterr()
    assert not printed.err
    result = json.loads(printed.out)
    sampled = {one["name"]: one["sampled_norm"] for one in result["controllers"]}
    assert min(sampled, key=lambda name: sampled[name]) == "both"
    assert sampled["both"] < 1.001 * result["invariant_limit"]["norm"]  # 0.1 % is what a full order design is to reach
