"""Compares the numbers of two checkouts: `python -m tests.same_numbers OLD NEW`. It is for changes that are to change no number.

Each line of `tests/support/ruler/commands.txt` runs in both checkouts with `--json`, in a folder with the files of
`tests/support/ruler/`, some cars of the tests, and the gallery's own vehicle types. These cars together have every key of a
vehicle file; `tests/house/test_ruler.py` checks this. Compared are exit codes, JSON objects, signals of logs and results of
campaigns. The new checkout also inspects the logs and verifies the campaigns of the old one.

By default numbers are equal to the last bit. With `--within`, they agree within the tolerances of `TOLERANCES`, by their place in
the object. Texts, counts and verdicts are always equal. Multipliers, residuals and errors are then not compared: they stay within
the limit next to them, and the verdicts on them stay. The old checkout runs twice with `--within`, once with other kernels of
BLAS and NumPy, whose rounding differs. A number that this moves, as gains of a design that are not unique, agrees within
`SHAKEN` times that. What is no number and moves then is listed as `shaken` and is no difference.

Keys that are new are listed and are no difference. Keys that are missing are one. A line of the file of `--allow` is a glob for
commands, and after the last space a glob for places: `sim.drive *curves.toml* .runs.*.metrics.*`. Differences there are listed
and do not fail, and entries without a difference are listed, too. Numbers of lists are parts of a place, and spaces are `_`.

Exit code 0: all the same. 1: what differs is listed, by command and place. `--only GLOB` selects commands.
"""

import argparse
import json
import math
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
# of its signal, or else to the number itself; a frequency has an absolute one, too [rad/s]. None: not compared.
TOLERANCES: tuple[tuple[float | None, float, str], ...] = (
    (
        None,
        0.0,
        r"residual|rounding|difference|\.(loss|lmi|X|error|allowed|off_by|cross_check|flat|refine_lowers\w*|\w*gap|\w*_error)\b",
    ),
    (1e-8, 1e-6, r"frequency|omega"),
    (1e-8, 0.0, r"margin|phase|angle|\bdelay|sample_period\.|fragility|pole|peak_\[Hz\]"),
    (1e-11, 0.0, r"\.signals\."),
    (1e-9, 0.0, ""),
)
SHAKEN = 100.0  # times the effect of another rounding
OTHER_ROUNDING = {
    "OPENBLAS_CORETYPE": "Nehalem",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX2 FMA3 AVX512_SKX AVX512_ICL AVX512_SPR",
}
LONG = 3  # differences of a list of numbers that are listed one by one
Difference = tuple[str, str, str]  # `differs`, `new` or `shaken`, the place, and a text


def tolerance(place: str) -> tuple[float | None, float]:
    """The relative and the absolute tolerance of a number at a place; None if it is not compared."""
    return next((relative, absolute) for relative, absolute, there in TOLERANCES if re.search(there, place))


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def largest(value: Any) -> float:
    """The largest magnitude of the numbers in an object."""
    if isinstance(value, dict | list):
        return max(map(largest, value.values() if isinstance(value, dict) else value), default=0.0)
    return abs(value) if is_number(value) else 0.0


def spread(old: Any, shaken: Any) -> float:
    """The largest difference between the numbers of two objects; infinite if they are of another form."""
    if isinstance(old, dict):
        return max((spread(one, shaken.get(key) if isinstance(shaken, dict) else None) for key, one in old.items()), default=0.0)
    if isinstance(old, list):
        again = shaken if isinstance(shaken, list) and len(shaken) == len(old) else [None] * len(old)
        return max(map(spread, old, again), default=0.0)
    if not is_number(old):
        return 0.0
    return abs(shaken - old) if is_number(shaken) else math.inf


def same(old: Any, new: Any, place: str, scale: float, noise: float) -> bool:
    """True if two leaves are the same within a tolerance. An integer is a count, which is exact."""
    if not (isinstance(old, float) and is_number(new)) or math.isnan(old) or math.isnan(new):
        return same_bits(old, new)
    relative, absolute = tolerance(place)
    return relative is None or abs(new - old) <= max(absolute + relative * max(scale, abs(old)), SHAKEN * noise)


