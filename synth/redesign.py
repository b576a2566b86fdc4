"""The designs of `design.py` for many plants like one that is designed already: side by side, a few milliseconds each.

What cannot be done side by side is designed by itself: a plant of another shape, an X of (22) from which (25) is infeasible, a
path that rounding ends early.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

import numpy as np

from models.arrays import Array
from synth.central import CentralPoint
from synth.design import Design, furthest, measurement, state_path, two_step_design, widened
from synth.errors import DesignError
from synth.many import central_paths
from synth.output_feedback import l_matrix, nullspace, output_feedback, r_matrix
from synth.plant import GeneralizedPlant

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
        DesignError: some have none; the message names them by index.
    """
    Cy = np.eye(len(nominal.A))

    def along(i: int, path: Path) -> Design:
        return furthest(plants[i], Cy, path)

    return _each(
        len(plants), _state_paths(nominal, nominal_path, plants), along, lambda i: along(i, state_path(plants[i], states))
    )


def two_step_designs(
    nominal: GeneralizedPlant,
    nominal_path: Path,
    nominal_Cy: Array,
    plants: Sequence[GeneralizedPlant],
    Cys: Sequence[Array],
    states: Sequence[str] = (),
) -> list[Design]:
    """What `two_step_design` finds for each plant, without a lower bound.

    Args:
        nominal: a plant like them, n states.
        nominal_path: its central path of (22).
        nominal_Cy: its C_y, shape (q, n).
        plants: any number of them.
        Cys: the C_y of each, shape (q, n).
        states: names of the states, for messages.

    Raises:
        InputError: a C_y does not fit its plant, or is empty.
        DesignError: some cannot be designed; the message names them by index.
    """
    Cy, kept = measurement(nominal, nominal_Cy)
    checked = [measurement(plant, each) for plant, each in zip(plants, Cys, strict=True)]
    rows = [each[independent] for each, independent in checked]

    def along(i: int, path: Path) -> Design:
        full, independent = checked[i]
        return widened(furthest(plants[i], rows[i], path), independent, len(full), 0.0)

    paths = _output_paths(nominal, nominal_path, Cy[kept], plants, rows)
    return _each(len(plants), paths, along, lambda i: two_step_design(plants[i], Cys[i], states=states))


def _state_paths(nominal: GeneralizedPlant, nominal_path: Path, plants: Sequence[GeneralizedPlant]) -> dict[int, Path]:
    """The central paths of (22), by index of the plant."""
    n, m = nominal.B.shape
    alike = [
        i
        for i, plant in enumerate(plants)
        if (plant.B.shape, plant.Dw.shape) == (nominal.B.shape, nominal.Dw.shape) and plant.independent_inputs().shape == (m, m)
    ]
    count = len(alike)
    return _paths(plants, alike, np.zeros((count, n, 0)), np.broadcast_to(np.eye(n), (count, n, n)), nominal_path)


def _output_paths(
    nominal: GeneralizedPlant, nominal_path: Path, nominal_Cy: Array, plants: Sequence[GeneralizedPlant], Cys: Sequence[Array]
) -> dict[int, Path]:
    """The central paths of (25) with L (14) from the optimum of (22), by index of the plant."""
    Q = nullspace(nominal_Cy)
    try:
        nominal_second = output_feedback(nominal, nominal_Cy, l_matrix(nominal_path[-1].X, nominal_Cy, Q), Q)
    except DesignError:
        return {}
    first = {i: path for i, path in _state_paths(nominal, nominal_path, plants).items() if Cys[i].shape == nominal_Cy.shape}
    Qs, Rs = [], []
    for i, path in first.items():
        Q = nullspace(Cys[i])
        Qs.append(Q)
        Rs.append(r_matrix(Cys[i], Q, l_matrix(path[-1].X, Cys[i], Q)))
    return _paths(plants, list(first), np.array(Qs), np.array(Rs), nominal_second)


def _paths(plants: Sequence[GeneralizedPlant], which: Sequence[int], Q: Array, R: Array, nominal: Path) -> dict[int, Path]:
    """`central_paths` of some of the plants, by their index among all."""
    start = min(nominal, key=lambda point: abs(np.log(point.mu / SHORT)))
    return {which[i]: path for i, path in central_paths([plants[i] for i in which], Q, R, start).items()}


def _each(
    count: int, paths: Mapping[int, Path], along: Callable[[int, Path], Design], alone: Callable[[int], Design]
) -> list[Design]:
    """A design from the path of each plant, or from the plant alone where there is no path, or none of its certificates holds."""
    designs: dict[int, Design] = {}
    for i, path in paths.items():
        with suppress(DesignError):
            designs[i] = along(i, path)
    failures = {}
    for i in sorted(set(range(count)) - set(designs)):
        try:
            designs[i] = alone(i)
        except DesignError as error:
            failures[i] = error
    if failures:
        first, error = next(iter(failures.items()))
        which = ", ".join(str(i) for i in failures)
        raise type(error)(f"{len(failures)} of {count} cannot be designed, by index: {which}; {first}: {error}")
    return [designs[i] for i in range(count)]
