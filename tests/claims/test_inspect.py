"""A log proves what it claims by a replay, and a change of its vehicle, law, road, responses or claims is found."""

import csv
import functools
import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.records import Message

from models.common.errors import InputError
from models.roads.road import Bump
from models.roads.sinusoids import sinusoid
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import read_vehicle
from sim.bump import main as bump
from sim.envelope import main as envelope
from sim.inspect.__main__ import main
from sim.inspect.log import read_log
from sim.inspect.proof import prove
from sim.margins import main as margins
from sim.recording.run_records import record_runs
from sim.runs.run import run_controllers, sample_times
from sim.sweep import main as sweep
from tests.support.analysed import predict
from tests.support.commands import prose, refused
from tests.support.pages import hopper
from tests.support.rewriting import Contents, contents, written
from tests.support.shared import printed

LIMITED = """
[limits]
suspension_stroke = 0.08
stop_stiffness = 1e5
actuator_force = 2000.0
actuator_bandwidth = 60.0
[implementation]
sample_period = 0.005
delay = 1
noise = { sprung_velocity = 0.005 }
quantisation = { sprung_velocity = 0.001 }
"""
FLEEING = """
[controllers.fleeing]
measured = ["sprung_velocity"]
A = [[2000.0]]
B = [[1.0]]
C = [[1e4]]
D = [[0.0]]
"""
WILD = '\n[controllers.wild]\nmeasured = ["sprung_velocity"]\ngain = [[40000.0]]\n'


def logged(command: str, *options: str, files: dict[str, str] | None = None) -> Path:
    """The log of a run."""
    (log,) = (printed(command, *options, "--logs", "logs", files=files).folder / "logs").glob("*.mcap")
    return log


@pytest.fixture(scope="module")
def log() -> Path:
    """A bump with two controllers, one of which leaves the ground."""
    controllers = ("--controller", "passive", "--controller", "I")
    return logged("sim.bump", *controllers, "--height", "0.2", "--speed", "25", "--duration", "0.4")


@pytest.fixture(scope="module")
def brief() -> Path:
    """The second of them alone, for a shorter time, as what is forged below."""
    return logged("sim.bump", "--controller", "I", "--height", "0.2", "--speed", "25", "--duration", "0.2")


@pytest.fixture(scope="module")
def parts(brief) -> Contents:
    return contents(brief)


def inspected(path: Path, capsys, *options: str) -> tuple[int, dict]:
    """Exit code, and what `--json` prints."""
    capsys.readouterr()
    code = main([str(path), "--json", *options])
    return code, json.loads(capsys.readouterr().out)


def broken(found: dict) -> set[tuple[str, str]]:
    """(part, verdict) of everything that is not proved."""
    findings = [*found["findings"], *(finding for run in found["runs"] for finding in run["findings"])]
    return {(one["part"], one["verdict"]) for one in findings if one["verdict"] in ("FAILS", "missing")}


# --- logs as they are written ---------------------------------------------------------------------------------------------


def test_bump(log, capsys):
    """A log as it was written proves every claim: certificate, responses to the last bit, lift-off, energy, numbers."""
    code, found = inspected(log, capsys)
    assert (code, found["proves"], broken(found)) == (0, True, set())
    passive, controlled = found["runs"]
    parts = {finding["part"] for finding in controlled["findings"]}
    assert parts == {"certificate", "responses", "claims", "result"}
    texts = {finding["part"]: finding["text"] for finding in controlled["findings"]}
    assert texts["responses"] == "the repeated responses (MuJoCo, sampled, continuous) equal the logged ones bit for bit"
    assert texts["claims"].startswith("energy balances")
    assert any(finding["text"].startswith("lift-off") for finding in controlled["findings"])
    result = json.loads(dict((name, data) for name, _, data in contents(log).attachments)["result.json"])
    again, said = controlled["again"], result["runs"][1]
    assert again["energy"] == said["energy"]
    assert again["signals"]["sprung_acceleration"]["peak"] == said["signals"]["sprung_acceleration"]["peak"]
    assert passive["again"]["controller"]["norm"] == pytest.approx(35.07201, rel=1e-6)  # of findings that share no code: 35.072


