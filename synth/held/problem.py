"""What a computer's gain is designed for: the discrete plant of a level (`sampled/lifted.py`), and forces of samples before."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from synth.plant import GeneralizedPlant
from synth.sampled.lifted import lifted
from synth.sampled.loop import Piece, SampledLoop


@dataclass(frozen=True, eq=False)
class HeldProblem:
    """A plant whose m forces are held from sample to sample and come some samples late.

    The states of a level's plant are the plant's, and the forces of samples before that are still on their way, or that what is
    measured has in it, the last first. No gain acts on those: a computer that fed back what it asked for would be a law with
    states.

    Attributes:
        plant: continuous, n states.
        Cy: shape (q, n).
        through: what the force that has acted until a sample does in what is measured there, shape (q, m).
        pieces: of the sample period: two where forces come a fraction of one late.
    """

    plant: GeneralizedPlant
    Cy: Array
    through: Array
    pieces: tuple[Piece, ...]

    @property
    def period(self) -> float:
        """[s]."""
        return sum(piece.duration for piece in self.pieces)

    @property
    def before(self) -> int:
        """How many samples before one the force was computed that has acted until it."""
        return self.pieces[-1].late + 1

    @cached_property
    def remembered(self) -> int:
        """How many samples back forces count."""
        return max(self.pieces[0].late, self.before if np.any(self.through) else 0)

    @cached_property
    def rows(self) -> Array:
        """C_y on all states, shape (q, n + m remembered)."""
        (q, m), k = self.through.shape, self.remembered
        past = np.zeros((q, k * m))
        if np.any(self.through):
            past[:, (self.before - 1) * m : self.before * m] = self.through
        return np.hstack([self.Cy, past])

    @property
    def at_once(self) -> "HeldProblem":
        """The same with forces that act at the sample, and in nothing that is measured."""
        return replace(self, through=np.zeros_like(self.through), pieces=(Piece(self.period, 0),))

    def loop(self, K: Array) -> SampledLoop:
        """The loop of a gain, shape (m, q), as the computer closes it."""
        m, kept = self.plant.B.shape[1], np.any(self.through)
        asked = K @ (np.hstack([self.Cy, self.through]) if kept else self.Cy)
        memory = np.zeros((m if kept else 0, asked.shape[1]))
        return SampledLoop(self.plant, self.pieces, asked, memory, np.eye(len(memory), m))

    def at(self, gamma: float) -> GeneralizedPlant | None:
        """The discrete plant whose norm is below 1 where the L2 gain of the loop is below a level; None where none can be."""
        (n, m), k = self.plant.B.shape, self.remembered
        count = len(self.pieces)
        held = [(piece.duration, np.eye(m, count * m, i * m)) for i, piece in enumerate(self.pieces)]
        found = lifted(self.plant, held, gamma)
        if found is None:
            return None
        start = np.zeros((n + count * m, n + (k + 1) * m))  # from states and the new force to [x; the forces that act]
        start[:n, :n] = np.eye(n)
        for i, piece in enumerate(self.pieces):
            acts = n + ((piece.late or k + 1) - 1) * m  # the new force comes last
            start[n + i * m : n + (i + 1) * m, acts : acts + m] = np.eye(m)
        moved = np.zeros((n + k * m, n + (k + 1) * m))
        moved[:n] = found.Ad[:n] @ start
        if k:
            moved[n : n + m, n + k * m :] = np.eye(m)
            moved[n + m :, n : n + (k - 1) * m] = np.eye((k - 1) * m)
        seen, driven = found.Cd @ start, np.zeros((n + k * m, found.Bd.shape[1]))
        driven[:n] = found.Bd[:n]
        states = n + k * m
        return GeneralizedPlant(
            A=moved[:, :states],
            B=moved[:, states:],
            Bw=driven,
            C=seen[:, :states],
            D=seen[:, states:],
            Dw=np.zeros((len(seen), found.Bd.shape[1])),
            dt=self.period,
        )
