"""Inputs made to break something: every command, every option, every file that is read, damaged in every way.

    python -m tests.benchmarks.hostile_inputs --count 1000

A bad one must end with exit code 2 and one line on stderr, leave nothing behind, and take neither 10 s nor 1.2 GB; one that
happens to be legal must run. Every case follows from its number: `--first N --count 1` repeats one, and shows it. Each runs in a
process of its own, forked from one that has imported everything; so this needs a POSIX system.
"""

import argparse
import contextlib
import io
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from models.common.command import run_command
from models.kinds.kind import HERE
from tests.commands import main_of
from tests.damaged_kinds import damages
from tests.hostile import hostile
from tests.pages import hopper
from tests.rewriting import contents

SLOWEST, LARGEST = 10.0, 1.2e9  # s, bytes of a case
COMMANDS = {
    "sim.bump": ["--controller", "I_printed", "--duration", "0.1", "--no-logs"],
    "sim.drive": ["--controller", "I_printed", "--duration", "0.2", "--no-logs"],
    "sim.sweep": ["--controller", "passive", "--timestep", "0.004"],
    "sim.envelope": ["--controller", "passive", "--vary", "height:0.02:0.1:2", "--vary", "speed:5:20:2", "--duration", "0.2"],
    "sim.margins": ["--controller", "II_printed"],
    "sim.report": ["--controller", "passive", "--quick", "--out", "report.html"],
    "sim.campaign": ["campaign.toml", "--workers", "1"],
    "sim.inspect": ["log.mcap"],
    "synth": ["--controller", "II_printed"],
}
LONG = {"sim.margins", "sim.report"}  # a legal run of these takes longer than a case may: they get bad input that is seen at once
OPTIONS = {
    "sim.bump": ["--controller", "--vehicle", "--height", "--length", "--speed", "--track", "--duration", "--timestep", "--logs"],
    "sim.drive": ["--controller", "--vehicle", "--class", "--seed", "--road", "--speed", "--duration", "--timestep", "--logs"],
    "sim.sweep": ["--controller", "--vehicle", "--amplitude", "--speed", "--timestep", "--picture", "--logs"],
    "sim.envelope": ["--controller", "--vehicle", "--vary", "--height", "--length", "--speed", "--csv", "--picture", "--logs"],
    "sim.margins": ["--controller", "--vehicle", "--timestep", "--picture", "--logs"],
    "sim.report": ["--controller", "--vehicle", "--out", "--figures", "--timestep"],
    "sim.campaign": ["--results", "--workers", "--batch", "--verify", "--runs", "--seed"],
    "sim.inspect": ["--csv", "--kinds"],
    "synth": ["--controller", "--vehicle", "--save", "--check"],
}
VALUES = [
    "", " ", "-", "--", "nan", "inf", "-inf", "-1", "0", "1e308", "1e-308", "1e999", "9" * 400, "0x10", "1_000", "１", "x",
    "I", "all",
    "a=b", "../..", ".", "..", "/", "folder", "pipe", "loop", "nowhere/x", "read_only.csv", "a\nb", "\x1b[2J", "é" * 300,
    "x" * 5000,
    "height:0:1:3", "height:nan:1:3", "height:1:0:3", "height:0.1:0.2:1000000000", "speed:1:2", "colour:1:2:3", "bump:height=nan",
    "pothole:depth=1e400", "iso8608:class=Z", "iso8608:class=C:class=D", "road.csv", "folder.csv", "pipe.csv", "zero.csv",
    "C", "c",
    "quarter_car", "no_car", "picture.bmp", "picture.png", "/nowhere/picture.svg", "file.html",
]  # fmt: skip
TOML_VALUES = [
    "nan", "inf", "-inf", "-1", "0", "1e400", "-1e-400", "1e308", "1e-308", '"text"', "[]", "{}", "true", "[[[1]]]", "1979-05-27",
    "9" * 5000, '"' + "y" * 100_000 + '"', "[1, 2, 3]", '["x", 1]', '[["I"]]', "{ a = 1 }", "0x7fffffffffffffffffff",
    '"\\u0000"', "''",
    "[[nan]]", "[[1e308, 1e308]]", "[[1], [2, 3]]", "[" * 5000 + "]" * 5000,
]  # fmt: skip
CELLS = ["nan", "inf", "", "x", "1e400", "-1e308", "1,5", '"', "1;2", "\x00", "9" * 400, "0", "-1"]

