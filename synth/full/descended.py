"""Controllers by descent, beside those from Riccati equations: a static gain, and the best of the others, all its numbers free.

The central law is one of a family, and where its regularisation costs something another may be nearer and slower. A controller of
fewer states, down to a static gain, is one of full order, too.
"""

import contextlib

import numpy as np

from models.common.errors import InputError
from models.law import LinearLaw, static_law
from synth.certificate.lower_bound import LowerBound
from synth.dynamic.loop import on_larger_plant
from synth.full.riccati import Search, Traded
from synth.search.refine import refine
from synth.search.static import LARGEST_GAIN, static_output_feedback

BEYOND = 10.0  # times the gain that makes poles as fast as they may be
SHARES_OF_GAIN = np.geomspace(1.0, 1e-3, 150)[1:]  # 5 % apart
MOST = 100  # numbers of a law with which a descent takes seconds


def descents(search: Search, start: Traded | None, fastest: float) -> list[Traded]:
    """What descents find: a static gain, and a law of as many states as the start's; none of a plant that is too large.

    Args:
        search: of the plant, in whose own units it is descended.
        start: the law to descend from; None where there is none.
        fastest: times the plant's own speed: what a pole may be.
    """
    own, found = search.own, list[Traded | None]()
    n, (q, m) = len(own.plant.A), (len(own.Cy), own.plant.B.shape[1])
    if (n + m) * (n + q) > MOST:
        return []
    # In own units a gain of one makes poles of size one, of a plant without feedthrough; so do gains that a fast loop needs.
    largest = max(LARGEST_GAIN, BEYOND * fastest * search.fastest / own.rate)
    with contextlib.suppress(InputError, np.linalg.LinAlgError):
        gain = static_output_feedback(own.plant, own.Cy, largest, LowerBound(search.bound), own.Dyw).gain
        found.append(search.judged(0.0, static_law(gain)))
        # Where that is too fast the best that is not lies before it, on the way from no control.
        fractions = (search.judged(0.0, static_law(share * gain)) for share in SHARES_OF_GAIN)
        slower = [each for each in fractions if each is not None and each.speed_up <= fastest]
        found.append(min(slower, key=lambda each: each.norm, default=None))
    if start is not None and start.own.states:
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            larger, G = on_larger_plant(own.plant, own.Cy, start.own)
            noise = np.vstack([own.Dyw, np.zeros((start.own.states, own.Dyw.shape[1]))])
            gain = refine(larger, G.Cy, G.K, noise).gain
            law = LinearLaw(A=gain[m:, q:], B=gain[m:, :q], C=gain[:m, q:], D=gain[:m, :q])
            found.append(search.judged(0.0, law))
    return [each for each in found if each is not None]
