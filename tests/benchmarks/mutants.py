"""Mutation testing: are wrong lines of the product seen by the suite? It needs `pip install -e '.[test,mutants]'`, and a while.

    python -m tests.benchmarks.mutants map --out map.json               # which tests run which lines; the suite, under coverage
    python -m tests.benchmarks.mutants try --map map.json --count 300 --seed 1 --out mutants.json

A mutant is a copy of the project with one line changed: a comparison, an operator, a sign, a number, a condition, `min` for
`max`. The tests that run its line are run in a copy of the tree, the quickest first, until one fails; then it is killed. What
survives is printed with its old and new line: it says the same in other words, or no test would see that mistake.

`--suite OTHER` takes the tests of another checkout, `--only mutants.json` tries what survived there: so one suite is held
against another, by the mutants that one of them lets live.
"""

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import Queue

from tests.benchmarks.mutating import Mutant, all_mutants

ROOT = Path(__file__).parents[2]
FLOORS = ("models", "synth", "sim")
MOST_TESTS_A_LINE = 400  # of the quickest; a line that all tests run needs no more
FIRST = 8.0  # s: the quickest tests up to here are one process, which most mutants do not survive


@dataclass(frozen=True)
class Verdict:
    """The end of one mutant.

    Attributes:
        mutant: what was changed.
        killed: by which test, or by "no import" or "time"; "" if it lives.
        tests: how many tests ran its line.
        seconds: how long it was tried.
    """

    mutant: Mutant
    killed: str
    tests: int
    seconds: float


def mapped(suite: Path, arguments: list[str]) -> dict:
    """Runs a suite under coverage, and returns `tests`, each with its seconds, and `lines`: file, line, numbers of tests.

    Subprocesses count for the test that starts them. The quickest tests come first.
    """
    from coverage import CoverageData  # pyright: ignore[reportMissingImports] - an extra
    from coverage.exceptions import DataError  # pyright: ignore[reportMissingImports] - an extra

    with tempfile.TemporaryDirectory() as folder:
        watch = Path(folder, "watch")
        watch.mkdir()
        shutil.copy(Path(__file__).with_name("watching.py"), watch / "sitecustomize.py")
        environment = os.environ | {"PYTHONPATH": str(watch), "WATCHED": folder, "WATCHED_ROOT": str(suite)}
        command = [sys.executable, "-m", "pytest", "-p", "sitecustomize", "-p", "no:cacheprovider", *arguments]
        subprocess.run(command, cwd=suite, env=environment, check=False)
        times: dict[str, float] = defaultdict(float)
        for line in (text for file in Path(folder).glob("seconds.*") for text in file.read_text().splitlines()):
            test, took = line.rsplit(" ", 1)
            times[test] += float(took)
        tests = sorted(times, key=lambda test: times[test])
        numbers = {test: number for number, test in enumerate(tests)}
        lines: dict[str, dict[int, set[int]]] = defaultdict(lambda: defaultdict(set))
        for file in Path(folder).glob("lines.*"):
            data = CoverageData(str(file))
            try:
                data.read()
            except DataError:  # of a process that a test has killed as it wrote
                continue
            for path in data.measured_files():
                for line, contexts in data.contexts_by_lineno(path).items():
                    name = Path(path).relative_to(suite).as_posix()
                    lines[name][line].update(numbers[test] for test in contexts if test in numbers)
    return {
        "tests": [[test, round(times[test], 3)] for test in tests],
        "lines": {
            file: {line: sorted(some)[:MOST_TESTS_A_LINE] for line, some in of.items() if some} for file, of in lines.items()
        },
    }


def drawn(count: int, seed: int) -> list[Mutant]:
    """Returns mutants drawn at random, as many of a folder as the square root of its lines asks for, at least one of each."""
    rng = random.Random(seed)
    folders: dict[Path, list[Path]] = defaultdict(list)
    for path in sorted(path for floor in FLOORS for path in (ROOT / floor).rglob("*.py")):
        folders[path.parent].append(path)
    weights = {folder: sum(len(path.read_bytes()) for path in paths) ** 0.5 for folder, paths in folders.items()}
    some = []
    for folder, paths in folders.items():
        there = [mutant for path in paths for mutant in all_mutants(path, ROOT)]
        wanted = max(1, round(count * weights[folder] / sum(weights.values())))
        some += rng.sample(there, min(wanted, len(there)))
    return rng.sample(some, min(count, len(some)))


def tests_of(mutant: Mutant, known: dict) -> list[int]:
    """Returns the tests that run a mutant's line, or the nearest line above it within its statement.

    A line outside of functions is run by the test that imports its file, so there the tests of the whole file count.
    """
    lines = known["lines"].get(mutant.file, {})
    tree = ast.parse((ROOT / mutant.file).read_text(encoding="utf-8"))
    functions = (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))
    if not any(node.body[0].lineno <= mutant.line <= (node.end_lineno or 0) for node in functions):
        return sorted({test for some in lines.values() for test in some})[:MOST_TESTS_A_LINE]
    for line in range(mutant.line, mutant.first - 1, -1):
        if str(line) in lines:
            return with_neighbours(lines[str(line)], known)
    return []


