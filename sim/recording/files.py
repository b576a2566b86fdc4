"""Recordings on disk: an MCAP file, and the files of `RECORDINGS` next to it. If not all files can be written, no file is
written.

Existing files are never overwritten.
"""

import itertools
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

from models.common.checks import AT_LEAST_ONE, Must
from models.common.errors import InputError
from models.common.extensions import RECORDINGS
from models.common.files import made_folder
from sim.recording.mcap_writer import write_mcap
from sim.recording.run_log import RunLog

SUFFIXES = {"mcap": "mcap"} | {name: "".join(texts) for name, texts in RECORDINGS.texts.items()}
Stem = Annotated[
    str,
    Must(
        "a file name without folder and suffix, at most 120 characters",
        lambda value: 0 < len(value) <= 120 and value.isprintable() and not {"/", "\\"} & {*value},
    ),
]


def record(
    folder: Path,
    stem: Stem,
    runs: Annotated[Sequence[RunLog], AT_LEAST_ONE],
    metadata: Mapping[str, str],
    attachments: Mapping[str, tuple[str, bytes]],
) -> dict[str, Path]:
    """Writes runs as `<stem>.mcap`, `<stem>.layout.json` (for the MCAP file in Foxglove and Lichtblick) and `<stem>.rrd`.

    If a file with one of these names exists, the stem becomes `<stem>-2`, `<stem>-3`, and so on. After an error or an
    interruption, no file of the recording remains.

    Args:
        folder: folder in which the files are written. If the folder does not exist, it is created.
        stem: common name of the files, without suffix.
        runs: runs with distinct names.
        metadata: metadata that apply to all runs; keys and values are texts.
        attachments: media type and content of each attached file, by name. Only the MCAP file contains attachments; a Rerun
            file cannot contain them.

    Returns:
        Paths of the written files, with the keys `mcap`, `layout` and `rerun`.

    Raises:
        InputError: the folder cannot be created, the files cannot be written, or two runs have the same name.

    Example:
        The function `sim.run_log` returns the runs to record; see the example of `run_log`:

        >>> from sim import record, run_log
    """
    names = [run.name for run in runs]
    if len(set(names)) < len(names):
        raise InputError(f"at least two of the run names {', '.join(names)} are equal; give each run a different name")
    try:
        # The temporary files are in the folder of the final files, so that the renaming at the end does not copy data.
        with made_folder(folder, "logs"), tempfile.TemporaryDirectory(dir=folder, prefix=f".{stem}-") as temporary:
            written = {kind: Path(temporary, f"run.{suffix}") for kind, suffix in SUFFIXES.items()}
            write_mcap(written["mcap"], runs, metadata, attachments)
            for kind in RECORDINGS:
                RECORDINGS.load(kind)(written[kind], runs, metadata)
            return _publish_files(written, folder, stem)
    except OSError as error:
        raise InputError(
            f"cannot write recordings in {folder} ({error.strerror or error}); give a writable folder with free space"
        ) from error


def _publish_files(written: Mapping[str, Path], folder: Path, stem: str) -> dict[str, Path]:
    """Renames completely written files to the first name that is free for all of them. Returns the final paths of the files."""
    for number in itertools.count(1):
        name = stem if number == 1 else f"{stem}-{number}"
        final = {kind: folder / f"{name}.{SUFFIXES[kind]}" for kind in written}
        ours: list[Path] = []
        try:
            # Renaming would overwrite an existing file without a warning. A new empty file therefore reserves the name, so that
            # other processes cannot use it either.
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