def measured_road() -> Path:
    """The log of a half-car over a road from a file that has gone since."""
    x = np.linspace(0, 30, 301)
    points = np.column_stack([x, 0.01 * np.sin(x), 0.01 * np.cos(2 * x)]).tolist()
    text = "".join(f"{at},{left},{right}\n" for at, left, right in points)
    options = ("--vehicle", "half_car", "--controller", "I", "--road", "road.csv", "--duration", "0.3")
    log = logged("sim.drive", *options, files={"road.csv": text})
    (log.parent.parent / "road.csv").unlink(missing_ok=True)
    return log


@pytest.mark.parametrize(
    "log_of",
    [
        lambda: logged("sim.drive", "--controller", "I", "--class", "C", "--duration", "0.3"),
        lambda: logged("sim.drive", "--controller", "I", "--road", "watts_hump:height=0.03", "--speed", "6", "--duration", "0.3"),
        measured_road,
    ],
    ids=["random", "single", "measured"],
)
def test_drive(log_of, capsys):
    """Random, single and measured roads come back from the log alone, and so do the metrics over them."""
    code, found = inspected(log_of(), capsys)
    assert (code, broken(found)) == (0, set())


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (b'"definitions": 7', b'"definitions": 1', "its metrics have other definitions; use the version"),
        (b'"settled": {"share": 0.', b'"settled": {"share": 1.', "result.json differs from the repeated run: settled.share"),
        (b'"expected": 0.', b'"expected": 1.', "result.json differs from the repeated run: metrics."),
    ],
)
def test_metrics_of_a_log(tmp_path, capsys, old, new, said):
    """Metrics of other definitions are not called wrong, and not proved either; those of these, and what they rest on, are."""
    whole = contents(logged("sim.drive", "--controller", "passive", "--class", "B", "--duration", "0.5"))
    changed = whole.with_attachment("result.json", lambda data: data.replace(old, new, 1))
    assert changed != whole
    (tmp_path / "changed.mcap").write_bytes(written(changed))
    code, found = inspected(tmp_path / "changed.mcap", capsys)
    verdict = "FAILS" if "differs from" in said else "missing"
    assert (code, broken(found)) == (1, {("result", verdict)})
    assert any(said in finding["text"] for finding in found["runs"][0]["findings"])


@pytest.mark.parametrize(
    ("kind", "more", "options", "said"),
    [
        ("quarter_car", LIMITED, ["--controller", "II", "--duration", "0.5"], "bump stop"),
        pytest.param(
            *("half_car", "\n[implementation.noise]\nheave_velocity = 1e-7\n"),
            *(["--controller", "I", "--duration", "0.5"], "the difference comes from geometry and noise"),
            marks=pytest.mark.attack,
        ),
        ("quarter_car", WILD, ["--controller", "wild"], "^diverged"),
        pytest.param(
            *("quarter_car_semi_active", FLEEING, ["--controller", "fleeing", "--duration", "0.6"], "^law overflow"),
            marks=pytest.mark.attack,
        ),
    ],
    ids=["limits", "noise and geometry", "diverged", "law overflow"],
)
def test_applied_again(kind, more, options, said, tmp_path, capsys):
    """Limits, delay, noise and geometry are applied and judged again as the log says; a run that broke off did so."""
    vehicle = tmp_path / "mine.toml"
    vehicle.write_text(read_vehicle(kind).text + more)
    bump(["--vehicle", str(vehicle), *options, "--logs", str(tmp_path)])
    vehicle.unlink()
    code, found = inspected(next(tmp_path.glob("*.mcap")), capsys)
    assert (code, broken(found)) == (0, set())
    assert any(re.search(said, finding["text"]) for finding in found["runs"][0]["findings"])


