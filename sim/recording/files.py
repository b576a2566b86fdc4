"""Recordings on disk: MCAP, its layout and Rerun side by side, complete or absent, never over somebody's older ones."""

import itertools
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from models.common import interrupt
from models.common.errors import InputError
from models.common.files import made_folder
from models.common.printed import Whole, pasted_path
from sim.recording.foxglove_layout import foxglove_layout
from sim.recording.mcap_writer import write_mcap
from sim.recording.rerun_writer import write_rrd
from sim.recording.run_log import RunLog

SUFFIXES = {"mcap": "mcap", "layout": "layout.json", "rerun": "rrd"}


def record(
    folder: Path,
    stem: str,
    runs: Sequence[RunLog],
    metadata: Mapping[str, str],
    attachments: Mapping[str, tuple[str, bytes]],
) -> dict[str, Path]:
    """Writes runs as `<stem>.mcap`, `<stem>.layout.json` and `<stem>.rrd`; the layout is the MCAP's in Foxglove and Lichtblick.

    Where one of them exists already, it is `<stem>-2`, `-3`, ... All are written in full under another name first. An error or
    an interruption leaves nothing behind.

    Args:
        folder: where the files go; made if it is not there.
        stem: the files' common name, without suffix.
        runs: what to write, by distinct names.
        metadata: what all runs share.
        attachments: (media type, content) by name; in the MCAP file only, as Rerun has no place for them.

    Returns:
        The files' paths: `mcap`, `layout` and `rerun`.

    Raises:
        InputError: the folder cannot be made, or not written.
        ValueError: two runs have the same name.

    Example:
        See `sim.run_log`, which makes what is recorded:

        >>> from sim import record, run_log
    """
    names = [run.name for run in runs]
    if len(set(names)) < len(names):
        raise ValueError(f"runs are told apart by their names, and these are not distinct: {', '.join(names)}")
    try:
        # Within the folder, so that giving the final name moves no data, and fails or succeeds at once.
        with made_folder(folder, "logs"), tempfile.TemporaryDirectory(dir=folder, prefix=f".{stem}-") as temporary:
            written = {kind: Path(temporary, f"run.{suffix}") for kind, suffix in SUFFIXES.items()}
            write_mcap(written["mcap"], runs, metadata, attachments)
            written["layout"].write_text(foxglove_layout(runs), encoding="utf-8", newline="\n")
            write_rrd(written["rerun"], runs, metadata)
            with interrupt.finishing():
                return _published(written, folder, stem)
    except OSError as error:
        raise _not_writable(folder, error) from error


def opening_lines(paths: Mapping[str, Path]) -> list[str]:
    """Returns the commands that open each file of a recording."""
    return [
        Whole(f"  rerun {pasted_path(paths['rerun'])}"),
        "  for Foxglove and Lichtblick, with the layout beside it",
        *(Whole(f"    {pasted_path(paths[kind])}") for kind in ("mcap", "layout")),
    ]


def _published(written: Mapping[str, Path], folder: Path, stem: str) -> dict[str, Path]:
    """Gives finished files the first name that is free for all of them; returns their final paths."""
    for number in itertools.count(1):
        name = stem if number == 1 else f"{stem}-{number}"
        final = {kind: folder / f"{name}.{SUFFIXES[kind]}" for kind in written}
        ours: list[Path] = []
        try:
            # A rename would overwrite silently. An empty file, made only where there is none, reserves the name
            # even against another process that records at the same time.
            for path in final.values():
                path.touch(exist_ok=False)
                ours.append(path)
            for kind, path in written.items():
                path.replace(final[kind])
            return final
        except BaseException as error:
            for path in ours:
                path.unlink()
            if not isinstance(error, FileExistsError):
                raise
    raise AssertionError("unreachable: the numbers do not end")


def _not_writable(folder: Path, error: OSError) -> InputError:
    return InputError(
        f"cannot write recordings in {folder}: {error.strerror or error}. It must be a folder with free space in "
        "which files can be made: name another one, or mend this one"
    )
