"""The slowest mode of a run, found in its samples: the rate at which the end of the run grows or decays.

After the bump a linear loop runs free. Each stretch of its motion is a linear map of the stretch before, and the map's
eigenvalues are the loop's, over the length of a stretch (dynamic mode decomposition: Schmid, J. Fluid Mech. 656, 2010). So a mode
is identified even if the bump hardly excites it, as long as it exceeds the effects of rounding and geometry.
"""

import math

import numpy as np

from models.common.arrays import Array

STRETCHES = 72  # a run is cut into, or fewer longer ones
PHASES = 16  # samples taken from each; no vehicle has so many modes as these hold numbers
SEEN = 1e-7  # of the loudest combination of samples; what is fainter may be geometry
EXPLAINED = 1e-4  # of the samples may be left over, else the run is not free and linear


def slowest_rate(states: Array, timestep: float, hold: int) -> float:
    """Returns the rate of the slowest mode [1/s], positive if it grows; NaN if the motion is not free and linear.

    Args:
        states: states of a run after its bump, shape (n, T).
        timestep: timestep of the physics [s].
        hold: samples over which the controller holds or delays what it has measured: no stretch is shorter, or a part of one.
    """
    length = hold * max(1, round(states.shape[1] / STRETCHES / hold))
    count = states.shape[1] // length
    if count < 2 or not np.all(np.isfinite(states)):
        return math.nan
    phases = np.unique(np.linspace(0, length, PHASES, endpoint=False).astype(int))
    stretches = np.concatenate([states[:, phase : count * length : length] for phase in phases])
    before, after = stretches[:, :-1], stretches[:, 1:]
    U, seen, Vt = np.linalg.svd(before, full_matrices=False)
    modes = seen > SEEN * seen[0]
    U, seen, Vt = U[:, modes], seen[modes], Vt[modes]
    step = U.T @ after @ Vt.T / seen
    if 2 * len(seen) > count:  # any samples at all would be explained
        return math.nan
    if np.linalg.norm(after - U @ step @ U.T @ before) > EXPLAINED * np.linalg.norm(after):
        return math.nan
    return math.log(np.abs(np.linalg.eigvals(step)).max()) / (length * timestep)