def test_loops_too_large_to_judge(designer, paper):
    """For a loop with more delayed forces than requested, growth is not computed."""
    late, time = replace(paper, implementation=Implementation(delay=20)), sample_times(paper, 0.1, 1e-3)
    controller, states = designer.design("II"), len(paper.linear_model.A) + 20
    assert predict(late, controller, Bump(), time, states).radius == predict(late, controller, Bump(), time).radius
    assert np.isnan(predict(late, controller, Bump(), time, states - 1).radius)


@pytest.mark.attack
def test_late_and_unstable(designer, paper, tmp_path, capsys):
    """Runs of margins and sweeps, late, growing, on a sinusoid, are proved; what else their result rests on is said."""
    late = replace(paper, implementation=Implementation(delay=120))
    controller, time = designer.design("II"), sample_times(paper, 1.0, 1e-3)
    runs = {}
    for name, vehicle, road in (("late", late, Bump(0.002)), ("worst", paper, sinusoid(64.2, 12.5).scaled(5e-5))):
        (runs[f"II_{name}"],) = run_controllers(vehicle, [controller], road, time)
    result = {"controller": "II"}
    path = record_runs(tmp_path, "roadproof margins --controller II", paper, ["II"], runs, result)["mcap"]
    code, found = inspected(Path(path), capsys)
    assert (code, broken(found)) == (0, set())
    parts = {(finding["part"], finding["verdict"]) for finding in found["runs"][0]["findings"]}
    assert {("implementation", "note"), ("result", "note")} <= parts
    assert any(finding["text"].startswith("unstable: the sampled loop grows") for finding in found["runs"][0]["findings"])


@pytest.mark.parametrize(
    ("command", "options"),
    [
        pytest.param(sweep, ["--controller", "I", "--timestep", "0.008"], marks=pytest.mark.attack),
        pytest.param(margins, ["--controller", "II", "--timestep", "0.004"], marks=pytest.mark.attack),
        (envelope, ["--controller", "I", "--vary", "height:0.02:0.3:2", "--vary", "speed:3:30:2", "--timestep", "0.004"]),
        pytest.param(bump, ["--controller", "I", "--vehicle", "full_car", "--duration", "0.25"], marks=pytest.mark.attack),
    ],
    ids=["sweep", "margins", "envelope", "full_car"],
)
def test_every_command(command, options, tmp_path, capsys):
    """The logs of every other command are proved too; so is geometry that leaves the linear analysis."""
    command([*options, "--logs", str(tmp_path)])
    code, found = inspected(next(tmp_path.glob("*.mcap")), capsys)
    assert (code, broken(found)) == (0, set())


def test_own_kind(tmp_path, capsys):
    """A kind of vehicle of the user's own is known again from its folder, and its code is run from nowhere else."""
    bump(["--vehicle", str(hopper(tmp_path)), "--controller", "I", "--duration", "0.3", "--logs", str(tmp_path / "logs")])
    path = next((tmp_path / "logs").glob("*.mcap"))
    code, found = inspected(path, capsys)
    assert code == 1
    assert "give --kinds" in found["findings"][-1]["text"]
    assert inspected(path, capsys, "--kinds", str(tmp_path))[0] == 0


# --- logs that were changed ------------------------------------------------------------------------------------------------


def scaled(topic: str, column: int, factor: float) -> Callable[[Contents], Contents]:
    """Multiplies one signal of one topic."""

    def change(messages: list[Message]) -> list[Message]:
        changed = []
        for message in messages:
            data, at = bytearray(message.data), 9 * column + 1
            data[at : at + 8] = (np.frombuffer(data[at : at + 8], "<f8") * factor).astype("<f8").tobytes()
            changed.append(Message(message.channel_id, message.log_time, bytes(data), message.publish_time, message.sequence))
        return changed

    return lambda parts: parts.with_messages(topic, change)


def after(topic: str, sample: int, change: Callable[[Contents], Contents]) -> Callable[[Contents], Contents]:
    """A change of one topic from a sample on."""

    def later(parts: Contents) -> Contents:
        changed, whole = change(parts), []
        parts.with_messages(topic, lambda messages: whole.append(messages) or messages)
        return changed.with_messages(topic, lambda messages: whole[0][:sample] + messages[sample:])

    return later


