"""The norm of a loop within a band: the largest singular value on a stretch of the imaginary axis, its edges included.

It is found as the norm on the whole axis is (`synth/certificate/norm.py`), by the same two routes. What it is stands between two
levels: one that the gain reaches at a frequency of the band, and one slightly above that no frequency of the band exceeds. For
the second every eigenvalue of the Hamiltonian is asked, whatever its real part: between two frequencies that they propose, and
between one and an edge, the gain lies above the level everywhere or nowhere.

**A band says nothing of stability**, nor of what lies beside it. Of a stable loop it is the most that a sinusoid of such a
frequency is amplified by. An unstable loop has a largest singular value too, but no sinusoid ever settles in it: there the number
is that of a formula, and nothing else.
"""

from dataclasses import dataclass

import numpy as np

from models.common.errors import InputError, quoted
from synth.certificate.gain import Gain
from synth.certificate.norm import EXACT, Norm, by_both_routes, discrete_by_both_routes, proposals
from synth.certificate.stability import Stability, stability
from synth.discrete.bilinear import continuous_loop, mapped_frequency, true_frequency
from synth.errors import DesignError
from synth.numerics import numerics
from synth.plant import GeneralizedPlant


@dataclass(frozen=True, eq=False)
class BandNorm:
    """The largest gain within a band.

    Attributes:
        value: reached at `peak_frequency`; infinite where a pole lies on the band's stretch of the axis.
        peak_frequency: in the band [rad/s]; an edge counts.
        level: slightly above the value; no gain within the band exceeds it.
        low: where the band begins [rad/s].
        high: where it ends [rad/s]; may be infinite.
        gap: relative distance of the two routes to the value.
        rounding: relative; how far from the true one the value may be, to first order.
        stability: of the loop. Where it is not stable, nothing is amplified by the value: no sinusoid settles.
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
        """What it is, on one line."""
        band = f"{self.low / (2 * np.pi):.4g} to {self.high / (2 * np.pi):.4g} Hz"
        if not np.isfinite(self.value):
            return f"infinite from {band}: a pole at {self.peak_frequency:.4g} rad/s, to rounding, does not decay"
        text = f"at most {self.value:.7g} from {band}, reached at {self.peak_frequency:.5g} rad/s"
        return text if self.stability.stable else f"{text}, of a loop in which no sinusoid settles: {self.stability.words}"


@numerics()
def norm_in_band(loop: GeneralizedPlant, low: float, high: float) -> BandNorm:
    """The largest gain from w to z with u = 0 at any frequency from low to high.

    Args:
        loop: continuous or discrete; a controlled one is `plant.closed_loop(...)`.
        low: from 0 [rad/s].
        high: above low [rad/s]; may be infinite. Of a discrete loop what lies beyond pi / dt is the same again.

    Raises:
        InputError: the band is none.
        DesignError: a discrete loop has a pole at z = -1.
    """
    gain = _gain(loop, low, high)
    if gain.on_axis is not None:
        norm = Norm(np.inf, true_frequency(gain.on_axis, loop.dt), np.inf, np.inf)
    else:
        norm = by_both_routes(gain) if loop.dt is None else discrete_by_both_routes(loop, loop.dt, gain)
    level, margin = norm.value, max(2 * EXACT, norm.gap, norm.rounding)
    if 0 < level < np.inf:
        while _exceeded(gain, level := norm.value * (1 + margin)):
            margin *= 10
    found = stability(loop.A, loop.dt)
    return BandNorm(norm.value, norm.peak_frequency, level, low, high, norm.gap, float(norm.rounding), found)


@numerics()
def stays_below(loop: GeneralizedPlant, low: float, high: float, level: float) -> bool:
    """Whether no gain at a frequency from low to high exceeds a level, up to the rounding of eigenvalues.

    Args:
        loop: continuous or discrete.
        low: as for `norm_in_band`.
        high: likewise.
        level: above 0.

    Raises:
        InputError: the band is none, or the level.
        DesignError: a discrete loop has a pole at z = -1.
    """
    if not (_is_number(level) and 0 < level < np.inf):
        raise InputError(f"level = {quoted(level)} is no gain to stay below; give a finite number above 0")
    gain = _gain(loop, low, high)
    return gain.on_axis is None and not _exceeded(gain, level)


def check_band(low: float, high: float) -> None:
    """Raises an InputError where from low to high [rad/s] is no band."""
    if not (_is_number(low) and _is_number(high) and 0 <= low < high):
        raise InputError(
            f"from {quoted(low)} to {quoted(high)} rad/s is no band; give where it begins, from 0, and where it ends, above that"
        )


def _gain(loop: GeneralizedPlant, low: float, high: float) -> Gain:
    check_band(low, high)
    if loop.dt is None:
        return Gain(loop, low, high)
    if low * loop.dt >= np.pi:
        raise InputError(
            f"the band begins at {low:g} rad/s, and a loop sampled every {loop.dt:g} s has frequencies up to "
            f"{np.pi / loop.dt:g} rad/s; begin below that"
        )
    try:
        mapped = continuous_loop(loop)
    except np.linalg.LinAlgError:
        raise DesignError(
            "the loop has a pole at z = -1, where nothing decays, and no continuous loop does in a band what it does; give one "
            "without"
        ) from None
    return Gain(mapped, mapped_frequency(low, loop.dt), mapped_frequency(high, loop.dt))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.integer | np.floating)


def _exceeded(gain: Gain, level: float) -> bool:
    """Whether some frequency of its stretch has a higher gain."""
    if gain.high == np.inf and gain.at_infinity > level:
        return True
    return bool(np.any(gain.at(proposals(gain, level)[0]) > level))