KIND_VALUES = ["nan", "inf", "-1", "0", "1e308", "1e-308", "1e400", "9" * 300, "None", "x", "''", "(", "1 / 0", "[1]", "1j"]
HEADINGS = [
    "distance", "height", "left", "right", "time", "x", "z", "Höhe", "", "distance left", "left height", "station", "1", "nan",
    "#", '"',
]  # fmt: skip
UNITS = ["", "", " [m]", " (mm)", "_cm", "/ft", " [furlong]", " []", " [in", "[[m]]", " inches", " (left)"]

LOGS = {
    "log.mcap": ("sim.bump", "--vehicle", "car.toml"),
    "random.mcap": ("sim.drive", "--class", "B"),
    "measured.mcap": ("sim.drive", "--road", "road.csv", "--speed", "15"),
}

CAMPAIGN = """
vehicles = ["car.toml"]
controllers = ["passive", "I_printed"]
roads = ["iso8608:class=B", "bump:height=0.02", "road.csv"]
speeds = [10.0]
seeds = 2
duration = 0.1
settle = 0.0
timestep = 2e-3

[samples]
count = 2
[samples.parameters]
sprung_mass = { uniform = [0.9, 1.1], relative = true }
"""
LIMITS = """
[limits]
suspension_stroke = 0.08
stop_stiffness = 2e5
actuator_force = 3000.0
actuator_bandwidth = 60.0

[implementation]
sample_period = 0.002
delay = 1
"""


@dataclass(frozen=True)
class Case:
    """One hostile call: `prepare` damages a folder of good files, then the command runs in it."""

    number: int
    command: str
    arguments: list[str]
    what: str
    prepare: Callable[[Path], None]


def nothing(folder: Path) -> None:
    """Leaves the files as they are."""


def good_files(folder: Path) -> None:
    """One of every kind of file that a command reads, small."""
    (folder / "car.toml").write_text((HERE / "quarter_car.toml").read_text(encoding="utf-8") + LIMITS, encoding="utf-8")
    (folder / "campaign.toml").write_text(CAMPAIGN, encoding="utf-8")
    x = np.linspace(0, 5, 51)
    lines = [f"{a:.3f},{b:.5f}" for a, b in zip(x, 0.01 * np.sin(x), strict=True)]
    (folder / "road.csv").write_text("\n".join(["distance,height", *lines]) + "\n", encoding="utf-8")
    hopper(folder)
    (folder / "read_only.csv").write_text("mine\n", encoding="utf-8")
    (folder / "read_only.csv").chmod(0o444)
    (folder / "folder").mkdir()
    (folder / "folder.csv").mkdir()
    os.mkfifo(folder / "pipe")
    os.mkfifo(folder / "pipe.csv")
    (folder / "zero.csv").symlink_to("/dev/zero")
    (folder / "loop").symlink_to("loop")


def made_once(folder: Path) -> None:
    """Returns what takes a run to make: a log, a campaign's folder, a saved design."""
    quiet = contextlib.redirect_stdout(io.StringIO())
    with contextlib.chdir(folder), quiet:
        for name, (command, *options) in LOGS.items():
            main_of(command)([*options, "--controller", "I_printed", "--duration", "0.1", "--logs", "logs"])
            shutil.copy(next((folder / "logs").glob("*.mcap")), name)
            shutil.rmtree("logs")
        main_of("sim.campaign")(["campaign.toml", "--results", "results"])
        main_of("synth")(["--controller", "I", "--save", "designed.toml"])


def case(number: int) -> Case:
    """The case of that number."""
    rng = np.random.default_rng(number)
    kinds = [_option, _option, _bytes, _toml, _toml, _special, _csv, _results, _kind, _headings, _log, _log]
    return kinds[number % len(kinds)](number, rng)


