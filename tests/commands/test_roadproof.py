"""`roadproof VERB` is `python -m` of that command."""

import subprocess
import sys
import tomllib

import pytest

from sim.__main__ import COMMANDS, VERBS, roadproof
from tests.support.commands import ROOT

CODE = "from sim.__main__ import roadproof; roadproof()"


def run(*command: str) -> tuple[int, str, str]:
    done = subprocess.run([sys.executable, *command], cwd=ROOT, capture_output=True, text=True)
    return done.returncode, done.stdout, done.stderr


def test_it_is_installed():
    """The package's one entry point is this function, and each command has a verb of its own."""
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
    assert scripts == {"roadproof": f"{roadproof.__module__}:{roadproof.__name__}"}
    assert len(VERBS) == len(COMMANDS)


@pytest.mark.parametrize(("called", "named"), [(("bump",), "roadproof bump"), ((), "roadproof")])
def test_an_error_names_the_command_as_it_was_called(called, named):
    """Bad options are sent to the help page of what was typed: of the verb, or of the module."""
    said = "roadproof: unrecognized arguments: --nonsense; see {} --help\n"
    assert run("-c", CODE, *called, "--nonsense") == (2, "", said.format(named))
    module = VERBS[called[0]] if called else "sim"
    assert run("-m", module, "--nonsense") == (2, "", said.format(f"python -m {module}"))
    assert run("-m", "sim", *called, "--nonsense") == (2, "", said.format(named if called else "python -m sim"))


def test_a_verb_is_its_command():
    """A command prints the same and ends the same either way, bad input included."""
    arguments = ("nowhere/car.toml",)
    by_verb, by_module = run("-c", CODE, "new", *arguments), run("-m", "sim.new", *arguments)
    assert by_verb == by_module
    assert by_verb[0] == 2


@pytest.mark.parametrize(("words", "code"), [(("nonsense",), 2), (("--help",), 0), ((), 0)])
def test_other_words(words, code):
    """Without a verb there is the table of commands; an unknown one is refused in a line that names them all."""
    ended, out, err = run("-c", CODE, *words)
    assert ended == code
    assert all(each in (out or err) for each in VERBS)
    assert len(err.splitlines()) == (code == 2)
