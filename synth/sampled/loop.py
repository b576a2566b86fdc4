"""A loop that a computer closes: a plant of which it reads the states every period, and holds the forces that it computes."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.plant import GeneralizedPlant
from synth.sampled.hold import held_inputs
from synth.sampled.lifted import with_inputs


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of the period, over which one force is held.

    Attributes:
        duration: [s].
        late: how many samples before this one the force that acts was computed.
    """

    duration: float
    late: int


@dataclass(frozen=True, eq=False)
class SampledLoop:
    """A plant and what a computer keeps and asks for at its samples.

    With x the plant's states at a sample, s what is kept, and p = [x; s],

        u = asked p,    s+ = memory p + of_force u_a,

    where u_a is the force that acts at the period's end.

    Attributes:
        plant: n states, m inputs.
        pieces: of the period, in their order, one after the other.
        asked: the forces that are computed, shape (m, n + k).
        memory: what is kept for the next sample, shape (k, n + k).
        of_force: what of it is the force that acts, shape (k, m).
    """

    plant: GeneralizedPlant
    pieces: tuple[Piece, ...]
    asked: Array
    memory: Array
    of_force: Array

    @property
    def period(self) -> float:
        """[s]."""
        return sum(piece.duration for piece in self.pieces)

    @property
    def late(self) -> int:
        """How many samples late the last force of all acts."""
        return max(piece.late for piece in self.pieces)

    @property
    def states(self) -> int:
        """N, of [x; s; forces on their way]."""
        return self.asked.shape[1] + self.late * len(self.asked)

    @cached_property
    def acting(self) -> list[tuple[float, Array]]:
        """Of every piece its duration, and which of the held inputs act, shape (m, m pieces): it has its own."""
        m, count = len(self.asked), len(self.pieces)
        return [(piece.duration, np.kron(np.eye(count)[i], np.eye(m))) for i, piece in enumerate(self.pieces)]

    @cached_property
    def moved(self) -> Array:
        """What a period makes of [x; held inputs] where nothing disturbs, less what they were, shape (n + k, n + k)."""
        total = np.zeros((0, 0))
        for duration, acting in self.acting:
            A, _, _ = with_inputs(self.plant, acting)
            n = len(A)
            # exp(A t) - I is the integral of exp(A s) A: a held input, and no 1 that takes its digits.
            piece = held_inputs(A, duration, linalg.expm, A)[1]
            total = piece if not len(total) else piece + total + piece @ total
            assert len(total) == n
        return total

    def register(self) -> tuple[Array, Array]:
        """The loop with the forces on their way as states of their own, the next to act first.

        Returns:
            From all N states to [x; held inputs] at the sample, shape (n + i, N), and to the next states but x, shape (N - n, N).
        """
        n, (m, known) = len(self.plant.A), self.asked.shape
        on_way, late = self.late * m, self.late
        N = known + on_way
        asked = np.hstack([self.asked, np.zeros((m, on_way))])
        forces = [asked if not piece.late else np.eye(m, N, known + (late - piece.late) * m) for piece in self.pieces]
        kept = np.hstack([self.memory, np.zeros((len(self.memory), on_way))]) + self.of_force @ forces[-1]
        shifted = np.eye(max(on_way - m, 0), N, known + m)
        return np.vstack([np.eye(n, N), *forces]), np.vstack([kept, shifted, asked] if late else [kept])

    def closed(self, moved: Array) -> tuple[Array, Array]:
        """The loop from sample to sample less the identity, shape (N, N), and from its N states to [x; held inputs].

        Args:
            moved: what a period makes of [x; held inputs], less what they were, shape (n + i, n + i).
        """
        start, rest = self.register()
        n, N = len(self.plant.A), start.shape[1]
        return np.vstack([moved[:n] @ start, rest - np.eye(N - n, N, n)]), start

    def turning(self, moved: Array, angles: Array) -> tuple[Array, Array]:
        """The loop at zeta = exp(j angle), where a delay is a power of zeta and the forces on their way need no states.

        Args:
            moved: as above.
            angles: [rad], shape (F,).

        Returns:
            zeta less what the loop makes of p, shape (F, n + k, n + k), and from p to [x; held inputs], shape (F, n + i, n + k).
        """
        n, known, turned = len(self.plant.A), self.asked.shape[1], np.exp(1j * angles)
        forces = [self.asked * (turned**-piece.late)[:, None, None] for piece in self.pieces]
        start = np.concatenate([np.broadcast_to(np.eye(n, known), (len(angles), n, known)), *forces], axis=1)
        matrix = np.empty((len(angles), known, known), dtype=complex)
        step = 2j * np.sin(angles / 2) * np.exp(0.5j * angles)  # zeta - 1, without the loss of digits of that difference
        matrix[:, :n] = step[:, None, None] * np.eye(n, known) - moved[:n] @ start
        matrix[:, n:] = turned[:, None, None] * np.eye(known - n, known, n) - self.memory - self.of_force @ forces[-1]
        return matrix, start