def with_neighbours(tests: list[int], known: dict) -> list[int]:
    """Returns tests and behind them the others of their files: what a fixture runs counts for the first that asks for it."""
    names = [test for test, _ in known["tests"]]
    files = {names[number].partition("::")[0] for number in tests}
    others = (number for number, name in enumerate(names) if name.partition("::")[0] in files)
    return list(dict.fromkeys([*tests, *others]))[:MOST_TESTS_A_LINE]


def tried(mutant: Mutant, tree: Path, known: dict, limit: float) -> Verdict:
    """Runs the tests of a mutant in a copy of the project until one fails."""
    path, start, tests = tree / mutant.file, time.monotonic(), tests_of(mutant, known)
    whole = path.read_text(encoding="utf-8")
    path.write_text(mutant.applied(whole), encoding="utf-8")
    killed, spent, portion, portions = "", 0.0, [], []
    for number in tests:
        test, seconds = known["tests"][number]
        if spent + seconds > limit:
            break
        portion.append(test)
        spent += seconds
        if spent > FIRST and not portions:
            portions, portion = [portion], []
    try:
        for some in [*portions, portion]:
            killed = killed or failing(some, tree, 20 + 4 * spent) if some else killed
    finally:
        path.write_text(whole, encoding="utf-8")
    return Verdict(mutant, killed, len(tests), round(time.monotonic() - start, 1))


def failing(tests: list[str], tree: Path, limit: float) -> str:
    """Returns the first of the tests that fails, "time" if they do not end, "no import" if they cannot begin, "" if all pass."""
    options = ["-x", "-q", "-m", "", "--tb=no", "-p", "no:cacheprovider", "-p", "no:benchmark", "-rfE"]
    command = [sys.executable, "-m", "pytest", *options, *tests]
    environment = os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    process = subprocess.Popen(
        command, cwd=tree, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, start_new_session=True
    )
    try:
        said, _ = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, 9)
        process.communicate()
        return "time"
    failed = [line.split(" ")[1] for line in said.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return failed[0] if failed else "" if process.returncode == 0 else "no import"


def main() -> int:
    """Reads the line, maps or tries; returns the exit code: 1 if mutants live."""
    about = "Tries one-line mutants of the product against the suite."
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.mutants", description=about)
    parser.add_argument("step", choices=["map", "try"])
    parser.add_argument("--suite", type=Path, default=ROOT, help="checkout whose tests run (default: this one)")
    parser.add_argument("--out", type=Path, required=True, help="file for the map, or the verdicts")
    parser.add_argument("--map", type=Path, help="try: the map to choose tests by")
    parser.add_argument("--count", type=int, default=300, help="try: mutants (default: 300)")
    parser.add_argument("--seed", type=int, default=1, help="try: of the draw (default: 1)")
    parser.add_argument("--only", type=Path, help="try: those that live in this file of verdicts")
    parser.add_argument("--limit", type=float, default=120.0, help="try: seconds of tests for one mutant (default: 120)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: one a core)")
    options, others = parser.parse_known_args()
    if options.step == "map":
        options.out.write_text(json.dumps(mapped(options.suite.resolve(), ["-n", str(options.workers), *others])))
        return 0
    known = json.loads(options.map.read_text())
    if options.only:
        mutants = [Mutant(**row["mutant"]) for row in json.loads(options.only.read_text()) if not row["killed"]]
    else:
        mutants = drawn(options.count, options.seed)
    verdicts: list[Verdict] = []
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(options.workers) as pool:
        trees: Queue[Path] = Queue()
        for number in range(options.workers):
            trees.put(copied(Path(folder, str(number)), options.suite.resolve()))

        def turn(mutant: Mutant) -> None:
            tree = trees.get()
            verdict = tried(mutant, tree, known, options.limit)
            trees.put(tree)
            verdicts.append(verdict)
            state = f"killed by {verdict.killed}" if verdict.killed else f"LIVES ({verdict.tests} tests run its line)"
            print(f"{len(verdicts)}/{len(mutants)} {mutant.place}: {state}, {verdict.seconds:.0f} s", flush=True)
            if not verdict.killed:
                print(f"    - {mutant.old.strip()}\n    + {mutant.new.strip()}", flush=True)
            options.out.write_text(json.dumps([asdict(one) for one in verdicts], indent=1))

        list(pool.map(turn, mutants))
    living = [verdict for verdict in verdicts if not verdict.killed]
    print(f"{len(verdicts) - len(living)} of {len(verdicts)} killed")
    return 1 if living else 0


def copied(tree: Path, suite: Path) -> Path:
    """Returns a copy of this project with the tests of a suite."""
    ignored = shutil.ignore_patterns(".venv", ".git", "__pycache__", "logs", ".*_cache")
    shutil.copytree(ROOT, tree, ignore=ignored)
    (tree / "logs").mkdir()
    shutil.copy(ROOT / "logs/README.md", tree / "logs")
    if suite != ROOT:
        shutil.rmtree(tree / "tests")
        shutil.copytree(suite / "tests", tree / "tests", ignore=ignored)
    return tree


if __name__ == "__main__":
    sys.exit(main())
