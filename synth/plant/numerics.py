"""What every door to a computation has in common: one thread, and failures that are raised, never returned as an empty result."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from models.common.errors import InputError
from models.common.threads import one_thread


class DesignError(InputError):
    """No controller could be designed. The message says what happened, what usually causes it, what to do."""


class BatchError(DesignError):
    """Some of many could not be designed. It carries those that were.

    Attributes:
        designs: what was designed, by index.
        failures: why the others were not, by index.
    """

    def __init__(self, message: str, designs: Mapping[int, Any], failures: Mapping[int, InputError]) -> None:
        super().__init__(message)
        self.designs, self.failures = dict(designs), dict(failures)


class InfeasibleError(DesignError):
    """The LMI problem has no solution with eta > 0."""


class TooLargeError(DesignError):
    """The LMI problem has more unknowns than its central path is followed with."""


# Shapes that do not fit are a fault of this package's own, even where numpy calls them a LinAlgError.
OF_SHAPES = ("dimension", "square", "shape")
NUMERIC = (  # what numpy, scipy, LAPACK and Python say
    *("infs", "NaN", "finite", "singular", "hermitian", "math domain error", "illegal value"),
    *("Reordering", "ill-conditioned", "converge"),
)


def of_rounding(error: BaseException) -> bool:
    """Whether an error says that floats leave no answer: a singular or infinite matrix, and no mistake such as a wrong shape."""
    said = str(error)
    if isinstance(error, np.linalg.LinAlgError):
        return not any(word in said for word in OF_SHAPES)
    return isinstance(error, ArithmeticError) or (
        isinstance(error, ValueError) and not isinstance(error, InputError) and any(word in said for word in NUMERIC)
    )


@contextmanager
def up_to_rounding() -> Iterator[None]:
    """What floats leave no answer to ends what is within, in silence: as a descent on the border of stability."""
    try:
        yield
    except (ValueError, ArithmeticError) as error:
        if not of_rounding(error):
            raise


@contextmanager
def numerics() -> Iterator[None]:
    """Within it, or in a function that it decorates, BLAS has one thread, and what leaves the range of floats does so in silence.

    What is not finite is refused where it would count. Where linear algebra finds no answer beyond rounding, that is said.

    Raises:
        DesignError: for what numpy and scipy raise of matrices that are singular, or not finite.
    """
    with one_thread(), np.errstate(all="ignore"):
        try:
            yield
        except (ValueError, ArithmeticError) as error:
            if not of_rounding(error):
                raise
            raise DesignError(f"rounding leaves no answer ({error}); give the plant in other units") from error
