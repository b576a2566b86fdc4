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
from importlib.util import find_spec
from os.path import dirname, join

if sys.argv[:1] == ["-m"] and not sys.flags.safe_path and sys.path[0] != dirname(__path__[0]):
    sys.path.append(sys.path.pop(0))  # the user's folder comes last: its models.py is not ours

for _name in ("models", "synth"):
    _spec = find_spec(_name)
    _where = [] if _spec is None else [*(_spec.submodule_search_locations or ())]
    if _spec is not None and join(dirname(__path__[0]), _name) not in _where:
        _line = (
            f"{_spec.origin or _where[0]} hides Roadproof's package {_name!r}; rename it, or run commands as in: roadproof bump"
        )
        if sys.argv[:1] != ["-m"]:
            raise ImportError(_line)
        sys.stderr.write(f"roadproof: {_line}\n")
        raise SystemExit(2)

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
