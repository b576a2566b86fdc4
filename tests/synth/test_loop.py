"""Loops against simulations by matrix exponentials written here, and against python-control where it can express them."""

from dataclasses import replace

import control
import numpy as np
import pytest
from scipy import linalg

from models.laws.linear import LinearLaw
from synth.plant.harmonic_response import frequency_response
from synth.plant.loop import HoldInterval, Loop, hold_intervals, respond
from synth.plant.state_space import StateSpace
from tests.support.commands import in_the_suite

STEP = 0.01
KINDS = "continuous", "every step", "slower", "late"


def drawn_loop(seed: int) -> Loop:
    """A stable plant under a random law: with loads, noise, an actuator lag or a measured acceleration, as the seed has it."""
    rng, kind = np.random.default_rng(seed), KINDS[seed % len(KINDS)]
    n, m, q, k = (int(rng.integers(*limits)) for limits in ((2, 6), (1, 3), (1, 4), (0, 4)))
    A, B, E = (rng.standard_normal(shape) for shape in ((n, n), (n, m), (n, 2)))
    A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.2, 2)) * np.eye(n)
    C, D, F = (rng.standard_normal(shape) for shape in ((q + 2, n), (q + 2, m), (q + 2, 2)))
    D *= 0.3 * (rng.random((q + 2, 1)) < 0.4)  # the rows of accelerations
    if seed % 3 == 0:  # behind a lag no output contains the requested force
        A = np.block([[A, B], [np.zeros((m, n)), -20 * np.eye(m)]])
        B, E, C, D = np.vstack([0 * B, 20 * np.eye(m)]), np.vstack([E, np.zeros((m, 2))]), np.hstack([C, D]), 0 * D
    measured, forces = (tuple(f"{what}{i}" for i in range(count)) for what, count in (("y", q), ("u", m)))
    noise = tuple(f"noise{i}" for i in range(q))
    plant = StateSpace(A, np.hstack([B, E]), C, np.hstack([D, F]), (*forces, "road", "load"), (*measured, "z0", "z1"))
    plant = plant.with_inputs(noise, np.zeros((len(A), q)), np.eye(q + 2, q))
    own, reading, force, direct = (0.4 * rng.standard_normal(shape) for shape in ((k, k), (k, q), (m, k), (m, q)))
    law = LinearLaw(own, reading, force, direct)
    if kind == "continuous":
        return Loop(plant, replace(law, A=law.A - 2 * np.eye(k)), measured, forces)
    steps = 1 if kind == "every step" else int(rng.integers(2, 6))
    delay = int(rng.integers(0, 3)) + (int(rng.integers(steps)) / steps if kind == "late" else 0)
    law = replace(law, sample_period=steps * STEP) if seed % 5 else replace(law, A=law.A - 2 * np.eye(k))
    return Loop(plant, law, measured, forces, hold_intervals(steps * STEP, delay), STEP)


