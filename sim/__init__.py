"""Runs of vehicles: roads, MuJoCo, the linear response, their comparison, logs, and the commands.

Public names, imported when they are first used; all units are SI:

- runs: `run`, a `Run` for each controller, of whatever kind; `sample_times`, and `Response`, which `to_pandas` and `to_control`
  export
- their ride, travel and grip: `measure_run`, and `RunMetrics`
- measured in MuJoCo, with their predictions: `find_margins`, and `measure_responses`, the frequency responses
- their logs: `run_log`, and `record`
- the best controllers for a vehicle and a road: `recommend`, a `Recommendation`
- own control laws of many runs side by side: `Driver`

Whatever else a module holds may move without notice.
"""

import sys

try:
    from models.common.lazy import attach
except Exception as error:  # a file or a folder of the user's has the name of a package of ours
    from importlib.util import find_spec

    _spec = find_spec("models")
    _place = "nothing" if _spec is None else _spec.origin or next(iter(_spec.submodule_search_locations or ()))
    _line = f"{_place} hides Roadproof's package 'models'; rename it, or run commands as in: roadproof bump"
    if sys.argv[:1] != ["-m"]:
        raise ImportError(_line) from error
    sys.stderr.write(f"roadproof: {_line}\n")
    raise SystemExit(2) from error

TYPE_CHECKING = False
if TYPE_CHECKING:  # what type checkers and editors see
    from sim.drive.driver import Driver
    from sim.drive.response import Response
    from sim.recording.files import record
    from sim.recording.run_records import run_log
    from sim.runs.by_name import run
    from sim.runs.run import Run, sample_times
    from sim.studies.frequency.identification import measure_responses
    from sim.studies.recommend.recommend import recommend
    from sim.studies.recommend.result import Recommendation
    from sim.studies.ride.run_metrics import RunMetrics, measure_run
    from sim.studies.stability.margin_search import find_margins
else:
    __getattr__, __dir__, __all__ = attach(__name__, __file__)