def compare(
    old: Any, new: Any, within: bool = False, shaken: Any = ..., place: str = "", scale: float = 0.0, noise: float = 0.0
) -> Iterator[Difference]:
    """Yields what differs.

    Args:
        within: True for tolerances.
        shaken: the old object with another rounding; the old one itself by default.
        scale, noise: largest magnitude of the object's numbers, and the largest effect of another rounding on them.
    """
    shaken = old if shaken is ... else shaken
    if isinstance(old, dict) and isinstance(new, dict):
        again = shaken if isinstance(shaken, dict) else {}
        of_signal = isinstance(old.get("peak"), dict)
        peak = (largest(old["peak"]), spread(old["peak"], again.get("peak"))) if of_signal else (scale, noise)
        for key in (*old, *(new.keys() - old.keys())):
            there = f"{place}.{str(key).replace(' ', '_')}"
            if key in ELSEWHERE:
                continue
            if key not in new:
                yield "differs", there, "is missing"
            elif key not in old:
                yield "new", there, f"is {str(new[key])[:60]}"
            else:
                size = peak if key in ("peak", "rms") else (scale, noise)
                yield from compare(old[key], new[key], within, again.get(key), there, *size)
        yield from beyond_limit(old, new, within, place)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        again = shaken if isinstance(shaken, list) and len(shaken) == len(old) else [None] * len(old)
        matrix = all(is_number(one) or isinstance(one, list) for one in old) and not scale
        size = (largest(old), spread(old, again)) if matrix else (scale, noise)
        found = [one for i in range(len(old)) for one in compare(old[i], new[i], within, again[i], f"{place}.{i}", *size)]
        if len(found) > LONG and all(map(is_number, old)):
            worst = max(range(len(old)), key=lambda i: abs(new[i] - old[i]) if is_number(new[i]) else math.inf)
            text = f"{len(found)} of {len(old)} entries, most at {worst}: {old[worst]} is now {new[worst]}"
            found = [("differs", f"{place}.*", text)]
        yield from found
    elif isinstance(old, list) and isinstance(new, list):
        rounding = within and not (isinstance(shaken, list) and len(shaken) == len(old))
        yield "shaken" if rounding else "differs", place, f"{len(old)} entries are now {len(new)}"
    elif not (same(old, new, place, scale, max(noise, spread(old, shaken))) if within else same_bits(old, new)):
        rounding = within and not isinstance(old, float) and shaken != old
        yield "shaken" if rounding else "differs", place, f"{str(old)[:60]} is now {str(new)[:60]}"


def same_bits(old: Any, new: Any) -> bool:
    """True if two leaves are the same to the last bit."""
    return old == new or (old != old and new != new)


def beyond_limit(old: dict[str, Any], new: dict[str, Any], within: bool, place: str) -> Iterator[Difference]:
    """Yields numbers that are not compared and are now beyond the limit next to them."""
    limits = [one.get("allowed") for one in (old, new)]
    if not within or not all(map(is_number, limits)):
        return
    for key in old.keys() & new.keys() - {"allowed"}:
        numbers = is_number(old[key]) and is_number(new[key]) and tolerance(f"{place}.{key}")[0] is None
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


def signals(messages: Sequence[tuple[int, bytes, Any]]) -> dict[str, list[Any]]:
    """The numbers and texts of messages, by field."""
    from mcap_protobuf.decoder import DecoderFactory

    decode = DecoderFactory().decoder_for("protobuf", messages[0][2])
    assert decode is not None
    every = [decode(data) for _, data, _ in messages]
    names = [one.name for one in every[0].DESCRIPTOR.fields]
    return {
        name: [getattr(one, name) for one in every] for name in names if isinstance(getattr(every[0], name), int | float | str)
    }