def _pick(rng: np.random.Generator, some: Any) -> Any:
    some = list(some)
    return some[int(rng.integers(len(some)))]


def _option(number: int, rng: np.random.Generator) -> Case:
    """A value that an option cannot have, or perhaps can."""
    command = _pick(rng, OPTIONS)
    option, value = _pick(rng, OPTIONS[command]), _pick(rng, VALUES)
    if command in LONG and option not in ("--timestep", "--vehicle", "--out", "--figures", "--picture", "--logs"):
        option = "--vehicle"
    if command in LONG:  # with a value that cannot be right
        value = _pick(rng, ["", "nan", "-1", "folder", "pipe", "loop", "nowhere/x"])
        value = value if option not in ("--logs", "--figures") else "pipe"
    arguments = [each for each in COMMANDS[command]]
    if option in arguments and option != "--vary":
        at = arguments.index(option)
        arguments[at : at + 2] = []
    if option == "--logs" and "--no-logs" in arguments:
        arguments.remove("--no-logs")
    return Case(number, command, [*arguments, f"{option}={value}"], f"{option}={value!r:.60}", nothing)


def _reading(rng: np.random.Generator) -> tuple[str, list[str], str]:
    """A command that reads a file, its arguments, and the file."""
    return _pick(
        rng,
        [
            ("sim.bump", [*COMMANDS["sim.bump"], "--vehicle", "car.toml"], "car.toml"),
            ("synth", ["--check", "designed.toml"], "designed.toml"),
            ("synth", ["--check", "designed.toml"], "designed.toml"),
            ("sim.drive", [*COMMANDS["sim.drive"], "--road", "road.csv"], "road.csv"),
            ("sim.campaign", ["campaign.toml", "--workers", "1", "--results", "new"], "campaign.toml"),
            ("sim.campaign", ["campaign.toml", "--workers", "1", "--results", "new"], "car.toml"),
            ("sim.campaign", ["campaign.toml", "--workers", "1", "--results", "new"], "road.csv"),
            ("sim.inspect", ["log.mcap"], "log.mcap"),
        ],
    )


def _bytes(number: int, rng: np.random.Generator) -> Case:
    """A file that is cut, or some of whose bytes are others."""
    command, arguments, name = _reading(rng)
    how = _pick(rng, ["cut", "flip", "noise", "doubled", "utf-16", "latin-1", "nul", "random"])

    def damage(folder: Path) -> None:
        path = folder / name
        content = bytearray(path.read_bytes())
        at = int(rng.integers(len(content)))
        if how == "cut":
            content = content[:at]
        elif how == "flip":
            content[at] ^= 1 << int(rng.integers(8))
        elif how == "noise":
            content[at : at + 20] = rng.bytes(20)
        elif how == "doubled":
            content = content * 2
        elif how == "utf-16":
            content = bytearray(content.decode("latin-1").encode("utf-16"))
        elif how == "latin-1":
            content[at:at] = b"\xe9"
        elif how == "nul":
            content[at:at] = bytes(10)
        else:
            content = bytearray(rng.bytes(1000))
        path.write_bytes(content)

    return Case(number, command, arguments, f"{name}: {how}", damage)


def _toml(number: int, rng: np.random.Generator) -> Case:
    """A TOML file with another value, key, section or line."""
    command, arguments, name = _reading(rng)
    while not name.endswith(".toml"):
        command, arguments, name = _reading(rng)
    how, value = _pick(rng, ["value", "value", "value", "key", "gone", "twice", "section", "deep"]), _pick(rng, TOML_VALUES)

    def damage(folder: Path) -> None:
        path = folder / name
        lines = path.read_text(encoding="utf-8").split("\n")
        at = int(_pick(rng, [i for i, line in enumerate(lines) if "=" in line.split("#")[0]]))
        key = lines[at].partition("=")[0]
        if how == "value":
            lines[at] = f"{key} = {value}"
        elif how == "key":
            lines[at] = f"nonsense_{lines[at]}"
        elif how == "gone":
            del lines[at]
        elif how == "twice":
            lines.insert(at, lines[at])
        elif how == "section":
            lines.insert(at, f"[{_pick(rng, ['parameters', 'controllers', 'x.y.z', 'controllers.I', 'limits', 'samples'])}]")
        else:
            lines[at] = f"{key} = {'[' * 100_000}"
        path.write_text("\n".join(lines), encoding="utf-8")

    return Case(number, command, arguments, f"{name}: {how} {value:.40}", damage)


