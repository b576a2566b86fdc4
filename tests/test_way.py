"""The way of a controller's name, from the command line to the log: down the rooms, and back up as seldom as can be."""

import functools
import sys
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from sim.bump import main
from sim.recording.run_log import RunLog
from sim.runs.prediction import Prediction
from sim.runs.run import Run
from synth.controller.controller import Controller
from tests.commands import ROOT
from tests.conftest import recorded_runs

NAME = "mine"
# Names from the options, by vehicle, a controller of a name, and its run: each of its own room.
UP = ["chosen_of", "design", "run_controllers"]


def named(value: Any) -> bool:
    """Whether a value is the name, or that of which it is the name, or some of these; what is said of it in words is not."""
    if isinstance(value, (list, tuple)):
        return any(map(named, value))
    if isinstance(value, dict):
        return any(isinstance(one, Run | list) and named(one) for one in value.values())
    if isinstance(value, Prediction | Run):
        return value.controller.name == NAME
    return value == NAME if isinstance(value, str) else isinstance(value, Controller | RunLog) and value.name == NAME


@functools.cache
def room(code: CodeType) -> str:
    """The room of code of ours; empty for others, for what has no name of its own, and for the check of arguments at a door."""
    path = Path(code.co_filename)
    if path == ROOT / "models" / "common" / "checks.py":
        return ""
    ours = path.is_relative_to(ROOT) and path.relative_to(ROOT).parts[0] in ("models", "synth", "sim")
    return ".".join(path.relative_to(ROOT).with_suffix("").parts[:2]) if ours and not code.co_name.startswith("<") else ""


def is_property(frame: FrameType) -> bool:
    """Returns True if it reads something off an object, which then is where it was."""
    return isinstance(getattr(type(frame.f_locals.get("self")), frame.f_code.co_name, None), property)


def test_the_way_of_a_name(tmp_path):
    """On its way from `sim.bump` to the log a controller's name comes back up to another room three times, and no more."""
    vehicle = tmp_path / "mine.toml"
    gain = f'\n[controllers.{NAME}]\nmeasured = ["sprung_velocity"]\ngain = [[-5000.0]]\n'
    vehicle.write_text((ROOT / "models" / "quarter_car.toml").read_text() + gain)
    found: list[str] = []

    def noticed(frame: FrameType, event: str, value: Any) -> None:
        below = room(frame.f_code)
        if event != "return" or not below or not named(value) or is_property(frame):
            return
        above = frame.f_back
        while above is not None and not room(above.f_code):
            above = above.f_back  # a comprehension, or what a decorator puts around
        if above is not None and room(above.f_code) != below:
            found.append(frame.f_code.co_name)

    options = ["--vehicle", str(vehicle), "--controller", NAME, "--duration", "0.1", "--logs", str(tmp_path), "--json"]
    before = sys.getprofile()
    sys.setprofile(noticed)
    try:
        assert main(options) == 0
    finally:
        sys.setprofile(before)
    (log,) = tmp_path.glob("*.mcap")
    assert recorded_runs(str(log)) == {NAME}
    assert found == UP
