"""H-infinity norm of a loop within a frequency band, computed from level sets and from a frequency sweep.

The norm in a band is computed by the same two methods as the norm over all frequencies (`synth/analysis/norm.py`). Two gains,
called levels, enclose the norm. At some frequency in the band, the gain reaches the lower level. The upper level is slightly
higher than the lower level, and the gain does not exceed the upper level anywhere in the band. To check the upper level, the
imaginary part of every eigenvalue of the Hamiltonian matrix counts as a frequency of a possible crossing of the level. The real
part of the eigenvalue is ignored. Between two neighbouring crossings, or between a crossing and an edge of the band, the gain
is either everywhere above the level or nowhere.

**A norm in a band does not imply stability**, and it implies nothing about frequencies outside the band. For a stable loop, the
norm is the largest amplification of a sinusoid whose frequency is in the band. An unstable loop also has a frequency response,
but the response of this loop to a sinusoid never reaches a steady state. The norm of an unstable loop is therefore not an
amplification.
"""

from dataclasses import dataclass

import numpy as np

from models.common.errors import InputError, short_repr
from models.common.printed import digits, rough
from synth.analysis.norm import EXACT, Gain, Norm, by_both_routes, proposals
from synth.analysis.specification import FREQUENCY
from synth.analysis.stability import Stability, stability
from synth.analysis.twice_precision import discrete_by_both_routes
from synth.plant.discrete import continuous_loop, mapped_frequency, true_frequency
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError, numerics


@dataclass(frozen=True, eq=False)
class BandNorm:
    """Largest gain of a loop within a frequency band.

    Attributes:
        value: largest gain in the band; infinite if a pole lies on the imaginary axis within the band.
        peak_frequency: frequency in the band at which the gain is `value` [rad/s]. The peak frequency may be an edge of the
            band.
        level: upper bound on the gain in the band, slightly above `value`.
        low: lower edge of the band [rad/s].
        high: upper edge of the band [rad/s]; may be infinite.
        gap: relative difference between the largest gains that the two methods (level sets and sweep) found.
        rounding: first-order bound on the relative rounding error of `value`.
        stability: stability of the loop (stable, marginal or unstable). If the loop is unstable, `value` is not an
            amplification.
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
        """One-line description of the norm in the band."""
        band = f"{rough(self.low / (2 * np.pi))} to {rough(self.high / (2 * np.pi))} Hz"
        if not np.isfinite(self.value):
            return f"norm from {band}: infinite, as a pole at {rough(self.peak_frequency)} rad/s does not decay"
        text = f"norm from {band}: at most {digits(self.value)}, reached at {FREQUENCY.text(self.peak_frequency)}"
        return text if self.stability.stable else f"{text}, but no sinusoid settles: the loop is {self.stability.words}"


@numerics()
def norm_in_band(loop: Plant, low: float, high: float) -> BandNorm:
    """Returns the largest gain from w to z within a frequency band, with the control u = 0.

    Args:
        loop: loop in continuous or discrete time; for a plant with a controller, use `plant.closed_loop(...)`.
        low: lower edge of the band, at least 0 [rad/s].
        high: upper edge of the band, above `low` [rad/s]; may be infinite. The gain of a discrete loop is periodic in
            frequency, so the gains above pi / dt are the same as those below.

    Returns:
        Largest gain, the frequency [rad/s] of this gain, and an upper bound on the gain in the band, as a `BandNorm`.

    Raises:
        InputError: the frequency band is empty or out of range.
        DesignError: the loop is discrete and has a pole at z = -1.

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
    """Raises an InputError unless 0 <= low < high [rad/s]."""
    if not 0 <= low < high:
        raise InputError(
            f"low = {short_repr(low)} and high = {short_repr(high)} rad/s do not form a frequency band; give a low of at "
            "least 0, and a high above low"
        )


def _gain(loop: Plant, low: float, high: float) -> Gain:
    check_band(low, high)
    if loop.dt is None:
        return Gain(loop, low, high)
    if low * loop.dt >= np.pi:
        raise InputError(
            f"low = {low:g} rad/s is not below the Nyquist frequency, which is {np.pi / loop.dt:g} rad/s for a sample "
            f"period of {loop.dt:g} s; give a smaller low"
        )
    try:
        mapped = continuous_loop(loop)
    except np.linalg.LinAlgError:
        raise DesignError(
            "the bilinear transformation to continuous time has no value for a pole at z = -1; give a loop without this pole"
        ) from None
    return Gain(mapped, mapped_frequency(low, loop.dt), mapped_frequency(high, loop.dt))


def exceeds(gain: Gain, level: float) -> bool:
    """Returns True if the gain exceeds the level at some frequency in the band. The argument `gain` specifies the loop and the
    frequency band.
    """
    if gain.high == np.inf and gain.at_infinity > level:
        return True
    return bool(np.any(gain.at(proposals(gain, level)[0]) > level))
