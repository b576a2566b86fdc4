"""Runs of vehicles: roads, MuJoCo, the linear response, their comparison, logs, and the commands.

Public names, imported when they are first used; all units are SI:

- runs: `run`, a `Run` for each controller, of whatever kind; `sample_times`, and `Response`, which `to_pandas` and `to_control`
  export
- their ride, travel and grip: `measure_run`, and `RunMetrics`
- found in MuJoCo beside what is predicted: `find_margins`, and `identify`, the frequency response
- their logs: `run_log`, and `record`

Whatever else a module holds may move without notice.
"""

import sys
from os.path import dirname

if sys.argv[:1] == ["-m"] and not sys.flags.safe_path and sys.path[0] != dirname(__path__[0]):
    sys.path.append(sys.path.pop(0))  # the user's folder comes last: its models.py is not ours

from models.common.interrupt import quiet_start

quiet_start()

from typing import TYPE_CHECKING

from models.common.lazy import attach

if TYPE_CHECKING:  # what type checkers and editors see
    from sim.recording.files import record
    from sim.recording.run_records import run_log
    from sim.response.response import Response
    from sim.runs.by_name import run
    from sim.runs.run import Run, sample_times
    from sim.studies.frequency.identification import identify
    from sim.studies.ride.run_metrics import RunMetrics, measure_run
    from sim.studies.stability.margin_search import find_margins
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "sim.recording.files": "record",
            "sim.recording.run_records": "run_log",
            "sim.response.response": "Response",
            "sim.runs.by_name": "run",
            "sim.runs.run": "Run sample_times",
            "sim.studies.frequency.identification": "identify",
            "sim.studies.ride.run_metrics": "RunMetrics measure_run",
            "sim.studies.stability.margin_search": "find_margins",
        },
    )