def compare_logs(old: Path, new: Path, shaken: Path, within: bool) -> Iterator[Difference]:
    """Yields what differs between the signals of two logs."""
    a, b = channels(old), channels(new)
    place, again = f".log.{log_name(old)}", {}
    for topic in a:
        there = f"{place}.{topic.removeprefix('/')}"
        if topic not in b:
            yield "differs", there, "is missing"
        elif [one[:2] for one in a[topic]] != [one[:2] for one in b[topic]] and not (within and topic.endswith("/difference")):
            again = again or (channels(shaken) if shaken != old else a)
            if [one[0] for one in a[topic]] != [one[0] for one in b[topic]]:
                yield "differs", there, "has other times"
            else:
                of_old, of_new, of_shaken = ({"signals": signals(one[topic])} for one in (a, b, again))
                other = [] if within else [("differs", there, "is another picture")]
                yield from compare(of_old, of_new, within, of_shaken, there) if of_old["signals"] else other


def compare_results(old: Path, new: Path, shaken: Path, within: bool) -> Iterator[Difference]:
    """Yields what differs between the tables of two campaigns."""
    from pyarrow import parquet

    of_old, of_new, of_shaken = (parquet.read_table(path / "results.parquet").to_pydict() for path in (old, new, shaken))
    yield from compare(of_old, of_new, within, of_shaken, f".{old.name}")


@dataclass
class Answer:
    """What the commands of a line gave in one checkout."""

    folder: Path
    objects: list[Any] = field(default_factory=list)
    seconds: float = 0.0

    def logs(self) -> dict[str, Path]:
        """Its logs by name, without time."""
        return {log_name(path): path for path in sorted(self.folder.glob("*logs/*.mcap"))}

    def written(self) -> dict[str, str]:
        """Code and vehicle files that it wrote, by name."""
        paths = [path for path in self.folder.rglob("*") if path.suffix in (".c", ".h", ".toml")]
        return {path.relative_to(self.folder).as_posix(): path.read_text() for path in sorted(paths)}

    def campaigns(self) -> list[Path]:
        """Folders of its campaigns."""
        return sorted(path.parent for path in self.folder.glob("*/results.parquet"))


