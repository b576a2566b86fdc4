"""The norm of a loop within a band of frequencies: by level sets and sweeps.

The norm is computed like the norm on the whole axis (`synth/analysis/norm.py`), by the same two routes. It lies between two
levels: one that the gain reaches at a frequency of the band, and one slightly above, which no frequency of the band exceeds. To
check the upper level, the imaginary part of every eigenvalue of the Hamiltonian is tried as a crossing, whatever its real part.
Between neighbouring crossings, or a crossing and an edge, the gain lies above the level everywhere or nowhere.

**A norm in a band does not imply stability**, nor anything at other frequencies. For a stable loop, the norm is the largest
amplification of a sinusoid in the band. An unstable loop has a frequency response, too, but no sinusoid settles in it, so its
norm is not an amplification.
"""

from dataclasses import dataclass

import numpy as np

from models.common.errors import InputError, short_repr
from models.common.printed import digits, rough
from synth.analysis.norm import EXACT, Gain, Norm, by_both_routes, discrete_by_both_routes, proposals
from synth.analysis.specification import FREQUENCY
from synth.analysis.stability import Stability, stability
from synth.plant.discrete import continuous_loop, mapped_frequency, true_frequency
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError, numerics


@dataclass(frozen=True, eq=False)
class BandNorm:
    """The largest gain within a band, its frequency and a level that bounds it.

    Attributes:
        value: norm, attained at `peak_frequency`; infinite if a pole is on the axis within the band.
        peak_frequency: frequency of the peak, in the band, edges included [rad/s].
        level: slightly above the value; no gain within the band exceeds it.
        low: lower edge of the band [rad/s].
        high: upper edge [rad/s]; may be infinite.
        gap: relative difference between the two routes.
        rounding: first-order bound on the relative rounding error of the value.
        stability: stability of the loop; if it is unstable, the value is not an amplification.
    """

    value: float
    peak_frequency: float
    level: float
    low: float
    high: float
    gap: float
    rounding: float
    stability: Stability

    @property
    def words(self) -> str:
        """The norm in the band on one line."""
        band = f"{rough(self.low / (2 * np.pi))} to {rough(self.high / (2 * np.pi))} Hz"
        if not np.isfinite(self.value):
            return f"norm from {band}: infinite, as a pole at {rough(self.peak_frequency)} rad/s does not decay"
        text = f"norm from {band}: at most {digits(self.value)}, reached at {FREQUENCY.text(self.peak_frequency)}"
        return text if self.stability.stable else f"{text}, but no sinusoid settles: the loop is {self.stability.words}"


@numerics()
def norm_in_band(loop: Plant, low: float, high: float) -> BandNorm:
    """Returns the largest gain from w to z with u = 0 at any frequency from low to high.

    Args:
        loop: loop in continuous or discrete time; a controlled one is `plant.closed_loop(...)`.
        low: 0 or more [rad/s].
        high: upper frequency, above low [rad/s]; may be infinite. The gain of a discrete loop repeats beyond pi / dt.

    Raises:
        InputError: the band is empty or out of range.
        DesignError: a discrete loop has a pole at z = -1.

    Example:
        >>> from synth import GeneralizedPlant, Feedback, norm_in_band
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> loop = oscillator.closed_loop(Feedback(K=[[-2.0]], Cy=[[0, 1]]))
        >>> band = norm_in_band(loop, low=3.0, high=6.0)
        >>> f"{band.value:.4f}, at most {band.level:.4f}"
        '0.1450, at most 0.1450'
    """
    gain = _gain(loop, low, high)
    if gain.on_axis is not None:
        norm = Norm(np.inf, true_frequency(gain.on_axis, loop.dt), np.inf, np.inf)
    else:
        norm = by_both_routes(gain) if loop.dt is None else discrete_by_both_routes(loop, loop.dt, gain)
    level, margin = norm.value, max(2 * EXACT, norm.gap, norm.rounding)
    if 0 < level < np.inf:
        while exceeds(gain, level := norm.value * (1 + margin)):
            margin *= 10
    loop_stability = stability(loop.A, loop.dt)
    return BandNorm(norm.value, norm.peak_frequency, level, low, high, norm.gap, float(norm.rounding), loop_stability)


def check_band(low: float, high: float) -> None:
    """Raises an InputError if 0 <= low < high [rad/s] is violated."""
    if not 0 <= low < high:
        raise InputError(
            f"low = {short_repr(low)} to high = {short_repr(high)} rad/s is not a frequency band; give low from 0 upwards, and "
            "high above low"
        )


def _gain(loop: Plant, low: float, high: float) -> Gain:
    check_band(low, high)
    if loop.dt is None:
        return Gain(loop, low, high)
    if low * loop.dt >= np.pi:
        raise InputError(
            f"low = {low:g} rad/s is not below the Nyquist frequency, which is {np.pi / loop.dt:g} rad/s for a sample period of "
            f"{loop.dt:g} s; give a lower frequency"
        )
    try:
        mapped = continuous_loop(loop)
    except np.linalg.LinAlgError:
        raise DesignError(
            "the bilinear transformation to continuous time has no value for a pole at z = -1; give a loop without this pole"
        ) from None
    return Gain(mapped, mapped_frequency(low, loop.dt), mapped_frequency(high, loop.dt))


def exceeds(gain: Gain, level: float) -> bool:
    """Returns True if the gain exceeds the level at some frequency of its interval."""
    if gain.high == np.inf and gain.at_infinity > level:
        return True
    return bool(np.any(gain.at(proposals(gain, level)[0]) > level))