def _special(number: int, rng: np.random.Generator) -> Case:
    """Something in a file's place that is no plain file, or far too large a one."""
    command, arguments, name = _reading(rng)
    how = _pick(rng, ["folder", "fifo", "zero", "sparse", "memory", "loop", "dangling", "gone", "empty", "5 MiB", "unreadable"])

    def damage(folder: Path) -> None:
        path = folder / name
        content = path.read_bytes()
        path.unlink()
        if how == "folder":
            path.mkdir()
        elif how == "fifo":
            os.mkfifo(path)
        elif how == "zero":
            path.symlink_to("/dev/zero")
        elif how == "memory":
            path.symlink_to("/proc/self/mem")
        elif how == "loop":
            path.symlink_to(path.name)
        elif how == "dangling":
            path.symlink_to("nowhere")
        elif how == "sparse":
            with path.open("wb") as file:
                file.truncate(20 * 2**30)
        elif how == "empty":
            path.touch()
        elif how == "5 MiB":
            path.write_bytes(content + b"\n# " + b"x" * 5 * 2**20 + b"\n")
        elif how == "unreadable":
            path.write_bytes(rng.bytes(2**20))

    return Case(number, command, arguments, f"{name}: {how}", damage)


def _csv(number: int, rng: np.random.Generator) -> Case:
    """A road file with cells that are no numbers, lines that do not fit, or distances that are none."""
    how, cell = _pick(rng, ["cell", "cell", "line", "shuffled", "columns", "long", "settings"]), _pick(rng, CELLS)
    settings = _pick(
        rng, ["height_unit=mm", "separator=tab", "columns=1,9", "columns=2,1", "unit=x", "distance_unit=km", "columns=1,1"]
    )
    road = f"road.csv:{settings}" if how == "settings" else "road.csv"

    def damage(folder: Path) -> None:
        path = folder / "road.csv"
        lines = path.read_text(encoding="utf-8").split("\n")
        at = int(rng.integers(1, len(lines) - 1))
        if how == "cell":
            lines[at] = f"{lines[at].partition(',')[0]},{cell}" if rng.random() < 0.5 else f"{cell},0"
        elif how == "line":
            lines[at] = _pick(rng, ["", ",", ",,,", "0", "a,b,c", "1,2,3,4", "\t", '"unclosed'])
        elif how == "shuffled":
            lines[1:] = list(rng.permutation(lines[1:]))
        elif how == "columns":
            lines[1:] = [f"{line},0,0" for line in lines[1:] if line]
        elif how == "long":
            lines[at] = "0," * 10**6
        path.write_text("\n".join(lines), encoding="utf-8")

    return Case(number, "sim.drive", [*COMMANDS["sim.drive"], "--road", road], f"{road}: {how} {cell:.20}", damage)


def _kind(number: int, rng: np.random.Generator) -> Case:
    """A kind of vehicle of the user's own, one of whose files has another number or word, or a line less."""
    name, how = _pick(rng, ["hopper.py", "hopper.py", "hopper.xml"]), _pick(rng, ["damage", "number", "number", "word", "line"])
    value = _pick(rng, KIND_VALUES)

    def damage(folder: Path) -> None:
        path = folder / name
        if how == "damage":
            one = _pick(rng, damages())
            path = folder / f"hopper.{one.suffix}"
            text = path.read_text(encoding="utf-8")
            path.write_text(text.replace(one.old, one.new, 1) if one.old else f"{text}\n{one.new}", encoding="utf-8")
            return
        text = path.read_text(encoding="utf-8")
        pattern = {"number": r"(?<![\w.])-?\.?\d+\.?\d*", "word": r"[A-Za-z_]\w+", "line": r".+\n"}[how]
        found = _pick(rng, re.finditer(pattern, text))
        new = {"number": value, "word": _pick(rng, re.findall(pattern, text)), "line": ""}[how]
        path.write_text(text[: found.start()] + new + text[found.end() :], encoding="utf-8")

    arguments = ["--vehicle", "hopper.toml", "--controller", "passive", "--duration", "0.1", "--no-logs"]
    return Case(number, "sim.bump", arguments, f"{name}: {how} {value}", damage)


