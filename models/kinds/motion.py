"""Interface of exact equations of motion, independent of MuJoCo; nonlinear if the vehicle is."""

from collections.abc import Callable, Mapping
from typing import Protocol

from models.common.arrays import Array

# Forces that pull suspensions together [N], by their deflections [m] and the rates of these [m/s]; each of shape (T, s).
Pulls = Callable[[Array, Array], Array]


class Motion(Protocol):
    """Equations of motion of a vehicle with s suspensions, m inputs, l loads and r wheels, for T states at once."""

    @property
    def names(self) -> tuple[str, ...]:
        """Returns the names of the signals that `read` returns, p of them."""
        ...

    def state(self, signals: Mapping[str, Array], heights: Array) -> Array:
        """Returns the states, shape (T, n).

        Args:
            signals: signals of `names`, each of shape (T,).
            heights: road heights under the wheels [m], shape (T, r).
        """
        ...

    def usable(self, state: Array) -> Array:
        """Returns True for each state from which the equations hold, shape (T,)."""
        ...

    def read(self, state: Array, heights: Array) -> Array:
        """Returns the signals of some states, shape (T, p)."""
        ...

    def rate(self, state: Array, heights: Array, inputs: Array, pulls: Pulls, loads: Array) -> Array:
        """Returns the rates of the states, shape (T, n).

        Args:
            inputs: forces at the wheels [N], shape (T, m).
            pulls: forces of the suspensions beyond their linear springs and dampers.
            loads: loads on the body [N, N m], shape (T, l); if tyres damp, also the road's velocities [m/s], shape (T, l + r).
        """
        ...

    def outputs(self, state: Array, heights: Array, inputs: Array, pulls: Pulls, loads: Array) -> Mapping[str, Array]:
        """Returns the vehicle's other signals, such as accelerations, by name, each of shape (T,). Arguments as for `rate`.

        It leaves out inputs, and what is a sum of other signals.
        """
        ...


class StoredEnergy(Protocol):
    """Energy that a vehicle stores, from its own equations: members of a `Motion` that a user's vehicle type may omit."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Returns the joints of the MJCF whose positions, and then their velocities, are the state, n / 2 of them."""
        ...

    def energy(self, state: Array, heights: Array) -> Array:
        """Returns potential and kinetic energy without suspension forces beyond the linear ones [J], shape (T, 2).

        Arguments as for `Motion.read`. The potential energy is relative to any fixed state.
        """
        ...
