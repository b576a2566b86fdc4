"""The slowest mode of a run, found in its samples: the rate at which the last of it grows or decays.

After the bump a linear loop runs free. Whatever it is made of, a stretch of it is a linear map of the stretch before, and the
map's eigenvalues are the loop's, over the length of a stretch (dynamic mode decomposition: Schmid, J. Fluid Mech. 656, 2010).
So a mode is told from the others however little the bump has excited it, as long as that is more than rounding and geometry make.
"""

import math

import numpy as np

from models.common.arrays import Array

STRETCHES = 72  # a run is cut into, or fewer longer ones
PHASES = 16  # samples taken from each; no vehicle has so many modes as these hold numbers
SEEN = 1e-7  # of the loudest combination of samples; what is fainter may be geometry
EXPLAINED = 1e-4  # of the samples may be left over, else the run is not free and linear


def slowest_rate(states: Array, timestep: float, hold: int) -> float:
    """Rate of the slowest mode [1/s], above 0 where it grows; NaN where the samples are no free linear motion.

    Args:
        states: of a run after its bump, shape (n, T).
        timestep: [s].
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