def claim(key: str, old: str, new: str) -> Callable[[Contents], Contents]:
    """Another claim of run I."""

    def change(text: str) -> str:
        assert old in text, "the test changes what is there"
        return text.replace(old, new, 1)

    return lambda parts: parts.with_claim("run/I", key, change)


def attached(file: str, old: bytes, new: bytes) -> Callable[[Contents], Contents]:
    """Another attachment."""

    def change(data: bytes) -> bytes:
        assert old in data, "the test changes what is there"
        return data.replace(old, new, 1)

    return lambda parts: parts.with_attachment(file, change)


# A millionth of its peak, where a tyre has left the road and there is no analysis to compare with.
ONE_SAMPLE = after("/mujoco", 200, scaled("/mujoco", 2, 1 + 2e-6))


SEMI_ACTIVE = ("sim.bump", "--vehicle", "quarter_car_semi_active", "--controller", "sky", "--duration", "0.2")
CHANGES = {
    "a norm": (claim("norm", "7.843", "7.842"), ("claims", "FAILS")),
    "a bound that its proof does not prove": (claim("certificate", '"bound": 7.87', '"bound": 7.83'), ("certificate", "FAILS")),
    "a gain": (claim("gain", "10825", "10826"), ("certificate", "FAILS")),
    "a measurement": (claim("measured", "sprung_velocity", "tyre_deflection"), ("claims", "FAILS")),
    "a road": (claim("road", '"height": 0.2', '"height": 0.21'), ("responses", "FAILS")),
    "a delay": (claim("implementation", '"delay": 0', '"delay": 3'), ("responses", "FAILS")),
    "agreement": (claim("agrees", "true", "false"), ("claims", "FAILS")),
    "the physics": (scaled("/mujoco", 6, 1 + 1e-4), ("responses", "FAILS")),
    "one sample": (ONE_SAMPLE, ("responses", "FAILS")),
    "no claim of energy": (lambda p: p.without_claim("run/I", "energy"), ("claims", "FAILS")),
    "the linear response": (scaled("/linear", 2, 1 + 1e-7), ("responses", "FAILS")),
    "a mass": (attached("vehicle.toml", b"504.5", b"504.6"), ("certificate", "FAILS")),
    "the result": (attached("result.json", b'"peak": {"mujoco": 0.', b'"peak": {"mujoco": 1.'), ("result", "FAILS")),
    "an empty result": (lambda p: p.with_attachment("result.json", lambda data: b"{}"), ("result", "FAILS")),
    "no vehicle": (lambda p: replace(p, attachments=p.attachments[1:]), ("vehicle", "missing")),
    "no certificate": (lambda p: p.with_claim("run/I", "certificate", lambda _: "null"), ("certificate", "missing")),
    "no physics": (lambda p: p.with_messages("/mujoco", lambda m: []), ("responses", "missing")),
    "an earlier version": (
        lambda _: contents(logged(*SEMI_ACTIVE)).with_claim("run/sky", "errors", lambda text: text.replace("null", "1e-6")),
        ("claims", "missing"),
    ),
    "a gap": (lambda p: p.with_messages("/linear", lambda m: m[:100] + m[101:]), ("responses", "missing")),
}


