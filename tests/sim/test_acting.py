"""The acting forces that a log shows beside its signals: loads on the body, and forces of dampers and springs."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun.blueprint as rrb

from models.roads.road import Bump
from models.vehicle.vehicle import read_vehicle
from sim.drive.__main__ import main
from sim.recording.foxglove_layout import foxglove_layout
from sim.recording.rerun_writer import _page, write_rrd
from sim.recording.run_records import run_log
from sim.runs.force_diagram import diagram_signals, diagrams
from sim.runs.run import run_controllers, sample_times
from synth.vehicle.designer import design
from tests.sim.test_rerun import _parts, rows
from tests.support.curved import DIGRESSIVE, PROGRESSIVE, with_curves
from tests.support.rewriting import contents

HISTORY = "time [s],roll [kN m]\n0,0\n0.5,1\n1,0\n"


def topic_of(log: Path, topic: str) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, str]]:
    """Times [s], fields, and units of a topic of doubles, by the reader that knows the responses alone."""
    whole = contents(log)
    (channel,) = [one for one in whole.channels if one.topic == topic]
    messages = [message for message in whole.messages if message.channel_id == channel.id]
    rows = np.frombuffer(b"".join(message.data for message in messages), np.uint8).reshape(len(messages), -1, 9)
    values = np.ascontiguousarray(rows[:, :, 1:]).view("<f8")[..., 0]  # each behind a tag of one byte
    units = {name: json.loads(about)["unit"] for name, about in channel.metadata.items()}
    times = np.array([message.log_time for message in messages]) * 1e-9
    return times, dict(zip(units, values.T, strict=True)), units


@pytest.fixture(scope="module")
def loaded(tmp_path_factory) -> Path:
    """A log of a car that brakes, in a curve that a file has, under a payload."""
    folder = tmp_path_factory.mktemp("loaded")
    (folder / "curve.csv").write_text(HISTORY)
    loads = ["brake:g=0.5", "payload:mass=100:x=-1.0:y=0.5", "brake:g=-0.1:start=1", str(folder / "curve.csv")]
    arguments = ["--vehicle", "full_car", "--controller", "passive", "--duration", "1.2", "--timestep", "2e-3"]
    assert main([*arguments, *(part for load in loads for part in ("--load", load)), "--logs", str(folder)]) == 0
    return next(folder.glob("*.mcap"))


def test_loads_are_logged(loaded):
    """A log shows every load in its way and unit, as it is held over a step, and all of them together."""
    time, found, units = topic_of(loaded, "/loads")
    car = read_vehicle("full_car")
    mass, height = car.parameters["sprung_mass"], car.parameters.get("centre_height", 0.55)
    assert {name: units[name] for name in ("heave_load", "pitch_load", "roll_load")} == {
        "heave_load": "N",
        "pitch_load": "N m",
        "roll_load": "N m",
    }
    comes = (1 - np.cos(np.pi * np.clip((time + 1e-3 - 0.5) / 0.2, 0, 1))) / 2
    np.testing.assert_allclose(found["brake_1_pitch_load"], mass * 9.81 * 0.5 * height * comes, atol=1e-6)
    np.testing.assert_allclose(found["file_roll_load"], 1e3 * np.interp(time + 1e-3, [0, 0.5, 1], [0, 1, 0]), atol=1e-9)
    assert found["payload_heave_load"][-1] == pytest.approx(-100 * 9.81)
    assert found["payload_roll_load"][-1] == pytest.approx(-100 * 9.81 * 0.5)
    for way in ("heave_load", "pitch_load", "roll_load"):
        parts = [values for name, values in found.items() if name.endswith(f"_{way}")]
        np.testing.assert_allclose(found[way], sum(parts), atol=1e-9)


@pytest.fixture(scope="module")
def adjusted():
    """A run with an adjustable damper, as it is written down."""
    vehicle = read_vehicle("quarter_car_semi_active")
    (run,) = run_controllers(vehicle, [design(vehicle, "I")], Bump(0.06), sample_times(vehicle, 0.5, 1e-3))
    return run, run_log(run, "I")


def test_a_damper_s_force_lies_between_its_limits(adjusted):
    """The log has the coefficient that acted times the velocity, and the limits at that velocity on either side."""
    run, log = adjusted
    found = log.other_signals["dampers"]
    velocity, force = found["damper_velocity"], found["damper_force"]
    np.testing.assert_allclose(force, run.physics["damping"] * velocity, atol=1e-6 * np.abs(force).max())  # RK4's reading
    np.testing.assert_allclose(found["damper_force_c_min"], 200.0 * velocity)
    np.testing.assert_allclose(found["damper_force_c_max"], 1000.0 * velocity)
    np.testing.assert_allclose(found["damper_force_line_at_rest"], 600.0 * velocity)


def test_both_viewers_draw_the_diagram(adjusted, tmp_path):
    """Foxglove plots force over velocity by message paths that are in the log; Rerun draws it, to the scale at its ticks."""
    _, log = adjusted
    layout = json.loads(foxglove_layout([log]))
    (plot,) = [panel for panel in layout["configById"].values() if panel.get("xAxisVal") == "custom"]
    fields = {f"/dampers.{name}" for name in log.other_signals["dampers"].names}
    assert {plot["xAxisPath"]["value"], *(path["value"] for path in plot["paths"])} == fields
    assert plot["xAxisPath"]["value"] == "/dampers.damper_velocity"
    assert [path["label"] for path in plot["paths"]] == ["c_min", "c_max", "line at rest", "MuJoCo"]

    (view,) = [part for part in _parts(_page([log], log)) if isinstance(part, rrb.Spatial2DView)]
    assert str(view.origin).lstrip("/") == "I/acting/diagrams/damper_force"
    path = tmp_path / "run.rrd"
    write_rrd(path, [log], {})
    drawn = np.array(rows(path, "/I/acting/diagrams/damper_force/now", "Points2D:positions")).reshape(-1, 2)
    found = log.other_signals["dampers"]
    for axis, name, sign in ((0, "damper_velocity", 1.0), (1, "damper_force", -1.0)):
        scaled = sign * found[name] / (1.15 * np.abs(found[name]).max())
        np.testing.assert_allclose(drawn[:, axis], scaled, atol=1e-6)  # single precision


def test_curves_are_logged_as_they_are():
    """A spring's force lies on its curve, over deflection, and a damper's, over velocity, off it by what its actuator pushes."""
    vehicle = with_curves(suspension_damping=DIGRESSIVE, suspension_stiffness=PROGRESSIVE)
    (run,) = run_controllers(vehicle, [design(vehicle, "passive")], Bump(0.06), sample_times(vehicle, 0.5, 1e-3))
    found = diagram_signals(vehicle, run.physics)
    assert found is not None
    for what, one in (("spring", "deflection"), ("damper", "velocity")):
        np.testing.assert_array_equal(found[f"{what}_force"], found[f"{what}_force_curve"])
        np.testing.assert_array_equal(found[f"{what}_{one}"], run.physics[f"suspension_{one}"])
    names, pushing = [signal.name for signal in run.physics.signals], run.physics.values.copy()
    pushing[:, names.index("control_force")] = 100.0
    pushed = diagram_signals(vehicle, replace(run.physics, values=pushing))
    assert pushed is not None
    np.testing.assert_array_equal(pushed["damper_force"], found["damper_force_curve"] - 100.0)  # pushing apart
    np.testing.assert_array_equal(pushed["spring_force"], found["spring_force_curve"])
    assert diagram_signals(vehicle.linearised, run.physics) is None
    assert diagrams(vehicle.linearised) == []
