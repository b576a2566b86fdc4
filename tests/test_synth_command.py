"""`python -m synth`: what it prints, saves and checks."""

import json
import subprocess
import sys

import pytest

from models.errors import InputError
from synth.__main__ import main


def table(capsys, *arguments) -> tuple[int, dict]:
    code = main([*arguments, "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_table(capsys):
    """Every controller has a gain, a norm that both routes give, poles and a gap to what no controller can beat."""
    code, found = table(capsys)
    assert code == 0
    rows = {row["name"]: row for row in found["controllers"]}
    assert set(rows) == {"state", "I", "II", "state_printed", "I_printed", "II_printed"}
    assert rows["I"]["norm"] == pytest.approx(7.843188, abs=1e-6)  # given with 7 digits
    assert rows["I"]["gap"] == pytest.approx(8.6e-4, abs=1e-5)  # 7.843188 / 7.836458 - 1
    assert all(row["routes_gap"] < 1e-10 and row["failures"] == [] for row in rows.values())
    assert all(0 <= row["gap"] < 0.01 for row in rows.values())


def test_text_names_the_flat_optimum_and_the_limit(capsys):
    """What the paper did not see is in the text."""
    assert main(["--controller", "state"]) == 0
    text = capsys.readouterr().out
    assert "the optimum is flat" in text
    assert "no control force changes 7.836458 at 63.757 rad/s" in text


def test_remark_4(capsys):
    """With L = 0 neither controller can be designed, and each says why."""
    code, found = table(capsys, "--zero-l")
    assert code == 1
    assert [row["name"] for row in found["controllers"]] == ["I", "II"]
    assert all("no solution with eta > 0 for L = 0" in row["reason"] for row in found["controllers"])


def test_refine_save_check(capsys, tmp_path):
    """A refined gain is saved as an entry that reads back, and checks, to the same norm."""
    file = tmp_path / "car.toml"
    code, refined = table(capsys, "--controller", "I", "--refine", "--save", str(file))
    assert code == 0
    assert "gamma 7.843188" in refined["controllers"][0]["traded"]
    code, checked = table(capsys, "--check", str(file), "--controller", "I_designed")
    assert code == 0
    assert checked["controllers"][0]["norm"] == pytest.approx(refined["controllers"][0]["norm"], rel=1e-12)
    assert checked["controllers"][0]["bound"] >= checked["controllers"][0]["norm"]


def test_check_needs_no_solver(tmp_path):
    """`--check` imports neither cvxpy nor a solver."""
    code = (
        "import sys; sys.modules['cvxpy'] = sys.modules['clarabel'] = None; from synth.__main__ import main; main(sys.argv[1:])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, "--check", "models/quarter_car.toml"], capture_output=True, text=True, check=True
    )
    assert "controller I_printed" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--controller", "nobody"], "unknown controller 'nobody'"),
        (["--zero-l", "--controller", "state"], "--zero-l needs a controller"),
        (["--controller", "I", "--save", "/no/such/folder/car.toml"], "cannot be written"),
        (["--vehicle", "/no/such/file"], "cannot be read"),
    ],
)
def test_bad_input(arguments, message):
    """A mistake is one line that says what to do."""
    with pytest.raises(InputError, match=message):
        main(arguments)
