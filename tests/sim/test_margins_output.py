"""`sim.margins`: its words and `--json`, and the loops without margins."""

import dataclasses
import re

import numpy as np
import pytest

from models.common.errors import InputError
from models.common.printed import LINES
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.vehicle import parse_vehicle
from sim.margins import main
from sim.studies.stability.margins import stability_margins
from sim.studies.stability.report import _rows, loop_texts, number
from synth import design_controllers


def test_a_terminal_shows_all_margins(capsys):
    """Every margin is on a terminal without -v."""
    assert main(["--controller", "I", "--timestep", "4e-3"]) == 0
    brief = capsys.readouterr().out
    assert brief.count("\n") <= LINES
    assert {"gain, factor", "phase lag [rad]", "delay [ms]", "sample period [ms]"} <= set(re.findall(r"^(\S.+?)  ", brief, re.M))


@pytest.mark.parametrize(
    ("gain", "damping", "word"),
    [
        (0.0, 400, "requests no force"),
        (90000.0, 400, r"its ideal loop is not stable \(unstable: a pole at 170.7 1/s\)"),
        (-100.0, 0, r"its ideal loop is not stable \(marginal: a pole at 0\+"),
    ],
)
def test_loops_without_margins(tmp_path, paper, gain, damping, word):
    """A gain of zero makes no loop, and an unstable or marginal loop has no margin to lose."""
    text = paper.text.replace("suspension_damping = 400", f"suspension_damping = {damping}")
    signal = "sprung_velocity" if damping else "suspension_deflection"
    (tmp_path / "own.toml").write_text(f'{text}[controllers.own]\nmeasured = ["{signal}"]\ngain = [[{gain}]]\n')
    with pytest.raises(InputError, match=word):
        main(["--controller", "own", "--vehicle", str(tmp_path / "own.toml")])


def test_which_loop_is_said(paper):
    """The output says which sections of a vehicle file the margins include."""
    plain = loop_texts(dataclasses.replace(paper, limits=Limits(actuator_force=1e3)))
    assert plain == ["The loop has no actuator lag.", "Norms are those of the ideal loop."]
    built = dataclasses.replace(paper, limits=Limits(actuator_bandwidth=60.0), implementation=Implementation(delay=1))
    assert "includes the lag of its actuators. Delay and sample period are totals" in " ".join(loop_texts(built))
    blurred = dataclasses.replace(built, implementation=Implementation(noise={"sprung_velocity": 0.01}))
    assert [("not include noise" in " ".join(loop_texts(one))) for one in (built, blurred)] == [False, True]


def test_margins_in_dB_and_degrees_and_reasons_without_a_limit(tmp_path, paper, designer):
    """Factors are in dB and angles in degrees, too. A loop with |L| < 1 at all frequencies states that as the reason."""
    (strong,) = stability_margins(paper, [designer.design("I")], 4e-3)
    text = f'{paper.text}\n[controllers.weak]\nmeasured = ["sprung_velocity"]\ngain = [[-50.0]]\n'
    weak_vehicle = parse_vehicle(text, source=str(tmp_path / "weak.toml"))
    (weak,) = stability_margins(weak_vehicle, design_controllers(weak_vehicle, ["weak"]), 4e-3)
    rows, weak_rows = ({row.margin: row for row in _rows(one)} for one in (strong, weak))
    gain, lag = rows["gain, factor"], rows["phase lag [rad]"]
    assert gain.usual == f"{20 * np.log10(gain.predicted):.3g} dB"
    assert lag.usual == f"{lag.predicted * 180 / np.pi:.3g}°"
    model, w = paper.linear_model, 1j * np.geomspace(1e-2, 1e4, 4000)
    to_velocity = np.linalg.solve(w[:, None, None] * np.eye(4) - model.A, np.broadcast_to(model.B, (len(w), 4, 1)))
    assert 50.0 * np.abs(to_velocity[:, model.states.index("sprung_velocity")]).max() < 1
    for name in ("phase lag [rad]", "phase lead [rad]", "delay [ms]"):
        assert number(weak_rows[name].predicted) == "no limit"
        assert "|L| < 1 at all frequencies" in weak_rows[name].note
    assert "stable up to factor 10000; stable down to factor 0" in weak_rows["gain, factor"].note
