"""Formats of results: numbers of digits that code outside `models/document` and the fields of tables chooses itself.

`python -m tests.house.formats` prints all of them. `--lower` writes their numbers into `MOST` of this file if they are smaller.

Exempt are the texts of errors, generated code, and formats without a number of digits, such as `:g` for a number from a file.
"""

import sys
from collections import defaultdict

from tests.house import prose
from tests.support.sources import sources

EXEMPT = ("models/document/", "synth/controller/export/")
MOST = {  # formats in a folder: lower these, never raise them
    "models/common": 2,
    "models/kinds": 2,
    "models/laws": 6,
    "models/roads": 4,
    "models/suspension": 4,
    "models/vehicle": 3,
    "synth/analysis": 13,
    "synth/command": 1,
    "synth/controller": 3,
    "synth/design": 12,
    "synth/vehicle": 3,
    "sim/command": 3,
    "sim/physics": 3,
    "sim/recording": 1,
    "sim/report": 4,
    "sim/response": 7,
    "sim/runs": 6,
    "sim/studies": 5,
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
