"""What every door to a computation has in common: one thread, and rounding's failures in the words of this package."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from models.common.errors import InputError
from models.common.threads import one_thread
from synth.errors import DesignError


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
        except InputError:
            raise
        except (ValueError, ArithmeticError) as error:  # a ValueError is LinAlgError, and scipy's word for what is not finite
            raise DesignError(f"rounding leaves no answer ({error}); give the plant in other units") from error
