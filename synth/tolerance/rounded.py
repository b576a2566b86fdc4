"""A law whose numbers are rounded to what small computers hold, and what that costs."""

from collections.abc import Callable

import numpy as np

from models.common.arrays import Array
from models.law import LinearLaw
from synth.certificate.bounding import certify_tightly
from synth.certificate.certificate import Certificate
from synth.plant import Feedback, GeneralizedPlant

INT16 = 2**15 - 1  # the largest number
FLOAT16 = 2.0**15  # a matrix is held over the power of two that brings its largest entry below this, where it is beyond
FORMATS = ("int16", "float16")


def rounding(
    law: LinearLaw, closed: Callable[[LinearLaw], tuple[GeneralizedPlant, Feedback]], plant: GeneralizedPlant
) -> dict[str, Certificate]:
    """What is true of a law in each of `FORMATS`.

    Args:
        law: the law.
        closed: what a law is a gain of.
        plant: without the law's states.
    """
    return {to: certify_tightly(*closed(rounded(law, to)), by_itself=plant) for to in FORMATS}


def rounded(law: LinearLaw, to: str) -> LinearLaw:
    """A law with its matrices in another format.

    Args:
        law: the law.
        to: "int16", each matrix over its largest entry; or "float16", each as it is, or over a power of two where it is beyond.
    """
    number = {"int16": _int16, "float16": _float16}[to]
    return LinearLaw(number(law.A), number(law.B), number(law.C), number(law.D), law.sample_period)


def _int16(matrix: Array) -> Array:
    largest = np.abs(matrix).max(initial=0.0)
    return np.round(matrix / largest * INT16) * (largest / INT16) if largest else matrix


def _float16(matrix: Array) -> Array:
    largest = np.abs(matrix).max(initial=0.0)
    scale = 2.0 ** max(0, np.ceil(np.log2(largest / FLOAT16))) if largest else 1.0
    return (matrix / scale).astype(np.float16).astype(float) * scale
