"""Peaks of signals for a disturbance of given energy: norms and proofs."""

import dataclasses

import control
import numpy as np
import pytest
from scipy import linalg

from models.common.errors import InputError
from models.roads.road import Bump
from synth.analysis.energy_to_peak import energy_peaks
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError

SIGNALS = ("suspension_deflection", "tyre_deflection", "control_force")


@pytest.mark.parametrize("name", ["passive", "state", "I", "II"])
def test_peaks_are_h2_norms_of_rows(paper, designer, name):
    """The energy-to-peak norm of one signal is its H2 norm, as python-control has it; the proved bounds lie just above.

    Over the paper's bump no signal goes beyond its bound times the root of the bump's energy.
    """
    G = designer.design(name).state_gain(paper)
    Cs, Ds = paper.linear_model.rows(SIGNALS)
    found, loop = energy_peaks(designer.plant, G, Cs, Ds), designer.plant.closed_loop(G)
    for c, peak, bound in zip(Cs + Ds @ G, found.peaks, found.bounds, strict=True):
        assert peak == pytest.approx(control.norm(control.ss(loop.A, loop.Bw, c[None], [[0.0]]), 2), rel=1e-9)  # rounding
        assert peak <= bound <= peak * (1 + 1e-8)  # the closest proof that is tried has 1e-12 of the power more
    assert found.together >= found.peaks.max() * (1 - 1e-12)
    assert found.together <= found.bound_together <= found.together * (1 + 1e-8)
    assert found.proof.holds
    step, x, reached = 1e-3, np.zeros(4), np.zeros(3)
    w = Bump(height=0.1).velocity(np.arange(0.0, 3.0, step) + step / 2)
    held = linalg.expm(step * np.block([[loop.A, loop.Bw], [np.zeros((1, 5))]]))
    for each in w:
        x = held[:4, :4] @ x + held[:4, 4] * each
        reached = np.maximum(reached, np.abs((Cs + Ds @ G) @ x))
    allowed = found.bounds * np.sqrt(np.sum(w**2) * step)
    assert np.all(reached <= allowed)
    assert reached[0] > 0.25 * allowed[0]  # so that the limit is one


def test_the_worst_disturbance_reaches_the_peak(paper, designer):
    """The w that runs backwards along the impulse response, of energy 1, takes the travel to its peak; no other goes further."""
    G = designer.design("I").state_gain(paper)
    Cs, Ds = paper.linear_model.rows(["suspension_deflection"])
    loop, peak = designer.plant.closed_loop(G), float(energy_peaks(designer.plant, G, Cs, Ds).peaks[0])
    step, count = 2e-4, 60_000  # 12 s: exp(-1.2 * 12) of the slowest mode is left
    held = linalg.expm(step * np.block([[loop.A, loop.Bw], [np.zeros((1, 5))]]))
    Ad, Bd, c = held[:4, :4], held[:4, 4], (Cs + Ds @ G)[0]
    impulse, x = np.empty(count), Bd.copy()
    for k in range(count):
        impulse[k], x = c @ x, Ad @ x
    w = impulse[::-1] / np.linalg.norm(impulse) / step**0.5
    assert np.sum(w**2) * step == pytest.approx(1.0)
    reached = impulse[::-1] @ w  # s at the end, by convolution
    assert reached <= peak
    assert reached == pytest.approx(peak, rel=1e-5)  # held over steps of 0.2 ms: second order in 63 rad/s times that
    rng = np.random.default_rng(0)
    for _ in range(20):
        other = rng.standard_normal(count)
        assert abs(impulse[::-1] @ (other / np.linalg.norm(other) / step**0.5)) < peak


def test_several_disturbances_and_signals():
    """With two disturbances the peak is over both at once, and the length of two signals lies between theirs and their sum."""
    rng = np.random.default_rng(3)
    A = rng.standard_normal((5, 5)) - 4 * np.eye(5)
    plant = GeneralizedPlant(A, np.zeros((5, 1)), rng.standard_normal((5, 2)), np.eye(5), np.zeros((5, 1)), np.zeros((5, 2)))
    Cs = rng.standard_normal((2, 5))
    found = energy_peaks(plant, np.zeros((1, 5)), Cs, np.zeros((2, 1)))
    alone = [
        energy_peaks(dataclasses.replace(plant, Bw=plant.Bw[:, [i]], Dw=plant.Dw[:, [i]]), np.zeros((1, 5)), Cs, np.zeros((2, 1)))
        for i in range(2)
    ]
    np.testing.assert_allclose(found.peaks**2, alone[0].peaks ** 2 + alone[1].peaks ** 2, rtol=1e-9)
    assert found.peaks.max() < found.together < np.linalg.norm(found.peaks)


def test_bad_input(designer):
    """A wrong shape, an unstable loop and a discrete plant are refused in one line each."""
    plant, G, Cs, Ds = designer.plant, np.zeros((1, 4)), np.eye(4)[:1], np.zeros((1, 1))
    for arguments, said in [
        ((dataclasses.replace(plant, dt=0.1), G, Cs, Ds), "this function needs a continuous plant"),
        ((plant, G, np.eye(3), Ds), r"Cs has shape \(3, 3\) and Ds \(1, 1\); give the shapes \(p, 4\) and \(p, 1\)"),
        ((plant, G, Cs, np.zeros((2, 1))), "give the shapes"),
    ]:
        with pytest.raises(InputError, match=said):
            energy_peaks(*arguments)
    with pytest.raises(DesignError, match=r"no bound .* the loop is unstable: a pole at .*; stabilise the loop first"):
        energy_peaks(plant, np.array([[0.0, 0.0, 1e5, 0.0]]), Cs, Ds)
