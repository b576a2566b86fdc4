"""The damper diagram of a report: force over velocity of a run, with the curve or the limits drawn in."""

from html import unescape
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from models.document.figure import styles
from models.roads.road import Bump
from models.vehicle.vehicle import read_vehicle
from sim.report.__main__ import main
from sim.report.agreement import DIAGRAM_POINTS, suspension_figure
from sim.runs.run import run_controllers, sample_times
from synth.vehicle.designer import design
from tests.support.curved import AXLES, DIGRESSIVE, PROGRESSIVE, curved_text, with_curves

NAMES = ("passive", "I")


def diagram(vehicle):
    """The figure over a bump, and the runs in it."""
    scope: Any = SimpleNamespace(vehicle=vehicle, styles=styles(NAMES))
    runs = run_controllers(vehicle, [design(vehicle, name) for name in NAMES], Bump(0.06), sample_times(vehicle, 0.5, 1e-3))
    return suspension_figure(scope, runs, "over a bump"), runs


def named(panel, label):
    """The curve of a label in a panel."""
    return next(curve for curve in panel.curves if curve.label == label)


@pytest.mark.attack
@pytest.mark.parametrize(
    ("kind", "curves"),
    [("quarter_car", {"suspension_damping": DIGRESSIVE, "suspension_stiffness": PROGRESSIVE}), ("half_car", AXLES)],
)
def test_points_are_what_suspensions_pull_with(kind, curves):
    """Without control points lie on the curve; with it, a damper's are the actuator's force off it; the line is its tangent."""
    vehicle = with_curves(kind, **curves)
    figure, runs = diagram(vehicle)
    assert figure is not None
    assert len(figure.panels) == len(vehicle.parts.with_curve)
    for panel, one in zip(figure.panels, vehicle.parts.with_curve, strict=True):
        drawn, line = named(panel, "curve"), named(panel, "line at rest")
        inside = np.abs(drawn.x) < np.abs(one.curve.x).max()
        np.testing.assert_allclose(drawn.y[inside], np.interp(drawn.x[inside], one.curve.x, one.curve.force), atol=1e-6)
        np.testing.assert_allclose(line.y, one.curve.slope * line.x)
        for run in runs:
            points = named(panel, run.controller.name)
            ending = one.deflection.removeprefix("suspension_deflection")
            force = np.interp(points.x, one.curve.x, one.curve.force)
            if one.part.argument == "velocity":
                every = len(run.physics.time) // DIAGRAM_POINTS
                force = force - run.physics[f"control_force{ending}"][::every]
                np.testing.assert_array_equal(points.x, run.physics[f"suspension_velocity{ending}"][::every])
            np.testing.assert_allclose(points.y, force, atol=1e-6)
            assert panel.xlim is not None
            assert panel.ylim is not None
            assert np.abs(points.x).max() < panel.xlim[1]
            assert np.abs(points.y).max() < panel.ylim[1]


def test_an_adjustable_damper_stays_between_its_limits():
    """Its points lie between c_min v and c_max v, some on each; the passive one's on the line at rest."""
    vehicle = read_vehicle("quarter_car_semi_active")
    figure, _ = diagram(vehicle)
    assert figure is not None
    (panel,) = figure.panels
    low, high = (named(panel, name) for name in ("c_min", "c_max"))
    slopes = low.y[0] / low.x[0], high.y[0] / high.x[0]
    assert slopes == pytest.approx((200.0, 1000.0))
    active, passive = named(panel, "I"), named(panel, "passive")
    held = np.abs(active.x) > 0.05  # a coefficient is held from sample to sample, so at rest a force is rounding over rounding
    ratio = active.y[held] / active.x[held]
    assert ratio.min() == pytest.approx(slopes[0], rel=1e-6)
    assert ratio.max() == pytest.approx(slopes[1], rel=1e-6)
    np.testing.assert_allclose(passive.y, 600.0 * passive.x, atol=1e-9)


def test_there_is_none_of_a_line(paper):
    """If every suspension is a line there is nothing to draw."""
    assert diagram(paper)[0] is None


@pytest.mark.attack
def test_a_report_has_it_where_there_is_something_to_draw(tmp_path):
    """The diagram is among a report's figures, and the page says when the curve leaves the line of linear analysis."""
    (tmp_path / "mine.toml").write_text(curved_text(suspension_damping=DIGRESSIVE))
    asked = ["--quick", "--vehicle", str(tmp_path / "mine.toml"), "--controller", "passive", "--timestep", "0.002"]
    assert main([*asked, "--out", str(tmp_path / "report.html"), "--figures", str(tmp_path / "figures")]) == 0
    assert (tmp_path / "figures" / "suspension.png").stat().st_size > 10_000
    page = (tmp_path / "report.html").read_text()
    words = " ".join(unescape(page).split())
    assert "curve: a damper or spring first differs from its line by 10 % of its largest force at" in words
    assert "Forces over the paper's bump. Lines: characteristics or limits, and their linearisation." in words
