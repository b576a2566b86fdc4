"""Response of an actuator's first-order lag to commands, integrated by RK4, and the bandwidths of a vehicle's lags."""

from typing import Any

import numpy as np

from models.common.arrays import Array, recursion
from models.vehicle.vehicle import Vehicle

SHARES = (0.0, 0.5, 0.5, 1.0)  # times at which RK4 evaluates its four stages, as fractions of a step
WEIGHTS = (1 / 6, 1 / 3, 1 / 3, 1 / 6)  # weights with which RK4 adds the rates of its four stages


def lag_commands(commands: Array, z: Array) -> Array:
    """Returns the outputs of the lags at the samples, integrated by RK4 from the initial value 0, shape (T, m).

    Args:
        commands: commands to the lags, constant from each sample to the next, shape (T, m).
        z: product of bandwidth and time step for each lag, shape (m,); 0 for no lag.
    """
    way = way_in_step(z)
    return np.where(z > 0, recursion(np.diag(1 - way), way * commands), commands)


def lag_stages(now: Array, z: Array) -> list[Array]:
    """Returns the outputs of the lags at the four stages of every RK4 step, as four arrays of shape (T - 1, m).

    Args:
        now: outputs of the lags at the samples, shape (T, m); without a lag, these outputs equal the commands.
        z: product of bandwidth and time step for each lag, see `lag_commands`.
    """
    way, before, gone = way_in_step(z), now[:-1], np.zeros_like(now[:-1])
    change, stages = np.diff(now, axis=0) / np.where(way > 0, way, 1.0), list[Array]()
    for share in SHARES:
        gone = share * z * (change - gone)
        stages.append(before + gone)
    return stages


def way_in_step(z: Any) -> Any:
    """Returns the fraction of the distance to the command that the output of a lag covers in one RK4 step.

    Args:
        z: product of bandwidth and time step for the lag, any shape.
    """
    return z * (1 - z / 2 * (1 - z / 3 * (1 - z / 4)))


def lag_rates(vehicle: Vehicle) -> Array:
    """Returns the bandwidth of each actuator's lag [rad/s], shape (m,); 0 for an actuator without lag."""
    inputs = vehicle.linear_model.inputs
    rates = np.full(len(inputs), vehicle.limits.actuator_bandwidth or 0.0)
    for one in vehicle.parts.adjustable:
        rates[inputs.index(one.force)] = one.damper.bandwidth or 0.0
    return rates
