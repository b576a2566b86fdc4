"""Recordings: what was written is read back by the formats' own readers, and an unfinished one leaves no trace."""

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from models.common.errors import InputError
from models.kinds.signals import CONTROL_FORCE, ROAD_DISPLACEMENT, SPRUNG_ACCELERATION, SUSPENSION_DEFLECTION
from sim.drive.response import Response
from sim.recording import rerun_writer
from sim.recording.files import record
from sim.recording.mcap_writer import write_mcap
from sim.recording.rerun_writer import write_rrd
from sim.recording.run_log import RunLog
from sim.recording.scene import Motion, Scene, Shape

SIGNALS = (ROAD_DISPLACEMENT, SUSPENSION_DEFLECTION, SPRUNG_ACCELERATION, CONTROL_FORCE)
METADATA = {"command": "sim.bump", "road": json.dumps({"type": "bump", "height_m": 0.1}), "vehicle_file": "a\nb | c"}
ATTACHMENTS = {"model.xml": ("application/xml", b"<mujoco/>"), "empty": ("text/plain", b"")}

WORDS = "agrees until 0.1 s (lift-off)"
TOPICS = ("mujoco", "linear", "continuous", "difference", "events", "transforms", "shapes", "scene")


def make_scene() -> Scene:
    """One solid of every form, turned and moving; the last frame is not finite, as in a run that broke off."""
    time = np.linspace(0.0, 0.3, 7)
    height = 0.1 * np.sin(20 * time)
    height[-1] = np.nan
    moving = np.stack([0 * time, 0 * time, height], axis=1)
    half_turn = np.sqrt(0.5)
    quaternions = np.tile([half_turn, 0.0, 0.0, half_turn], (7, 1))
    upright, lying = np.array([1.0, 0, 0, 0]), np.array([half_turn, half_turn, 0, 0])
    grey = np.array([0.5, 0.5, 0.5, 1.0])
    shapes = (
        Shape("body", "sprung", "box", np.array([0.5, 0.3, 0.1]), np.array([0, 0, 0.5]), upright, grey),
        Shape("rod", "sprung", "capsule", np.array([0.02, 0.2, 0]), np.array([0, 0, 0.3]), upright, grey),
        Shape("tyre", "unsprung", "cylinder", np.array([0.3, 0.1, 0]), np.zeros(3), lying, grey),
        Shape("hub", "unsprung", "sphere", np.array([0.05, 0, 0]), np.zeros(3), upright, grey),
    )
    bodies = {"sprung": Motion(moving + [0, 0, 0.5], quaternions), "unsprung": Motion(moving, quaternions)}
    springs = {"suspension": np.stack([moving, moving + [0, 0, 0.4]], axis=1)}
    return Scene(time, shapes, bodies, springs)


def make_run(name: str) -> RunLog:
    """Responses with zeros, negative zeros, tiny and huge numbers, NaN and infinity, on different times and signals."""
    random = np.random.default_rng(len(name))
    values = random.standard_normal((300, 4)) * 10.0 ** random.integers(-300, 300, (300, 4))
    values[:10] = 0.0
    values[10:20] = -0.0
    values[-3:] = np.nan, np.inf, -np.inf, 1.0
    time = np.linspace(0.0, 0.299, 300)
    responses = {
        "mujoco": Response(time, SIGNALS, values),
        "linear": Response(time, SIGNALS, values * 1.01),
        "continuous": Response(time[::3], SIGNALS[1:], values[::3, 1:]),
    }
    events = ((0.05, "tyre leaves the road"), (0.08, "tyre lands"))
    return RunLog(name, responses, {"bound": "6.3", "gain": "[[1, 2]]"}, events, f"# {name}\n\nproved", make_scene(), WORDS)


@pytest.fixture(scope="module")
def run() -> RunLog:
    return make_run("I")


