"""The name of a road that lies in a file: the file, and how it is to be read, as in `road.csv:height_unit=mm`."""

import re

SETTINGS = r"(?P<settings>(:\w+=[^:]*|:[^:\\/]*)*)"
FILE = re.compile(rf"(?P<path>.+\.(?P<suffix>csv|txt|crg)){SETTINGS}", re.IGNORECASE | re.DOTALL)
RIG = re.compile(rf"rig:file=(?P<path>.+\.(?P<suffix>csv|txt)){SETTINGS}", re.IGNORECASE | re.DOTALL)


def named_file(text: str) -> tuple[str, str] | None:
    """The file that a road's text names, and what a road of it describes itself as; None where it names none."""
    if found := RIG.fullmatch(text):
        return found["path"], "rig"
    found = FILE.fullmatch(text)
    return (found["path"], "profile") if found else None
