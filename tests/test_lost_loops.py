"""A controller is judged by the loop that drives: stable with its computer though not without it, or the other way round."""

import json
import re

import numpy as np
import pytest

from models.common.errors import InputError
from models.vehicle.vehicle import read_vehicle
from sim.bump import main as bump
from sim.inspect.__main__ import main as inspect
from sim.margins import main as margins
from sim.report.__main__ import main as report
from synth.__main__ import main as synth
from synth.vehicle.designer import design
from tests.analysed import sampled_radius
from tests.commands import prose

SLOW = "\n[implementation]\nsample_period = 0.05\n"  # s: at 20 Hz what is best with samples is unstable without
HELD = f"{SLOW}sampled = true\n"
WITHOUT = "without a computer its loop is unstable"


@pytest.fixture
def held(tmp_path, paper):
    """The paper's car, designed for a slow computer."""
    path = tmp_path / "held.toml"
    path.write_text(paper.text + HELD)
    return path


@pytest.mark.attack
def test_a_sampled_design_is_judged_by_its_sampled_loop(held, tmp_path, capsys):
    """Its loop is stable as it runs, by a route of its own, and has a norm: no claim fails, in the table, in JSON, or saved."""
    vehicle = read_vehicle(str(held))
    controller = design(vehicle, "I")
    assert not controller.certificate.stable
    assert sampled_radius(vehicle, controller, 0.05) < 1
    saved = tmp_path / "saved.toml"
    assert synth(["--vehicle", str(held), "--controller", "I", "--save", str(saved), "--json"]) == 0
    assert design(read_vehicle(str(saved)), "I_designed").false_claims == ()
    (row,) = json.loads(capsys.readouterr().out)["controllers"]
    assert row["failures"] == []
    assert row["norm"] is None
    assert row["certificate"].keys() & {"norm", "bound", "sampled_norm"} == {"sampled_norm"}
    for arguments in (["--vehicle", str(held), "--controller", "I"], ["--check", str(saved), "--controller", "I_designed"]):
        assert synth([*arguments, "-v"]) == 0
        text = capsys.readouterr().out
        assert WITHOUT in prose(text)
        assert "FAILS" not in text
        (line,) = [each for each in text.splitlines() if each.startswith(("I  ", "I_designed  "))]
        assert re.search(rf"UNSTABLE .*{row['sampled_norm']:.7g}", line)
        assert "every claim holds, of 1 controller\n" in text


@pytest.mark.attack
def test_what_it_claims_in_vain_still_fails(held, tmp_path, capsys):
    """A certificate that claims another sampled norm, or a norm without the computer, does not hold."""
    saved = tmp_path / "saved.toml"
    synth(["--vehicle", str(held), "--controller", "I", "--save", str(saved)])
    text = saved.read_text()
    head, tail = text.split("sampled_norm = ")
    for wrong in (f"{head}sampled_norm = 7.9{tail[tail.index(chr(10)) :]}", f"{head}norm = 7.9\nsampled_norm = {tail}"):
        saved.write_text(wrong)
        capsys.readouterr()
        assert synth(["--check", str(saved), "--controller", "I_designed"]) == 1
        assert "is claimed to be 7.9, and is" in prose(capsys.readouterr().out)
    saved.write_text(text.replace("sample_period = 0.05", "sample_period = 0.01"))  # stable with neither
    assert synth(["--check", str(saved), "--controller", "I_designed"]) == 1
    assert "FAILS: unstable" in prose(capsys.readouterr().out)


@pytest.mark.attack
def test_a_run_of_it_holds_in_its_log(held, tmp_path, capsys):
    """MuJoCo drives it as analysis says, and what its log claims is found to hold."""
    where = str(tmp_path / "logs")
    assert bump(["--vehicle", str(held), "--controller", "I", "--logs", where, "--duration", "1", "-v"]) == 0
    assert WITHOUT in prose(capsys.readouterr().out)
    assert inspect([str(next((tmp_path / "logs").glob("*.mcap"))), "-v"]) == 0
    text = prose(capsys.readouterr().out)
    assert WITHOUT in text
    assert "sampled norm 8.32" in text


@pytest.mark.attack
def test_rates_of_it(held, capsys):
    """Rates say from where its loop is stable again."""
    assert synth(["--vehicle", str(held), "--controller", "I", "--rates", "50"]) == 0
    text = prose(capsys.readouterr().out)
    assert "controller I is unstable in continuous time; at once it" in text
    assert "(50 ms is stable again)" in text


def test_what_its_computer_loses_is_said_in_the_verdict(tmp_path, paper, capsys):
    """A design for the ideal loop, on a computer that loses it: its claims hold, and the last line names it."""
    path = tmp_path / "lost.toml"
    path.write_text(f"{paper.text}\n[implementation]\nsample_period = 0.15\ndelay = 5\n")
    assert synth(["--vehicle", str(path), "--controller", "I", "--controller", "passive", "-v"]) == 0
    assert prose(capsys.readouterr().out).endswith("every claim holds, of 2 controllers; UNSTABLE as the computer runs it: I")


@pytest.mark.attack
def test_a_report_of_it(held, tmp_path, capsys):
    """A report treats it as stable: its norm as built, its responses and the end of its regime, and no ideal norm."""
    assert (
        report(
            [
                "--vehicle",
                str(held),
                "--controller",
                "I",
                "--quick",
                "--timestep",
                "2.5e-3",
                "--out",
                str(tmp_path / "r.html"),
                "--json",
            ]
        )
        == 0
    )
    said = json.loads(capsys.readouterr().out)
    assert any("`I` is stable as built, and UNSTABLE as the ideal loop" in text for text in said["answer"])
    tables = said["tables"]
    assert tables["designs"][0]["certificate"].startswith(WITHOUT)
    assert tables["norms"][0]["norm, ideal loop"] == tables["norms"][0]["that is"] == "-"
    assert float(tables["norms"][0]["norm, as built"]) < 9  # 8.894
    assert tables["frequency-responses"]
    assert tables["regime"]


@pytest.mark.attack
def test_margins_are_of_the_controller_that_the_computer_was_thought_of_for(held, monkeypatch):
    """A sampled design keeps its gain where margins are found without the computer; where it has none, that is the reason."""
    with pytest.raises(InputError, match="without a computer its loop is not stable"):
        margins(["--vehicle", str(held), "--controller", "I"])
    held.write_text(held.read_text().replace("sample_period = 0.05", "sample_period = 0.01"))
    found = []

    def begun(vehicle, controller, *_):
        found.append(controller)
        raise InputError("far enough")

    monkeypatch.setattr("sim.studies.stability.margin_search.find_margins", begun)
    with pytest.raises(InputError, match="far enough"):
        margins(["--vehicle", str(held), "--controller", "I"])
    (controller,) = found
    np.testing.assert_array_equal(controller.gain, design(read_vehicle(str(held)), "I").gain)
