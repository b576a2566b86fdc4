"""Everything that a log holds, against what it would hold if it were written now from the runs made anew.

What is written, and what a log is held to, comes from the same functions (`recording/run_log.py`), so that nothing can be missing
from the one and not from the other. Nothing extra is accepted: whoever reads the log in a player would believe it.
"""

from collections.abc import Iterator, Sequence
from typing import Any

from models.common.command import versions
from models.common.errors import InputError
from models.vehicle.vehicle import Vehicle
from sim.inspect.claims import logged_as
from sim.inspect.findings import FAILS, HOLDS, MISSING, NOTE, Finding, different, merge_repeats
from sim.inspect.log import Recorded, read_json
from sim.inspect.mcap_contents import Logged
from sim.recording.mcap_writer import PACKAGE, LoggedChannel, channels, records
from sim.recording.run_log import DAMPERS, LOADS, WHOLE, RunLog, check_keys
from sim.recording.run_records import attachments, common_metadata
from sim.runs.prediction import Prediction
from sim.studies.ride.metrics import DEFINITIONS
from sim.studies.ride.run_metrics import driven_roughness, measured_samples, roughness_object

ELSEWHERE = (  # claims of a run that other checks hold, with a tolerance and words of their own
    "certificate",
    "norm",
    "bound",
    "peak_frequency",
    "poles",
    "stable",
    "agrees",
    "energy",
    "half_step",
    "lift_off",
    "errors",
    "samples",
)
ACTING = (LOADS, DAMPERS)
CHECKED = ("vehicle.toml", "model.xml", "result.json")  # attachments of which other checks hold the contents
SCHEMAS = ("protobuf", "foxglove-schemas-protobuf")  # packages that make the schemas of events and scene


def check_contents(
    log: Recorded, vehicle: Vehicle, timestep: float, written: Sequence[RunLog], current: bool
) -> Iterator[Finding]:
    """The records, attachments and channels of a log.

    Args:
        timestep: [s].
        written: its runs as they would be written now, the responses as they were logged.
        current: whether it is of this format; of an older one nothing is demanded, and what differs is said.
    """
    wrong = [*_records(log, vehicle, timestep, written), *_attachments(log, vehicle, timestep, written)]
    made_now = list(channels(written))
    since = {channel.topic for channel in made_now if channel.topic.rpartition("/")[2] in ACTING} - log.file.channels.keys()
    kept = [channel for channel in made_now if channel.topic not in since]
    topics, older = _topics(log, kept)
    wrong += topics
    if not current:
        if wrong:
            text = "the log is older than formats are numbered, and not held to one; it differs from what is written now"
            yield Finding("format", NOTE, f"{text}: {merge_repeats(wrong, 'differences')}")
        return
    yield from (Finding("format", FAILS, text) for text in wrong)
    if not wrong:
        count = sum(len(record) for record in log.file.metadata.values())
        yield Finding("format", HOLDS, f"{len(kept)} channels with events, differences and scene, {count} claims; nothing else")
    if since:
        yield Finding("format", NOTE, f"it has no {' and no '.join(sorted(since))}, which logs of older versions have not")
    if older:
        yield Finding("format", NOTE, f"the schemas of {', '.join(older)} are of another version of {' or '.join(SCHEMAS)}")


def check_whole_result(log: Recorded, again: Sequence[Prediction]) -> Iterator[Finding]:
    """Checks the keys of the result and its parts beside the runs.

    Args:
        again: recomputed predictions of its runs.
    """
    try:
        result, command = log.result, log.metadata.get("command", "")
        check_keys(command, result)
    except InputError as error:
        yield Finding("result", MISSING, str(error))
        return
    if command not in WHOLE:
        return
    names = [logged_as(one) for one in result["runs"]] if _objects(result["runs"]) else None
    if names != [run.name for run in log.runs]:
        yield Finding("result", FAILS, "the runs of result.json are not those of the log, in their order")
    if command == "drive":
        first, samples = again[0], len(again[0].time)
        duration = (samples - 1) * first.timestep
        start, end = measured_samples([(one.vehicle, one.controller) for one in again], first.road, duration, first.timestep)
        due = [float(first.time[start]), *([] if end is None else [float(first.time[end - 1])])]
        said = [result[key] for key in ("measured_from", "measured_until") if key in result]
        several = any("vehicle" in one for one in result["runs"])  # of the other vehicles the log says nothing
        if said != due and not (several and len(said) <= len(due) and all(a >= b for a, b in zip(said, due, strict=False))):
            yield Finding("result", FAILS, "measured_from or measured_until is not when measuring of such runs begins or ends")
        if result["definitions"] != DEFINITIONS:
            yield Finding("result", MISSING, "the definitions of its metrics are not this version's")
        roughness = roughness_object(driven_roughness(first.vehicle, first.road, first.time))
        if "iri" in result and list(different(result["iri"], roughness, exact=True)):
            yield Finding("result", FAILS, "the iri is not that of the road")


