"""A certificate in a vehicle file that does not hold is said, in one line, by every command that drives its gain."""

import re

import pytest

from sim import bump
from sim.campaign import __main__ as campaign
from synth.__main__ import main as synth
from tests.drives import EVERY_DRIVE

GIVEN = "II_designed"  # what a saved design of II is called


@pytest.fixture(scope="module")
def vehicles(tmp_path_factory):
    """A vehicle file with a gain and its certificate; the same with another norm claimed; and with a proof that is none."""
    folder = tmp_path_factory.mktemp("vehicles")
    honest, forged, broken = (folder / f"{name}.toml" for name in ("honest", "forged", "broken"))
    synth(["--controller", "II", "--save", str(honest)])
    text = honest.read_text()
    norm = re.search(r"^norm = (\S+)$", text, re.M)
    assert norm
    forged.write_text(text.replace(norm[0], f"norm = {float(norm[1]) / 2}"))
    broken.write_text(text.replace(norm[0], "norm = 'low'"))
    return {"honest": honest, "forged": forged, "broken": broken}


@EVERY_DRIVE
def test_said_by(vehicles, capsys, main, options):
    """One line names the controller and what does not hold, and nothing else changes; of a true certificate nothing is said."""
    said, every = {}, vehicles if main is bump.main else {name: vehicles[name] for name in ("honest", "forged")}
    for name, vehicle in every.items():
        code = main(["--vehicle", str(vehicle), "--controller", GIVEN, *options])
        printed = capsys.readouterr()
        lines = [line for line in printed.err.splitlines() if line.startswith("roadproof: ")]
        said[name] = (code, printed.out.replace(str(vehicle), "FILE"), lines)
    assert said["honest"][2] == []
    for name, why in {"forged": "the norm is claimed to be", "broken": "norm = 'low' in a certificate is not a number"}.items():
        if name not in said:
            continue
        code, out, (line,) = said[name]
        assert (code, out) == said["honest"][:2]
        assert line.startswith("roadproof: the certificate of controller 'II_designed' in the vehicle file does not hold (")
        assert why in line


def test_said_by_a_campaign(vehicles, tmp_path, capsys):
    """A campaign says it for each of its vehicles, and drives the gain."""
    files = ", ".join(f'"{vehicles[name]}"' for name in ("honest", "forged"))
    text = f'vehicles = [{files}]\ncontrollers = ["{GIVEN}"]\nroads = ["bump"]\nspeeds = [10.0]\nduration = 0.1\n'
    (tmp_path / "campaign.toml").write_text(text)
    assert campaign.main([str(tmp_path / "campaign.toml")]) == 0
    assert capsys.readouterr().err.count("the certificate of controller 'II_designed' in the vehicle file does not hold") == 1
