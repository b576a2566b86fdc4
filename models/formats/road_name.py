"""The name of a road that lies in a file: the file, and how it is to be read, as in `road.csv:height_unit=mm`."""

import re

FILE = re.compile(r"(?P<path>.+\.(?P<suffix>csv|txt|crg))(?P<settings>(:\w+=[^:]*|:[^:\\/]*)*)", re.IGNORECASE | re.DOTALL)
