"""A logged run, run by MuJoCo again and written down again."""

from dataclasses import replace

from sim.inspect.log import RESPONSES, RecordedRun
from sim.inspect.reproduction import as_response, kept
from sim.physics.simulate import simulate
from sim.recording.provenance import run_log
from sim.recording.run_log import RunLog
from sim.response.response import Response
from sim.runs.run import Run, balanced, driven


def balanced_again(run: Run) -> tuple[Run, Response]:
    """A run with the energy balance of what MuJoCo makes of it now, and what half the step changes; and that physics.

    A law in Python is not run: the forces that it asked for are.
    """
    time = run.prediction.time
    made = simulate([run.vehicle], [driven(run.prediction, time)], [run.road], time)
    (run,) = balanced([run], made)
    return run, made.run(0)


def written_again(recorded: RecordedRun, run: Run, samples: int) -> RunLog:
    """A run as it would be written now, with the responses that were logged."""
    timestep, states = run.prediction.timestep, kept(run.controller)
    responses = {name: as_response(run.vehicle, recorded, name, samples, timestep, states) for name in RESPONSES}
    return replace(run_log(run, recorded.name), responses=responses)
