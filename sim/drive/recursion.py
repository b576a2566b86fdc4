"""The first-order lag of an actuator in steps of RK4."""

from typing import Any

import numpy as np

from models.common.arrays import Array, recursion

SHARES = (0.0, 0.5, 0.5, 1.0)  # times of RK4's stages, as shares of a step
WEIGHTS = (1 / 6, 1 / 3, 1 / 3, 1 / 6)  # of the stages' rates


def lag_commands(commands: Array, z: Array) -> Array:
    """Returns what lags behind commands at the samples, from 0, as RK4 integrates it, shape (T, m).

    Args:
        commands: commands, held from each sample to the next, shape (T, m).
        z: rate of every lag times the timestep, shape (m,); 0 for none: its command acts at once.
    """
    way = way_in_step(z)
    return np.where(z > 0, recursion(np.diag(1 - way), way * commands), commands)


def lag_stages(now: Array, z: Array) -> list[Array]:
    """Returns what lags behind held commands in the four stages of every step of RK4, shape (T - 1, m) each.

    Args:
        now: values at the samples, shape (T, m); without a lag the commands.
        z: product of lag and timestep, see `lag_commands`.
    """
    way, before, gone = way_in_step(z), now[:-1], np.zeros_like(now[:-1])
    change, stages = np.diff(now, axis=0) / np.where(way > 0, way, 1.0), list[Array]()
    for share in SHARES:
        gone = share * z * (change - gone)
        stages.append(before + gone)
    return stages


def way_in_step(z: Any) -> Any:
    """Returns the share of the distance to its command that a lag covers in a step of RK4, from rate times timestep, (...)."""
    return z * (1 - z / 2 * (1 - z / 3 * (1 - z / 4)))
