"""Runs as a Rerun file: the moving car beside its curves, with the layout that shows them stored inside.

Rerun is imported where it is used: it takes half a second, and most commands write nothing.
"""

import hashlib
import re
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

from sim.recording.appearance import largest_force
from sim.recording.run_log import RunLog


def write_rrd(path: Path, runs: Sequence[RunLog], metadata: Mapping[str, str]) -> None:
    """Writes runs to a Rerun file that opens on a finished layout.

    Entities of a run, under its name: `signals/<signal>/<response>`, what happened on it at `signals/<signal>/<event>`,
    `difference/<group>`, `world/<body>/<shape>`, `world/springs/<spring>`, `world/forces/<spring>`, `world/profile/<track>`,
    `acting/loads/<load>`, `acting/diagrams/<force>`, `summary` and `events`; once, `metadata` and, of several runs,
    `certificates`. The timeline is `time`, from the start of a run. The same content gets the same recording id, so that a run
    opened twice is one recording; the bytes differ, as Rerun numbers rows by clock.

    Args:
        path: the file; overwritten if it exists.
        runs: what to write, by distinct names. Frames of a scene that are not finite (the run broke off) are left out:
            the car stays where it was last.
        metadata: what all runs share.

    Raises:
        OSError: the file cannot be written.
        ValueError: Rerun cannot log something.
    """
    import rerun as rr

    from sim.recording.rerun_layout import layout
    from sim.recording.rerun_scene import log_scene
    from sim.recording.rerun_signals import (
        certificates,
        colours,
        entity,
        listed,
        log_acting,
        log_difference,
        log_events,
        log_properties,
        log_signals,
        log_text,
    )

    # The viewer keeps one layout per application id: files with runs of the same names share it, others do not.
    # Of characters outside this set it complains.
    application = re.sub(r"[^A-Za-z0-9_-]+", "-", "-".join(["roadproof", *(run.name for run in runs)]))
    recording = rr.RecordingStream(
        application,
        recording_id=_content_id(runs, metadata),
        send_properties=False,  # they hold the time of writing
    )
    strict = rr.strict_mode()
    rr.set_strict_mode(True)  # or Rerun only warns of what it cannot log, and the file lacks it
    try:
        recording.set_log_time_enabled(False)
        recording.set_log_tick_enabled(False)
        try:
            recording.save(path)
        except RuntimeError as error:
            raise OSError(str(error)) from error
        recording.send_blueprint(layout(runs))
        recording.send_recording_name(", ".join(run.name for run in runs))
        log_properties(recording, "roadproof", metadata)
        log_text(recording, entity("metadata"), listed(metadata))
        if len(runs) > 1:
            log_text(recording, entity("certificates"), certificates(runs))
        largest = largest_force(run.scene for run in runs)
        for run, color in zip(runs, colours(runs), strict=True):
            log_properties(recording, f"run {run.name}", run.metadata)
            log_text(recording, entity(run.name, "summary"), run.summary + "\n\n---\n\n" + listed(run.metadata))
            log_signals(recording, run, color)
            log_difference(recording, run)
            log_acting(recording, run, color)
            log_events(recording, run)
            log_scene(recording, run, largest)
    finally:
        recording.disconnect()  # flushes and closes the file
        rr.set_strict_mode(strict)
    _check_complete(path)


def _check_complete(path: Path) -> None:
    """Reads the table of contents, which Rerun writes last: it writes in a thread, and raises nothing on a full disk.

    Raises:
        OSError: there is none.
    """
    import rerun.chunk

    try:
        with warnings.catch_warnings(action="error"):
            rerun.chunk.RrdReader(path).store()
    except (RuntimeError, ValueError, Warning) as error:
        raise OSError("Rerun did not write the whole file; is the disk full?") from error


def _content_id(runs: Sequence[RunLog], metadata: Mapping[str, str]) -> str:
    """A name for the content: of text and of every number in the responses."""
    digest = hashlib.sha256()
    for part in (metadata, *((run.name, run.metadata, run.events, run.summary) for run in runs)):
        digest.update(repr(part).encode())
    for run in runs:
        for name, response in run.responses.items():
            digest.update(repr((name, response.signals)).encode() + response.time.tobytes() + response.values.tobytes())
    return digest.hexdigest()[:32]
