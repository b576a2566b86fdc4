"""Plants that leave problem (22) without an optimum, or every gain one: what is the case, and a problem beside it that has one.

- **w does not reach z**, or some gain keeps it out: a norm of 0 is reached, and eta has no bound. Then every state that z sees is
  disturbed by itself, too.
- **No control force reaches z**: the norm is the same for all gains. Then every state and every force counts, too.

The gain is certified for the plant as it is: an X that proves a bound with more disturbances and outputs proves it with fewer.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from synth.certificate.stability import balance, is_stable, pole_text
from synth.lmi.unseen import RANK, hidden, nulling, unseen
from synth.modes import largest
from synth.plant import GeneralizedPlant, check_states
from synth.scaling import own_units, size

INSTEAD = "designed against a disturbance of every state that z sees"


@dataclass(frozen=True, eq=False)
class Posed:
    """A problem that has an optimum.

    Attributes:
        plant: to be designed for; the given one, but in the two cases above.
        case: what is the case of a gain designed for it, in words; empty where neither is.
        best: a state gain that nothing beats, shape (m, n), where one is known.
        best_case: what is the case of that gain.
    """

    plant: GeneralizedPlant
    case: str = ""
    best: Array | None = None
    best_case: str = ""

    def __post_init__(self) -> None:
        if self.best is not None:
            self.best.flags.writeable = False


@functools.lru_cache(maxsize=2)  # both steps of a design ask for it, and plants do not change
def posed(plant: GeneralizedPlant) -> Posed:
    """The problem (22) of a plant, or one beside it; what is the case, and what is beside it, does not depend on units.

    Raises:
        InputError: the plant has no state.
    """
    check_states(len(plant.A))
    if not (np.any(plant.Bw) or np.any(plant.Dw)) or not (np.any(plant.C) or np.any(plant.D)):
        return Posed(plant)  # bad input, and the central path says so
    scale, forces = own_units(plant).exact
    step, form = plant.dt or 0.0, plant.differences
    own, nothing = form.in_coordinates(np.diag(scale)).with_inputs(np.diag(forces)), np.zeros_like(plant.B.T)
    blind = hidden(own, nothing)[1]  # what z does not see without control
    alone = nothing if is_stable(plant.A, plant.dt) else None
    strength = size(own.Bw) * (plant.dt or 1.0)
    everything = _counting(_disturbed(plant, strength * np.diag(scale)), own, scale, forces)

    if not np.any(plant.D) and not _leaves(own.B, blind):
        said = "no control force reaches z: its norm is the same for every gain"
        return Posed(everything, f"{said} that stabilises the plant", alone, f"{said}; none is applied")

    kept, rest, F = _seen(own, step)
    direct = bool(np.any(plant.Dw))
    if len(rest.A) and (direct or _leaves(own.Bw, blind, kept @ rest.Bw)):
        return Posed(plant)
    beside = _disturbed(plant, strength * scale[:, None] * kept) if len(rest.A) else everything
    how = "only through Dw" if direct else "in no way"
    if not _leaves(own.Bw, blind):
        said = f"without control w reaches z {how}"
        return Posed(beside, f"{said}, but the plant is not stable; {INSTEAD}", alone, f"{said}; none is applied")
    best = forces[:, None] * F / scale
    stable = is_stable(plant.closed_loop(best).A, plant.dt)
    said = f"with the right state feedback w reaches z {how}; {INSTEAD}"
    return Posed(beside, said, best if stable else None, f"with this gain w reaches z {how}")


def free_force(plant: GeneralizedPlant) -> list[str]:
    """Why (22) has no optimum where a control force costs nothing, in words; empty where each does."""
    step, plant = plant.dt or 0.0, own_units(plant).into(plant.differences)
    _, rest, _ = _seen(plant.in_coordinates(np.diag(balance(plant.A)[1])), step)
    W = rest.independent_inputs()
    rank = int(np.linalg.matrix_rank(rest.D @ W, RANK * size(rest.D))) if W.shape[1] else 0
    if rank < W.shape[1]:
        return [
            f"some control force costs nothing: z weighs {rank} of {W.shape[1]} independent ones, so that nothing bounds the "
            "gain of the optimum; give every control force a weight"
        ]
    return []


def standing(plant: GeneralizedPlant, states: Sequence[str] = ()) -> list[str]:
    """Why (22) has no optimum where z does not see a mode that neither decays nor grows, in words; empty where it sees all.

    Args:
        plant: n states, m inputs.
        states: names of the states; x1, x2, ... without them.
    """
    dt, plant = plant.dt, own_units(plant).into(plant.differences)
    scale = balance(plant.A)[1]
    balanced, names = plant.in_coordinates(np.diag(scale)), list(states) or [f"x{i + 1}" for i in range(len(plant.A))]
    for F in nulling(balanced):
        V, A = hidden(balanced, F)[1], balanced.closed_loop(F).A
        poles, vectors = np.linalg.eig(V.T @ A @ V) if V.shape[1] else (np.zeros(0), V)
        rounding = RANK * size(A)
        if dt is None:
            still = [
                (abs(pole.imag) if abs(pole.imag) > rounding else 0.0, vector)
                for pole, vector in zip(poles, vectors.T, strict=True)
                if abs(pole.real) <= rounding
            ]
        else:  # |1 + dt pole| = 1
            still = [
                (pole if abs(pole) > rounding else 0.0, vector)
                for pole, vector in zip(poles, vectors.T, strict=True)
                if abs(pole.real + dt * abs(pole) ** 2 / 2) <= rounding
            ]
        if still:  # the slowest of them: which comes first is rounding's choice
            at, vector = min(still, key=lambda pair: abs(pair[0]))
            where = complex(0.0, at.real) if dt is None else complex(1 + dt * at)
            return [
                f"z does not see the mode at {pole_text(where, dt)}, which does not decay and moves most in "
                f"{largest(scale * (V @ vector), names)}: the optimum would let it be, and is not stable; weigh a signal that it "
                "is seen in, or take it out of the model"
            ]
    return []


def _seen(plant: GeneralizedPlant, step: float) -> tuple[Array, GeneralizedPlant, Array]:
    """What `unseen` leaves of a plant for (22): its coordinates, shape (n, k), its plant; and the gain that hides the rest."""
    kept, parts = np.eye(len(plant.A)), []
    while (part := unseen(plant, np.zeros((len(plant.A), 0)), np.eye(len(plant.A)), step)) is not None:
        kept, plant, parts = kept @ part.Z[:, : len(part.rest.A)], part.rest, [*parts, part]
    F = np.zeros_like(plant.B.T)
    for part in reversed(parts):
        F = part.gain(F)
    return kept, plant, F


def _leaves(inputs: Array, inside: Array, what: Array | None = None) -> bool:
    """Whether inputs drive anything outside a set of states; or `what` of them does, where that is given."""
    outside = inputs - inside @ (inside.T @ inputs) if what is None else what
    return bool(np.any(np.linalg.norm(outside, axis=0) > RANK * np.linalg.norm(inputs, axis=0)))


def _disturbed(plant: GeneralizedPlant, where: Array) -> GeneralizedPlant:
    """With disturbances that act on the states as the columns of `where` say."""
    Bw, Dw = np.hstack([plant.Bw, where]), np.hstack([plant.Dw, np.zeros((len(plant.C), where.shape[1]))])
    return replace(plant, Bw=Bw, Dw=Dw)


def _counting(plant: GeneralizedPlant, own: GeneralizedPlant, scale: Array, forces: Array) -> GeneralizedPlant:
    """With every state and every input in z, each in its own size, where the plant itself is `own`."""
    n, m = plant.B.shape
    weight = size(own.C)
    states, inputs = weight * np.diag(1 / scale), weight * size(own.B) / size(own.A) * np.diag(1 / forces)
    C = np.vstack([plant.C, states, np.zeros((m, n))])
    D = np.vstack([plant.D, np.zeros((n, m)), inputs])
    return replace(plant, C=C, D=D, Dw=np.vstack([plant.Dw, np.zeros((n + m, plant.Dw.shape[1]))]))
