"""`python -m tests.house` lists the faults that a change brings, and no other, each with its line and what to do."""

import shutil
import subprocess

import pytest

from tests.house.__main__ import main
from tests.support.commands import ROOT

LONG = "A sentence of a page or docstring with more than twenty-five words is hard to read, " + "and so on " * 5 + "to the end."
MESSAGE = "the value is not allowed; " + "give another value " * 10
PROSE = "the value is not told apart from others"
TABLE = f"| {'wide ' * 20}|\n"
CODE = f'''"""Docstring.

{LONG}
"""

import os

from models.common.errors import InputError


def check(value: float) -> str:
    """Returns the value in digits.

    Raises:
        InputError: the value is wrong.
    """
    if value == 1:
        raise InputError("{MESSAGE}")
    if value == 2:
        raise InputError("{PROSE}")
    return f"{{value:.3f}}"
'''


@pytest.fixture
def checkout(tmp_path):
    """A Git checkout with one fault of many kinds, which its `main` has, too."""
    for folder in ("models/common", "models/roads", "docs", "tests"):
        (tmp_path / folder).mkdir(parents=True)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    (tmp_path / "models/common/files.py").write_text(CODE)
    (tmp_path / "README.md").write_text(f"# Title\n\n{LONG}\n\n{TABLE}")
    git = ["git", "-c", "user.name=x", "-c", "user.email=x@example.org"]
    for arguments in (["init", "-q", "-b", "main"], ["add", "."], ["commit", "-q", "-m", "x"], ["switch", "-q", "-c", "change"]):
        subprocess.run([*git, *arguments], cwd=tmp_path, check=True)
    return tmp_path


def test_faults_of_a_change(checkout, capsys):
    """Only faults that a change brings are listed, with `--all` those of `main`, too. A moved file brings none."""
    assert main([], checkout) == 0
    subprocess.run(["git", "mv", "models/common/files.py", "models/common/table.py"], cwd=checkout, check=True)
    (checkout / "README.md").write_text(f"# Title\n\nA new line above.\n\n{LONG}\n\n{TABLE}")
    assert main([], checkout) == 0
    assert capsys.readouterr().out == "no faults\n" * 2

    (checkout / "models/common/errors.py").write_text(CODE + "\n" * 4000)
    (checkout / "models/common/wrong.py").write_text("import sim.drive.loop\n")
    (checkout / "models/nobody.py").touch()
    (checkout / "README.md").write_text(f"# Title\n\n{LONG} {LONG}\n\n{TABLE}{TABLE}")
    assert main([], checkout) == 1
    *faults, count = capsys.readouterr().out.splitlines()
    assert count == f"{len(faults)} faults"
    where = "models/common/errors.py"
    for line, what, do in (
        (f"{where}:6", "F401 `os` imported but unused", "run ruff check --fix"),
        (where, "not formatted", f"run ruff format {where}"),
        ("tests/house/ceilings.py", "what all commands share", "remove as many"),
        ("models/nobody.py", "in no rows", "list the file in one row"),
        ("models/common/wrong.py", "models.common imports sim.drive.loop", "move one of both"),
        (f"{where}:3", "words: A sentence", "write two sentences"),
        (f"{where}:20", "private word", "a term of the field"),
        (f"{where}:21", "digits of a number", "use a format of models/common/printed.py"),
        (f"{where}:18", "a message of check has", "shorten to 200"),
        ("README.md:3", "words: A sentence", "write two sentences"),
        ("README.md:6", "a row of a table", "shorten to 100"),
    ):
        assert any(one.startswith(f"{line}: ") and what in one and do in one for one in faults), "\n".join([line, what, *faults])
    assert not any("table.py" in one for one in faults)
    assert main(["--all"], checkout) == 1
    assert "models/common/table.py:6: F401" in capsys.readouterr().out


def test_no_checkout(tmp_path, capsys):
    """A folder without Git is refused in one line."""
    assert main([], tmp_path) == 2
    assert "must be a Git checkout" in capsys.readouterr().err
