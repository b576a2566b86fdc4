"""Formats of results: numbers of digits that code chooses itself, outside fields of tables, documents and the shared formats.

`python -m tests.house.formats` prints all of them. `--lower` writes their numbers into `MOST` of this file if they are smaller.

Exempt are the texts of errors, the shared formats of `models/common/printed.py`, generated code, and formats without a number
of digits, such as `:g` for a number from a file.
"""

import sys
from collections import defaultdict

from tests.house import prose
from tests.support.sources import sources

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


def findings() -> dict[str, list[str]]:
    """Returns the formats in each folder."""
    found: dict[str, list[str]] = defaultdict(list)
    for file, source in sources().items():
        if source.formats and not file.startswith(EXEMPT):
            folder = "/".join(file.split("/")[:2]).removesuffix(".py")
            found[folder] += [f"{file}: {each}" for each in source.formats]
    return found


if __name__ == "__main__":
    sys.exit(prose.report(__file__, MOST, findings()))
