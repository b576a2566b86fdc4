"""Common frame of every computation: one thread, and failures that are raised, never returned as an empty result."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from models.common.errors import InputError
from models.common.threads import one_thread


class DesignError(InputError):
    """Failure of a design. The message contains the problem, its usual cause and what to do."""

    exit_code = 1  # the input is valid


class InfeasibleError(DesignError):
    """Proof that no such controller stabilises the plant. The message names the mode, or what else forbids it."""


class NoSolutionError(DesignError):
    """An LMI problem has no solution with eta > 0. There may be a controller nevertheless."""


class TooLargeError(DesignError):
    """The LMI problem has more unknowns than its central path is followed with."""


# Shapes that do not fit are a fault of this package's own, even where numpy calls them a LinAlgError.
OF_SHAPES = ("dimension", "square", "shape")
NUMERIC = (  # what numpy, scipy, LAPACK and Python say
    *("infs", "NaN", "finite", "singular", "hermitian", "math domain error", "illegal value"),
    *("Reordering", "ill-conditioned", "converge"),
)


def of_rounding(error: BaseException) -> bool:
    """Returns True if an error comes from rounding, as for a singular matrix, not from a mistake like a wrong shape."""
    message = str(error)
    if isinstance(error, np.linalg.LinAlgError):
        return not any(word in message for word in OF_SHAPES)
    return isinstance(error, ArithmeticError) or (
        isinstance(error, ValueError) and not isinstance(error, InputError) and any(word in message for word in NUMERIC)
    )


@contextmanager
def up_to_rounding() -> Iterator[None]:
    """Ends the block silently on an error that comes from rounding, as in a descent on the border of stability."""
    try:
        yield
    except (ValueError, ArithmeticError) as error:
        if not of_rounding(error):
            raise


@contextmanager
def numerics() -> Iterator[None]:
    """Limits BLAS to one thread in a block or decorated function, silences overflow, and turns failed linear algebra into errors.

    Results that are not finite are refused where they would count.

    Raises:
        DesignError: numpy or scipy found a matrix that is singular, or not finite.
    """
    with one_thread(), np.errstate(all="ignore"):
        try:
            yield
        except (ValueError, ArithmeticError) as error:
            if not of_rounding(error):
                raise
            raise DesignError(f"rounding errors prevent a result ({error}); give the plant in other units") from error
