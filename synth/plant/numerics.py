"""Common settings of all computations: only one BLAS thread, and an error with a message if a computation fails."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from models.common.errors import InputError
from models.common.threads import one_thread


class DesignError(InputError):
    """Failure of a design. The error message describes the problem, its usual cause and what the user can do."""

    exit_code = 1  # the exit code is 1, because the failure is not an error in the input


class InfeasibleError(DesignError):
    """Error that is raised if it is proved that no controller of the requested type stabilises the plant.

    The error message names the mode that cannot be stabilised, or gives a different reason.
    """


class NoSolutionError(DesignError):
    """Error that is raised if an LMI problem has no solution with eta > 0. A controller that stabilises the plant may still
    exist.
    """


class TooLargeError(DesignError):
    """Error that is raised if an LMI problem has more optimisation variables than the central-path method allows."""


# A wrong shape is a programming error of Roadproof, even though numpy raises a LinAlgError for it.
INTEGRATOR_POLE = 1e-9  # a pole belongs to an integrator if its relative distance from 0 is smaller than this
OF_SHAPES = ("dimension", "square", "shape")
NUMERIC = (  # words that numpy, scipy, LAPACK and Python use in messages about numerical failures
    *("infs", "NaN", "finite", "singular", "hermitian", "math domain error", "illegal value"),
    *("Reordering", "ill-conditioned", "converge"),
)


def of_rounding(error: BaseException) -> bool:
    """Returns True if an error is caused by rounding (such as a singular matrix), not by a mistake (such as a wrong shape)."""
    message = str(error)
    if isinstance(error, np.linalg.LinAlgError):
        return not any(word in message for word in OF_SHAPES)
    return isinstance(error, ArithmeticError) or (
        isinstance(error, ValueError) and not isinstance(error, InputError) and any(word in message for word in NUMERIC)
    )


@contextmanager
def up_to_rounding() -> Iterator[None]:
    """Ends the `with` block without a message if an error is due to rounding, for example in a descent at the limit of
    stability.
    """
    try:
        yield
    except (ValueError, ArithmeticError) as error:
        if not of_rounding(error):
            raise


@contextmanager
def numerics() -> Iterator[None]:
    """Runs a block or a decorated function with one BLAS thread and without warnings about overflow.

    If a computation of linear algebra fails, a DesignError is raised. Results can be infinite or NaN, so the callers check
    them.

    Raises:
        DesignError: numpy or scipy reports that a matrix is singular or not finite.
    """
    with one_thread(), np.errstate(all="ignore"):
        try:
            yield
        except (ValueError, ArithmeticError) as error:
            if not of_rounding(error):
                raise
            raise DesignError(f"rounding errors prevent a result ({error}); give the plant in other units") from error