def _headings(number: int, rng: np.random.Generator) -> Case:
    """A road file with headings of any words and units, in any order, and options that may contradict them."""
    mark, count = _pick(rng, [",", ";", "\t", " "]), int(rng.integers(1, 6))
    cells = [f"{_pick(rng, HEADINGS)}{_pick(rng, UNITS)}" for _ in range(count)]
    setting = _pick(rng, ["", "", ":columns=1,2", ":columns=2,1,3", ":height_unit=mm", ":distance_unit=ft", ":separator=tab"])

    def damage(folder: Path) -> None:
        x = np.linspace(0, 5, 51)
        columns = [_pick(rng, [x, 0.01 * np.sin(x), 0 * x, 100 * x]) for _ in range(max(2, count))]
        rows = [mark.join(f"{value:.6g}" for value in row) for row in np.stack(columns, axis=-1).tolist()]
        (folder / "road.csv").write_text("\n".join([mark.join(cells), *rows]) + "\n", encoding="utf-8")

    return Case(number, "sim.drive", [*COMMANDS["sim.drive"], "--road", f"road.csv{setting}"], f"{cells} {setting}", damage)


def _results(number: int, rng: np.random.Generator) -> Case:
    """A campaign's folder that was changed behind its back."""
    name = _pick(rng, ["campaign.json", "results.parquet"])
    how = _pick(rng, ["cut", "flip", "gone", "folder", "fifo", "empty", "stray"])
    arguments = _pick(rng, [["campaign.toml", "--results", "results"], ["--verify", "results", "--runs", "2"]])

    def damage(folder: Path) -> None:
        path = folder / "results" / name
        content = bytearray(path.read_bytes())
        at = int(rng.integers(len(content)))
        if how == "stray":
            (folder / "results" / "part-000000000-000000001-0.parquet").write_bytes(rng.bytes(100))
            return
        path.unlink()
        if how == "cut":
            path.write_bytes(content[:at])
        elif how == "flip":
            content[at] ^= 1 << int(rng.integers(8))
            path.write_bytes(content)
        elif how == "folder":
            path.mkdir()
        elif how == "fifo":
            os.mkfifo(path)
        elif how == "empty":
            path.touch()

    return Case(number, "sim.campaign", arguments, f"results/{name}: {how}", damage)


def _log(number: int, rng: np.random.Generator) -> Case:
    """A log that no run has written: cut, flipped, or forged with right checksums."""
    name, options = _pick(rng, LOGS), _pick(rng, [[], ["--json"], ["--csv", "signals.csv"]])

    def damage(folder: Path) -> None:
        path = folder / name
        path.write_bytes(hostile(path.read_bytes(), contents(path), rng))

    return Case(number, "sim.inspect", [name, *options], f"{name}: forged", damage)


def listing(folder: Path) -> set[str]:
    """Everything in a folder, but what a finished run may leave beside it."""
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.name != ".lock"}


