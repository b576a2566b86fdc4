"""Compares the numbers of two checkouts: `python -m tests.same_numbers OLD NEW`. It is for changes that are to change no number.

Each line of `tests/support/ruler/commands.txt` runs in both checkouts with `--json`, in a folder with the files of
`tests/support/ruler/`, some cars of the tests, and the gallery's own vehicle types. These cars together have every key of a
vehicle file; `tests/house/test_ruler.py` checks this. Compared are exit codes, JSON objects, signals of logs and results of
campaigns. The new checkout also inspects the logs and verifies the campaigns of the old one.

By default numbers are equal to the last bit. With `--within`, they agree within the tolerances of `TOLERANCES`, by their place in
the object. Texts and verdicts are always equal. Residuals, solver slacks and errors are then not compared: they stay within the
limit next to them, and the verdicts on them stay.

Keys that are new are listed and are no difference. Keys that are missing are one. A line of the file of `--allow` is a glob for
commands, and after the last space a glob for places: `sim.drive *curves.toml* .runs.*.metrics.*`. Differences there are listed
and do not fail, and entries without a difference are listed, too. Numbers of lists are parts of a place, and spaces are `_`.

Exit code 0: all the same. 1: what differs is listed, by command and place. `--only GLOB` selects commands.
"""

import argparse
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
RULER = HERE / "support" / "ruler"
CARS = [HERE / "support/active_suspension.toml", *sorted((HERE / "benchmarks/cars").glob("*.toml"))]
TYPES = ("one_mass", "simulink_half_car")  # own vehicle types of the gallery
BAD_INPUT = 2
ELSEWHERE = {"logs", "seconds", "report", "results", "folder", "source", "saved", "csv", "picture", "figures", "versions"}
LISTED = 8  # places per command

# The first expression found in a place decides. A tolerance is relative to the largest entry of a number's matrix, or to the peak
# of its signal, or else to the number itself. None: not compared.
TOLERANCES: tuple[tuple[float | None, str], ...] = (
    (None, r"residual|rounding|loss\b|slack|gap\b|multiplier|\.lmi\.|\.error\b|error_to|_error\b|difference|\.allowed\b|off_by"),
    (1e-8, r"margin|frequency|omega|phase|angle|\bdelay|sample_period\.|fragility|robustness|pole|peak_\[Hz\]"),
    (1e-11, r"\.signals\."),
    (1e-9, ""),
)


@dataclass
class Found:
    """What differs between two objects: texts by place."""

    differs: dict[str, str] = field(default_factory=dict)
    new: dict[str, str] = field(default_factory=dict)
    allowed: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Allowed:
    """Entry of the list of allowed changes."""

    command: str
    place: str

    def covers(self, command: str, place: str) -> bool:
        return fnmatchcase(command, self.command) and fnmatchcase(place, self.place)


def tolerance(place: str) -> float | None:
    """The relative tolerance of a number at a place; None if it is not compared."""
    return next(one for one, there in TOLERANCES if re.search(there, place))


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def largest(value: Any) -> float:
    """The largest magnitude of the numbers in an object."""
    if isinstance(value, dict | list):
        return max(map(largest, value.values() if isinstance(value, dict) else value), default=0.0)
    return abs(value) if is_number(value) else 0.0


def same(old: Any, new: Any, place: str, within: bool, scale: float) -> bool:
    """True if two leaves are the same. An integer is a count, which is exact."""
    if not (within and isinstance(old, float) and is_number(new)) or old != old:
        return old == new or (old != old and new != new)
    allowed = tolerance(place)
    return allowed is None or abs(new - old) <= allowed * max(scale, abs(old))


