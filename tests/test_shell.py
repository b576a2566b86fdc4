"""Commands that are printed can be pasted, whatever files and controllers are called."""

import json
import os
import re
import shlex
import subprocess
import sys
import unicodedata
from pathlib import Path

import pytest

from models.common.errors import InputError
from models.common.printed import option, pasted, pasted_path
from models.kinds.kind import HERE
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.recording.files import opening_lines
from synth.__main__ import main
from tests.commands import attacks
from tests.test_own_kind import folder as hopper

NAMES = (
    "--help",
    "-h",
    "-",
    "--",
    "my car.toml",
    "it's",
    '"',
    "a\nb",
    "a\tb\x1b[2J",
    "$HOME",
    "`id`",
    "a;b",
    "*",
    "Ы é",
    "\\",
    "#x",
    "~",
    "!!",
)
assert hopper  # a fixture


@pytest.mark.skipif(sys.platform == "win32" or not Path("/bin/bash").exists(), reason="it is read back by bash")
def test_a_shell_reads_it_back():
    """Every word comes out of a shell as it went in, and the command is one line of printable letters."""
    command = pasted([*NAMES, *(f"--vehicle={name}" for name in NAMES)])
    assert command.isprintable()
    echo = subprocess.run(
        ["/bin/bash", "-c", f"printf '%s\\0' {command}"], capture_output=True, check=True, env={"LC_ALL": "C.UTF-8"}
    )
    assert echo.stdout.decode().split("\0")[:-1] == [*NAMES, *(f"--vehicle={name}" for name in NAMES)]


def test_ordinary_words_are_as_they_were():
    """Words that need no quotation have none, and others have the shell's usual one."""
    assert pasted(["python", "-m", "synth", "it's"]) == shlex.join(["python", "-m", "synth", "it's"])


@pytest.mark.parametrize("name", NAMES)
def test_a_value_is_none_for_an_option(name):
    """A value that looks like an option is written into one word with its own."""
    words = shlex.split(option("--vehicle", name)) if name.isprintable() else [option("--vehicle", name)]
    assert len(words) == (1 if name.startswith("-") or not name.isprintable() else 2)
    assert not pasted_path(Path(name)).startswith("-")


@pytest.mark.parametrize(
    "name", ["--help", "-", "-I", "--", "a b", "a\\nb", "it's", "", "\N{COMBINING ACUTE ACCENT}a", "_\N{COMBINING ACUTE ACCENT}"]
)
def test_names_of_controllers(name):
    """A controller whose name would be an option, or no word, is refused."""
    text = (HERE / "quarter_car.toml").read_text(encoding="utf-8")
    with pytest.raises(InputError, match=r"a controller's name has letters, digits, '_' and '-' only, .* no '-' first"):
        parse_vehicle(f'{text}\n[controllers."{name}"]\nmeasured = ["sprung_velocity"]')


@pytest.mark.parametrize("name", ["नियंत्रक", "re\N{COMBINING ACUTE ACCENT}glage", *attacks(("ผู้ช่วย", "𐐷-1"))])
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
@pytest.mark.parametrize("name", ["a b's\n.toml", *attacks(["--help.toml"])])
def test_what_is_printed_runs(tmp_path, monkeypatch, capsys, name):
    """The command that offers `--refine`, pasted, is for that vehicle file and does refine; the one for a recording names it."""
    monkeypatch.chdir(tmp_path)
    text = (HERE / "quarter_car.toml").read_text(encoding="utf-8").partition("[controllers.I_printed]")[0]
    Path(name).write_text(text.replace("13100.0", "30000.0"), encoding="utf-8")
    assert main([f"--vehicle={name}", "--controller", "II", "-v"]) == 0
    offered = re.search(r"^  python -m (synth .*)$", capsys.readouterr().out, re.MULTILINE)
    assert offered is not None
    shell = ["/bin/bash", "-c", f"{shlex.quote(sys.executable)} -m {offered[1]} --json"]
    if sys.platform != "win32":
        ran = subprocess.run(
            shell, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(HERE.parent)}, timeout=120
        )
        assert ran.returncode == 0, ran.stderr
        assert json.loads(ran.stdout)["controllers"][0]["name"] == "II"
    paths = {kind: Path(f"{name}.{kind}") for kind in ("rerun", "mcap", "layout")}
    assert all(line.isprintable() and not line.startswith("-") for line in opening_lines(paths))
