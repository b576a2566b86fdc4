"""The way of a controller's name, from the command line to the log: down the rooms, and back up as seldom as can be."""

import sys
from pathlib import Path
from types import FrameType
from typing import Any

from sim.bump import main
from sim.recording.run_log import RunLog
from sim.runs.prediction import Prediction
from sim.runs.run import Run
from synth.controller import Controller
from tests.commands import ROOT
from tests.conftest import recorded_runs

NAME = "mine"
UP = ["chosen", "design", "run_all"]  # names from the options, a controller of a name, its run: each of a room of its own


def named(value: Any) -> bool:
    """Whether a value is the name, or that of which it is the name, or holds such."""
    if isinstance(value, (list, tuple)):
        return any(map(named, value))
    if isinstance(value, dict):
        return any(map(named, value.values()))
    if isinstance(value, Prediction | Run):
        return value.controller.name == NAME
    return value == NAME if isinstance(value, str) else isinstance(value, Controller | RunLog) and value.name == NAME


def room(frame: FrameType) -> str:
    """The room of a frame of ours; empty for others."""
    path = Path(frame.f_code.co_filename)
    if not path.is_relative_to(ROOT) or path.relative_to(ROOT).parts[0] not in ("models", "synth", "sim"):
        return ""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts[:2])


def is_property(frame: FrameType) -> bool:
    """Whether it reads something off an object, which then is where it was."""
    return isinstance(getattr(type(frame.f_locals.get("self")), frame.f_code.co_name, None), property)


def test_the_way_of_a_name(tmp_path):
    """On its way from `sim.bump` to the log a controller's name comes back up to another room three times, and no more."""
    vehicle = tmp_path / "mine.toml"
    gain = f'\n[controllers.{NAME}]\nmeasured = ["sprung_velocity"]\ngain = [[-5000.0]]\n'
    vehicle.write_text((ROOT / "models" / "quarter_car.toml").read_text() + gain)
    found: list[str] = []

    def noticed(frame: FrameType, event: str, value: Any) -> None:
        below = room(frame)
        if event != "return" or not below or not named(value) or is_property(frame):
            return
        above = frame.f_back
        while above is not None and not (room(above) and not above.f_code.co_name.startswith("<")):
            above = above.f_back  # a comprehension, or what a decorator puts around
        if above is not None and room(above) != below and not frame.f_code.co_name.startswith("<"):
            found.append(frame.f_code.co_name)

    before = sys.getprofile()
    sys.setprofile(noticed)
    try:
        assert (
            main(["--vehicle", str(vehicle), "--controller", NAME, "--duration", "0.5", "--logs", str(tmp_path), "--json"]) == 0
        )
    finally:
        sys.setprofile(before)
    (log,) = tmp_path.glob("*.mcap")
    assert recorded_runs(str(log)) == {NAME}
    assert found == UP