@pytest.mark.parametrize("what", CHANGES)
def test_change_is_found(what, parts, tmp_path, capsys):
    """A log written anew with one thing changed, all checksums right, proves its claim no longer, and says which part."""
    change, expected = CHANGES[what]
    path = tmp_path / "changed.mcap"
    path.write_bytes(written(change(parts)))
    code, found = inspected(path, capsys)
    assert code == 1
    assert expected in broken(found)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda parts: parts.with_claim("run/I", "errors", lambda text: text.replace(": ", ": 1")),
            r"the log differs from the repeated run: errors\.\w+ \(and 5 more claims, such as errors\.\w+\)",
        ),
        (
            lambda parts: parts.with_attachment("result.json", lambda data: data.replace(b'"mujoco": 0.', b'"mujoco": 7.')),
            r"result\.json differs from .* run: [\w.]+ \(and \d+ more numbers of the result, such as [\w.]+\)",
        ),
        (claim("errors", '"sprung_velocity": ', '"sprung_velocity": 1'), "the log differs from .* run: errors.sprung_velocity"),
    ],
    ids=["errors", "result", "one"],
)
def test_one_cause_is_one_line(change, said, parts, tmp_path, capsys):
    """Many numbers that are wrong for one cause are one finding: the first, how many more, and the first of those."""
    path = tmp_path / "forged.mcap"
    path.write_bytes(written(change(parts)))
    assert main([str(path)]) == 1
    _, run = capsys.readouterr().out.split("run I: ")
    (found,) = re.findall(r"^  \w+ FAILS: (.*\n(?: {4}.*\n)*)", run, re.M)
    assert re.fullmatch(said, prose(found))


def test_several(brief, parts, tmp_path, capsys, monkeypatch):
    """Several logs are inspected in turn, a line each, with `-v` each as by itself, in JSON too; the exit code is the worst."""
    for name, function in (("log.read_log", read_log), ("proof.prove", prove)):
        monkeypatch.setattr(f"sim.inspect.{name}", functools.cache(function))  # each log is proved once
    forged, stub = tmp_path / "forged.mcap", tmp_path / "stub.mcap"
    forged.write_bytes(written(CHANGES["a norm"][0](parts)))
    stub.write_bytes(b"time,height")
    with pytest.raises(InputError) as error:
        read_log(stub)
    said = str(error.value)
    capsys.readouterr()
    alone, texts = {}, {}
    for path in (brief, forged):
        main([str(path), "-v"])
        texts[path] = capsys.readouterr().out
        alone[path] = inspected(path, capsys)[1]
        assert "logs" not in alone[path]
        del alone[path]["csv"]
    for some, code, ends in (
        ([brief, brief], 0, "2 of 2 logs still prove what they claim\n"),
        ([forged, brief], 1, "1 of 2 logs still proves what it claims\n"),
        ([stub, forged, brief], 2, "1 of 3 logs still proves what it claims\n"),
    ):
        assert main([str(path) for path in some]) == code
        short = capsys.readouterr().out.splitlines()
        assert short.count(f"still proves    {brief}") == some.count(brief)
        assert short.count(f"DOES NOT PROVE  {forged}") == some.count(forged)
        assert f"{short[-1]}\n" == ends
        assert main([*map(str, some), "-v"]) == code
        printed = capsys.readouterr()
        assert printed.out == "".join(f"{texts[path]}\n" for path in some if path != stub) + ends
        assert printed.err.splitlines() == [f"roadproof: {said}"] * (stub in some)
        if code == 1:
            continue
        assert main([*map(str, some), "--json"]) == code
        found = json.loads(capsys.readouterr().out)
        assert set(found) == {"logs", "proves"}
        assert found["proves"] is (code == 0)
        refused = {"log": str(stub), "proves": False, "error": said}
        assert found["logs"] == [refused if path == stub else alone[path] for path in some]


def test_until_when_the_error_is_of(parts, tmp_path, capsys):
    """Until when a run's errors are of is held against the run like any number; a log from before it was written lacks it."""
    path = tmp_path / "changed.mcap"
    for change, wrong in ((lambda run: run.pop("until"), set()), (lambda run: run.update(until=0.15), {("result", "FAILS")})):
        result = json.loads(dict((name, data) for name, _, data in parts.attachments)["result.json"])
        change(result["runs"][0])
        path.write_bytes(written(parts.with_attachment("result.json", lambda _, said=result: json.dumps(said).encode())))
        code, found = inspected(path, capsys)
        assert (code, broken(found)) == (len(wrong), wrong)


def test_another_format(parts, tmp_path):
    """A log of another format is refused with one line that names the version that wrote it."""
    path = tmp_path / "other.mcap"
    path.write_bytes(written(parts.with_claim("roadproof", "format", lambda _: "2")))
    with refused(match=r"the log has format 2 of Roadproof 0\.1\.0, but this version reads format 1"):
        main([str(path)])


