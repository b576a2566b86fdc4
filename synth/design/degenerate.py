"""Regularised problems for plants whose problem (22) of the paper is degenerate: no gain, or every gain, is optimal.

- **w does not affect z**, or some gain decouples z from w. The norm is then 0, and eta = norm^-2 has no upper bound. In the
  regularised problem, additional disturbances act on every state that z contains.
- **No control force affects z**. All gains then give the same norm. In the regularised problem, additional disturbances act on
  every state, and z also contains every state and every force.

The gain is then certified for the given plant: a matrix X that proves a bound with the additional disturbances and outputs also
proves this bound without them. A plant whose z contains every state does not need this module (`WellPosedProblem.regular`).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from synth.analysis.stabilisability import largest, stabilisability_failures
from synth.analysis.stability import balance, is_stable, pole_text
from synth.design.problem import WellPosedProblem
from synth.lmi.output_nulling import RANK, output_nulling_gains, output_nulling_subspace
from synth.lmi.unobservable import remove_unobservable
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError, InfeasibleError
from synth.plant.units import own_units, size

INSTEAD = "designed for a disturbance of every state that z contains"


def regularise_problem(plant: Plant) -> WellPosedProblem:
    """Returns problem (22) of a plant or, if (22) is degenerate, a regularised problem. The result does not depend on units."""
    if not (np.any(plant.Bw) or np.any(plant.Dw)) or not (np.any(plant.C) or np.any(plant.D)):
        return WellPosedProblem(plant)  # an invalid plant is passed on, because the central path raises the error
    scale, forces = own_units(plant).exact
    step, form = plant.dt or 0.0, plant.differences
    own, nothing = form.in_coordinates(np.diag(scale)).with_inputs(np.diag(forces)), np.zeros_like(plant.B.T)
    unobservable = output_nulling_subspace(own, nothing)[1]  # these states are unobservable in z without control
    zero_gain = nothing if is_stable(plant.A, plant.dt) else None
    strength = size(own.Bw) * (plant.dt or 1.0)
    regular = _with_all_outputs(_with_disturbances(plant, strength * np.diag(scale)), own, scale, forces)

    if not np.any(plant.D) and not _leaves(own.B, unobservable):
        text = "no control force affects z, so its norm is the same for every gain"
        return WellPosedProblem(regular, f"{text} that stabilises the plant", zero_gain, f"{text}; no force is applied")

    kept, rest, F = _seen(own, step)
    direct = bool(np.any(plant.Dw))
    if len(rest.A) and (direct or _leaves(own.Bw, unobservable, kept @ rest.Bw)):
        return WellPosedProblem(plant)
    disturbed = _with_disturbances(plant, strength * scale[:, None] * kept) if len(rest.A) else regular
    how = "affects z only through Dw" if direct else "does not affect z"
    if not _leaves(own.Bw, unobservable):
        text = f"without control w {how}"
        return WellPosedProblem(
            disturbed, f"{text}, but the plant is not stable; {INSTEAD}", zero_gain, f"{text}; no force is applied"
        )
    best = forces[:, None] * F / scale
    stable = is_stable(plant.closed_loop(best).A, plant.dt)
    text = f"with the right state feedback w {how}; {INSTEAD}"
    return WellPosedProblem(disturbed, text, best if stable else None, f"with this gain w {how}")


def unpenalised_inputs(plant: Plant) -> list[str]:
    """Returns a list with one message if z lacks a control force, because (22) then has no optimum; else an empty list."""
    step, plant = plant.dt or 0.0, own_units(plant).into(plant.differences)
    _, rest, _ = _seen(plant.in_coordinates(np.diag(balance(plant.A)[1])), step)
    W = rest.independent_inputs()
    rank = int(np.linalg.matrix_rank(rest.D @ W, RANK * size(rest.D))) if W.shape[1] else 0
    if rank < W.shape[1]:
        return [
            f"z weights only {rank} of {W.shape[1]} independent control forces, so that nothing limits the optimal gain; give "
            "every control force a weight"
        ]
    return []


def unobservable_marginal_modes(plant: Plant, states: Sequence[str] = ()) -> list[str]:
    """Returns a list with a message about the slowest undamped mode that is unobservable in z.

    If an undamped mode is unobservable, problem (22) has no optimum. The list is empty if all undamped modes are observable.
    """
    dt, plant = plant.dt, own_units(plant).into(plant.differences)
    scale = balance(plant.A)[1]
    balanced, names = plant.in_coordinates(np.diag(scale)), list(states) or [f"x{i + 1}" for i in range(len(plant.A))]
    for F in output_nulling_gains(balanced):
        V, A = output_nulling_subspace(balanced, F)[1], balanced.closed_loop(F).A
        poles, vectors = np.linalg.eig(V.T @ A @ V) if V.shape[1] else (np.zeros(0), V)
        rounding = RANK * size(A)
        # each such pole lies on the imaginary axis or, for a discrete plant, has |1 + dt pole| = 1
        still = [
            (pole if abs(pole) > 2 * rounding else 0.0, vector)
            for pole, vector in zip(poles, vectors.T, strict=True)
            if abs(pole.real + (dt or 0.0) * abs(pole) ** 2 / 2) <= rounding
        ]
        if still:  # the slowest mode is chosen explicitly, because rounding may change the order of the modes
            at, vector = min(still, key=lambda pair: abs(pair[0]))
            where = complex(0.0, abs(at.imag)) if dt is None else complex(1 + dt * at)
            return [
                f"z does not contain the mode at {pole_text(where, dt)}, which does not decay and appears most in "
                f"{largest(scale * (V @ vector), names)}, so the optimal loop is not stable; weight a signal that contains this "
                "mode, or remove the mode from the model"
            ]
    return []


def check_marginal_modes(plant: Plant, problem: Plant, states: Sequence[str]) -> None:
    """Checks that every mode that does not decay is observable in z. If a mode that does not decay is unobservable, the path of
    (22) does not end at an optimum.

    Raises:
        InfeasibleError: no control force can stabilise the plant; the message describes the mode that cannot be stabilised.
        DesignError: the plant can be stabilised, but the optimal loop is not stable.
    """
    # without this check, the search would follow the path without reaching an optimum
    if modes := unobservable_marginal_modes(problem, states):
        if reached_by_none := "; ".join(stabilisability_failures(plant, states)):
            raise InfeasibleError(reached_by_none)
        raise DesignError(modes[0])


def _seen(plant: Plant, step: float) -> tuple[Array, Plant, Array]:
    """Returns a basis of the observable states, shape (n, k), the plant with only these states, and the gain that makes the
    other states unobservable.
    """
    kept, parts = np.eye(len(plant.A)), []
    while (part := remove_unobservable(plant, np.zeros((len(plant.A), 0)), np.eye(len(plant.A)), step)) is not None:
        kept, plant, parts = kept @ part.Z[:, : len(part.rest.A)], part.rest, [*parts, part]
    F = np.zeros_like(plant.B.T)
    for part in reversed(parts):
        F = part.gain(F)
    return kept, plant, F


def _leaves(inputs: Array, inside: Array, what: Array | None = None) -> bool:
    """Returns True if inputs drive the state out of a subspace.

    Args:
        inputs: input matrix, shape (n, r).
        inside: orthonormal basis of the subspace.
        what: component of the inputs outside the subspace; None if not yet computed.
    """
    outside = inputs - inside @ (inside.T @ inputs) if what is None else what
    return bool(np.any(np.linalg.norm(outside, axis=0) > RANK * np.linalg.norm(inputs, axis=0)))


def _with_disturbances(plant: Plant, where: Array) -> Plant:
    """Returns the plant with additional disturbances; each column of `where` is the effect of one disturbance on the states."""
    Bw, Dw = np.hstack([plant.Bw, where]), np.hstack([plant.Dw, np.zeros((len(plant.C), where.shape[1]))])
    return replace(plant, Bw=Bw, Dw=Dw)


def _with_all_outputs(plant: Plant, own: Plant, scale: Array, forces: Array) -> Plant:
    """Returns the plant with every state and every input as an additional output in z, each divided by its internal unit.

    Args:
        own: the argument `plant` in internal units.
        scale: internal unit of each state, shape (n,).
        forces: internal unit of each input, shape (m,).
    """
    n, m = plant.B.shape
    weight = size(own.C)
    states, inputs = weight * np.diag(1 / scale), weight * size(own.B) / size(own.A) * np.diag(1 / forces)
    C = np.vstack([plant.C, states, np.zeros((m, n))])
    D = np.vstack([plant.D, np.zeros((n, m)), inputs])
    return replace(plant, C=C, D=D, Dw=np.vstack([plant.Dw, np.zeros((n + m, plant.Dw.shape[1]))]))
