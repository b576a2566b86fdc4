"""Formats of results: numbers of digits that code chooses itself, outside fields of tables, documents and the shared formats.

`python -m tests.house.formats` prints all of them. `--lower` writes their numbers into `MOST` of this file if they are smaller.

Exempt are the texts of errors, the shared formats of `models/common/printed.py`, generated code, and formats without a number
of digits, such as `:g` for a number from a file.
"""

import sys
from collections.abc import Iterator, Mapping

from tests.house import prose
from tests.support.sources import Source, sources

EXEMPT = ("models/document/", "models/common/printed.py", "synth/controller/export/")
MOST = {  # formats in a folder: lower these, never raise them
    "models/kinds": 2,
    "models/laws": 2,
    "models/roads": 4,
    "models/characteristics": 1,
    "synth/analysis": 4,
    "synth/command": 1,
    "synth/controller": 3,
    "synth/design": 4,
    "sim/recording": 1,
    "sim/report": 2,
    "sim/runs": 3,
    "sim/studies": 3,
}


def own_formats(code: Mapping[str, Source]) -> Iterator[prose.Finding]:
    """Yields a finding for each format with digits of its own."""
    for file, source in code.items():
        for each in () if file.startswith(EXEMPT) else source.formats:
            yield prose.Finding(file, "digits of a number", "use a format of models/common/printed.py, or a Field", each)


def findings() -> dict[str, list[prose.Finding]]:
    """Returns the formats in each folder."""
    return prose.by_folder(own_formats(sources()), depth=2)


if __name__ == "__main__":
    sys.exit(prose.report(__file__, MOST, findings()))
