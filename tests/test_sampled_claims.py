"""The norm of a loop as built, wherever it is said: in the table, in `--json`, in certificates, in logs."""

import json
import re
from pathlib import Path

import pytest

from models.vehicle.vehicle import read_vehicle
from sim.bump import main as bump
from sim.inspect.__main__ import main as inspect
from synth.__main__ import main as synth
from synth.controller.implementation_norm import norm_as_implemented
from synth.vehicle.designer import design
from tests.commands import prose
from tests.rewriting import contents, written

BUILT = "\n[implementation]\nsample_period = 0.01\ndelay = 1\n"


@pytest.fixture
def built(tmp_path, paper) -> Path:
    """The paper's car with a computer."""
    path = tmp_path / "built.toml"
    path.write_text(paper.text + BUILT)
    return path


def said(capsys, *arguments: str) -> tuple[int, dict]:
    """Exit code and JSON object of `python -m synth`."""
    code = synth([*arguments, "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_json_and_table(built, capsys):
    """The table prints JSON's numbers, between the levels that prove them; an actual road reaches it."""
    code, found = said(capsys, "--vehicle", str(built))
    assert code == 0
    synth(["--vehicle", str(built), "-v"])
    text = capsys.readouterr().out
    assert max(len(line) for line in text.splitlines() if str(built) not in line) <= 80
    rows = dict(re.findall(r"^(\w+) +\S+ +\S+ +(\S+) +\S+ +\S+ +\S+$", text, re.MULTILINE))
    for one in found["controllers"]:
        proof = one["sampled_norm_proof"]
        assert proof["above"] < one["sampled_norm"] < proof["below"] < one["sampled_norm"] * (1 + 2e-8)  # as they are apart
        assert proof["reached"] == pytest.approx(one["sampled_norm"], rel=1e-9)  # polynomials of degree 3 over 2.5 ms
        assert rows[one["name"]] == f"{one['sampled_norm']:.7g}"
        assert one["sampled_norm"] > one["lower_bound"]
        assert one["certificate"]["sampled_norm"] == one["sampled_norm"]
        if one["name"] == "I":
            share = f"{100 * (one['sampled_norm'] / one['norm'] - 1):.2g} % above the ideal loop's"
            assert f"sampled norm {one['sampled_norm']:.7g}, {share}" in prose(text)
            assert prose(text).count("a sample every 10 ms, forces that act 1 sample late") == 1  # of all controllers
            assert f"less than {proof['below']:.9g} by level sets, and a road reaches {proof['reached']:.9g} of" in prose(text)


def test_nothing_without_a_computer(capsys):
    """A vehicle file that says nothing of its computer has no such number, and no such column."""
    _, found = said(capsys, "--controller", "I")
    assert "sampled_norm" not in found["controllers"][0]
    assert "sampled_norm" not in found["controllers"][0]["certificate"]
    synth(["--controller", "I", "-v"])
    assert "sampled" not in capsys.readouterr().out.partition("\n\n")[2]  # behind the file, whose folder may have any name


@pytest.mark.parametrize("asked", ["noise", "lag"])
def test_norms_of_other_goals_are_not_compared(built, asked, capsys):
    """A controller that is designed for its noise or lag has an ideal norm of another w or z: no share of it is printed."""
    plain = 'measured = ["sprung_velocity"]\ngain = [[-8000.0]]\n'
    built.write_text(
        f"{built.read_text()}noise = {{ sprung_velocity = 0.005 }}\n[limits]\nactuator_bandwidth = 60.0\n"
        f"[controllers.plain]\n{plain}[controllers.asked]\n{plain}{asked} = true\n"
    )
    synth(["--vehicle", str(built), "--controller", "plain", "--controller", "asked", "-v"])
    text = prose(capsys.readouterr().out)
    norms = [re.split(r", with|it is less", part)[0] for part in text.split("sampled norm ")[1:3]]
    plain_norm, asked_norm = (float(re.split("[, :]", norm)[0]) for norm in norms)
    # With the lag the loops as built are the same; noise of the readings counts where it is asked for, and then it adds.
    assert plain_norm < asked_norm if asked == "noise" else plain_norm == asked_norm
    assert "the ideal loop's" in norms[0]
    assert "the ideal loop's" not in norms[1]


def test_unstable_as_built(built, capsys):
    """At a rate that the loop does not bear, that is said, and no number stands there."""
    built.write_text(built.read_text().replace("0.01", "0.3"))
    _, found = said(capsys, "--vehicle", str(built), "--controller", "II")
    assert found["controllers"][0]["sampled_norm"] is None
    assert "sampled_norm" not in found["controllers"][0]["certificate"]
    synth(["--vehicle", str(built), "--controller", "II", "-v"])
    text = capsys.readouterr().out
    assert "sampled norm infinite: UNSTABLE with a sample every 300 ms" in prose(text)
    assert re.search(r"^II +\S+ +\S+ +UNSTABLE ", text, re.MULTILINE)


@pytest.mark.parametrize("change", ["period", "digit", "none"])
def test_saved_and_checked(built, tmp_path, capsys, change):
    """A certificate says the norm as built, and is refused where that is another: of another rate, or by a hair, or of none."""
    saved = tmp_path / "saved.toml"
    assert said(capsys, "--vehicle", str(built), "--controller", "I", "--save", str(saved))[0] == 0
    assert said(capsys, "--check", str(saved), "--controller", "I_designed")[0] == 0
    text = saved.read_text()
    (claimed,) = re.findall(r"^sampled_norm = (.*)$", text, re.MULTILINE)
    changed = {
        "period": text.replace("sample_period = 0.01", "sample_period = 0.011"),
        "digit": text.replace(claimed, repr(float(claimed) * (1 - 1e-6))),
        "none": text.replace(BUILT.strip(), ""),
    }[change]
    saved.write_text(changed)
    code, found = said(capsys, "--check", str(saved), "--controller", "I_designed")
    (failure,) = found["controllers"][0]["failures"]
    assert code == 1
    assert failure.startswith("the sampled norm is claimed to be 7.87")
    assert ("neither sample_period nor delay" in failure) == (change == "none")
    bump(["--vehicle", str(saved), "--controller", "I_designed", "--no-logs", "--duration", "0.1"])
    assert "the sampled norm is claimed to be 7.87" in prose(capsys.readouterr().err)


def test_inspected(built, tmp_path, capsys):
    """A log claims the norm as built; inspection finds it again, and refuses another."""
    bump(["--vehicle", str(built), "--controller", "I", "--logs", str(tmp_path), "--duration", "0.5", "-v"])
    capsys.readouterr()
    (log,) = tmp_path.glob("*.mcap")
    assert inspect([str(log), "-v"]) == 0
    vehicle = read_vehicle(str(built))
    norm = norm_as_implemented(vehicle, design(vehicle, "I"))
    assert f"sampled norm {norm.value:.7g}" in prose(capsys.readouterr().out)

    def forge(claim: str) -> str:
        record = json.loads(claim)
        return json.dumps(record | {"sampled_norm": record["sampled_norm"] * (1 - 1e-6)})

    forged = tmp_path / "forged.mcap"
    forged.write_bytes(written(contents(log).with_claim("run/I", "certificate", forge)))
    assert inspect([str(forged)]) == 1
    assert "the sampled norm is claimed to be 7.87" in prose(capsys.readouterr().out)
