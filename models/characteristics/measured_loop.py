"""Mean characteristic of a measured loop: the points of a test that moves a damper, spring or stop back and forth.

The force of such a test depends on the direction, too. The points belong to the branch on which the argument rises or to the one
on which it falls. Each branch is averaged in bins. The characteristic is the mean of both branches, and half of their difference
is the hysteresis. Noise may leave a mean that falls; the nearest one that does not, in least squares, takes its place (isotonic
regression).

With play or friction, a damper's slope at rest differs from the coefficient of the linear damper that dissipates as much energy
over the test, the sum of F v over the sum of v^2 for samples at even times. A remark contains both.
"""

import numpy as np

from models.characteristics.curve import ForceCurve
from models.common.arrays import Array
from models.common.printed import rough

LOOP, ENERGY = "mean of a measured loop", "by dissipated energy"  # in the phrase about a loop; the second for dampers
TURN = 0.1  # of the range: a smaller reversal is noise
OVERLAP = 0.5  # of the range: branches that share less are not those of a loop
BINS = 200  # of each branch
ROUNDING = 1e-9  # of the largest force


def mean_of_loop(x: Array, force: Array, unit: str, at_rest: bool) -> tuple[Array, Array, str] | None:
    """Returns the mean characteristic of a loop, or None if the points are not a loop.

    Args:
        x: argument in the order of the measurement, shape (n,).
        force: shape (n,) [N].
        unit: unit of the argument.
        at_rest: True if the force of the mean at 0 is subtracted, as the gas of a damper causes it.

    Returns:
        Argument and force, ascending, shapes (k,), and in a phrase the largest hysteresis, the subtracted force, and for a damper
        the coefficient that dissipates as much.
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
    """Returns the slope at rest of the mean of a loop, and the range over which it is taken; empty for other curves."""
    if LOOP not in curve.note:
        return ""
    i = int(np.searchsorted(curve.x, 0.0))
    low, high = (round(float(x), 5) for x in (curve.x[i - 1], curve.x[i + 1]))
    slope, unit = ("N s/m", "m/s") if ENERGY in curve.note else ("N/m", "m")
    return f"; slope at rest {rough(curve.slope)} {slope}, of the mean of both branches between {low:g} and {high:g} {unit}"


def _bin_means(x: Array, force: Array, start: float, span: float) -> tuple[Array, Array]:
    """Returns the mean points of a branch in bins of the argument, ascending."""
    which = np.minimum(((x - start) / span * BINS).astype(int), BINS - 1)
    count = np.bincount(which, minlength=BINS)
    means = [np.bincount(which, values, BINS)[count > 0] / count[count > 0] for values in (x, force)]
    return means[0], means[1]
