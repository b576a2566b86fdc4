"""`python -m sim.inspect` on logs that no run has written: it must neither crash, hang, fill memory, nor write anywhere.

    python -m tests.benchmarks.fuzz_inspect --count 10000

Every case follows from its number: `--first N --count 1` repeats one. Memory is limited for the process, time for every case.
"""

import argparse
import contextlib
import io
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from models.common.errors import InputError
from sim.bump import main as bump
from sim.drive import main as drive
from sim.inspect.__main__ import main as inspect
from tests.hostile import hostile
from tests.rewriting import contents

SLOWEST = 20.0  # s, of one case
MEMORY = 2**30  # bytes beyond what the process has taken before the first case


def whole_logs(folder: Path) -> list[Path]:
    """Short logs of several kinds of run: a bump with two controllers, a random road, a measured one on a half-car."""
    x = np.linspace(0.0, 5.0, 51)
    road = folder / "road.csv"
    np.savetxt(road, np.column_stack([x, 0.01 * np.sin(x), 0.01 * np.cos(x)]), delimiter=",")
    cases = (
        (bump, ["--controller", "passive", "--controller", "I", "--duration", "0.15"]),
        (drive, ["--controller", "II", "--seed", "1", "--duration", "0.1"]),
        (drive, ["--vehicle", "half_car", "--controller", "I", "--road", str(road), "--speed", "15", "--duration", "0.1"]),
    )
    logs = []
    for number, (command, options) in enumerate(cases):
        with contextlib.redirect_stdout(io.StringIO()):
            command([*options, "--logs", str(folder / str(number))])
        logs += (folder / str(number)).glob("*.mcap")
    return logs


def fuzz(first: int, count: int, report=None, logs: Sequence[Path] = ()) -> dict[int, int]:
    """Inspects hostile logs.

    Args:
        first: number of the first.
        count: how many.
        report: is called with a line now and then; None for silence.
        logs: whole ones to begin with; `whole_logs`, if there are none.

    Returns:
        How often each exit code came.

    Raises:
        AssertionError: a case went wrong; the message has its number.
    """
    with tempfile.TemporaryDirectory() as folder:
        logs = logs or whole_logs(Path(folder))
        bases = [(log.read_bytes(), contents(log)) for log in logs]
        for log in logs:
            assert _inspected(log, []) == 0, "the whole logs are proved"
        inside = Path(folder, "a", "b", "c")
        inside.mkdir(parents=True)
        before = _tree(Path(folder))
        resource.setrlimit(resource.RLIMIT_AS, (_address_space() + MEMORY, resource.RLIM_INFINITY))
        codes: dict[int, int] = {}
        slowest, start = (0.0, -1), time.monotonic()
        os.chdir(inside)
        try:
            for number in range(first, first + count):
                rng = np.random.default_rng([7, number])
                data = hostile(*bases[number % len(bases)], rng)
                log = inside / "hostile.mcap"
                log.write_bytes(data)
                options = [[], ["--json"], ["--csv", "signals.csv"]][number % 3]
                began = time.monotonic()
                try:
                    code = _inspected(log, options)
                except BaseException as error:
                    raise AssertionError(f"case {number}: {type(error).__name__}: {error}\n{traceback.format_exc()}") from error
                took = time.monotonic() - began
                slowest = max(slowest, (took, number))
                assert code in (0, 1, 2), f"case {number}: exit code {code}"
                codes[code] = codes.get(code, 0) + 1
                log.unlink()
                Path("signals.csv").unlink(missing_ok=True)
                assert _tree(Path(folder)) == before, f"case {number} wrote a file"
                if report and (number + 1) % 500 == 0:
                    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
                    seconds = time.monotonic() - start
                    report(f"{number + 1}: {codes}, {seconds:.0f} s, slowest {slowest[0]:.1f} s ({slowest[1]}), {largest} MiB")
        finally:
            os.chdir("/")
        return codes


def _inspected(log: Path, options: list[str]) -> int:
    """The command's exit code; its own one-line refusals are code 2."""
    out = io.StringIO()
    signal.signal(signal.SIGALRM, _too_slow)
    signal.setitimer(signal.ITIMER_REAL, SLOWEST)
    try:
        with contextlib.redirect_stdout(out):
            code = inspect([str(log), *options])
    except InputError as error:
        return 2 if str(error) else -1  # a refusal says why
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    text = out.getvalue()
    assert all(c.isprintable() or c == "\n" for c in text), "what a terminal would obey is in the text"
    assert len(text) < 2**24, "the text is endless"
    return code


def _too_slow(*_) -> None:
    raise TimeoutError(f"took more than {SLOWEST} s")


def _tree(folder: Path) -> set[Path]:
    return set(folder.rglob("*"))


def _address_space() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--logs", type=Path, nargs="*", default=[])
    options = parser.parse_args()
    np.seterr(all="ignore")
    print(fuzz(options.first, options.count, lambda line: print(line, flush=True), options.logs), file=sys.stderr)