# --- what is none ----------------------------------------------------------------------------------------------------------


def test_no_log_is_refused(tmp_path, parts):
    """A file that is not a log of Roadproof, or is cut or damaged, is refused with one line."""
    (tmp_path / "text").write_text("time,height\n")
    (tmp_path / "empty").touch()
    (tmp_path / "others").write_bytes(written(replace(parts, metadata=[("other", {})])))
    whole = written(parts)
    (tmp_path / "stub").write_bytes(whole[:40])
    (tmp_path / "cut").write_bytes(whole[: len(whole) * 6 // 10])
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    (tmp_path / "flipped").write_bytes(flipped)
    for name in ("text", "empty", "others", "stub", "cut", "flipped", "absent", "."):
        with refused(match="^log "):
            main([str(tmp_path / name)])


def test_command(log, tmp_path):
    """As a command: one line and 2 for what is no log; text and exit code 0. It never imports a solver, and needs no network."""
    code = """
import atexit, runpy, sys
atexit.register(lambda: print({'cvxpy', 'control', 'rerun'} & set(sys.modules)))
for path in sys.argv[1:]:
    sys.argv = ['sim.inspect', path]
    try:
        runpy.run_module('sim.inspect', run_name='__main__', alter_sys=True)
    except SystemExit as ended:
        print('exit code', ended.code)
"""
    run = subprocess.run([sys.executable, "-c", code, __file__, str(log)], capture_output=True, text=True, timeout=60)
    assert (run.returncode, run.stderr.count("\n")) == (0, 1)
    refused, proved, no_solver = run.stdout.split("exit code ")
    assert (refused, proved[:2], no_solver) == ("", "2\n", "0\nset()\n")
    assert proved.endswith("the log still proves what it claims\n")
    assert "\n  roadproof" in proved


def test_csv(log, tmp_path, capsys):
    """The table holds every sample of every run, to the last bit, units in its headings; nothing else is written."""
    path = tmp_path / "signals.csv"
    inspected(log, capsys, "--csv", str(path))
    with path.open(newline="") as file:
        head, *rows = csv.reader(file)
    assert head[:4] == [
        "time [s]",
        "road_displacement passive mujoco [m]",
        "road_displacement passive sampled [m]",
        "road_displacement passive recomputed [m]",
    ]
    assert len(rows) == 401
    column, parts = head.index("sprung_acceleration I mujoco [m/s2]"), contents(log)
    (number,) = [channel.id for channel in parts.channels if channel.topic == "/I/mujoco"]
    logged = [message.data[9 * 6 + 1 : 9 * 6 + 9] for message in parts.messages if message.channel_id == number]
    assert [float(row[column]) for row in rows] == np.frombuffer(b"".join(logged), "<f8").tolist()
    assert [row[column + 1] for row in rows] == [row[column + 2] for row in rows]
    assert [path.name for path in tmp_path.iterdir()] == ["signals.csv"]
    for logs, table, said in (
        ([log, log], "signals.csv", "^--csv writes the signals of one log, but 2 are given; give one log, or omit --csv$"),
        ([log], log, "is an input file"),
        ([log], "absent/x.csv", "there is no folder"),
        ([log], "x.txt", r"csv .*x\.txt: a table is written as CSV; give a name that ends in \.csv"),
    ):
        with pytest.raises(InputError, match=said):
            main([*map(str, logs), "--csv", str(tmp_path / table)])


def test_vehicle_of_the_log_not_of_the_machine(parts, tmp_path, capsys):
    """The vehicle is the attached one, wherever its file is said to have been; a log that is written again is proved."""
    path = tmp_path / "moved.mcap"
    path.write_bytes(written(parts.with_claim("roadproof", "vehicle", lambda _: "C:\\\\models\\\\quarter_car.toml")))
    assert main([str(path), "-v"]) == 0
    assert capsys.readouterr().out.endswith("the log still proves what it claims\n")
    assert read_vehicle("quarter_car").text.encode() == parts.attachments[0][2]
