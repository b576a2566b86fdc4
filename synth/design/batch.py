"""The designs of `two_step.py` for many plants like one that is designed already: side by side, a few milliseconds each.

A gain is that of `two_step.py` to where the central path is stopped (`central_path.LIMIT`), and not to the last bit. So the X of
its proof is another one, too, and where rounding leaves a proof little room the bounds of both may differ by up to a tenth.

All is done in the own units of the one that is designed. Where that does not lead to the limit of the central path and a
certificate that holds, a plant is designed by itself: if it has another shape or is discrete, if its weights have states, which
leave the X of (22) unsettled at its limit and so all that comes after, if (25) is infeasible from the optimal X of (22), or if
the optimum is reached only by gains beyond any actuator.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from synth.design.fallback import two_steps_or_descent
from synth.design.two_step import Design, furthest, measurement, state_design, widened
from synth.lmi.central_path import CentralPoint
from synth.lmi.central_path_batch import path_limits
from synth.lmi.output_feedback import l_matrix, nullspace, output_feedback, r_matrix
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import BatchError, DesignError, numerics
from synth.plant.units import OwnUnits, own_units

SHORT = 0.1  # mu / eta of the point on the nominal plant's path that says where the others begin

Path = Sequence[CentralPoint]


def state_designs(
    nominal: GeneralizedPlant, nominal_path: Path, plants: Sequence[GeneralizedPlant], states: Sequence[str] = ()
) -> list[Design]:
    """The state feedback (22) of each plant, without a lower bound.

    Args:
        nominal: a plant like them, n states.
        nominal_path: its central path of (22).
        plants: any number of them.
        states: names of the states, for messages.

    Raises:
        BatchError: some have none; the message names them by index, and the error carries the designs of the others.
    """
    Cy, units = np.eye(len(nominal.A)), own_units(nominal)
    alike = [i for i, plant in enumerate(plants) if plant.B.shape == nominal.B.shape]
    limits = _state_limits(units.into(nominal), _into(units, nominal_path), [units.into(plants[i]) for i in alike])
    return _each(
        len(plants),
        {alike[i]: point.in_units(units.states, units.inputs, units.states) for i, point in limits.items()},
        lambda i, point: furthest(plants[i], Cy, [point]),
        lambda i: state_design(plants[i], states=states),
    )


def two_step_designs(
    nominal: GeneralizedPlant,
    nominal_path: Path,
    nominal_Cy: Array,
    plants: Sequence[GeneralizedPlant],
    Cys: Sequence[Array],
    states: Sequence[str] = (),
) -> list[Design]:
    """What `two_steps_or_descent` finds for each plant, without a lower bound.

    Args:
        nominal: a plant like them, n states.
        nominal_path: its central path of (22).
        nominal_Cy: its C_y, shape (q, n).
        plants: any number of them.
        Cys: the C_y of each, shape (q, n).
        states: names of the states, for messages.

    Raises:
        InputError: the nominal C_y does not fit its plant, or is empty.
        BatchError: some cannot be designed, or their C_y does not fit; the message names them by index, and the error carries the
            designs of the others.
    """
    Cy, kept = measurement(nominal, nominal_Cy)
    checked: dict[int, tuple[Array, list[int]]] = {}
    for i, (plant, each) in enumerate(zip(plants, Cys, strict=True)):
        with suppress(InputError):  # said where the plant is designed alone
            checked[i] = measurement(plant, each)
    rows = {i: full[independent] for i, (full, independent) in checked.items()}

    def at(i: int, point: CentralPoint) -> Design:
        full, independent = checked[i]
        return widened(furthest(plants[i], rows[i], [point]), independent, len(full), 0.0)

    units = own_units(nominal, Cy[kept])
    nominal_rows, measured = units.rows(Cy[kept])
    alike = [
        i
        for i in checked
        if plants[i].B.shape == nominal.B.shape
        and rows[i].shape == nominal_rows.shape
        and not (plants[i].weights or nominal.weights)
    ]
    limits = _output_limits(
        units.into(nominal),
        _into(units, nominal_path),
        nominal_rows,
        [units.into(plants[i]) for i in alike],
        [np.linalg.solve(measured, rows[i] * units.states) for i in alike],
    )
    return _each(
        len(plants),
        {alike[i]: point.in_units(units.states, units.inputs, measured) for i, point in limits.items()},
        at,
        lambda i: two_steps_or_descent(plants[i], Cys[i], states=states),
    )


def _into(units: OwnUnits, path: Path) -> Path:
    """Points of (22) in a plant's own units."""
    return [point.in_units(1 / units.states, 1 / units.inputs, 1 / units.states) for point in path]