class Simulation:
    """The loop step by step: exponentials of the plant, a law that is evaluated at samples, and a list of its last forces."""

    def __init__(self, loop: Loop) -> None:
        plant, self.loop = loop.plant, loop
        self.m, self.lates = (
            len(loop.forces),
            [part.delay_samples for part in loop.hold for _ in range(round(part.duration / STEP))],
        )
        self.law, self.rows = loop.law.sampled(STEP * len(self.lates)), [plant.outputs.index(name) for name in loop.measured]
        k = plant.B.shape[1]
        self.n, whole = len(plant.A), linalg.expm(STEP * np.block([[plant.A, plant.B], [np.zeros((k, len(plant.A) + k))]]))
        self.Phi, self.Gamma = whole[: self.n, : self.n], whole[: self.n, self.n :]
        self.sizes = np.cumsum([self.n, self.law.states, self.m] + [self.m] * max(self.lates))
        self.start = np.zeros(self.sizes[-1])  # x, states of the law, the force that acted last, and earlier forces

    def run(self, start, d, added):
        """Returns the outputs, law's states and requested forces at every step, and the state behind them.

        Args:
            d: disturbances, shape (T, k).
            added: what adds to the requested forces at samples, shape (T, m).
        """
        (x, kept, before, *queue, _), rows = np.split(start, self.sizes), []
        plant, law, requested, seen = self.loop.plant, self.law, np.zeros(self.m), kept
        for i, (now, more) in enumerate(zip(d, added, strict=True)):
            if i % len(self.lates) == 0:
                y = (plant.C @ x + plant.D @ np.concatenate([before, now]))[self.rows]
                requested, seen = law.C @ kept + law.D @ y, kept
                kept = law.A @ kept + law.B @ y
                queue = [requested + more, *queue]
            before = queue[self.lates[i % len(self.lates)]]
            rows.append(np.concatenate([plant.C @ x + plant.D @ np.concatenate([before, now]), seen, requested]))
            x = self.Phi @ x + self.Gamma @ np.concatenate([before, now])
        return np.array(rows), np.concatenate([x, kept, before, *queue[: max(self.lates)]])

    def by_frequency(self, omega, d, added):
        """Returns the share of the outputs at a frequency, over one period whose end is its start times exp(j omega T)."""
        P = len(self.lates)
        turn = np.exp(1j * omega * STEP * np.arange(P + 1))[:, None]
        inputs = [turn[:P] * d, turn[:P] * added]
        pushed = self.run(self.start, *inputs)[1]
        free = [self.run(unit, 0 * inputs[0].real, 0 * inputs[1].real)[1] for unit in np.eye(len(self.start))]
        there = np.linalg.solve(turn[P, 0] * np.eye(len(self.start)) - np.array(free).T, pushed)
        return (self.run(there, *inputs)[0] / turn[:P]).mean(axis=0)


def continuous_loop(loop: Loop) -> tuple[np.ndarray, ...]:
    """A, B, C, D of the loop, from all its equations at once: those of forces and readings are solved for both."""
    plant, law, m, n = loop.plant, loop.law, len(loop.forces), len(loop.plant.A)
    q, rows, k, r = len(loop.measured), [plant.outputs.index(name) for name in loop.measured], law.states, plant.B.shape[1]
    # Unknown [u; y]; known [x; x_c; added; d].
    unknown = np.block([[np.eye(m), -law.D], [-plant.D[rows, :m], np.eye(q)]])
    known = np.zeros((m + q, n + k + r))
    known[:m, n : n + k], known[:m, n + k : n + k + m] = law.C, np.eye(m)
    known[m:, :n], known[m:, n + k + m :] = plant.C[rows], plant.D[rows, m:]
    u, y = np.split(np.linalg.solve(unknown, known), [m])
    states, outside = np.eye(n + k, n + k + r), np.eye(r - m, n + k + r, n + k + m)
    forced = np.vstack([u, outside])
    moved = np.vstack([plant.A @ states[:n] + plant.B @ forced, law.A @ states[n:] + law.B @ y])
    seen = plant.C @ states[:n] + plant.D @ forced
    return moved[:, : n + k], moved[:, n + k :], seen[:, : n + k], seen[:, n + k :]


def close(found, expected):
    """Asserts that these agree to 1e-9 of the peak."""
    assert np.abs(found - expected).max() <= 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize("kind", in_the_suite([len(KINDS) - 1], range(1, len(KINDS))))