def said(checkout: Path, folder: Path, command: Sequence[str], shaken: bool = False) -> tuple[int, Any]:
    """Exit code and JSON object of a command; with another rounding if `shaken`."""
    arguments = [sys.executable, "-m", *command, "--json"]
    environment = os.environ | {"PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}
    environment |= OTHER_ROUNDING if shaken else {}
    done = subprocess.run(arguments, cwd=folder, env=environment, capture_output=True, text=True)
    texts = (re.sub(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC", "TIME", text) for text in (done.stdout, done.stderr))
    out, err = (text.replace(str(folder), ".").replace(str(checkout), ".") for text in texts)
    return done.returncode, json.loads(out) if out else err


def filled(folder: Path) -> Path:
    """Returns a new folder with the files of all commands."""
    shutil.copytree(RULER, folder)
    own = [path for name in TYPES for path in (HERE.parent / "models/gallery" / name).iterdir() if path.is_file()]
    for file in (*CARS, *own):
        shutil.copy(file, folder / (f"{file.parent.name}.toml" if file.name == "car.toml" else file.name))
    return folder


def answer(checkout: Path, folder: Path, line: str, shaken: bool = False) -> Answer:
    """Runs the commands of a line, one after the other, in a folder of its own."""
    filled(folder)
    start = time.monotonic()
    objects = [said(checkout, folder, shlex.split(command), shaken) for command in line.split(" ; ")]
    return Answer(folder, objects, time.monotonic() - start)


def proofs(new: Path, old: "Future[Answer]") -> list[str]:
    """What the new checkout does not prove of the logs and campaigns of the old one."""
    made, failed = old.result(), []
    logs, campaigns = list(made.logs().values()), made.campaigns()
    types = ["--kinds", str(made.folder)] if any(made.folder.glob("*.xml")) else []
    commands = [["sim.inspect", *map(str, logs), *types]] if logs else []
    commands += [["sim.campaign", "--verify", str(one), "--runs", "2"] for one in campaigns]
    for command in commands:
        code, found = said(new, made.folder, command)
        if code:
            failed.append(f"{command[0]} of the old one's files ends with {code}: {str(found)[:400]}")
    return failed


def every_difference(old: Answer, new: Answer, shaken: Answer, within: bool) -> Iterator[Difference]:
    """Yields what differs between the answers of both checkouts."""
    for i, (of_old, of_new, of_shaken) in enumerate(zip(old.objects, new.objects, shaken.objects, strict=True)):
        place = f".then{i}" if i else ""
        if of_old[0] == BAD_INPUT:
            yield "differs", f"{place}.code", f"the old one refuses it: {str(of_old[1])[:300]}"
        elif of_old[0] != of_new[0]:
            rounding = within and of_old[0] != of_shaken[0]
            text = f"{of_old[0]} is now {of_new[0]}: {str(of_new[1])[:300]}"
            yield "shaken" if rounding else "differs", f"{place}.code", text
        else:
            yield from compare(of_old[1], of_new[1], within, of_shaken[1], place)
    logs = [one.logs() for one in (old, new, shaken)]
    for name, path in logs[0].items():
        if name in logs[1]:
            yield from compare_logs(path, logs[1][name], logs[2].get(name, path), within)
        else:
            yield "differs", f".log.{name}", "is missing"
    if not within:
        yield from compare({".file": old.written()}, {".file": new.written()})
    for one in old.campaigns():
        if (new.folder / one.name / "results.parquet").exists():
            yield from compare_results(one, new.folder / one.name, shaken.folder / one.name, within)


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
    allowed = {tuple(line.rsplit(None, 1)): 0 for line in lines_of(given.allow)} if given.allow else {}
    unchanged = 0
    with tempfile.TemporaryDirectory() as temporary, ThreadPoolExecutor(2) as pool:
        jobs = []
        for i, line in enumerate(lines):
            place = Path(temporary, str(i))
            first = pool.submit(answer, old, place / "old", line)
            again = pool.submit(answer, old, place / "shaken", line, True) if given.within else first
            second = pool.submit(answer, new, place / "new", line)
            jobs.append((line, first, again, second, pool.submit(proofs, new, first)))
        for line, first, again, second, proof in jobs:
            reference = first.result()
            found: dict[str, dict[str, str]] = {kind: {} for kind in ("differs", "shaken", "allowed", "new")}
            for kind, place, text in every_difference(reference, second.result(), again.result(), given.within):
                there = [one for one in allowed if kind == "differs" and all(map(fnmatchcase, (line, place), one))]
                for one in there:
                    allowed[one] += 1
                found["allowed" if there else kind][place] = text
            found["differs"] |= dict.fromkeys(proof.result(), "")
            differs = bool(found["differs"])
            unchanged += not differs
            logs, campaigns = len(reference.logs()), len(reference.campaigns())
            proved = f"  ({logs} log)" * bool(logs) + f"  ({campaigns} campaign)" * bool(campaigns)
            print(f"{'DIFFERS' if differs else 'same':8}{reference.seconds:5.1f} s  {line}{proved}", flush=True)
            for what, places in found.items():
                texts = [f"{place}: {text}" for place, text in places.items()]
                rest = [f"and {len(texts) - LISTED} more"] * (len(texts) > LISTED)
                for text in texts[:LISTED] + rest:
                    print(f"    {'' if what == 'differs' else what + ' '}{text}", flush=True)
            shutil.rmtree(reference.folder.parent)
    print(*(f"UNUSED  {' '.join(one)}\n" for one, count in allowed.items() if not count), sep="", end="")
    print(f"{unchanged} of {len(lines)} lines are the same {'within their tolerances' if given.within else 'to the last bit'}")
    return int(unchanged < len(lines))


if __name__ == "__main__":
    sys.exit(main())
