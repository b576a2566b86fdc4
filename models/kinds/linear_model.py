"""Linear vehicle model with named states, inputs and outputs.

    x' = A x + B u + Bw w + Br z_r + Bl f,     signals = C x + D u + Dw w + Cr z_r + Dl f,

with the road heights z_r under the wheels, their velocities w = z_r', and loads f on the body (`models/roads/loads/`). The
matrices Br and Cr are zero in the paper, and for every body that can follow all motions of the wheels. If the matrices Br and
Cr are zero, only the road velocity acts on the vehicle. For a vehicle with four wheels, the warp of the road acts as a
displacement.

The road velocity acts in two ways, so its matrix is a sum: Bw = J + Bt. The matrix J describes how the road velocity changes
deflections directly, independently of all forces. The matrix Bt describes how the road velocity pushes the wheels through tyres
that have damping. The matrix Dw describes the direct effect of the road velocity on accelerations. With tyre damping, a
vertical edge of the road is an impulse on the wheel. If the road height is constant within each time step, it jumps between two
steps, and the deflections change by J times this jump. Within a step, the mean road velocity of the step pushes the wheels
through the damping of the tyres.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress

import numpy as np

from models.common.arrays import Array
from models.common.checks import Positive, check_fields, check_shape
from models.common.errors import InputError, list_names, short_repr

# Fields that contain the names of the columns, by matrix: first the matrices with a row for each state, then those with a row
# for each output
OF_STATES = {"A": "states", "B": "inputs", "Bw": "disturbances", "Br": "disturbances", "Bt": "disturbances", "Bl": "loads"}
OF_OUTPUTS = {"C": "states", "D": "inputs", "Cr": "disturbances", "Dw": "disturbances", "Dl": "loads"}
AXES = {name: (rows, of[name]) for rows, of in (("states", OF_STATES), ("outputs", OF_OUTPUTS)) for name in of}
OPTIONAL = ("Bl", "Dl", "Bt", "Dw")
# Pairs of matrices for the same input: the effect on the states, and the direct effect on the outputs
PAIRS = (("A", "C"), ("B", "D"), ("Br", "Cr"), ("Bl", "Dl"), ("Bt", "Dw"))


def _zero() -> Array:
    return np.zeros((0, 0))


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Linear vehicle model relative to static equilibrium.

    Attributes:
        A: state matrix, shape (n, n).
        B: input matrix, shape (n, m).
        Bw: disturbance matrix, shape (n, r). The disturbance is the vertical road *velocity* under each wheel [m/s].
        C: gain from the state to each output signal, shape (p, n).
        D: gain from the input to each output signal, shape (p, m).
        states: names of the n states.
        inputs: names of the m inputs [N].
        disturbances: names of the r disturbances [m/s].
        outputs: names of the p output signals.
        Br: gain from the road heights to x', shape (n, r).
        Cr: gain from the road heights to the output signals, shape (p, r).
        twist_rate: factor [rad/s] that converts road warp to an equivalent road velocity, which has the same weight in a
            controller design.
        loads: names of the l loads on the body [N, N m].
        Bl: gain from the loads to x', shape (n, l); zero by default.
        Dl: gain from the loads to the output signals, shape (p, l); zero by default.
        Bt: part of Bw that acts through the damping of tyres, shape (n, r); zero by default.
        Dw: gain from the road velocities to the output signals, shape (p, r); zero by default.
        heights: names of output signals that are heights above a flat datum. The state contains only deflections, so heights
            above a datum depend on the state and, through Cr, on the road heights.

    Raises:
        InputError: a matrix does not fit the names or is not finite, or the names are not distinct texts.
    """

    A: Array
    B: Array
    Bw: Array
    C: Array
    D: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    disturbances: tuple[str, ...]
    outputs: tuple[str, ...]
    Br: Array
    Cr: Array
    twist_rate: Positive = 1.0
    loads: tuple[str, ...] = ()
    Bl: Array = field(default_factory=_zero)
    Dl: Array = field(default_factory=_zero)
    Bt: Array = field(default_factory=_zero)
    Dw: Array = field(default_factory=_zero)
    heights: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self)
        for what in ("states", "inputs", "disturbances", "outputs", "loads"):
            names = getattr(self, what)
            if len(set(names)) < len(names):
                raise InputError(f"{what} = {short_repr(names)} contains a name twice; give different names")
        for name, (rows, columns) in AXES.items():
            shape = len(getattr(self, rows)), len(getattr(self, columns))
            if name in OPTIONAL and not np.size(getattr(self, name)):
                object.__setattr__(self, name, np.zeros(shape))
            if np.iscomplexobj(getattr(self, name)):
                raise InputError(f"{name} has complex entries; give real numbers")
            matrix = np.array(getattr(self, name), dtype=float)
            check_shape(name, matrix, shape, "which follows from the numbers of states, inputs, disturbances, outputs and loads")
            for row, column in np.argwhere(~np.isfinite(matrix))[:1]:
                raise InputError(f"{name}[{row}, {column}] = {matrix[row, column]} is not finite; give finite numbers")
            matrix.flags.writeable = False
            object.__setattr__(self, name, matrix)

    @property
    def measurable(self) -> tuple[str, ...]:
        """Output signals that a controller can measure: all signals that do not depend on the road height.

        Control forces are included, because a controller that measures them can subtract their effect from an acceleration.
        """
        return tuple(name for name, of_road in zip(self.outputs, np.any(self.Cr, axis=1), strict=True) if not of_road)

    def over_datum(self, signals: Collection[str]) -> list[str]:
        """Returns those of the supplied signals that are heights above a flat datum. Only a control law for a theoretical study
        may measure heights above a flat datum.
        """
        return [name for name in self.heights if name in signals]

    @property
    def tyres_damp(self) -> bool:
        """True if a tyre has damping, so that the road velocity pushes a wheel."""
        return bool(self.Bt.any() or self.Dw.any())

    @property
    def jump(self) -> Array:
        """Matrix J: the direct effect of the road height on the states, shape (n, r).

        If the road height is held constant during a time step and then jumps, the combination x - J z_r of state and road
        height is continuous.
        """
        return self.Bw - self.Bt if self.tyres_damp else self.Bw

    @property
    def Bh(self) -> Array:
        """Effect on x' of the quantities that are held constant during a time step: loads and, if tyres have damping, road
        velocities.

        The matrix has the shape (n, l), or (n, l + r) with tyre damping.
        """
        return np.hstack([self.Bl, self.Bt]) if self.tyres_damp else self.Bl

    @property
    def Dh(self) -> Array:
        """Effect on the output signals of the quantities that are held constant during a time step, shape (p, l) or (p, l + r);
        see `Bh`.
        """
        return np.hstack([self.Dl, self.Dw]) if self.tyres_damp else self.Dl

    def of(self, outputs: Collection[str]) -> "LinearModel":
        """Returns the model with only the selected output signals, in the same order as in this model."""
        chosen = [name in outputs for name in self.outputs]
        names = tuple(compress(self.outputs, chosen))
        rows = {name: getattr(self, name)[chosen] for name in OF_OUTPUTS}
        return replace(self, outputs=names, heights=tuple(self.over_datum(names)), **rows)

    def has_rate(self, output: str) -> bool:
        """Returns True if the time derivative of an output signal is a function of state, road height and forces.

        The result is True if neither a force nor the road velocity acts directly on the signal.
        """
        i = self.outputs.index(output)
        return not (np.any(self.D[i]) or np.any(self.C[i] @ self.Bw + self.Cr[i]))

    def with_rates(self, rates: Mapping[str, str]) -> "LinearModel":
        """Returns the model in which time derivatives of output signals are additional outputs.

        Args:
            rates: names of the signals to differentiate; the keys are the names of the derivatives.
        """
        if not rates:
            return self
        index = [self.outputs.index(name) for name in rates.values()]
        rows = {direct: self.C[index] @ getattr(self, acting) for acting, direct in PAIRS if direct != "Dw"}
        return replace(self, outputs=(*self.outputs, *rates), **self._with_rows(OF_OUTPUTS, len(index), rows))

    def _with_rows(self, matrices: Iterable[str], k: int, rows: Mapping[str, Array]) -> dict[str, Array]:
        """Returns the named matrices with k additional rows each; the rows of a matrix that is not in `rows` are zero."""
        extended = dict[str, Array]()
        for name in matrices:
            given = getattr(self, name)
            extended[name] = np.vstack([given, rows.get(name, np.zeros((k, given.shape[1])))])
        return extended

    def with_integrals(self, integrals: Mapping[str, Mapping[str, float]]) -> "LinearModel":
        """Returns the model in which integrals of sums of output signals are additional states and outputs.

        Args:
            integrals: factors of the signals in the sum that is integrated; the keys are the names of the integrals. The sums
                must not depend on the road height.
        """
        if not integrals:
            return self
        mix = np.array([[terms.get(name, 0.0) for name in self.outputs] for terms in integrals.values()])
        Bw = mix @ self.Dw
        of_sums = {"B": mix @ self.D, "Bw": Bw, "Bt": Bw, "Br": mix @ self.Cr, "Bl": mix @ self.Dl}
        return self.with_states(tuple(integrals), mix @ self.C, of_sums)

    def with_states(self, names: tuple[str, ...], rates: Array, more: Mapping[str, Array] | None = None) -> "LinearModel":
        """Returns the model with k additional states, each of which is also an output with the same name as the state.

        Args:
            names: names of the additional states.
            rates: gains from the states to the rates of the additional states. The matrix has the shape (k, n) for gains from
                the n states of this model, or (k, n + k) with gains from the additional states.
            more: additional rows of B, Bw, Bt, Br and Bl for the additional states; zero by default.
        """
        k, n = len(names), len(self.A)
        return replace(
            self,
            A=np.block([[self.A, np.zeros((n, k))], [np.pad(rates, ((0, 0), (0, n + k - rates.shape[1])))]]),
            C=np.block([[self.C, np.zeros((len(self.C), k))], [np.zeros((k, n)), np.eye(k)]]),
            states=(*self.states, *names),
            outputs=(*self.outputs, *names),
            **self._with_rows(AXES.keys() - {"A", "C"}, k, more or {}),
        )

    def with_lines(self, rows: Array, push: Array, shown: Array, stiffness: Array, damping: Array) -> "LinearModel":
        """Returns the model with additional springs and dampers along e lengths d of the vehicle, whose forces are f = k d + c
        d'.

        Args:
            rows: gains from the states to the lengths, shape (e, n). Neither the road nor a force may act directly on the
                lengths.
            push: effect on x' of forces that pull along the lengths, shape (n, e).
            shown: effect of the forces along the lengths on the outputs, shape (p, e).
            stiffness: k [N/m], shape (e,).
            damping: c [N s/m], shape (e,).
        """
        force = stiffness[:, None] * rows + damping[:, None] * (rows @ self.A)
        return replace(self, A=self.A + push @ force, C=self.C + shown @ force)

    def with_inertance(self, speeds: Array, push: Array, shown: Array, inertance: Array) -> "LinearModel":
        """Returns the model with additional inerters along e lengths d of the vehicle, whose forces are f = b d''.

        Let the lengths have the rates d' = S x, and let E be the effect on x' of forces along the lengths. Then the inerters
        give the force p = b S (x' + E p) = (1 - b S E)^-1 b S x', where x' is the rate without inerters.

        Args:
            speeds: matrix S of gains from the states to the rates of the lengths, shape (e, n).
            push: matrix E of effects on x' of forces that pull along the lengths, shape (n, e).
            shown: effect of the forces along the lengths on the outputs, shape (p, e).
            inertance: b [kg], shape (e,).
        """
        if not inertance.any():
            return self
        b = np.diag(inertance)
        # Gains from the rates x' to the inerter forces p
        of_rates = np.linalg.solve(np.eye(len(b)) - b @ speeds @ push, b @ speeds)
        moved: dict[str, Array] = {}
        for acting, direct in PAIRS:
            pull = of_rates @ getattr(self, acting)
            moved[acting], moved[direct] = getattr(self, acting) + push @ pull, getattr(self, direct) + shown @ pull
        return replace(self, Bw=self.Bw + push @ (of_rates @ self.Bw), **moved)

    def geared(self, ratios: Array) -> "LinearModel":
        """Returns the model in which every input is multiplied by its motion ratio, shape (m,), before it acts on the vehicle.

        Outputs that are control forces are not multiplied by a motion ratio.
        """
        if np.all(ratios == 1):
            return self
        own = np.array([[output == force for force in self.inputs] for output in self.outputs])
        return replace(self, B=self.B * ratios, D=np.where(own, self.D, self.D * ratios))

    def behind_lag(self, bandwidth: float | Array | None) -> "LinearModel":
        """Returns the model with actuator lag: the inputs are the requested forces, and the actual forces are states.

        Each actual force f follows f' = bandwidth (u - f), and replaces the requested force u in all signals.

        Args:
            bandwidth: corner frequency of all actuators, or of each actuator, shape (m,) [rad/s]; 0 for an actuator without
                lag, None if no actuator has a lag.
        """
        if bandwidth is None:
            return self
        rates = np.broadcast_to(bandwidth, len(self.inputs))
        lags = np.flatnonzero(rates)
        return replace(
            self,
            A=np.block([[self.A, self.B[:, lags]], [np.zeros((len(lags), len(self.A))), -np.diag(rates[lags])]]),
            B=np.vstack([np.where(rates == 0, self.B, 0.0), np.diag(rates)[lags]]),
            **self._with_rows(("Bw", "Br", "Bl", "Bt"), len(lags), {}),
            C=np.hstack([self.C, self.D[:, lags]]),
            D=np.where(rates == 0, self.D, 0.0),
            states=(*self.states, *(f"lagged_{self.inputs[i]}" for i in lags)),
        )

    def rows(self, signals: Sequence[str]) -> tuple[Array, Array]:
        """Returns the rows of C and D for k output signals, shapes (k, n) and (k, m).

        Raises:
            InputError: the vehicle does not have one of the requested signals.
        """
        for signal in signals:
            if signal not in self.outputs:
                raise InputError(f"unknown signal {signal!r}; this vehicle has the signals {list_names(self.outputs)}")
        index = [self.outputs.index(signal) for signal in signals]
        return self.C[index], self.D[index]