def run(one: Case, template: Path, show: bool = False) -> str:
    """Runs a case; what is wrong, in words, or nothing."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "case"
        shutil.copytree(template, folder, symlinks=True, copy_function=shutil.copy2, ignore=shutil.ignore_patterns("pipe*"))
        for name in ("pipe", "pipe.csv"):
            os.mkfifo(folder / name)
        one.prepare(folder)
        before = listing(folder)
        began = time.monotonic()
        child = os.fork()
        if child == 0:
            _child(one, folder, Path(place))
        status, usage = _waited(child)
        took = time.monotonic() - began
        out, err = ((Path(place) / name).read_text(encoding="utf-8", errors="replace") for name in ("out", "err"))
        code = os.waitstatus_to_exitcode(status)
        if show:
            print(f"{one.command} {one.arguments}\n{one.what}\nexit code {code}, {took:.2f} s\n{out[:2000]}\n{err[:2000]}")
        new = {name for name in listing(folder) - before if name not in ("new", "report.html")}
        return _judged(code, out, err, took, usage.ru_maxrss * 1024, new)


def _child(one: Case, folder: Path, place: Path) -> None:
    try:
        os.chdir(folder)
        for number, name in ((1, "out"), (2, "err")):
            handle = os.open(place / name, os.O_WRONLY | os.O_CREAT, 0o600)
            os.dup2(handle, number)
        sys.stdout = io.TextIOWrapper(os.fdopen(1, "wb", closefd=False), encoding="utf-8")
        sys.stderr = io.TextIOWrapper(os.fdopen(2, "wb", closefd=False), encoding="utf-8", line_buffering=True)
        sys.argv = sys.orig_argv = ["python", "-m", one.command, *one.arguments]
        run_command(lambda: main_of(one.command)(one.arguments))
    except SystemExit as error:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(error.code if isinstance(error.code, int) else 1)
    except BaseException:
        import traceback

        traceback.print_exc()
        sys.stderr.flush()
        os._exit(99)


def _waited(child: int) -> tuple[int, resource.struct_rusage]:
    deadline = time.monotonic() + 3 * SLOWEST
    while time.monotonic() < deadline:
        pid, status, usage = os.wait4(child, os.WNOHANG)
        if pid:
            return status, usage
        time.sleep(0.005)
    os.kill(child, signal.SIGKILL)
    _, status, usage = os.wait4(child, 0)
    return status, usage


def _judged(code: int, out: str, err: str, took: float, memory: float, new: set[str]) -> str:
    if code not in (0, 1, 2):
        return f"exit code {code}: {(err.strip().splitlines() or ['nothing said'])[-1]}"
    if took > SLOWEST:
        return f"took {took:.1f} s"
    if memory > LARGEST:
        return f"took {memory / 1e9:.2f} GB"
    if "Traceback" in err or "Traceback" in out:
        return "a traceback"
    if not all(letter.isprintable() or letter == "\n" for letter in out) or len(out) >= 2**24:
        return "text without an end, or that a terminal would obey"
    if code == 2:
        if out:
            return f"exit code 2, and stdout has {out[:80]!r}"
        if err.count("\n") != 1 or not err.startswith("roadproof: "):
            return f"exit code 2, and stderr is not one line: {err[:200]!r}"
        if len(err) > 1100:
            return f"a line of {len(err)} characters"
        left = {name for name in new if not name.startswith("new/")}
        if left:
            return f"exit code 2, and left {sorted(left)[:3]}"
    return ""


def attack(first: int, count: int, show: bool = False) -> dict[int, str]:
    """Runs cases; those that failed, with what was wrong."""
    for command in COMMANDS:
        main_of(command)
    import cvxpy  # noqa: F401 - what commands import when they need it is imported once, here
    import matplotlib.figure  # noqa: F401
    import scipy.stats  # noqa: F401

    failed = {}
    with tempfile.TemporaryDirectory() as place:
        template = Path(place) / "template"
        template.mkdir()
        good_files(template)
        made_once(template)
        for number in range(first, first + count):
            one = case(number)
            wrong = run(one, template, show)
            if wrong:
                failed[number] = f"{one.command} {' '.join(one.arguments)[:120]!r} ({one.what!r}): {wrong}"
                print(f"{number}: {failed[number]}", flush=True)
    return failed


def main() -> int:
    """Runs the attack; 1 if anything broke."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=1000)
    options = parser.parse_args()
    began = time.monotonic()
    failed = attack(options.first, options.count, show=options.count == 1)
    print(f"{options.count} inputs, {len(failed)} broke something, {time.monotonic() - began:.0f} s")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
