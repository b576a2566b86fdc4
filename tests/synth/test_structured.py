"""The barrier by sums of products of entries: the derivatives of the dense one, and the same designs."""

import numpy as np
import pytest

from synth.analysis.uncertainty_box import lmi
from synth.design.two_step import two_step_design
from synth.lmi import central_path as central
from synth.lmi import structured_barrier as structured
from synth.lmi.barrier import Barrier, FactoredDerivatives
from synth.lmi.central_path import central_path
from synth.lmi.stacked_barrier import StackedBarrier
from synth.lmi.structured_barrier import StructuredBarrier, path_constraints, start_constraints
from synth.lmi.unknowns import Basis
from synth.plant.generalized import GeneralizedPlant
from tests.benchmarks.states import chain


def a_plant(seed: int, n: int, m: int, feedthrough: float) -> GeneralizedPlant:
    """A random plant in coordinates in which X = I and Y = 0 satisfy (24) with an eta of 0.1."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    return GeneralizedPlant(
        A=A - (np.linalg.eigvalsh(A + A.T)[-1] + 4) * np.eye(n),
        B=rng.standard_normal((n, m)),
        Bw=0.3 * rng.standard_normal((n, 2)),
        C=0.3 * rng.standard_normal((3, n)),
        D=rng.standard_normal((3, m)),
        Dw=feedthrough * rng.standard_normal((3, 2)),
    )


def both(plant: GeneralizedPlant, free: int, phase: str) -> tuple[Barrier, StructuredBarrier, Basis]:
    """The two barriers of a plant, the dense one from the matrices that the unknowns multiply."""
    basis = Basis.of(plant, free)
    n, m = plant.B.shape
    if phase == "path":
        dense = Barrier([(-basis.F0, -basis.F), (np.zeros((n, n)), basis.X)])
        constraints = path_constraints(plant)
    else:
        lyapunov, box = -basis.F[:, :n, :n], np.zeros((basis.size, m + n, m + n))
        lyapunov[-1] = np.eye(n)
        box[:, :m, m:], box[:, m:, :m] = basis.Y, basis.Y.transpose(0, 2, 1)
        zero = np.zeros((n, n))
        dense = Barrier([(zero, lyapunov), (zero, basis.X), (np.eye(n), -basis.X), (10 * np.eye(m + n), box)])
        constraints = start_constraints(plant, 10.0)
    return dense, StructuredBarrier(constraints, n, m, free), basis


def hessian(here: FactoredDerivatives) -> np.ndarray:
    R = np.triu(here.triangle) / here.scale
    return R.T @ R


def somewhere(basis: Basis, rng: np.random.Generator) -> np.ndarray:
    """A feasible point of both phases."""
    n, m = basis.n, basis.m
    X = np.eye(n) / 2 + 0.02 * np.diag(rng.uniform(-1, 1, n))
    return basis.pack(X, 0.05 * rng.standard_normal((m, n)), 0.1) + 0.01 * rng.uniform(-1, 1, basis.size)


@pytest.mark.parametrize("nearly_singular", [0.0, 1e-7, 0.2, 1.0])
@pytest.mark.parametrize("phase", ["path", "start"])
@pytest.mark.parametrize(("seed", "n", "m", "free", "feedthrough"), [(0, 6, 2, 0, 0.3), (1, 7, 1, 4, 0.3), (2, 5, 3, 2, 0.0)])
def test_derivatives_are_those_of_the_dense_basis(monkeypatch, seed, n, m, free, feedthrough, phase, nearly_singular):
    """Gradient, Hessian, solutions and rates are those of `Barrier`, whatever share of S is taken by reflections."""
    monkeypatch.setattr(structured, "NEARLY_SINGULAR", nearly_singular)
    dense, quick, basis = both(a_plant(seed, n, m, feedthrough), free, phase)
    rng = np.random.default_rng(seed)
    p, step = somewhere(basis, rng), rng.standard_normal(basis.size)
    expected, found = dense.at(p), quick.at(p)
    assert expected is not None
    assert found is not None
    np.testing.assert_allclose(found.trace, expected.trace, rtol=1e-10, atol=1e-10)  # rounding of inverses of size 10
    exact = hessian(expected)
    np.testing.assert_allclose(hessian(found), exact, rtol=0, atol=1e-11 * np.abs(exact).max())  # likewise, and SHIFTS[0]
    np.testing.assert_allclose(np.sort(found.rates(step)), np.sort(expected.rates(step)), atol=1e-10)
    solved = found.solve(found.half(step))
    np.testing.assert_allclose(solved, expected.solve(expected.half(step)), rtol=0, atol=1e-9 * np.abs(solved).max())


@pytest.mark.parametrize("name", ["I", "II"])
def test_same_path(designer, monkeypatch, name):
    """The paper's design by this barrier is that by the dense one."""
    plant, Cy = designer.plant, np.eye(4)[[0, 2] if name == "I" else [2]]
    expected = designer.design(name)
    monkeypatch.setattr(central, "DENSE", 0)
    design = two_step_design(plant, Cy)
    np.testing.assert_allclose(design.gain, expected.gain, rtol=1e-7)  # rounding at the end of the path: 2e-9
    assert design.certificate.bound == pytest.approx(expected.certificate.bound, rel=1e-9)


