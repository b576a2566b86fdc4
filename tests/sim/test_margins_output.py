"""`sim.margins`: its words and `--json`, and the same controller on other vehicles."""

import dataclasses
import re

import numpy as np
import pytest

from models.common.errors import InputError
from models.common.printed import LINES
from models.document.figure import Curve
from models.kinds.kind import Variation
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.margins import main
from sim.studies.stability.figure import margins_figure
from sim.studies.stability.report import _rows, loop_texts, number
from sim.studies.stability.robustness import _worst, read_variations, robustness, varied_text
from sim.studies.stability.study import stability_margins
from synth import design_controllers
from synth.analysis.norm import by_level_sets, hinf_norm
from synth.controller.problem import generalized_plant
from tests.support.commands import once


def test_a_worst_norm_between_the_points_of_its_grid_is_found():
    """From a grid's best points the worst norm of a smooth one is refined to its top, inside the box and on its side."""
    box = [Variation("mass", 0.7, 1.4), Variation("tyre", 0.75, 1.25)]
    for top, at in ((7.0, (1.0137, 0.9031)), (7.0 - 2 * 0.05**2, (1.0137, 1.25))):
        tyre = 0.9031 if at[1] < 1.25 else 1.30
        _, norms, worst, where = _worst(lambda m, k, t=tyre: 7.0 - (m - 1.0137) ** 2 - 2 * (k - t) ** 2, box)
        assert norms.max() < worst == pytest.approx(top, rel=1e-9)
        assert where == pytest.approx(at, abs=1e-4)


def test_what_varies_may_be_asked_for(paper, designer, monkeypatch):
    """The box is the one that is asked for, and its worst norm is the largest of as many vehicles as it says, no other."""
    norms = []

    def counted(gain):
        norms.append(by_level_sets(gain)[0])
        return norms[-1], 0.0

    monkeypatch.setattr("sim.studies.stability.robustness.by_level_sets", counted)
    variations = read_variations(paper, ["suspension_damping:0.5:1.25"])
    (box,) = robustness(paper, [designer.design("I")], 4e-3, variations=variations)
    assert box is not None
    assert box.holds
    assert box.text == "suspension damping -50 to +25 %"
    assert [corner.parameters for corner in box.corners] == [{"suspension_damping": 200.0}, {"suspension_damping": 500.0}]
    assert box.computed == len(norms) > 49  # a grid, refined
    assert box.norm == pytest.approx(max(norms), rel=1e-12)  # by both routes
    for factor in np.random.default_rng(20261121).uniform(0.5, 1.25, 20):
        other = paper.with_parameters(suspension_damping=factor * paper.parameters["suspension_damping"])
        assert hinf_norm(generalized_plant(other).closed_loop(designer.design("I").state_gain(other))).value <= box.norm
    both = read_variations(read_vehicle("half_car"), ["tyre_stiffness:0.9:1.1"])
    assert list(both.values()) == [("tyre_stiffness_front", "tyre_stiffness_rear")]


def of_kind(vehicle, **varied):
    """Returns the vehicle, of a type that lets these parameters vary."""
    parameters = tuple(dataclasses.replace(one, varied=varied.get(one.name)) for one in vehicle.kind.parameters)
    return dataclasses.replace(vehicle, kind=dataclasses.replace(vehicle.kind, parameters=parameters))


def test_the_kind_says_what_varies(paper, designer):
    """The box, its worst norm, words and figure are of what the vehicle type lets vary; nothing is claimed if nothing varies."""
    controller, fixed = designer.design("I"), of_kind(paper)
    assert robustness(fixed, [controller], 4e-3) == [None]
    assert "nothing is varied" in varied_text(fixed.kind)
    wheel, damper = Variation("wheel", 0.9, 1.2), Variation("damper", 0.75, 1.0)
    vehicle = of_kind(paper, unsprung_mass=wheel, suspension_damping=damper)
    assert varied_text(vehicle.kind) == "wheel -10 to +20 %, damper -25 to +0 %"
    (found,) = stability_margins(vehicle, [controller], 4e-3)
    box = found.box
    assert box is not None
    assert box.holds
    assert set(box.at) == {"unsprung_mass", "suspension_damping"}
    assert [corner.factors for corner in box.corners] == [(m, c) for m in (0.9, 1.2) for c in (0.75, 1.0)]
    for corner in box.corners:
        other = paper.with_parameters(**corner.parameters)
        assert corner.norm == pytest.approx(hinf_norm(generalized_plant(other).closed_loop(controller.state_gain(other))).value)
        assert corner.norm <= box.norm
    panel = margins_figure(found).panels[-1]
    assert (panel.xlabel, panel.ylabel) == ("change of wheel [%]", "change of damper [%]")
    drawn = [curve.x for curve in panel.curves if isinstance(curve, Curve) and curve.marker in "ox" and curve.marker]
    assert set(np.concatenate(drawn).round(9)) == {-10.0, 20.0}  # rounding of 100 (factor - 1)


def test_a_terminal_shows_all_margins(capsys, monkeypatch):
    """Every margin is on a terminal without -v; with -v, every corner of the varied vehicles, too."""
    monkeypatch.setattr("sim.studies.stability.study.stability_margins", once(stability_margins))
    asked = ["--controller", "I", "--timestep", "4e-3"]
    assert main(asked) == 0
    brief = capsys.readouterr().out
    assert brief.count("\n") <= LINES
    assert {"gain, factor", "phase lag [rad]", "delay [ms]", "sample period [ms]"} <= set(re.findall(r"^(\S.+?)  ", brief, re.M))
    assert main([*asked, "-v"]) == 0
    corners = re.findall(r"^([+-]\d+) +([+-]\d+) +\S+ +decays +agrees$", capsys.readouterr().out, re.M)
    assert corners == [(mass, tyre) for mass in ("-30", "+40") for tyre in ("-25", "+25")]


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
