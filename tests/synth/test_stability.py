"""Stable, marginal or unstable: one function decides, with an allowance that scales with the problem."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg

from models.common.errors import InputError
from models.vehicle.vehicle import read_vehicle
from sim.bump import main as bump
from sim.drive.__main__ import main as drive
from sim.inspect.__main__ import main as inspect
from sim.sweep import main as sweep
from synth.__main__ import main as synth
from synth.analysis.stability import MARGINAL, STABLE, UNSTABLE, _Triangle, sampled_growth, stability
from tests.support.commands import prose

CASES = [
    ([[-1.0, 1.0], [0.0, -1.0]], STABLE),  # a double pole moves by 1e-8, and is stable still
    ([[-1e-6, 1.0], [-1.0, -1e-6]], STABLE),  # lightly damped
    ([[0.0, 1.0], [-1.0, 0.0]], MARGINAL),
    ([[0.0, 1.0], [0.0, 0.0]], MARGINAL),  # a double integrator, whose poles rounding moves to +-1e-8
    ([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]], MARGINAL),  # and here to 1e-5
    ([[0.0, 1.0], [-1.0, 1e-6]], UNSTABLE),
    ([[0.0, 0.0], [0.0, 1e-3]], UNSTABLE),  # on the axis, and beyond
]


@pytest.mark.parametrize(("A", "verdict"), CASES)
def test_verdict_depends_on_no_coordinates(A, verdict):
    """A verdict is that of the loop: the same in twenty other coordinates and units of time."""
    rng = np.random.default_rng(0)
    A = np.array(A)
    assert stability(A).verdict == verdict
    for _ in range(20):
        T = rng.standard_normal((len(A), len(A))) * 10.0 ** rng.uniform(-3, 3, len(A))
        if np.linalg.cond(T / np.linalg.norm(T, axis=0)) < 30:  # beyond, the coordinates themselves lose what is asked for
            assert stability(10.0 ** rng.uniform(-5, 5) * np.linalg.solve(T, A @ T)).verdict == verdict


def test_allowance_is_rounding_not_more():
    """A mode damped by a thousand roundings is stable, one damped by a tenth of one is not, whatever the size of A."""
    for size in 10.0 ** np.arange(-20, 21, 5):
        for damping, verdict in ((1e-12, STABLE), (1e-17, MARGINAL), (-1e-17, MARGINAL), (-1e-12, UNSTABLE)):
            assert stability(size * np.array([[-damping, 1.0], [-1.0, -damping]])).verdict == verdict


def test_sampled_growth():
    """On the unit circle to rounding it is exactly 1, double or not; off it, it is the spectral radius."""
    turn = np.array([[np.cos(0.1), np.sin(0.1)], [-np.sin(0.1), np.cos(0.1)]])
    for Phi, growth in ((turn, 1.0), (np.array([[1.0, 1.0], [0.0, 1.0]]), 1.0), (0.5 * turn, 0.5), (1.01 * turn, 1.01)):
        assert sampled_growth(Phi) == pytest.approx(growth, rel=1e-12 if growth != 1 else 0)  # 1 is exact
    assert sampled_growth((1 - 1e-12) * turn) < 1
    assert sampled_growth(np.zeros((2, 2))) == 0
    delayed = np.diag(np.ones(59), 1)  # a force on its way for 60 samples: sixty poles at zero, and one eigenvector
    assert sampled_growth(delayed) == 0
    for count, size, growth in ((1, 0.9, 0.9), (2, 1.0, 1.0), (2, 1.01, 1.01), (4, 0.999, 0.999)):
        # In other coordinates rounding moves the poles of a long chain off zero, to all angles: none of them is on the circle.
        loop = np.asarray(linalg.block_diag(np.diag(np.ones(60 * count - 1), 1), size * turn))
        other = np.linalg.qr(np.random.default_rng(0).standard_normal(loop.shape))[0]
        assert sampled_growth(other.T @ loop @ other) == pytest.approx(growth, rel=1e-9 if growth != 1 else 0)


def test_a_bound_by_parts_is_one(monkeypatch):
    """Parts of a Schur form bound the norm of the inverse from above, and one part is the inverse itself, to rounding."""
    rng = np.random.default_rng(3)
    A = rng.standard_normal((70, 70)) / 10
    for most in (70, 30, 9):
        monkeypatch.setattr("synth.analysis.stability.PART", most)
        bound = _Triangle(A)
        for p in np.exp(1j * np.linspace(0.1, 3.0, 5)):
            true = np.linalg.norm(np.linalg.inv(A - p * np.eye(70)))
            assert bound.inverse_size(p) >= true * (1 - 1e-9)
            assert most < 70 or bound.inverse_size(p) == pytest.approx(true, rel=1e-9)


@pytest.mark.parametrize("kind", ["quarter_car", "half_car", "full_car"])
def test_no_car_turns_marginal_by_mistake(kind):
    """A shipped vehicle is stable, from a thousandth of its damping up; without any it is marginal, also in its sampled loop."""
    vehicle = read_vehicle(kind)
    damped = [name for name in vehicle.parameters if "damping" in name]
    for factor, verdict in ((1.0, STABLE), (1e-3, STABLE), (1e-9, STABLE), (1e-17, MARGINAL), (0.0, MARGINAL)):
        other = dataclasses.replace(
            vehicle, parameters={**vehicle.parameters, **{name: factor * vehicle.parameters[name] for name in damped}}
        )
        assert stability(other.linear_model.A).verdict == verdict
        growth = sampled_growth(linalg.expm(1e-3 * other.linear_model.A))
        assert growth < 1 if verdict == STABLE else growth == 1.0


def test_every_command_calls_it_marginal(paper, tmp_path, capsys):
    """A car without damping has no norm, which is no failure: in the table, in a run, in its log and in JSON."""
    undamped = str(tmp_path / "undamped.toml")
    Path(undamped).write_text(paper.text.replace("suspension_damping = 400.0", "suspension_damping = 1e-13"))
    assert synth(["--vehicle", undamped, "--controller", "passive", "-v"]) == 0
    out = capsys.readouterr().out
    assert re.search("passive +(- +)*MARGINAL", out)
    assert "marginal: a pole at 0+65.4j rad/s does not decay (within rounding)" in out
    assert synth(["--vehicle", undamped, "--controller", "passive", "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["controllers"]
    assert (row["stability"], row["norm"], row["peak_frequency"]) == (MARGINAL, None, None)

    bump(["--vehicle", undamped, "--controller", "passive", "--duration", "0.5", "--logs", str(tmp_path), "-v"])
    out = capsys.readouterr().out
    assert "marginal: a pole at 0+65.4j rad/s" in out
    assert "marginal: a mode of the sampled loop neither grows nor decays, within rounding" in out
    assert "stable" not in out
    (log,) = tmp_path.glob("*.mcap")
    assert inspect([str(log), "-v"]) == 0
    out = prose(capsys.readouterr().out)
    assert "certificate: marginal: a pole at 0+65.4j rad/s does not decay (within rounding); the log claims the same" in out
    drive(
        ["--vehicle", undamped, "--controller", "passive", "--class", "A", "--speed", "10", "--duration", "3", "--no-logs", "-v"]
    )
    assert "passive, expected" not in capsys.readouterr().out  # a loop without a variance
    with pytest.raises(InputError, match="does not decay"):
        sweep(["--vehicle", undamped, "--controller", "passive"])
