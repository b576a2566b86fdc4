"""Mean characteristic of a measured hysteresis loop: the points of a test that moves a damper, spring or stop back and forth.

The measured force also depends on the direction of motion. Each point belongs to one of two branches: the argument rises on one
branch, and falls on the other branch. The force of each branch is averaged in bins of the argument. The characteristic is the
mean of both branches, and the hysteresis is half of their difference. Because of noise, the mean force may decrease in some
ranges of the argument. A mean force that decreases is replaced by the closest non-decreasing function in the least-squares
sense (isotonic regression).

If a damper has play or friction, its slope at velocity 0 differs from the coefficient of a linear damper that dissipates the
same energy in the test. For samples at a constant rate, the coefficient is the sum of F v divided by the sum of v^2, with force
F and velocity v. The note of the characteristic contains the slope at 0 and the coefficient of the linear damper.
"""

import numpy as np

from models.characteristics.curve import ForceCurve
from models.common.arrays import Array
from models.common.printed import rough

# Texts of the note about a measured hysteresis loop; the second text is used only for dampers
LOOP, ENERGY = "mean of a measured loop", "by dissipated energy"
TURN = 0.1  # a reversal of direction that is smaller than this share of the range counts as noise
OVERLAP = 0.5  # two branches that overlap by less than this share of the range do not form a loop
BINS = 200  # number of intervals over which each branch of a loop is averaged
ROUNDING = 1e-9  # a mean force at argument 0 below this share of the largest force counts as a rounding error


def mean_of_loop(x: Array, force: Array, unit: str, at_rest: bool) -> tuple[Array, Array, str] | None:
    """Returns the mean characteristic of a hysteresis loop, or None if the points do not form a loop.

    Args:
        x: velocity, deflection or compression at each point, in the order of the measurement, shape (n,).
        force: force at each value of the argument [N], shape (n,).
        unit: unit of the argument, for the returned phrase.
        at_rest: True to subtract the mean force at argument 0, which is caused by the gas in a damper.

    Returns:
        Argument (ascending) and force of the mean characteristic, shapes (k,), and a phrase for the characteristic's note. The
        phrase gives the largest hysteresis, the subtracted force and, for a damper, the coefficient of a linear damper that
        dissipates the same energy.
    """
    from scipy.optimize import isotonic_regression
    from scipy.signal import find_peaks

    span = float(np.ptp(x))
    tops, bottoms = (find_peaks(side * x, prominence=TURN * span)[0] for side in (1.0, -1.0))
    turns = np.sort(np.concatenate([tops, bottoms]))
    if not len(turns):
        return None
    to_top = np.isin(turns, tops)
    rising = np.append(to_top, not to_top[-1])[np.searchsorted(turns, np.arange(len(x)))]
    branches = [_bin_means(x[side], force[side], x.min(), span) for side in (rising, ~rising)]
    low, high = max(branch[0][0] for branch in branches), min(branch[0][-1] for branch in branches)
    if high - low < OVERLAP * span:
        return None
    grid = np.unique(np.concatenate([branch[0] for branch in branches]))
    grid = grid[(low <= grid) & (grid <= high)]
    grid = grid[np.append(True, np.diff(grid) > span / (10 * BINS))]
    up, down = (np.interp(grid, *branch) for branch in branches)
    half, mean = np.abs(up - down) / 2, np.asarray(isotonic_regression((up + down) / 2).x)
    widest, offset = int(half.argmax()), float(np.interp(0.0, grid, mean)) if at_rest else 0.0
    words = f"{LOOP}, hysteresis up to {round(half[widest], 1):g} N either way at {round(grid[widest], 4):g} {unit}"
    words += f", {round(offset, 1):g} N at rest subtracted" if abs(offset) > ROUNDING * np.abs(mean).max() else ""
    words += f"; {ENERGY} {rough((force - offset) @ x / (x @ x))} N s/m over the whole test" if at_rest else ""
    return grid, mean - offset, words


def slope_words(curve: ForceCurve) -> str:
    """Describes the slope at 0 of a loop's mean characteristic, and the range of arguments from which the slope is computed;
    empty without a loop.
    """
    if LOOP not in curve.note:
        return ""
    i = int(np.searchsorted(curve.x, 0.0))
    low, high = (round(float(x), 5) for x in (curve.x[i - 1], curve.x[i + 1]))
    slope, unit = ("N s/m", "m/s") if ENERGY in curve.note else ("N/m", "m")
    return f"; slope at rest {rough(curve.slope)} {slope}, from the mean of both branches between {low:g} and {high:g} {unit}"


def _bin_means(x: Array, force: Array, start: float, span: float) -> tuple[Array, Array]:
    """Returns argument and force of a branch, averaged over the points in each bin of the argument, in ascending order."""
    which = np.minimum(((x - start) / span * BINS).astype(int), BINS - 1)
    count = np.bincount(which, minlength=BINS)
    means = [np.bincount(which, values, BINS)[count > 0] / count[count > 0] for values in (x, force)]
    return means[0], means[1]