def _state_limits(nominal: GeneralizedPlant, nominal_path: Path, plants: Sequence[GeneralizedPlant]) -> dict[int, CentralPoint]:
    """The optima of (22), by index of the plant."""
    n, m = nominal.B.shape
    alike = [
        i for i, plant in enumerate(plants) if plant.Dw.shape == nominal.Dw.shape and plant.independent_inputs().shape == (m, m)
    ]
    count = len(alike)
    return _limits(plants, alike, np.zeros((count, n, 0)), np.broadcast_to(np.eye(n), (count, n, n)), nominal_path)


def _output_limits(
    nominal: GeneralizedPlant, nominal_path: Path, nominal_Cy: Array, plants: Sequence[GeneralizedPlant], Cys: Sequence[Array]
) -> dict[int, CentralPoint]:
    """The optima of (25), with L (14) from the optimum of (22), by index of the plant."""
    Q = nullspace(nominal_Cy)
    try:
        second_path = output_feedback(nominal, nominal_Cy, l_matrix(nominal_path[-1].X, nominal_Cy, Q), Q)
    except DesignError:
        return {}
    first = _state_limits(nominal, nominal_path, plants)
    spanned: dict[int, tuple[Array, Array]] = {}
    for i, point in first.items():
        Q = nullspace(Cys[i])
        with suppress(DesignError):
            spanned[i] = Q, r_matrix(Cys[i], Q, l_matrix(point.X, Cys[i], Q))
    Qs, Rs = (np.array([each[k] for each in spanned.values()]) for k in (0, 1))
    return _limits(plants, list(spanned), Qs, Rs, second_path)


def _limits(
    plants: Sequence[GeneralizedPlant], which: Sequence[int], Q: Array, R: Array, nominal_path: Path
) -> dict[int, CentralPoint]:
    """`path_limits` of some of the plants, by their index among all.

    Of none where the nominal one shows z only some states, or where they are discrete.
    """
    if any(point.proof is not None for point in nominal_path) or any(plants[i].dt is not None for i in which):
        return {}
    nominal = min(nominal_path, key=lambda point: abs(np.log(point.mu / SHORT)))
    with suppress(DesignError), numerics():
        return {which[i]: point for i, point in path_limits([plants[i] for i in which], Q, R, nominal).items()}
    return {}


def _each(
    count: int,
    limits: Mapping[int, CentralPoint],
    at: Callable[[int, CentralPoint], Design],
    alone: Callable[[int], Design],
) -> list[Design]:
    """The design at the limit of each plant's path; of the plant alone where there is none, or it is none to build."""
    designs: dict[int, Design] = {}
    for i, point in limits.items():
        with suppress(DesignError):
            design = at(i, point)
            if not design.certificate.beyond_actuators:
                designs[i] = design
    failures: dict[int, InputError] = {}
    for i in sorted(set(range(count)) - set(designs)):
        try:
            designs[i] = alone(i)
        except InputError as error:
            failures[i] = error
    if failures:
        first, error = next(iter(failures.items()))
        which = ", ".join(str(i) for i in failures)
        message = f"{len(failures)} of {count} cannot be designed, by index: {which}; {first}: {error}"
        raise BatchError(message, dict(sorted(designs.items())), failures) from error
    return [designs[i] for i in range(count)]
