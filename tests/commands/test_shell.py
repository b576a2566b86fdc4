"""Commands that are printed can be pasted, whatever files and controllers are called."""

import re
import shlex
import subprocess
import sys
import unicodedata
from pathlib import Path

import pytest

from models.common.printed import pasted_path, shell_line
from models.kinds.kind import HERE
from models.vehicle.vehicle import read_vehicle
from synth.__main__ import main
from tests.support.commands import environment

NAMES = ("my car.toml", "it's", '"', "$HOME", "`id`", "a;b", "*", "Ы é", "\\", "#x")


@pytest.mark.skipif(sys.platform == "win32" or not Path("/bin/bash").exists(), reason="it is read back by bash")
def test_a_shell_reads_it_back():
    """Every word of a printed command comes out of a shell as it went in."""
    command = " ".join([shell_line(NAMES), *(pasted_path(Path(one)) for one in NAMES)])
    echo = subprocess.run(["/bin/bash", "-c", f"printf '%s\\0' {command}"], capture_output=True, check=True)
    assert echo.stdout.decode().split("\0")[:-1] == [*NAMES, *NAMES]


@pytest.mark.parametrize("name", ["नियंत्रक", "re\N{COMBINING ACUTE ACCENT}glage"])
def test_names_of_controllers_have_marks(tmp_path, capsys, name):
    """Letters of any script with their vowel signs and accents make a name, in either spelling; what is saved is read again."""
    car, saved = tmp_path / "car.toml", tmp_path / "saved.toml"
    text = (HERE / "quarter_car.toml").read_text(encoding="utf-8").partition("[controllers.I]")[0]
    car.write_text(f'{text}\n[controllers."{name}"]\nmeasured = ["suspension_deflection", "sprung_velocity"]\n', encoding="utf-8")
    for form in ("NFC", "NFD"):
        asked = unicodedata.normalize(form, name)
        assert main(["--vehicle", str(car), "--controller", asked, "--save", str(saved)]) == 0
        vehicle = read_vehicle(saved)
        assert set(vehicle.controllers) == {unicodedata.normalize("NFC", name + ending) for ending in ("", "_designed")}
        assert main(["--check", str(saved)]) == 0
    capsys.readouterr()


@pytest.mark.attack
@pytest.mark.skipif(sys.platform == "win32" or not Path("/bin/bash").exists(), reason="it is read by bash")
def test_what_is_printed_runs(tmp_path, monkeypatch, capsys):
    """The command that verifies an export, pasted into a shell, reads the exported folder and proves its claim."""
    monkeypatch.chdir(tmp_path)
    assert main(["--controller", "I", "--export", "a b's"]) == 0
    offered = re.search(r"^  roadproof (synth .*)$", capsys.readouterr().out, re.MULTILINE)
    assert offered is not None
    shell = ["/bin/bash", "-c", f"{shlex.quote(sys.executable)} -m {offered[1]}"]
    ran = subprocess.run(shell, capture_output=True, text=True, env=environment(), timeout=120)
    assert ran.returncode == 0, ran.stderr
