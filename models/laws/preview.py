"""Preview: the part of a linear law that responds to the road ahead. The preview is a feedforward in addition to the feedback u
= K y.

The preview force is the integral of F(s) d(t + s) over s from 0 to T, where d contains the road velocities w and heights z_r
under the wheels:

    F(s) = C exp(A s) [B, H]    on [w; z_r].

A computer knows the road only at its sample times. The preview is exact for a road that changes linearly between samples. Like
the preview, a sampled law with states is exact for measurements that change linearly between samples (`models.laws.linear`).
For a road that changes linearly between samples, the preview force is a weighted sum of the road heights at the coming samples.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from models.common.arrays import Array, real_matrix
from models.common.errors import InputError
from models.laws.linear import LARGEST, MOST_STATES, PREVIEW_MATRICES
from models.laws.python_law import AHEAD, samples_ahead

COMPARED_SAMPLES = 100  # two previews are compared at this number of samples
MOST_PRODUCTS = 2e9  # a sum with at most this number of products is computed term by term, which takes about 1 s


@dataclass(frozen=True, eq=False)
class RoadPreview:
    """Feedforward force that depends on the road ahead. The docstring of the module contains the formula for the force.

    Attributes:
        seconds: preview time T, for which the road ahead of every wheel is known [s].
        A: state matrix, shape (k, k).
        B: input matrix of the road velocities, shape (k, r).
        H: input matrix of the road heights, shape (k, r).
        C: output matrix, shape (m, k).

    Raises:
        InputError: a matrix has the wrong shape or entries that are not real and finite, or the preview time T is not allowed.
    """

    seconds: float
    A: Array
    B: Array
    H: Array
    C: Array

    def __post_init__(self) -> None:
        for name in PREVIEW_MATRICES:
            matrix, _ = real_matrix(getattr(self, name), name, LARGEST)
            matrix.flags.writeable = False
            object.__setattr__(self, name, matrix)
        k, r = self.B.shape
        if not 0 < k <= MOST_STATES:
            raise InputError(f"a preview law with {k} states is not allowed; give 1 to {MOST_STATES} states")
        for name, shape in {"A": (k, k), "H": (k, r), "C": (len(self.C), k)}.items():
            if getattr(self, name).shape != shape:
                raise InputError(f"{name} of a preview law has shape {getattr(self, name).shape}; expected {shape}")
        object.__setattr__(self, "seconds", AHEAD.number("a preview", self.seconds))

    @property
    def record(self) -> dict[str, Any]:
        """The preview as keys of JSON."""
        return {"seconds": self.seconds} | {name: getattr(self, name).tolist() for name in PREVIEW_MATRICES}

    def samples(self, period: float) -> int:
        """Returns how many road heights the sampled preview uses for each wheel, including the present height.

        Args:
            period: sample period of the preview [s].
        """
        return samples_ahead(self.seconds, period)

    def weights(self, period: float) -> Array:
        """Returns the forces per metre of road height at the coming samples, shape (P, m, r): u = sum of W_i z_r(t + i period).

        The preview time is rounded down to an integer number of samples.
        """
        count, (k, r), m = self.samples(period), self.B.shape, len(self.C)
        if count == 1:
            return np.zeros((1, m, r))
        # The exponential of the matrix `step` contains the integrals of exp(A s) and exp(A s) s / period over one sample period
        step = np.zeros((3 * k, 3 * k))
        step[:k, :k], step[:k, k : 2 * k], step[k : 2 * k, 2 * k :] = period * self.A, np.eye(k), np.eye(k)
        whole = linalg.expm(step)
        # `fall` is the integral of exp(A s) (1 - s / period) over one sample period
        level, fall = period * whole[:k, k : 2 * k], period * whole[:k, 2 * k :]
        rise = level - fall
        near, far = fall @ self.H - level @ self.B / period, rise @ self.H + level @ self.B / period
        weights, row = np.zeros((count, m, r)), self.C
        for i in range(count - 1):
            weights[i] += row @ near
            weights[i + 1] += row @ far
            row = row @ whole[:k, :k]
        return weights

    def difference(self, other: "RoadPreview") -> float:
        """Returns the largest difference between the weights of this preview and another preview, relative to the largest
        weight of the other preview.

        The difference is infinite if the preview times or shapes differ.
        """
        if self.seconds != other.seconds:
            return np.inf
        one, two = (each.weights(self.seconds / COMPARED_SAMPLES) for each in (self, other))
        return float(np.abs(one - two).max() / (np.abs(two).max() or 1.0)) if one.shape == two.shape else np.inf

    def forces(self, heights: Array, steps: int, timestep: float, samples: int) -> Array:
        """Returns the preview forces at the timesteps of a run, shape (T, m); each force is constant from one sample to the
        next.

        Args:
            heights: heights of the road at the T timesteps of a run, followed by the heights during the preview time after the
                run [m], shape (T + ahead, r).
            steps: number of timesteps between two samples of the controller.
            timestep: time between two successive heights [s].
            samples: number T of timesteps in the run.
        """
        weights, due = self.weights(steps * timestep), -(-samples // steps)
        sampled = heights[: (due + len(weights) - 2) * steps + 1 : steps]
        forces = np.zeros((due, weights.shape[1]))
        for i, j in np.ndindex(weights.shape[1:]):
            if np.any(weights[:, i, j]):
                forces[:, i] += _correlate(sampled[:, j], weights[:, i, j])
        return np.repeat(forces, steps, axis=0)[:samples]

    def response(self, omega: Array) -> Array:
        """Returns the frequency response from the road velocity to the forces, complex, shape (F, m, r).

        Args:
            omega: angular frequencies above 0 [rad/s], shape (F,).
        """
        s = 1j * np.asarray(omega, dtype=float)[:, None, None]
        turning = self.A + s * np.eye(len(self.A))
        ahead = linalg.expm(self.A * self.seconds) * np.exp(s * self.seconds) - np.eye(len(self.A))
        return self.C @ np.linalg.solve(turning, ahead @ (self.B + self.H / s))

    def sampled_response(self, omega: Array, period: float) -> Array:
        """Returns the frequency response of the sampled preview from the road height to the forces, complex, shape (F, m, r)."""
        weights = self.weights(period)
        turns = np.exp(1j * np.multiply.outer(np.asarray(omega, dtype=float), period * np.arange(len(weights))))
        return (turns @ weights.reshape(len(weights), -1)).reshape(-1, *weights.shape[1:])


def _correlate(heights: Array, weights: Array) -> Array:
    """Returns the correlation of two signals, heights and weights, at all positions where a height exists for every weight.

    For long signals, the correlation is computed by Fourier transforms.
    """
    if len(heights) * len(weights) <= MOST_PRODUCTS:
        return np.correlate(heights, weights, "valid")
    size = 1 << (len(heights) - 1).bit_length()
    turned = np.fft.irfft(np.fft.rfft(heights, size) * np.conj(np.fft.rfft(weights, size)), size)
    return turned[: len(heights) - len(weights) + 1]


def preview_of(record: Mapping[str, Any]) -> RoadPreview | None:
    """Returns the preview that a controller's record contains; None for a controller without preview.

    Raises:
        InputError: a number of the preview is missing or invalid.
    """
    if not isinstance(found := record.get("preview"), Mapping):
        return None
    try:
        return RoadPreview(*(found[name] for name in ("seconds", *PREVIEW_MATRICES)))
    except KeyError as error:
        raise InputError(f"the recorded preview has no key {error}; repeat the simulation or the campaign") from error
