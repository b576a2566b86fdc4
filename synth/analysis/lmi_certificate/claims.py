"""Claims about upper bounds, for LMI certificates. Each claim contains an X that proves its bound in rational arithmetic.

X is computed in floats and rounded to as few bits as the proof allows, which keeps the files short. The code of
`check_certificate.py` then checks the claim. A claim is returned only if the check of `check_certificate.py` proves the claim.
"""

from collections.abc import Iterator
from decimal import ROUND_CEILING
from itertools import product
from typing import Any

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.extensions import FEATURES
from synth.analysis.bounding import bounding_x
from synth.analysis.certificate import eta_of, prove_bound
from synth.analysis.lmi_certificate.check_certificate import ExactLoop, Matrix
from synth.analysis.lmi_certificate.rational import decimal, exact, floats, rational, rounded, rows, shortened
from synth.analysis.norm import Norm, hinf_norm
from synth.analysis.rigorous import definiteness
from synth.analysis.stability import balance, stability
from synth.analysis.uncertainty_box import BoxProof
from synth.plant.generalized import Plant

Claim = dict[str, Any]

NOISE = (0.3, 1e-1, 1e-3)  # noise powers that `bounding_x` adds, relative to the gap between bound and norm
EVERYWHERE = (1e-3, 1e-6, 1e-9, 1e-12)  # fractions of this noise that act on every state in `bounding_x`, tried in this order
# relative gaps between bound and norm, tried in this order if the user gives no bound
ABOVE = (1e-6, 1e-4, 1e-2, 0.1)
# relative amounts by which the tried rates are below the decay rate of the slowest pole, if the user gives no rate
SLOWER = (1e-3, 1e-2, 0.1)


def norm_claim(loop: ExactLoop, dt: float | None = None, bound: float | None = None, known: Array | None = None) -> Claim | None:
    """Returns the claim that a loop is stable and its norm is below a bound; None if the claim is not proved.

    Args:
        loop: closed loop in rational arithmetic.
        dt: sample period [s]; None for a continuous loop.
        bound: upper bound that the claim states for the norm. If `bound` is None, the claim uses a value just above the norm.
        known: matrix X that proves the bound, shape (n, n); None if no matrix that proves the bound is known.
    """
    plain = floats(loop, dt)
    if not stability(plain.A, dt).stable:
        return None
    peak = hinf_norm(plain)
    norm = peak.value
    for level in (bound,) if bound is not None else [rounded(norm * (1 + above), 9, ROUND_CEILING) for above in ABOVE]:
        if not norm < level < np.inf:
            continue
        for X in _bounding(plain, level, peak, known):
            for short in shortened(X):
                near = prove_bound(plain, np.zeros((0, len(X))), short, eta_of(level)).holds
                if near and loop.norm(exact(short), decimal(level)):
                    return {"kind": "norm", "bound": rational(decimal(level)), "X": rows(short)}
    return None


def _bounding(loop: Plant, level: float, norm: Norm, known: Array | None) -> Iterator[Array]:
    """Yields matrices X that may prove the bound `level` on the norm of a loop."""
    turned = norm.peak_frequency * (loop.dt or 0.0) > np.pi / 2
    image = FEATURES.load("discrete plants").continuous_loop(loop, turned=turned)
    margin = min(level / norm.value - 1, 1.0) if norm.value else 1.0
    for more, everywhere in product(NOISE, EVERYWHERE):
        try:
            X = (loop.dt or 1.0) * bounding_x(image, level, more * margin, everywhere)
        except (np.linalg.LinAlgError, ValueError):
            continue
        if np.all(np.diagonal(X) > 0):
            yield X
    if known is not None:
        yield known


def decay_claim(loop: ExactLoop, dt: float | None = None, rate: float | None = None) -> Claim | None:
    """Returns the claim that all poles of a loop decay faster than a rate; None if the claim is not proved.

    Args:
        loop: closed loop in rational arithmetic.
        dt: sample period [s]; None for a continuous loop.
        rate: decay rate [1/s]; for a discrete loop, the largest allowed |z|. If `rate` is None, the claim uses a value close to
            the decay rate of the slowest pole.
    """
    plain = floats(loop, dt)
    growth = float(stability(plain.A, dt).growth.max())
    slowest = -growth if dt is None else 1 + growth
    trials = [rounded(slowest * (1 - less), 4) for less in SLOWER]
    if dt is not None:
        trials = [rounded(slowest + less * (1 - slowest), 9, ROUND_CEILING) for less in SLOWER]
    for each in trials if rate is None else (rate,):
        A = plain.A + each * np.eye(len(plain.A)) if dt is None else plain.A / each
        balanced, scale = balance(A)
        noise = np.eye(len(A)) * np.linalg.norm(balanced)
        if dt is None:
            solved = linalg.solve_continuous_lyapunov(balanced, -noise)
        else:
            solved = linalg.solve_discrete_lyapunov(balanced, noise)
        X = scale[:, None] * (solved + solved.T) / 2 * scale
        for short in shortened(X) if np.all(np.diagonal(X) > 0) else ():
            if definiteness(short).proved and loop.decay(exact(short), decimal(each)):
                return {"kind": "decay", "rate": rational(decimal(each)), "X": rows(short)}
    return None


def peak_claim(loop: ExactLoop, bound: float, X: Array) -> Claim | None:
    """Returns the claim that |z| does not exceed a bound for any w of energy 1; None if the claim is not proved.

    Args:
        loop: closed loop in rational arithmetic, without feedthrough from w to z.
        bound: upper bound that the claim states for |z|.
        X: solution of the Lyapunov inequality that proves the bound, shape (n, n).
    """
    level = decimal(np.nextafter(bound, np.inf))  # the value is rounded up, so it is not below `bound`
    for short in shortened(X):
        if definiteness(short).proved and loop.energy_to_peak(exact(short), level):
            return {"kind": "energy_to_peak", "bound": rational(level), "X": rows(short)}
    return None


def box_claims(loop: ExactLoop, proof: BoxProof, rate: float | None = None) -> list[Claim] | None:
    """Returns one claim for each part of a box of gain errors; None if a claim is not proved.

    Either all claims of the list bound the norm, or all claims bound the decay rate.

    Args:
        loop: closed loop without gain errors, in rational arithmetic.
        proof: box of gain errors, split into parts, with a matrix X that proves the bound for each part.
        rate: decay rate that is proved for every part [1/s]; None if a bound on the norm is proved instead.
    """
    what = {"of": "norm", "bound": decimal(proof.bound)} if rate is None else {"of": "decay", "rate": decimal(rate)}
    claims = list[Claim]()
    for box, X in proof.parts:
        low, high = ([[decimal(x) for x in ends]] for ends in (box.low, box.high))
        short = next((M for M in shortened(X) if loop.box(low=Matrix(low), high=Matrix(high), X=exact(M), **what)), None)
        if short is None:
            return None
        texts = {key: value if isinstance(value, str) else rational(value) for key, value in what.items()}
        claims.append({"kind": "box", **texts, "low": rows(low), "high": rows(high), "X": rows(short)})
    return claims