def test_responses_are_simulations(kind):
    """75 sampled loops, prompt, slower and late by fractions: every output over time, and by frequency, is the simulation's."""
    for seed in range(kind, 200, 2 * len(KINDS)):
        loop, rng = drawn_loop(seed), np.random.default_rng(seed)
        mine, T = Simulation(loop), 40 + seed % 3  # part of a period is left
        inputs = {name: rng.standard_normal((2, T)) for name in (*loop.disturbances, *loop.forces)}
        d, added = (np.stack([inputs[name] for name in names], axis=-1) for names in (loop.disturbances, loop.forces))
        names = (*loop.plant.outputs, *loop.law_states, *loop.requested_forces)
        found = respond(loop, names, inputs)
        close(found, np.stack([mine.run(mine.start, d[i], added[i])[0] for i in range(2)]))
        close(respond(loop, names[-1:], {"road": inputs["road"][0]}), respond(loop, names, {"road": inputs["road"][0]})[:, -1:])
        omega = np.array([0.3, 17.0, 0.9 * np.pi / STEP])
        drive = {name: np.full((len(omega), 1), rng.standard_normal()) for name in inputs}
        first = [np.array([drive[name][0, 0] for name in some]) for some in (loop.disturbances, loop.forces)]
        expected = np.stack([mine.by_frequency(w, *first) for w in omega])[:, : len(loop.plant.outputs)]
        close(frequency_response(loop, loop.plant.outputs, drive, omega)[..., 0], expected)


def test_continuous_loops():
    """50 continuous loops are their equations solved at once, over time and by frequency; accelerations contain the force."""
    measures_force = 0
    for seed in range(0, 200, len(KINDS)):
        loop = drawn_loop(seed)
        A, B, C, D = continuous_loop(loop)
        inputs, omega = (*loop.forces, *loop.disturbances), np.array([0.2, 3.0, 400.0])
        closed = loop.closed_loop.part(loop.plant.outputs, inputs)
        for t in (0.1, 1.0):
            close(closed.C @ linalg.expm(closed.A * t) @ closed.B, C @ linalg.expm(A * t) @ B)
        expected = C @ np.linalg.solve(1j * omega[:, None, None] * np.eye(len(A)) - A, B) + D
        drive = {
            name: np.broadcast_to(row, (len(omega), len(inputs))) for name, row in zip(inputs, np.eye(len(inputs)), strict=True)
        }
        close(frequency_response(loop, loop.plant.outputs, drive, omega), expected)
        measures_force += loop.direct_radius > 0
        cut = loop.cut(loop.forces[:1])  # closed again, this is the loop
        close(cut.C @ linalg.expm(cut.loop_matrix(1.0)) @ cut.B, cut.C @ linalg.expm(A) @ cut.B)
    assert measures_force > 10


@pytest.mark.parametrize("late", [None, 0, 2])
def test_python_control(late):
    """Loops that no reading closes at once, continuous or sampled with whole samples of delay, are those of python-control."""
    for seed in range(40):
        loop = drawn_loop(seed)
        plant = replace(loop.plant, D=np.where(np.isin(loop.plant.inputs, loop.forces), 0.0, loop.plant.D))
        k, period = loop.law.states, None if late is None else 0.05
        law = replace(loop.law, A=loop.law.A - 2 * np.eye(k) * (late is None), sample_period=period)
        hold = () if late is None else (HoldInterval(0.05, late),)
        loop = replace(loop, plant=plant, law=law, hold=hold, step=None)
        m, q, time = len(loop.forces), len(loop.measured), () if late is None else (0.05,)
        theirs = control.ss(plant.A, plant.B, plant.C, plant.D)
        computer = control.ss(law.A, law.B, law.C, law.D, *time)
        if late is not None:
            theirs = control.sample_system(theirs, 0.05)
            for _ in range(late):
                computer = control.ss(np.zeros((m, m)), np.eye(m), np.eye(m), np.zeros((m, m)), 0.05) * computer
        back = control.append(computer, control.ss([], [], [], np.zeros((plant.B.shape[1] - m, len(plant.C) - q)), *time))
        closed = control.feedback(theirs, back, sign=1)
        omega = np.array([0.2, 3.0, 40.0])
        inputs = (*loop.forces, *loop.disturbances)
        at = 1j * omega if late is None else np.exp(1j * omega * 0.05)
        found = loop.closed_loop.part(plant.outputs, loop.disturbances).response(at)
        close(found, np.moveaxis(np.asarray(closed(at)), -1, 0)[:, :, [inputs.index(name) for name in loop.disturbances]])
