"""Linearisation of parts at equilibrium: keys and descriptions of characteristics, and internal states in linear models."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.characteristics.curve_reading import Argument
from models.common.arrays import Array
from models.common.extensions import PARTS
from models.common.printed import rough
from models.kinds.kind import Suspension
from models.kinds.linear_model import LinearModel
from models.parts.part import SuspensionPart


def curvable(suspensions: Sequence[Suspension]) -> dict[str, Argument]:
    """Returns the parameters that a characteristic can replace, each with the argument of the characteristic."""
    over = dict[str, Argument]()
    for part in PARTS.load_all().values():
        if (replaces := part.replaces) is not None:
            over |= {parameter: replaces[1] for one in suspensions if (parameter := getattr(one, replaces[0]))}
    return over


def lines_at_rest(curves: Sequence[SuspensionPart]) -> str:
    """Describes the linearisation of characteristics: slope at equilibrium, and range of slopes.

    The text is empty if all characteristics are straight.

    As in `[parameters]`, the slopes of an element do not include the stiffness that a preload adds.
    """
    bent = {one.name: one for one in curves if one.curve.is_nonlinear}
    slopes = {
        name: [(slope - one.part.line.of_preload) / one.ratio**2 for slope in (one.curve.slope, *one.curve.slope_range)]
        for name, one in bent.items()
    }
    return ", ".join(
        "{} {:g} {} (slope of the whole curve: {:g} to {:g})".format(
            name, float(rough(at)), "N s/m" if bent[name].damps else "N/m", float(rough(low)), float(rough(high))
        )
        for name, (at, low, high) in slopes.items()
    )


def with_own_states(
    model: LinearModel, parts: Sequence[SuspensionPart], rows: Array, speeds: Array, push: Array, shown: Array
) -> LinearModel:
    """Returns a linear model of n states, extended by the linearised internal states of e parts.

    Args:
        model: linear model without the internal states.
        parts: e parts, each with its suspension.
        rows: gains from the states to the deflections of the parts' suspensions, shape (e, n).
        speeds: gains from the states to the rates of the suspensions' deflections, shape (e, n).
        push: effect of forces along the suspensions on the derivatives of the states, shape (n, e).
        shown: effect of forces along the suspensions on the p outputs, shape (p, e).
    """
    names = tuple(signal.name for one in parts for signal in one.states)
    if not names:
        return model
    n, end = len(model.A), 0
    rates, B, pulls = (
        np.zeros((len(names), n + len(names))),
        np.zeros((len(names), len(model.inputs))),
        np.zeros((len(parts), len(names))),
    )
    for i, one in enumerate(parts):
        line, own, end = one.part.line, slice(end, end + len(one.states)), end + len(one.states)
        if line.of_states is None or line.rates is None:
            continue
        of_states, of_travel, of_speed, of_input = np.split(line.rates, np.arange(3) + len(one.states), axis=1)
        rates[own, :n], rates[own, n:][:, own] = of_travel * rows[i] + of_speed * speeds[i], of_states
        if one.part.inputs:
            B[own, [model.inputs.index(one.place.force)]] = of_input
        pulls[i, own] = line.of_states
    with_them = model.with_states(names, rates, {"B": B})
    A, C = np.array(with_them.A), np.array(with_them.C)
    A[:n, n:], C[: len(model.C), n:] = push @ pulls, shown @ pulls
    return replace(with_them, A=A, C=C)
