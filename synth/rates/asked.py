"""The sample periods that `--rates` asks for."""

from collections.abc import Sequence

from models.common.errors import InputError
from models.reality import LONGEST_PERIOD
from synth.rates.lost import SHORTEST

MOST = 1000  # rates in one table


def periods_of(rates: Sequence[float]) -> list[float]:
    """Sample periods [s], ascending, of as many in milliseconds.

    Raises:
        InputError: one is beyond its limits or given twice, or they are too many.
    """
    for rate in rates:
        if not 1e3 * SHORTEST <= rate <= 1e3 * LONGEST_PERIOD:  # NaN is within no limits
            raise InputError(
                f"--rates {rate:g} ms is not allowed; give sample periods from {1e3 * SHORTEST:g} to {1e3 * LONGEST_PERIOD:g} ms"
            )
        if list(rates).count(rate) > 1:
            raise InputError(f"--rates {rate:g} ms is given twice; give it once")
    if len(rates) > MOST:
        raise InputError(f"--rates asks for {len(rates)} sample periods; give at most {MOST}")
    return sorted(rate / 1e3 for rate in rates)
