"""Coverage of a test run, with the name of the test that runs each line: for `tests.benchmarks.mutants`.

It lies as `sitecustomize` on the path of every process of the run, and is a plugin of pytest in those that run tests. It writes
to the folder `WATCHED`: `lines.*`, what coverage has seen, and `seconds.*`, what each test took.
"""

import atexit
import os
import uuid
from pathlib import Path

import coverage  # pyright: ignore[reportMissingImports] - an extra

FOLDER, ROOT = Path(os.environ["WATCHED"]), os.environ["WATCHED_ROOT"]
MINE = uuid.uuid4().hex
WATCHER = coverage.Coverage(
    data_file=str(FOLDER / f"lines.{MINE}"),
    include=[f"{ROOT}/{floor}/*" for floor in ("models", "synth", "sim")],
    config_file=False,
    context=os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" ")[0],
    messages=False,
)
WATCHER.start()


@atexit.register
def _saved() -> None:
    """Saves what was seen."""
    WATCHER.stop()
    WATCHER.save()


def pytest_runtest_protocol(item, nextitem) -> None:
    """Lets what runs from now on count for this test."""
    del nextitem
    WATCHER.switch_context(item.nodeid)


def pytest_runtest_makereport(item, call) -> None:
    """Notes how long a part of a test took."""
    with open(FOLDER / f"seconds.{MINE}", "a", encoding="utf-8") as stream:
        stream.write(f"{item.nodeid} {call.duration}\n")