@pytest.fixture(scope="module")
def paths(run: RunLog, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return record(tmp_path_factory.mktemp("logs"), "bump", [run], METADATA, ATTACHMENTS)


def rerun_command(*arguments: object) -> None:
    subprocess.run([sys.executable, "-m", "rerun", *map(str, arguments)], check=True, capture_output=True, timeout=60)


def rerun_columns(path: Path, entity: str) -> dict[str, list]:
    """Every column of an entity's rows over time, in the order of time; a component's value is its first instance."""
    from rerun.chunk import RrdReader

    columns: dict[str, list] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        if chunk.entity_path == entity and not chunk.is_static:
            batch = chunk.to_record_batch()
            for name, column in zip(batch.schema.names, batch.columns, strict=True):
                # Durations as integers: Python's own have no nanoseconds.
                values = column.cast("int64") if str(column.type).startswith("duration") else column
                columns.setdefault(name, []).extend(
                    value[0] if isinstance(value, list) else value for value in values.to_pylist()
                )
    return columns


def nanoseconds(time: np.ndarray) -> list[int]:
    return [round(t * 1e9) for t in time]


def messages(path: Path) -> dict[str, list]:
    """(schema, channel, record, decoded) of every message, by topic."""
    found: dict[str, list] = {}
    with path.open("rb") as stream:
        for message in make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            found.setdefault(message[1].topic, []).append(message)
    return found


def test_mcap_gives_back_every_number(run: RunLog, paths: dict[str, Path]) -> None:
    """Times to the nanosecond and values to the bit, NaN, infinities and signed zeros included; what a signal is, too."""
    found = messages(paths["mcap"])
    assert set(found) == {f"/{topic}" for topic in TOPICS}
    for name, response in run.responses.items():
        rows = found[f"/{name}"]
        values = np.array([[getattr(decoded, signal) for signal in response.names] for *_, decoded in rows])
        # No tolerance: protobuf doubles are IEEE doubles.
        assert values.tobytes() == np.ascontiguousarray(response.values).tobytes()
        assert [message.log_time for _, _, message, _ in rows] == nanoseconds(response.time)
        assert all(message.publish_time == message.log_time for _, _, message, _ in rows)
    described = {name: json.loads(text) for name, text in found["/mujoco"][0][1].metadata.items()}
    assert described == {s.name: {"unit": s.unit, "symbol": s.symbol, "meaning": s.meaning} for s in SIGNALS}


def test_mcap_carries_events_metadata_and_attachments(run: RunLog, paths: dict[str, Path]) -> None:
    """Events are Foxglove's logs; common and per-run metadata, and attached files, come back as they were given."""
    found = [
        (log.timestamp.ToNanoseconds() / 1e9, log.message, log.name, log.level) for *_, log in messages(paths["mcap"])["/events"]
    ]
    assert found == [(time, text, "I", 2) for time, text in run.events]  # 2 is INFO
    with paths["mcap"].open("rb") as stream:
        reader = make_reader(stream)
        assert {item.name: item.metadata for item in reader.iter_metadata()} == {"roadproof": METADATA, "run/I": run.metadata}
        assert {item.name: (item.media_type, item.data) for item in reader.iter_attachments()} == ATTACHMENTS


def test_mcap_topics_of_several_runs(tmp_path: Path) -> None:
    """Several runs are told apart by their names, and come in the order of time."""
    write_mcap(tmp_path / "runs.mcap", [make_run("I"), make_run("II")], {}, {})
    found = messages(tmp_path / "runs.mcap")
    assert set(found) == {f"/{run}/{topic}" for run in ("I", "II") for topic in TOPICS}
    with (tmp_path / "runs.mcap").open("rb") as stream:
        times = [message.log_time for *_, message in make_reader(stream).iter_messages(log_time_order=False)]
    assert times == sorted(times)


def test_mcap_fields_beyond_fifteen(tmp_path: Path) -> None:
    """A vehicle with many signals decodes too: from field 16 on, a tag is two bytes."""
    signals = tuple(SUSPENSION_DEFLECTION.at(f"corner_{index}") for index in range(40))
    values = np.random.default_rng(0).standard_normal((5, 40))
    run = RunLog("I", {"mujoco": Response(np.linspace(0.0, 1.0, 5), signals, values)}, {}, (), "", make_scene())
    write_mcap(tmp_path / "many.mcap", [run], {}, {})
    rows = messages(tmp_path / "many.mcap")["/mujoco"]
    assert [[getattr(row[3], signal.name) for signal in signals] for row in rows] == values.tolist()


def test_rerun_opens_the_mcap(run: RunLog, paths: dict[str, Path], tmp_path: Path) -> None:
    """Rerun decodes the messages into fields named as the signals, with the numbers that went in."""
    converted = tmp_path / "converted.rrd"
    rerun_command("mcap", "convert", paths["mcap"], "-o", converted, "--timeline-type", "duration")
    columns = rerun_columns(converted, "/mujoco")
    (messages_,) = (column for name, column in columns.items() if name.endswith(":message"))
    response = run.responses["mujoco"]
    assert columns["message_log_time"] == nanoseconds(response.time)
    for name in response.names:
        np.testing.assert_array_equal([message[name] for message in messages_], response[name])


def test_rerun_file_is_valid(paths: dict[str, Path], tmp_path: Path) -> None:
    """Rerun's own check passes, for one run and for several, with names and metadata of any kind; the file has its layout."""
    from rerun.chunk import RrdReader

    assert len(RrdReader(paths["rerun"]).blueprints()) == 1
    odd = make_run("my/own: é #1")
    write_rrd(tmp_path / "odd.rrd", [odd, make_run("II")], {})
    rerun_command("rrd", "verify", paths["rerun"], tmp_path / "odd.rrd")


def test_rerun_gives_back_every_number(run: RunLog, paths: dict[str, Path]) -> None:
    """Every signal of every response is at `/<run>/signals/<signal>/<response>`, to the bit.

    The shown one has a NaN after its end, by the width of a label.
    """
    for name, response in run.responses.items():
        for signal in response.names:
            columns = rerun_columns(paths["rerun"], f"/I/signals/{signal}/{name}")
            count = len(response.time)
            assert columns["time"][:count] == nanoseconds(response.time)
            # No tolerance: Rerun keeps scalars as doubles.
            assert np.array(columns["Scalars:scalars"][:count]).tobytes() == response[signal].tobytes()
            assert columns["time"][count:] == nanoseconds(1.04 * response.time[-1:]) * (name == "mujoco")
            assert all(map(math.isnan, columns["Scalars:scalars"][count:]))


def test_rerun_file_moves_the_car(run: RunLog, paths: dict[str, Path]) -> None:
    """Bodies and springs move with the scene; frames that are not finite are left out."""
    for body, motion in run.scene.bodies.items():
        columns = rerun_columns(paths["rerun"], f"/I/world/{body}")
        assert columns["time"] == nanoseconds(run.scene.time[:-1])
        # Rerun's 3D is single precision: 6e-8 relative, on coordinates below 1 m.
        np.testing.assert_allclose(columns["Transform3D:translation"], motion.positions[:-1], atol=1e-7)
        x, y, z, w = np.transpose(columns["Transform3D:quaternion"])
        np.testing.assert_allclose(np.stack([w, x, y, z], axis=1), motion.quaternions[:-1], atol=1e-7)
    strips = np.array(rerun_columns(paths["rerun"], "/I/world/springs/suspension")["LineStrips3D:strips"])
    np.testing.assert_allclose(strips[:, [0, -1]], run.scene.springs["suspension"][:-1], atol=1e-7)


def test_rerun_file_draws_every_form(paths: dict[str, Path]) -> None:
    """Each shape is there, as the solid of its form."""
    from rerun.chunk import RrdReader

    chunks = [chunk for chunk in RrdReader(paths["rerun"]).stream().to_chunks() if chunk.is_static]
    static = {chunk.entity_path: set(chunk.to_record_batch().schema.names) for chunk in chunks}
    forms = {"sprung/body": "Boxes3D", "sprung/rod": "Capsules3D", "unsprung/tyre": "Cylinders3D", "unsprung/hub": "Ellipsoids3D"}
    for name, form in forms.items():
        assert any(column.startswith(f"{form}:") for column in static[f"/I/world/{name}"])


def test_nothing_is_overwritten(run: RunLog, tmp_path: Path) -> None:
    """If one of the names is taken, all files get the next free one."""
    (tmp_path / "bump.rrd").write_text("somebody's")
    second = record(tmp_path, "bump", [run], METADATA, ATTACHMENTS)
    third = record(tmp_path, "bump", [run], METADATA, ATTACHMENTS)
    suffixes = {"mcap": "mcap", "layout": "layout.json", "rerun": "rrd"}
    assert second == {kind: tmp_path / f"bump-2.{suffix}" for kind, suffix in suffixes.items()}
    assert third == {kind: tmp_path / f"bump-3.{suffix}" for kind, suffix in suffixes.items()}
    assert (tmp_path / "bump.rrd").read_text() == "somebody's"
    assert sorted(tmp_path.iterdir()) == sorted([tmp_path / "bump.rrd", *second.values(), *third.values()])


@pytest.mark.parametrize(("error", "moment"), [(KeyboardInterrupt(), "write_rrd"), (ValueError("no"), "replace")])
def test_an_unfinished_recording_leaves_nothing(
    run: RunLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException, moment: str
) -> None:
    """An error or Ctrl-C leaves no file, whether it comes while writing or between the two final names."""
    replace = Path.replace

    def fail(path: Path, *_: object) -> Path:
        if moment == "replace" and path.suffix == ".mcap":
            return replace(path, *_)  # type: ignore[arg-type]
        path.write_text("half a file")
        raise error

    monkeypatch.setattr(*((rerun_writer, "write_rrd") if moment == "write_rrd" else (Path, "replace")), fail)
    with pytest.raises(type(error)):
        record(tmp_path, "bump", [run], METADATA, ATTACHMENTS)
    assert list(tmp_path.iterdir()) == []


def test_a_cut_rerun_file_is_refused(run: RunLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rerun raises nothing when the disk is full; the file is read back, and a cut one is an error of one line."""
    import rerun as rr

    disconnect = rr.RecordingStream.disconnect

    def cut(stream: rr.RecordingStream) -> None:
        disconnect(stream)
        for path in tmp_path.rglob("*.rrd"):
            path.write_bytes(path.read_bytes()[:-100])

    monkeypatch.setattr(rr.RecordingStream, "disconnect", cut)
    with pytest.raises(InputError, match="Rerun did not write the whole file"):
        record(tmp_path, "bump", [run], METADATA, ATTACHMENTS)
    assert list(tmp_path.iterdir()) == []


def test_runs_of_one_name_are_refused(run: RunLog, tmp_path: Path) -> None:
    """Two runs of one name would be one in the files."""
    with pytest.raises(InputError, match="I, I"):
        record(tmp_path, "bump", [run, run], {}, {})
