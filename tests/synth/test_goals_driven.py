"""Goals that a controller does not keep are said wherever it is driven, stand in a report, and are none of a log's claims."""

import json
from dataclasses import replace

import pytest

from models.vehicle.vehicle import read_vehicle
from sim import bump, envelope
from sim.campaign import __main__ as campaign
from sim.command.comparison import warn_invalid_certificates
from sim.inspect.__main__ import main as inspect
from synth.__main__ import main as synth
from synth.analysis.specification import Specification
from tests.support.commands import prose
from tests.support.drives import MAP
from tests.support.reading import read_report

SECTION = """
[controllers.b]
measured = ["suspension_deflection", "sprung_velocity"]
gain = [[5000.0, -3000.0]]
bounds = [{ norm = %s }, { decay = 0.5 }, { peak = "suspension_deflection", road = "bump", at_most = %s }]
"""
KEPT, BROKEN = SECTION % ("8.0", "0.1"), SECTION % ("7.0", "0.01")
SAID = "roadproof: controller 'b' does not meet its goals in the vehicle file (norm is 7.9"


@pytest.fixture(scope="module")
def vehicles(tmp_path_factory):
    """The paper's car with a gain that keeps its goals, and with one that does not."""
    folder, text = tmp_path_factory.mktemp("vehicles"), read_vehicle("quarter_car").text
    found = {name: folder / f"{name}.toml" for name in ("kept", "broken")}
    for file, section in zip(found.values(), (KEPT, BROKEN), strict=True):
        file.write_text(text + section)
    return found


@pytest.mark.parametrize(("main", "options"), [(bump.main, ["--no-logs", "--duration", "0.2"]), (envelope.main, MAP)])
def test_said_by(vehicles, capsys, main, options):
    """One line names the controller and the first goal it misses, and nothing else changes; of kept goals there is none."""
    said = {}
    for name in ("kept", "broken"):
        code = main(["--vehicle", str(vehicles[name]), "--controller", "b", *options])
        printed = capsys.readouterr()
        lines = [line for line in printed.err.splitlines() if line.startswith("roadproof: ")]
        said[name] = (code, printed.out.replace(str(vehicles[name]), "FILE"), lines)
    assert said["kept"][2] == []
    code, out, (line,) = said["broken"]
    assert (code, out) == said["kept"][:2]
    assert line.startswith(SAID)
    assert line.endswith("at most 7 is allowed, and 1 more); it is used nevertheless; roadproof synth explains this")


def test_said_by_a_campaign(vehicles, tmp_path, capsys):
    """A campaign says it for each of its vehicles."""
    files = ", ".join(f'"{vehicles[name]}"' for name in ("kept", "broken"))
    text = f'vehicles = [{files}]\ncontrollers = ["b"]\nroads = ["bump"]\nspeeds = [10.0]\nduration = 0.1\n'
    (tmp_path / "campaign.toml").write_text(text)
    assert campaign.main([str(tmp_path / "campaign.toml")]) == 0
    assert capsys.readouterr().err.count(SAID) == 1


def test_of_a_design_too(designer, capsys):
    """The promises that are said are the design's own."""
    controller = designer.design("II")
    warn_invalid_certificates([replace(controller, specifications=(Specification("norm", 6.0, at_most=7.0),))])
    assert capsys.readouterr().err == ""
    warn_invalid_certificates([replace(controller, specifications=(Specification("norm", 6.0, proved=8.0, at_most=7.0),))])
    assert "controller 'II' does not meet its goals" in capsys.readouterr().err


@pytest.mark.attack
def test_a_report_has_them(vehicles, tmp_path, capsys):
    """Its table of goals has the numbers that `synth` has of each, and its answer names the one that is missed first."""
    pytest.importorskip("jinja2", reason="a report needs the extra [report]")
    pytest.importorskip("matplotlib", reason="a report needs the extra [report]")
    asked = ["--vehicle", str(vehicles["broken"]), "--controller", "b"]
    synth([*asked, "--json"])
    (row,) = json.loads(capsys.readouterr().out)["controllers"]
    out = tmp_path / "broken.html"
    page = read_report(out, *asked, "--quick", "--timestep", "0.0025")
    assert capsys.readouterr().err.count(SAID) == 1
    for cells, promise in zip(page.tables["goals"], row["promises"], strict=True):
        assert cells["controller"] == "b"
        assert cells["goal"] == f"{promise['promise']} ({promise['where']})" if promise["where"] else promise["promise"]
        assert cells["value"] == f"{promise['value']:.7g}"
        assert cells["proved to be at most"] == ("exact" if promise["proved"] is None else f"{promise['proved']:.7g}")
    assert [cells["kept"] for cells in page.tables["goals"]] == ["yes", "NO", "yes", "NO"]
    (missed,) = [line for line in page.answer if "DOES NOT KEEP" in line]
    assert missed.startswith("b DOES NOT KEEP the goals of the vehicle file: norm is 7.9")
    assert missed.endswith("at most 7 is allowed, and 1 more.")


def test_a_log_claims_nothing_of_goals(vehicles, tmp_path, capsys):
    """If the vehicle.toml of a log has goals, a note says that they are not checked; without any there is no note."""
    driven = ["--vehicle", str(vehicles["kept"]), "--controller", "b", "--controller", "II"]
    bump.main([*driven, "--duration", "0.1", "--logs", str(tmp_path)])
    (log,) = tmp_path.glob("*.mcap")
    capsys.readouterr()
    assert inspect([str(log), "-v"]) == 0
    printed = prose(capsys.readouterr().out)
    assert printed.count("goals note: the log does not prove the controller's goals in vehicle.toml (bounds); check") == 1
    assert printed.endswith("the log still proves what it claims; the log makes no claim about goals")
    assert inspect([str(log), "--json"]) == 0
    runs = json.loads(capsys.readouterr().out)["runs"]
    parts_of = {run["name"]: [finding["part"] for finding in run["findings"]] for run in runs}
    assert "goals" in parts_of["b"]
    assert "goals" not in parts_of["II"]
