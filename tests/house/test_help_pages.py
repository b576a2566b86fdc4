"""Pages for readers in trouble, or from other tools: their snippets print what the pages show, and the quoted texts exist."""

import re

import pytest

from tests.house.test_architecture import FILES, ROOT
from tests.support.commands import main_of, prose
from tests.support.pages import missing, page, sections

TROUBLE = "docs/troubleshooting.md"


def check_snippets(name: str, capsys) -> None:
    """Runs the Python blocks of a page in one namespace, and compares the output of each section with its text blocks."""
    names: dict[str, object] = {}
    for one in sections(name):
        for snippet in one.blocks("python"):
            exec(compile(snippet, str(one), "exec"), names)
        printed = capsys.readouterr().out
        for text in one.blocks("text"):
            assert missing(text, printed) is None, f"{one}: {missing(text, printed)}\n{printed}"


@pytest.mark.attack
def test_published_failures_of_hinfsyn(capsys):
    """Four plants at which hinfsyn fails have a certified controller, or a proof that no static gain stabilises them."""
    check_snippets("docs/how-to/when-hinfsyn-fails.md", capsys)


@pytest.mark.slow
def test_calls_for_matlab_users(capsys):
    """Each call beside a MATLAB function runs, and the gain of LQR is that of `lqr` with the other sign."""
    check_snippets("docs/start/from-matlab.md", capsys)


def test_quoted_messages_exist():
    """Each text that troubleshooting quotes is a text of the code, so that a reader finds what a command printed."""
    quoted = re.findall(r"^### `([^`]{3,})`|^\| `([^`]+)` \||^- `([^`]+)`:|If `([^`]+)`", page(TROUBLE), re.M)
    texts = [text for groups in quoted for text in groups if text]
    assert len(texts) > 12
    code = re.sub(r'"\s+f?"', "", "\n".join((ROOT / path).read_text(encoding="utf-8") for path in FILES))
    made = {"linear analysis applies until", "DOES NOT AGREE", "energy DOES NOT BALANCE"}  # put together from parts
    assert [text for text in texts if text not in made and text not in code] == []


def test_example_of_a_coarse_timestep(capsys):
    """The timestep that troubleshooting gives as an example is too coarse."""
    assert "--timestep 0.02" in page(TROUBLE)
    assert main_of("sim.bump")(["--controller", "I", "--timestep", "0.02", "--no-logs", "-v"]) == 0
    said = "MuJoCo agrees with the model; linear analysis applies over the whole run; the timestep is too coarse"
    assert f"{said} for accurate numbers; energy balances" in prose(capsys.readouterr().out)
