"""The goals of speed in one table: `python -m tests.benchmarks.all`, in five minutes on an idle machine.

Every row is a ratio that one of the benchmarks marked `goal` measures: its median, what it may be at most, its range, and the
machine's noise meanwhile (half the middle spread of the reference's own times). Exit code 1 if a goal is missed.
"""

import sys
from pathlib import Path

import pytest


class Rows:
    """The rows of the table, collected by pytest's hooks."""

    def __init__(self) -> None:
        self.rows: list[str] = []

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_teardown(self, item):
        """Keeps what a benchmark has measured."""
        benchmark = getattr(item, "funcargs", {}).get("benchmark")
        if benchmark is not None and "ratio" in benchmark.extra_info:
            of = benchmark.extra_info
            verdict = "" if of["ratio"] <= of["claim"] else "  missed"
            spread = f"{of['low']:.2f} to {of['high']:.2f}"
            name = item.name.removeprefix("test_")
            self.rows.append(f"{name:<70} {of['ratio']:6.2f} {of['claim']:6g}  {spread:<14} {100 * of['noise']:4.0f} %{verdict}")
        return (yield)


def main() -> int:
    """Runs the goals and prints the table; returns the exit code."""
    table, folder = Rows(), Path(__file__).parent
    files = [str(folder / name) for name in ("bench_commands.py", "bench_identify.py", "bench_speed.py")]
    quiet = ["-q", "--tb=no", "--no-summary", "--benchmark-disable-gc", "--benchmark-columns=median", "-p", "no:cacheprovider"]
    code = pytest.main([*quiet, "-m", "goal", *files], plugins=[table])
    print(f"\n{'':<70} {'ratio':>6} {'goal':>6}  {'range':<14} {'noise':>6}", *table.rows, sep="\n")
    return int(code)


if __name__ == "__main__":
    sys.exit(main())
