"""The forces that a law in Python asked for, as a log has them attached: CSV, a row per sample, every digit."""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError

LONGEST = 26  # characters of a number and its separator


def written_forces(names: Sequence[str], forces: Array) -> bytes:
    """Forces [N] of these names, shape (T, m), as text."""
    rows = (",".join(map(repr, row)) for row in forces.tolist())
    return "\n".join([",".join(names), *rows, ""]).encode()


def read_forces(content: bytes, names: Sequence[str], samples: int) -> Array:
    """Forces [N], shape (T, m), from such text.

    Args:
        content: the text.
        names: of the forces.
        samples: how many there must be.

    Raises:
        InputError: it is none of these forces, or of another number of samples.
    """
    heading, m = (",".join(names) + "\n").encode(), len(names)
    if not content.startswith(heading) or len(content) > len(heading) + LONGEST * m * samples:
        raise InputError(f"the forces of its law are no table of {', '.join(names)} at {samples} samples")
    try:
        rows = content.decode("ascii").split("\n")[1:-1]
        forces = np.array([[float(number) for number in row.split(",")] for row in rows]).reshape(samples, m)
    except ValueError:
        raise InputError(f"the forces of its law are not {samples} rows of {m} numbers") from None
    if not np.all(np.isfinite(forces)):
        raise InputError("a force of its law is not finite")
    return forces