def _objects(runs: Any) -> bool:
    return isinstance(runs, list) and all(isinstance(one, dict) and isinstance(one.get("controller"), dict) for one in runs)


def _records(log: Recorded, vehicle: Vehicle, timestep: float, written: Sequence[RunLog]) -> Iterator[str]:
    """Yields the differences between the metadata and those that would be written."""
    expected = records(written, common_metadata(log.metadata.get("command_line", ""), vehicle, timestep))
    logged = log.file.metadata
    yield from _keys("metadata record", logged, expected)
    for name in expected.keys() & logged.keys():
        yield from _keys(f"claim of {name}", logged[name], expected[name])
    for key in ("format", "command", "vehicle_type", "timestep"):
        if log.metadata.get(key, "") != expected[PACKAGE][key]:
            yield f"its {key} is not {expected[PACKAGE][key]!r}"
    said = _json(log.metadata.get("versions", ""))
    if not isinstance(said, dict) or set(said) != set(versions()) or not all(isinstance(one, str) for one in said.values()):
        yield f"its versions are not those of {', '.join(versions())}"
    for run in written:
        claims = logged.get(f"run/{run.name}", {})
        for key in run.metadata.keys() & claims.keys() - set(ELSEWHERE):
            yield from different({key: _json(claims[key])}, {key: _json(run.metadata[key])}, True, f"run {run.name}")


def _attachments(log: Recorded, vehicle: Vehicle, timestep: float, written: Sequence[RunLog]) -> Iterator[str]:
    """Yields the differences between the attachments and those that would be written."""
    expected = attachments(vehicle, timestep, {}) | {name: file for run in written for name, file in run.files.items()}
    attached = log.file.attachments
    yield from _keys("attachment", attached, expected)
    for name in expected.keys() & attached.keys():
        media_type, data = expected[name]
        if (attached[name].media_type, attached[name].times) != (media_type, (0, 0)):
            yield f"the attachment {name} is not {media_type}, without a time"
        if name not in CHECKED and attached[name].data != data:
            yield f"the attachment {name} is not what the run has"


def _topics(log: Recorded, kept: Sequence[LoggedChannel]) -> tuple[list[str], list[str]]:
    """Returns the differences of the channels from those that would be written, and the topics with another library version's
    schema.
    """
    expected, channels = {channel.topic: channel for channel in kept}, log.file.channels
    wrong, older = list(_keys("channel", channels, expected)), []
    if sorted(log.file.schemas) != sorted({channel.schema[0] for channel in kept}):
        wrong.append("it has other schemas than those of its channels, each once")
    then, now = _json(log.metadata.get("versions", "")), versions()
    known = isinstance(then, dict) and all(then.get(name) == now[name] for name in SCHEMAS)
    for topic in expected.keys() & channels.keys():
        logged, channel = channels[topic], expected[topic]
        if logged.schema != channel.schema:
            if known or logged.schema is None or logged.schema[:2] != channel.schema[:2] or channel.metadata:
                wrong.append(f"{topic} has another schema")
            else:
                older.append(topic)
        wrong += [f"{topic} {text}" for text in _channel(logged, channel)]
    return wrong, older


def _channel(logged: Logged, channel: LoggedChannel) -> Iterator[str]:
    """Yields the differences between a channel and the one that would be written."""
    if logged.encoding != "protobuf" or dict(logged.metadata) != dict(channel.metadata):
        yield "does not say of its fields what a log says"
    if logged.unlike:
        yield f"has {logged.unlike} messages that are numbered, or published at another time than logged"
    if logged.times.tolist() != list(channel.times):
        yield f"has {len(logged.times)} messages at other times than the {len(channel.times)} that follow"
        return
    for time, now, said in zip(channel.times, channel.contents(), logged.messages(), strict=True):
        if said != now and not channel.alike(now, bytes(said)):
            yield f"does not show what follows, first at {time / 1e9:g} s"
            return


def _keys(what: str, present: Any, expected: Any) -> Iterator[str]:
    """Yields missing and extra keys."""
    for name in expected:
        if name not in present:
            yield f"the {what} {name} is missing"
    for name in present:
        if name not in expected:
            yield f"the {what} {name[:60]!r} is none of a log's"


def _json(text: str) -> Any:
    """Returns the parsed JSON, or the text itself if it is not JSON."""
    try:
        return read_json(text, "a claim")
    except InputError:
        return text
