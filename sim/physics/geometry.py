"""Whether a vehicle's bodies turn, or its springs pull askew, so that its physics is linear for small motions only.

A quarter-car goes up and down: between its limits it is linear, however far it moves. What pitches or rolls is not, and a spring
that does not pull along a joint is not either. This is asked of the compiled model itself, so that it holds for any kind.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import functools
from dataclasses import replace

import mujoco
import numpy as np

from models.common.arrays import Array
from models.mjcf import build_model
from models.reality import Limits
from models.vehicle import Vehicle

MOVE = 2e-3  # m, rad and their rates: rounding is 1e-12 of what it makes, and turning 1e-3
OF_TYRE = 0.1  # of its static deflection a tyre gives way at most: it stays on the road
LINEAR = 1e-8  # of what a motion makes, what twice as far makes beside twice as much
TRIALS = 3


@functools.lru_cache(maxsize=16)
def has_geometry(vehicle: Vehicle) -> bool:
    """Whether accelerations are not linear in position and speed, between its limits, for some motions drawn at random."""
    model = build_model(replace(vehicle, limits=Limits()), 1e-3)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)

    def accelerations(motion: Array) -> Array:
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = motion[: model.nq], motion[model.nq :]
        mujoco.mj_forward(model, data)
        return np.array(data.qacc)

    far = min(MOVE, OF_TYRE * min(vehicle.kind.static_tyre_deflection(vehicle.parameters).values()))
    rest = accelerations(np.zeros(model.nq + model.nv))
    for _ in range(TRIALS):
        motion = rng.uniform(-far / 2, far / 2, model.nq + model.nv)
        once, twice = accelerations(motion) - rest, accelerations(2 * motion) - rest
        if np.abs(twice - 2 * once).max() > LINEAR * np.abs(twice).max():
            return True
    return False