def compare(old: Any, new: Any, within: bool = False, place: str = "", scale: float = 0.0) -> Iterator[tuple[str, str, str]]:
    """Yields what differs: `differs` or `new`, the place, and a text."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in (*old, *(new.keys() - old.keys())):
            there = f"{place}.{str(key).replace(' ', '_')}"
            if key in ELSEWHERE:
                continue
            if key not in new:
                yield "differs", there, "is missing"
            elif key not in old:
                yield "new", there, f"is {str(new[key])[:60]}"
            else:
                peak = largest(old["peak"]) if isinstance(old.get("peak"), dict) and key in ("peak", "rms") else scale
                yield from compare(old[key], new[key], within, there, peak)
        yield from beyond_limit(old, new, within, place)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        matrix = scale or (largest(old) if all(is_number(one) or isinstance(one, list) for one in old) else 0.0)
        for i, pair in enumerate(zip(old, new, strict=True)):
            yield from compare(*pair, within, f"{place}.{i}", matrix)
    elif isinstance(old, list) and isinstance(new, list):
        yield "differs", place, f"{len(old)} entries are now {len(new)}"
    elif not same(old, new, place, within, scale):
        yield "differs", place, f"{str(old)[:60]} is now {str(new)[:60]}"


def beyond_limit(old: dict[str, Any], new: dict[str, Any], within: bool, place: str) -> Iterator[tuple[str, str, str]]:
    """Yields numbers that are not compared and are now beyond the limit next to them."""
    limits = [one.get("allowed") for one in (old, new)]
    if not within or not all(map(is_number, limits)):
        return
    for key in old.keys() & new.keys() - {"allowed"}:
        numbers = is_number(old[key]) and is_number(new[key]) and tolerance(f"{place}.{key}") is None
        if numbers and abs(old[key]) <= limits[0] and abs(new[key]) > limits[1]:
            yield "differs", f"{place}.{key}", f"{new[key]:g} is beyond its limit {limits[1]:g}"


def log_name(path: Path) -> str:
    """The name of a log without its time."""
    return re.sub(r"-\d{8}T\d{6}Z", "", path.name)


def channels(path: Path) -> dict[str, list[tuple[int, bytes, Any]]]:
    """The messages of a log by topic: time, content, and schema."""
    from mcap.reader import make_reader

    found: dict[str, list[tuple[int, bytes, Any]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time, message.data, schema))
    return found


def signals(messages: Sequence[tuple[int, bytes, Any]]) -> dict[str, list[float]]:
    """The numbers of messages, by field."""
    from mcap_protobuf.decoder import DecoderFactory

    decode = DecoderFactory().decoder_for("protobuf", messages[0][2])
    assert decode is not None
    every = [decode(data) for _, data, _ in messages]
    names = [one.name for one in every[0].DESCRIPTOR.fields]
    return {name: [getattr(one, name) for one in every] for name in names if is_number(getattr(every[0], name))}


def compare_logs(old: Path, new: Path, within: bool) -> Iterator[tuple[str, str, str]]:
    """Yields what differs between the signals of two logs."""
    (a, b), place = map(channels, (old, new)), f".log.{log_name(old)}"
    for topic in a:
        there = f"{place}.{topic.removeprefix('/')}"
        if topic not in b:
            yield "differs", there, "is missing"
        elif [one[:2] for one in a[topic]] != [one[:2] for one in b[topic]] and not (within and topic == "/difference"):
            if [one[0] for one in a[topic]] != [one[0] for one in b[topic]]:
                yield "differs", there, "has other times"
            else:
                both = [{"signals": signals(one[topic])} for one in (a, b)]
                yield from compare(*both, within, there) if both[0]["signals"] else [("differs", there, "has another content")]


def compare_results(old: Path, new: Path, within: bool) -> Iterator[tuple[str, str, str]]:
    """Yields what differs between the tables of two campaigns."""
    from pyarrow import parquet

    tables = [parquet.read_table(path / "results.parquet").to_pydict() for path in (old, new)]
    yield from compare(*tables, within, f".{old.name}")


@dataclass
class Answer:
    """What the commands of a line gave in one checkout."""

    folder: Path
    objects: list[Any] = field(default_factory=list)
    seconds: float = 0.0

    def logs(self) -> dict[str, Path]:
        """Its logs by name, without time."""
        return {log_name(path): path for path in sorted(self.folder.glob("*logs/*.mcap"))}

    def campaigns(self) -> list[Path]:
        """Folders of its campaigns."""
        return sorted(path.parent for path in self.folder.glob("*/results.parquet"))


def said(checkout: Path, folder: Path, command: Sequence[str]) -> tuple[int, Any]:
    """Exit code and JSON object of a command."""
    arguments = [sys.executable, "-m", *command, "--json"]
    environment = os.environ | {"PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}
    done = subprocess.run(arguments, cwd=folder, env=environment, capture_output=True, text=True)
    out, err = (text.replace(str(folder), ".").replace(str(checkout), ".") for text in (done.stdout, done.stderr))
    return done.returncode, json.loads(out) if out else err


def filled(folder: Path) -> Path:
    """Returns a new folder with the files of all commands."""
    shutil.copytree(RULER, folder)
    own = [path for name in TYPES for path in (HERE.parent / "models/gallery" / name).iterdir() if path.is_file()]
    for file in (*CARS, *own):
        shutil.copy(file, folder / (f"{file.parent.name}.toml" if file.name == "car.toml" else file.name))
    return folder


def answer(checkout: Path, folder: Path, line: str) -> Answer:
    """Runs the commands of a line, one after the other, in a folder of its own."""
    filled(folder)
    start = time.monotonic()
    objects = [said(checkout, folder, shlex.split(command)) for command in line.split(" ; ")]
    return Answer(folder, objects, time.monotonic() - start)


def proofs(new: Path, old: "Future[Answer]", folder: Path) -> list[str]:
    """What the new checkout does not prove of the logs and campaigns of the old one."""
    made, failed = old.result(), []
    logs, campaigns = list(made.logs().values()), made.campaigns()
    types = ["--kinds", str(made.folder)] if any(made.folder.glob("*.xml")) else []
    commands = [["sim.inspect", *map(str, logs), *types]] if logs else []
    commands += [["sim.campaign", "--verify", str(one), "--runs", "2"] for one in campaigns]
    for command in commands:
        code, found = said(new, folder, command)
        if code:
            failed.append(f"{command[0]} of the old one's files ends with {code}: {str(found)[:400]}")
    return failed


def both(old: Path, new: Path, line: str, folder: Path, pool: ThreadPoolExecutor) -> tuple["Future[Answer]", "Future[Any]"]:
    """Starts a line in both checkouts."""
    first = pool.submit(answer, old, folder / "old", line)

    def second() -> tuple[Answer, list[str]]:
        made = answer(new, folder / "new", line)
        return made, proofs(new, first, folder / "new")

    return first, pool.submit(second)


def every_difference(old: Answer, new: Answer, within: bool) -> Iterator[tuple[str, str, str]]:
    """Yields what differs between the answers of both checkouts."""
    for i, pair in enumerate(zip(old.objects, new.objects, strict=True)):
        (code, said_by_old), (code_of_new, said_by_new) = pair
        place = f".then{i}" if i else ""
        if code == BAD_INPUT:
            yield "differs", f"{place}.code", f"the old one refuses it: {str(said_by_old)[:300]}"
        elif code != code_of_new:
            yield "differs", f"{place}.code", f"{code} is now {code_of_new}: {str(said_by_new)[:300]}"
        else:
            yield from compare(said_by_old, said_by_new, within, place)
    a, b = old.logs(), new.logs()
    for name in a:
        yield from compare_logs(a[name], b[name], within) if name in b else [("differs", f".log.{name}", "is missing")]
    for one in old.campaigns():
        if (new.folder / one.name).exists():
            yield from compare_results(one, new.folder / one.name, within)


def lines_of(path: Path) -> list[str]:
    """Lines of a file without comments."""
    lines = (line.strip() for line in path.read_text().splitlines())
    return [line for line in lines if line and not line.startswith("#")]


def main(arguments: Sequence[str] | None = None) -> int:
    """Compares; returns the exit code."""
    parser = argparse.ArgumentParser("tests.same_numbers", description="Compare the numbers of two checkouts.")
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    way = parser.add_mutually_exclusive_group()
    way.add_argument("--exact", action="store_true", help="equal to the last bit (default)")
    way.add_argument("--within", action="store_true", help="equal within the tolerance of each kind of number")
    parser.add_argument("--allow", metavar="FILE", type=Path, help="list of allowed changes")
    parser.add_argument("--only", metavar="GLOB", default="*", help="commands to run")
    given = parser.parse_args(arguments)
    old, new = given.old.resolve(), given.new.resolve()
    lines = [line for line in lines_of(RULER / "commands.txt") if fnmatchcase(line, given.only)]
    allowed = {Allowed(*line.rsplit(None, 1)): 0 for line in lines_of(given.allow)} if given.allow else {}
    failed = unchanged = 0
    with tempfile.TemporaryDirectory() as temporary, ThreadPoolExecutor(2) as pool:
        jobs = [both(old, new, line, Path(temporary, str(i)), pool) for i, line in enumerate(lines)]
        for line, (first, second) in zip(lines, jobs, strict=True):
            (made, unproved), reference = second.result(), first.result()
            found = Found()
            for kind, place, text in every_difference(reference, made, given.within):
                there = [one for one in allowed if one.covers(line, place)]
                for one in there:
                    allowed[one] += kind == "differs"
                (found.new if kind == "new" else found.allowed if there else found.differs)[place] = text
            found.differs |= dict.fromkeys(unproved, "")
            differs = bool(found.differs)
            failed, unchanged = failed + differs, unchanged + (not differs)
            logs, campaigns = len(reference.logs()), len(reference.campaigns())
            proved = f"  ({logs} log)" * bool(logs) + f"  ({campaigns} campaign)" * bool(campaigns)
            print(f"{'DIFFERS' if differs else 'same':8}{reference.seconds:5.1f} s  {line}{proved}", flush=True)
            for what in ("differs", "allowed", "new"):
                texts = [f"{place}: {text}" for place, text in getattr(found, what).items()]
                rest = [f"and {len(texts) - LISTED} more"] * (len(texts) > LISTED)
                for text in texts[:LISTED] + rest:
                    print(f"    {'' if what == 'differs' else what + ' '}{text}", flush=True)
            shutil.rmtree(reference.folder.parent)
    unused = [f"{one.command} {one.place}" for one, count in allowed.items() if not count]
    for text in unused:
        print(f"UNUSED  {text}")
    print(f"{unchanged} of {len(lines)} lines are the same {'within their tolerances' if given.within else 'to the last bit'}")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