def test_coordinates_that_no_longer_fit(monkeypatch):
    """If X grows by orders of magnitude the path goes on in other coordinates, to the same limit."""
    plant, _ = chain(8)
    Q, R = np.zeros((8, 0)), np.eye(8)
    expected = central_path(plant, Q, R)[-1]
    monkeypatch.setattr(central, "FAR", 1e2)
    found = central_path(plant, Q, R)[-1]
    assert found.eta == pytest.approx(expected.eta, rel=1e-9)  # rounding
    np.testing.assert_allclose(found.K, expected.K, rtol=0, atol=1e-5 * np.abs(expected.K).max())  # where the path is stopped


@pytest.mark.attack
def test_forty_states():
    """A chain of 40 states has a design by the two steps, certified."""
    design = two_step_design(*chain(40))
    assert design.certificate.failures == ()
    assert design.certificate.norm.value < 1.453  # measured 1.45257; a chain of 26 has 1.61


def test_loops_that_share_an_x_have_the_derivatives_of_the_dense_barrier():
    """One X of (20) of many loops: gradient, Newton step and rates are those of a barrier that knows no structure."""
    rng, V, n, r, d, eta = np.random.default_rng(20261123), 5, 4, 2, 3, 0.1
    loops = rng.standard_normal((V, n + d, n + r))
    constant = lmi(loops, np.zeros((n, n)), eta)
    stacked = StackedBarrier(constant, loops[:, :, :n])
    units = [stacked.matrix(unit) for unit in np.eye(n * (n + 1) // 2 + 1)[:-1]]
    blocks = [(np.zeros((n, n)), np.array([*units, np.zeros((n, n))]))]
    for v in range(V):
        blocks.append((-constant[v], np.array([*(constant[v] - lmi(loops, unit, eta)[v] for unit in units), np.eye(n + d)])))
    X = np.eye(n) + 0.1 * np.ones((n, n))
    p = np.append(stacked.unknowns(X), 1.5 * np.linalg.eigvalsh(lmi(loops, X, eta)).max())
    here, dense = stacked.at(p), Barrier(blocks).at(p)
    assert here is not None
    assert dense is not None
    c = rng.standard_normal(len(p))
    np.testing.assert_allclose(here.trace, dense.trace, rtol=1e-12)  # sums of some hundred terms of size one
    np.testing.assert_allclose(here.solve(here.half(c)), dense.solve(dense.half(c)), rtol=1e-9)  # the Hessian's condition
    np.testing.assert_allclose(np.sort(here.rates(c)), np.sort(dense.rates(c)), rtol=1e-11, atol=1e-12)  # some are nearly 0
    p[-1] = -1.0
    assert stacked.at(p) is None
