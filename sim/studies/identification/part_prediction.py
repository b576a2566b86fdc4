"""Force of a part under a measured motion, as on a dyno, with derivatives with respect to the part's numerical parameters.

The extension d of the part is a cubic spline through the samples, and v is the rate of d. The internal states z of the part
satisfy z' = f(d, v, z), where f is defined by the part (`models.parts`). The trapezoidal rule

    z[k+1] - z[k] = h/2 (f[k] + f[k+1])

is applied to fine steps of length h, and its equations are solved for all steps simultaneously by Newton's method. Each
equation contains the states of only two consecutive steps, so the matrix is banded. The banded matrix also gives the
derivatives of z with respect to the part's parameters and to z[0].
"""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError, alike, short_repr
from models.parts.part import STEP, Part
from models.vehicle.vehicle import Vehicle
from sim.studies.identification.prediction import LogPrediction, PredictedSignals

# Relative step of finite differences. A part compares its numbers with limits, so complex steps are not possible. The step is
# always upwards, because a number may be at its smallest allowed value.
RELATIVE = 1e-6
FINE, FINEST = 4, 64  # smallest and largest number of integration steps between two samples
RATE = 0.5  # largest product of the fine step and the rate of the part's states, at the largest speed
TURNS = 40  # largest number of iterations of Newton's method
SETTLED = 1e-10  # Newton's method ends if the relative change of the states z is smaller than this
FAR = 1e12  # N, force that is used for a part whose states diverge, so that the search turns back


class PartPrediction(LogPrediction):
    """Prediction of the force of a part on a dyno; see `Experiment.part`."""

    def part(self, vehicle: Vehicle) -> Part:
        """Returns the part of a vehicle that an experiment measures on a dyno.

        Raises:
            InputError: the vehicle does not have this part.
        """
        return part_of(vehicle, self.experiment.part)

    def states(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """Returns the names of the part's internal states."""
        return tuple(one.name for one in self.part(self.vehicle(values)).states)

    @cached_property
    def _motion(self) -> tuple[Array, Array, int]:
        """Extension and extension rate at all fine steps, each of shape (K,), and the number of fine steps per sample of the
        log.
        """
        from scipy.interpolate import CubicSpline

        one = self.experiment
        travel, time = CubicSpline(one.time, one.road[:, 0]), one.time
        # `fastest` is the fastest rate of the part at a velocity of 2 m/s
        fastest = self.part(self.vehicle({})).fastest * float(np.abs(travel(time, 1)).max()) / 2.0
        fine = min(max(math.ceil(fastest * one.step / RATE), FINE), FINEST)
        at = one.start + one.step / fine * np.arange((len(time) - 1) * fine + 1)
        return travel(at), travel(at, 1), fine

    def __call__(
        self,
        values: Mapping[str, float],
        free: Mapping[str, float],
        start: Array | None,
        delays: Sequence[float],
        derivatives: bool = True,
    ) -> PredictedSignals:
        """Returns predicted forces. The arguments are those of `LogPrediction`."""
        d, v, fine = self._motion
        part = self.part(self.vehicle(values))
        n, p = len(part.states), len(free)
        z0 = np.zeros(n) if start is None else start
        z, bands = self._solved(part, z0)
        columns = [part.pull(d, v, z)]
        if derivatives:
            slopes = [np.imag(part.pull(d, v, z + STEP * 1j * one)) / STEP for one in np.eye(n)]
            moves, direct = np.zeros((len(z) * n, p + n)), list[Array]()
            for j, (name, size) in enumerate(free.items()):
                ahead = self.part(self.vehicle({**values, name: values[name] + RELATIVE * size}))
                rates, pulls = (getattr(ahead, one)(d, v, z) - getattr(part, one)(d, v, z) for one in ("rate", "pull"))
                moves[n:, j] = self._mean(rates).ravel() / (RELATIVE * size)
                direct.append(pulls / (RELATIVE * size))
            moves[:n, p:] = np.eye(n)
            moved = _solve(bands, moves, n).reshape(len(z), n, -1) if n else np.zeros((len(z), 0, p))
            through = sum((slope[:, None] * moved[:, i] for i, slope in enumerate(slopes)), np.zeros((len(z), moved.shape[2])))
            columns += [through[:, j] + (direct[j] if j < p else 0.0) for j in range(p if start is None else p + n)]
        return self._sampled(columns, p, fine, delays)

    def _sampled(self, columns: Sequence[Array], p: int, fine: int, delays: Sequence[float]) -> PredictedSignals:
        """Returns the delayed force at the sample times, followed by its derivatives with respect to p parameters and n
        states.
        """
        time = self.experiment.time
        at = self.experiment.start + self.experiment.step / fine * np.arange(len(columns[0]))
        rate = np.gradient(columns[0], self.experiment.step / fine)
        each = np.stack([[np.interp(time - delay, at, one, left=np.nan) for delay in delays] for one in [*columns, rate]])
        each = np.clip(np.moveaxis(each, 1, 2), -FAR, FAR)
        return PredictedSignals(each[0], each[1 : p + 1], each[p + 1 : -1], -each[-1])

    def _mean(self, rates: Array) -> Array:
        return self.experiment.step / self._motion[2] * (rates[1:] + rates[:-1]) / 2

    def _solved(self, part: Part, z0: Array) -> tuple[Array, Array]:
        """Returns the part's internal states at all fine steps, shape (K, n), and the bands of the Jacobian matrix of the
        equations.
        """
        d, v, fine = self._motion
        half, n = self.experiment.step / fine / 2, len(z0)
        z, bands = np.tile(z0, (len(d), 1)), np.zeros((3 * n - 1 if n else 0, len(d) * n))
        for _ in range(TURNS if n else 0):
            J = np.stack([np.imag(part.rate(d, v, z + STEP * 1j * one)) / STEP for one in np.eye(n)], axis=-1)
            bands[:] = 0.0
            for i in range(n):
                for j in range(n):  # derivatives of equation (k, i) with respect to the unknowns (k, j) and (k - 1, j)
                    bands[n - 1 + i - j, j::n] = (i == j) - half * J[:, i, j] * (np.arange(len(d)) > 0)
                    bands[2 * n - 1 + i - j, j : -n or None : n] = -(i == j) - half * J[:-1, i, j]
            error = np.vstack([z[:1] - z0, np.diff(z, axis=0) - self._mean(part.rate(d, v, z))])
            step = _solve(bands, error.reshape(-1, 1), n).reshape(z.shape)
            z = np.nan_to_num(z - step, nan=FAR, posinf=FAR, neginf=-FAR)
            if np.abs(step).max() <= SETTLED * max(np.abs(z).max(), 1e-300):
                break
        return z, bands


def _solve(bands: Array, right: Array, n: int) -> Array:
    return linalg.solve_banded((2 * n - 1, n - 1), bands, right, check_finite=False)


def part_of(vehicle: Vehicle, name: str) -> Part:
    """Returns the part that the section `[parts.NAME]` defines.

    Raises:
        InputError: the vehicle does not have this part.
    """
    parts = {one.name: one.part for one in vehicle.elements}
    if name not in parts:
        what = alike(name, parts) if parts else "write a section [parts.NAME] in the vehicle file"
        raise InputError(f"part = {short_repr(name)} is not a part of this vehicle; {'give one of ' * bool(parts)}{what}")
    return parts[name]
