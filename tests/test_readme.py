"""The README's recipes work as they stand there."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from models.vehicle import parse_vehicle, read_vehicle
from sim.bump import main
from sim.campaign.file import read_campaign
from sim.linear.loop import sampled_response, taylor4
from sim.physics.simulate import simulate
from sim.roads.road import Bump
from sim.runs.run import sample_times
from synth.__main__ import main as design_main
from synth.designer import Designer

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")


@pytest.fixture
def hopper(tmp_path):
    """The vehicle of "Add your own kind of vehicle", its three files written to a folder of its own."""
    recipe = README.split("## Add your own kind of vehicle")[1].split("\n## ")[0]
    for suffix, language in (("py", "python"), ("xml", "xml"), ("toml", "toml")):
        (block,) = re.findall(rf"^```{language}\n(.*?)^```", recipe, re.M | re.S)
        (tmp_path / f"hopper.{suffix}").write_text(block)
    return tmp_path / "hopper.toml"


def test_own_kind_of_vehicle(hopper, tmp_path, capsys):
    """Three files make a new kind of vehicle: designed, driven, found to agree, logged, by the command of the recipe."""
    assert main(["--vehicle", str(hopper), "--controller", "I", "--logs", str(tmp_path / "logs")]) == 0
    assert "agrees: MuJoCo is the exact sampled response" in capsys.readouterr().out
    assert {path.suffix for path in (tmp_path / "logs").iterdir()} == {".mcap", ".json", ".rrd"}


def test_own_kind_of_vehicle_is_exact(hopper):
    """Its physics is RK4 on its linear model to rounding, as for those that ship."""
    vehicle = read_vehicle(hopper)
    controller, road = Designer(vehicle).design("I"), Bump(height=0.02)
    time = sample_times(vehicle, 1.0, 1e-3)
    physics = simulate([vehicle], [controller], [road], time).response.run(0)
    predicted = sampled_response(vehicle, controller, road, time, exponential=taylor4)
    for name in vehicle.linear_model.outputs:
        assert abs(physics[name] - predicted[name]).max() < 1e-11 * predicted.scale(name)  # rounding of 1000 steps


def test_unknown_kind_is_named(hopper):
    """A vehicle file whose kind lies nowhere says what is known, and where another would be looked for."""
    hopper.write_text(hopper.read_text().replace('"hopper"', '"hoper"'))
    with pytest.raises(
        ValueError, match=r"unknown vehicle type 'hoper'; known: full_car, half_car, hopper, quarter_car.*hoper\.py"
    ):
        read_vehicle(hopper)


def test_design_table(capsys):
    """The README's design table is what the command prints."""
    assert design_main([]) == 0
    printed = capsys.readouterr().out
    (table,) = re.findall(r"^```text\n(controller  .*?)^```", README, re.M | re.S)
    for line in filter(None, table.splitlines()):
        assert line in printed


def test_any_plant(capsys):
    """The README's plant from matrices is designed and certified."""
    (snippet,) = re.findall(r"^```python\n(import numpy as np\n\nfrom synth.*?)^```", README, re.M | re.S)
    exec(snippet, {})
    assert capsys.readouterr().out.endswith("()\n")


def test_many_vehicles(capsys):
    """The README's hundred vehicles are redesigned."""
    snippet = README.split("there is `redesign`")[1].split("```python\n")[1].split("```")[0]
    exec(snippet, {})
    assert capsys.readouterr().out.startswith("[[")


def test_vehicle_file_snippets():
    """The README's controllers, limits and implementation are accepted in a vehicle file."""
    snippets = re.findall(r"^```toml\n(\[.*?)^```", README, re.M | re.S)
    assert len(snippets) == 2
    vehicle = parse_vehicle(read_vehicle("quarter_car").text + "\n".join(snippets))
    assert {"soft", "mine"} < set(vehicle.controllers)
    assert vehicle.limits.actuator_force == 2000.0
    assert vehicle.implementation.delay == 1


def test_campaign_snippet(tmp_path):
    """The README's campaign file is one."""
    (snippet,) = re.findall(r"^```toml\n(vehicles.*?)^```", README, re.M | re.S)
    (tmp_path / "campaign.toml").write_text(snippet)
    campaign = read_campaign(tmp_path / "campaign.toml")
    assert len(campaign.seeds) == 100
    assert len(campaign.samples["quarter_car"]) == 16
    assert campaign.settle == 5.0


@pytest.mark.attack
@pytest.mark.parametrize("picture", ["sweep", "margins", "envelope"])
def test_picture_is_what_its_command_draws(picture, tmp_path):
    """Beside a picture stands the command that draws it, to the pixel but for the edges of letters."""
    pytest.importorskip("matplotlib", reason="needs the extra [report]")
    from matplotlib.image import imread

    section = README.split(f".github/pictures/{picture}.png")[1].split("\n## ")[0]
    lines = re.findall(r"^```sh\n(.*?)^```", section, re.M | re.S)[0].splitlines()
    (drawing,) = [i for i, line in enumerate(lines) if f"--picture {picture}.png" in line]
    script = (
        "\n".join(lines[: drawing + 1]).replace("/tmp/", f"{tmp_path}/").replace(f"{picture}.png", str(tmp_path / "drawn.png"))
    )
    root = Path(__file__).parent.parent
    subprocess.run(["sh", "-ec", script.replace("python -m", f"{sys.executable} -m")], cwd=root, check=True)
    drawn, shown = (imread(path) for path in (tmp_path / "drawn.png", root / f".github/pictures/{picture}.png"))
    assert drawn.shape == shown.shape
    # Other fonts and versions of Matplotlib move letters by a pixel; another curve, or another cell, is more than that.
    assert np.mean(np.abs(drawn - shown).max(axis=-1) > 0.1) < 0.01


def test_notebook_snippet(tmp_path, monkeypatch, capsys):
    """The README's script designs, runs, compares and plots."""
    pytest.importorskip("pandas", reason="needs the extra [report]")
    pytest.importorskip("matplotlib", reason="needs the extra [report]")
    snippet = README.split("## From a notebook")[1].split("```python\n")[1].split("```")[0]
    assert len(snippet.splitlines()) <= 15
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    exec(compile(snippet, "README", "exec"), {})
    assert capsys.readouterr().out.startswith("[True, True]")
    assert (tmp_path / "bump.png").stat().st_size > 10_000
