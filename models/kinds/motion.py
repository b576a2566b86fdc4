"""Interface of exact equations of motion, which do not use MuJoCo. The equations are nonlinear if the vehicle is nonlinear."""

from collections.abc import Callable, Mapping
from typing import Protocol

from models.common.arrays import Array

# Function that returns the forces that pull the suspensions together [N], given the suspension deflections [m] and their rates
# [m/s]; each array has shape (T, s).
Pulls = Callable[[Array, Array], Array]


class Motion(Protocol):
    """Equations of motion of a vehicle with s suspensions, m inputs, l loads and r wheels, evaluated for T states together."""

    @property
    def names(self) -> tuple[str, ...]:
        """Returns the names of the p signals that `read` returns."""
        ...

    def state(self, signals: Mapping[str, Array], heights: Array) -> Array:
        """Returns the states of the equations, shape (T, n).

        Args:
            signals: values of the signals in `names`, each of shape (T,).
            heights: road heights under the wheels [m], shape (T, r).
        """
        ...

    def usable(self, state: Array) -> Array:
        """Returns an array that is True for each state at which the equations of motion are valid, shape (T,)."""
        ...

    def read(self, state: Array, heights: Array) -> Array:
        """Returns the signals of `names` for the supplied states, shape (T, p)."""
        ...

    def rate(self, state: Array, heights: Array, inputs: Array, pulls: Pulls, loads: Array) -> Array:
        """Returns the time derivatives of the states, shape (T, n).

        Args:
            state: states, shape (T, n).
            heights: road heights under the wheels [m], shape (T, r).
            inputs: forces at the wheels [N], shape (T, m).
            pulls: function that returns the suspension forces other than those of linear springs and dampers [N].
            loads: loads on the body [N, N m], shape (T, l). If tyres have damping, further columns of `loads` contain the road
                velocities [m/s], shape (T, l + r).
        """
        ...

    def outputs(self, state: Array, heights: Array, inputs: Array, pulls: Pulls, loads: Array) -> Mapping[str, Array]:
        """Returns the signals that are not in `names`, such as accelerations, by name, each of shape (T,).

        Inputs, and signals that are sums of other signals, are not returned. For the arguments, see `rate`.
        """
        ...


class StoredEnergy(Protocol):
    """Energy that is stored in a vehicle, computed from the equations of motion. The `Motion` of a custom vehicle type may omit
    the members of the class `StoredEnergy`.
    """

    @property
    def joints(self) -> tuple[str, ...]:
        """Returns the n / 2 joints of the MJCF; their positions, followed by their velocities, are the state."""
        ...

    def energy(self, state: Array, heights: Array) -> Array:
        """Returns the potential and the kinetic energy of the vehicle, without the energy of nonlinear suspension forces [J],
        shape (T, 2).

        For the arguments, see `Motion.read`. The potential energy is relative to an arbitrary but fixed state.
        """
        ...
