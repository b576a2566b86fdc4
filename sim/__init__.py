"""Simulations in MuJoCo, their comparison with linear analysis, logs, and the commands of Roadproof.

Start with `run`, which simulates a vehicle with a controller on a road and returns a `Run`. Each public name is imported when
it is first used. All quantities are in SI units. The public names of this package are:

- Simulate: `run` and its result `Run`; `sample_times`; `Response`, the signals of a run, with `to_pandas` and `to_control`.
- Evaluate a run: `measure_run` returns ride, suspension travel and road holding as `RunMetrics`.
- Measure in MuJoCo and compare with linear analysis: `find_margins` (stability margins) and `measure_responses` (frequency
  responses).
- Record runs: `run_log` converts a run to the content of a log, and `record` writes the log files.
- Select a controller: `recommend` searches for the best controllers for a vehicle and a road, and returns a `Recommendation`.
- Add a control law in Python: `Driver` is the interface whose methods the simulation loop calls for many runs together.

Names in the modules of `sim` that are not public can change without notice.
"""

import sys

try:
    from models.common.lazy import attach
except Exception as error:  # the user's folder contains a file or folder with the same name as a package of Roadproof
    from importlib.util import find_spec

    _spec = find_spec("models")
    _place = "nothing" if _spec is None else _spec.origin or next(iter(_spec.submodule_search_locations or ()))
    _line = f"{_place} hides Roadproof's package 'models'; rename it, or run commands as in: roadproof bump"
    if sys.argv[:1] != ["-m"]:
        raise ImportError(_line) from error
    sys.stderr.write(f"roadproof: {_line}\n")
    raise SystemExit(2) from error

TYPE_CHECKING = False
if TYPE_CHECKING:  # imports for type checkers and editors
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
