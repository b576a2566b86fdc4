"""LQR, LQG, H2 and leaky integrators: the best in the mean, by two routes, and never better when anything is changed."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, linalg

from models.common.errors import InputError
from models.laws.linear import LinearLaw, static_law
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from synth.analysis.norm import hinf_norm
from synth.controller.problem import generalized_plant
from synth.design.full_order.full_order import full_order_design
from synth.design.full_order.quadratic import ASSUMED_SIZE, h2_design, h2_norm, lqg_design, lqr_design
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError, InfeasibleError
from synth.vehicle.designer import Designer
from tests.models.test_units import Moved
from tests.support.commands import attacks
from tests.synth.test_noise import noisy

SLOW = "sprung_acceleration = 1.0\nsuspension_deflection = 0.1\ntyre_deflection = 0.2\n"


def loop_of(plant: GeneralizedPlant, Cy: np.ndarray, law: LinearLaw, Dyw: np.ndarray | None = None) -> GeneralizedPlant:
    """The closed loop."""
    larger, G = plant.measured(Cy, Dyw).with_law(law)
    return larger.closed_loop(G)


def norm_of(plant: GeneralizedPlant, Cy: np.ndarray, law: LinearLaw, Dyw: np.ndarray | None = None) -> float:
    """The H2 norm of a loop by its Gramian; infinite where it is not stable."""
    loop = loop_of(plant, Cy, law, Dyw)
    return h2_norm(loop) if np.all(np.linalg.eigvals(loop.A).real < 0) else np.inf


def by_frequencies(loop: GeneralizedPlant) -> float:
    """The same from the power at all frequencies, the root of the integral of |T|^2 over omega / 2 pi."""

    def power(angle: float) -> float:
        T = loop.frequency_response(np.array([np.tan(angle)]))[0]
        return float(np.sum(np.abs(T) ** 2)) / np.cos(angle) ** 2

    total, _ = integrate.quad(power, -np.pi / 2, np.pi / 2, limit=2000, epsrel=1e-10)
    return float(np.sqrt(total / (2 * np.pi)))


def changed(law: LinearLaw, seed: int, by: float) -> LinearLaw:
    """A law with all its entries moved a little, each by its own."""
    rng = np.random.default_rng(seed)
    A, B, C, D = (
        matrix + by * np.abs(matrix).max(initial=0.0) * rng.standard_normal(matrix.shape)
        for matrix in (law.A, law.B, law.C, law.D)
    )
    return LinearLaw(A, B, C, D)


@pytest.mark.parametrize("seed", range(3))
def test_lqr(seed):
    """Its gain is that of python-control's lqr for these weights, its norm two routes', and no other gain has a smaller one."""
    import control

    plant, _, _ = noisy(seed, 1.0)
    rng = np.random.default_rng(seed)
    plant = replace(plant, D=plant.D + 0.2 * rng.standard_normal(plant.D.shape))
    found = lqr_design(plant)
    K, _, _ = control.lqr(plant.A, plant.B, plant.C.T @ plant.C, plant.D.T @ plant.D, plant.C.T @ plant.D)
    np.testing.assert_allclose(found.law.D, -np.asarray(K), rtol=1e-7, atol=1e-7 * np.abs(K).max())  # two Riccati solvers
    everything = np.eye(len(plant.A))
    assert found.h2_norm == pytest.approx(by_frequencies(found.certificate.loop), rel=1e-8)  # the quadrature
    for i in range(20):
        other = norm_of(plant, everything, changed(found.law, i, 10.0 ** -(i % 4)))
        assert other >= found.h2_norm * (1 - 1e-9)  # rounding of the Gramian
    assert not found.remark


@pytest.mark.parametrize("seed", range(3))
def test_lqg_and_h2(seed):
    """They are one law for one noise: python-control's Kalman gain and lqr put together, and no changed law is better."""
    import control

    plant, Cy, Dyw = noisy(seed, 0.4)
    found = h2_design(plant, Cy, Dyw)
    K, _, _ = control.lqr(plant.A, plant.B, plant.C.T @ plant.C, plant.D.T @ plant.D)
    L, _, _ = control.lqe(plant.A, np.eye(len(plant.A)), Cy, plant.Bw @ plant.Bw.T, Dyw @ Dyw.T)
    K, L = np.asarray(K), np.asarray(L)
    textbook = LinearLaw(plant.A - plant.B @ K - L @ Cy, L, -K, np.zeros((len(K), len(Cy))))
    omega = 1j * np.array([0.0, 0.5, 2.0, 30.0])[:, None, None] * np.eye(len(K.T))
    one, other = (law.C @ np.linalg.solve(omega - law.A, law.B.astype(complex)[None]) for law in (found.law, textbook))
    np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9 * np.abs(other).max())  # two Riccati solvers
    assert found.h2_norm == pytest.approx(by_frequencies(found.certificate.loop), rel=1e-8)  # the quadrature
    for i in range(20):
        assert norm_of(plant, Cy, changed(found.law, i, 10.0 ** -(i % 4)), Dyw) >= found.h2_norm * (1 - 1e-9)
    assert not found.remark
    alone = replace(plant, Bw=plant.Bw[:, :2], Dw=plant.Dw[:, :2])
    same = lqg_design(alone, Cy, [0.4] * len(Cy))
    assert same.h2_norm == pytest.approx(found.h2_norm, rel=1e-9)
    assert not same.remark
    # What it is the best against is none of what it is certified against: w is the plant's alone.
    assert same.certificate.norm.value == pytest.approx(hinf_norm(loop_of(alone, Cy, found.law)).value, rel=1e-9)
    assert same.certificate.norm.value < found.certificate.norm.value
    assert lqr_design(plant).h2_norm <= found.h2_norm
    assert hinf_norm(found.certificate.loop).value == pytest.approx(found.certificate.norm.value, rel=1e-9)


@pytest.mark.parametrize("kind", ["quarter_car", "half_car", "full_car"])
def test_cars(kind):
    """A car's LQR is the best in the mean, LQG pays for what it does not measure, and the noise it takes for granted is said."""
    vehicle = read_vehicle(kind)
    plant, Cy = generalized_plant(vehicle), vehicle.linear_model.rows(vehicle.controllers["I"].measured)[0]
    lqr, lqg, h2 = lqr_design(plant), lqg_design(plant, Cy), h2_design(plant, Cy)
    static = norm_of(plant, Cy, static_law(np.zeros((plant.B.shape[1], len(Cy)))))
    assert lqr.h2_norm < lqg.h2_norm < static
    assert h2.h2_norm == pytest.approx(lqg.h2_norm, rel=1e-9)
    assert not lqr.remark
    said = "this design needs noise on every measurement"
    assert lqg.remark == f"{said}; {100 * ASSUMED_SIZE:g} % of the plant's own size was assumed where they are missing"
    assert lqg.certificate.stable
    noisier = lqg_design(plant, Cy, [0.05] * len(Cy))
    assert not noisier.remark
    assert noisier.h2_norm > lqr.h2_norm


def test_a_slow_mode_and_no_weight_on_the_force():
    """Where the acceleration alone prices the force, a mode of 0.2 rad/s is left: LQR is SciPy's of the plant in SI units."""
    car = parse_vehicle(
        re.sub(r"(?ms)^\[performance\].*?(?=^\[)", f"[performance]\n{SLOW}\n", read_vehicle("quarter_car").text)
        + '[controllers.lqr]\ndesign = "lqr"\n'
    )
    plant = generalized_plant(car)
    weight, cross = plant.D.T @ plant.D, plant.C.T @ plant.D
    X = linalg.solve_continuous_are(plant.A, plant.B, plant.C.T @ plant.C, weight, s=cross)
    K = -np.linalg.solve(weight, plant.B.T @ X + cross.T)
    assert np.abs(np.linalg.eigvals(plant.A + plant.B @ K)).min() < 0.4
    np.testing.assert_allclose(Designer(car).design("lqr").law.D, K, rtol=1e-6, atol=1e-6 * np.abs(K).max())


def test_a_force_that_costs_nothing():
    """If z does not weigh a force a small cost is assumed, and said."""
    plant, Cy, Dyw = noisy(2, 0.4)
    free = replace(plant, D=0 * plant.D)
    assert "a cost of every force" in lqr_design(free).remark
    assert "noise" not in h2_design(free, Cy, Dyw).remark
    assert lqr_design(free).h2_norm < lqr_design(plant).h2_norm


@pytest.mark.parametrize("seed", range(4))
def test_units(seed):
    """The same law in units that differ by powers of two, also where noise is assumed."""
    plant, Cy, _ = noisy(seed, 0.4)
    moved = Moved(plant, Cy, seed)
    one, other = lqg_design(plant, Cy), lqg_design(moved.plant, moved.Cy)
    assert other.h2_norm == pytest.approx(one.h2_norm * moved.norm * moved.t**0.5, rel=1e-9)  # rounding of the Gramian
    through = [np.einsum("mk,kq->kmq", each.law.C, each.law.B) for each in (one, other)]
    np.testing.assert_array_equal(moved.u[:, None] / moved.t * through[1] * moved.y, through[0])
    np.testing.assert_array_equal(moved.u[:, None] * lqr_design(moved.plant).law.D / moved.x, lqr_design(plant).law.D)


def test_no_force():
    """If no force does anything, and none is needed, none is applied, by whatever design."""
    plant, Cy, _ = noisy(0, 1.0)
    idle = replace(plant, B=0 * plant.B, D=0 * plant.D)
    for found in (lqr_design(idle), lqg_design(idle, Cy), h2_design(idle, Cy), full_order_design(idle, Cy)):
        assert not found.law.acts
        assert found.certificate.norm.value == pytest.approx(hinf_norm(plant).value, rel=1e-9)  # rounding of the norm


def test_refused():
    """A problem without a best in the mean is refused, and why is said."""
    plant, Cy, _ = noisy(0, 1.0)
    n, m = plant.B.shape
    A = np.block([[plant.A, np.zeros((n, 1))], [np.zeros((1, n)), np.zeros((1, 1))]])
    beside = GeneralizedPlant(
        A, np.vstack([plant.B, np.ones((1, m))]), np.vstack([plant.Bw, np.ones((1, plant.Bw.shape[1]))]),
        np.hstack([plant.C, np.zeros((len(plant.C), 1))]), plant.D, plant.Dw,
    )  # fmt: skip
    with pytest.raises(DesignError, match="z does not contain a mode"):
        lqr_design(beside)
    with pytest.raises(InfeasibleError, match="none of them contains the mode at 0"):
        lqg_design(beside, np.hstack([Cy, np.zeros((len(Cy), 1))]))
    with pytest.raises(InputError, match="numbers of at least 0"):
        lqg_design(plant, Cy, [-0.1] * len(Cy))
    with pytest.raises(InputError, match="no disturbance"):
        lqr_design(replace(plant, Bw=0 * plant.Bw))


def little_noise(part: float, cost: float = 1.0) -> tuple[GeneralizedPlant, np.ndarray, list[float]]:
    """A plant with little noise on what is measured: parts of it, and of the costs of its forces."""
    plant = GeneralizedPlant(
        A=np.array([[-2.58841, 1.28038], [0.288104, -0.797557]]),
        B=np.array([[-3.59307e-3, 0.298766], [-9.81854e-3, 2.0464]]),
        Bw=np.array([[-1.00107], [-3.98213]]),
        C=np.array([[0.0422803, -0.611982], [-0.252985, -0.716133], [0.0, 0.0], [0.0, 0.0]]),
        D=np.vstack([np.zeros((2, 2)), cost * np.diag([3.77604e-4, 0.122917])]),
        Dw=np.zeros((4, 1)),
    )
    return plant, np.array([[2510.11, -1148.33], [178423.0, -267928.0]]), [part * 4.34, part * 0.0227]


@pytest.mark.parametrize(("part", "cost"), [(1.0, 1.0), (1e-2, 1e-2)])
def test_small_noise_and_cost_are_taken_as_given(part, cost):
    """The optimum is for the given noise and cost, however small: that of Riccati equations in units in which they are one."""
    plant, Cy, noise = little_noise(part, cost)
    found = lqg_design(plant, Cy, noise)
    assert part != 1 or found.h2_norm == pytest.approx(0.7013, abs=5e-5)  # of SLICOT's law, given with four digits
    assert not found.remark
    unit = np.diag(plant.D[2:])
    X = linalg.solve_continuous_are(plant.A, plant.B / unit, plant.C.T @ plant.C, np.eye(2))
    Y = linalg.solve_continuous_are(plant.A.T, (Cy / np.array(noise)[:, None]).T, plant.Bw @ plant.Bw.T, np.eye(2))
    F = -(plant.B / unit).T @ X
    squared = np.trace(plant.Bw.T @ X @ plant.Bw) + np.trace(F @ Y @ F.T)
    assert found.h2_norm**2 == pytest.approx(squared, rel=1e-5)  # rounding of a fast observer


def test_noise_too_small_for_floats():
    """Noise that no Riccati equation in floats keeps is refused in a line that gives its size, and never replaced."""
    plant, Cy, noise = little_noise(1e-4)
    with pytest.raises(DesignError, match=r"noise of a measurement is \S+ of the plant's own size.*give more, or omit it"):
        lqg_design(plant, Cy, noise)


def test_lqg_without_a_sample_period():
    """Noise in a vehicle file is refused for LQG without the sample period that its intensity takes, and not left out."""
    car = parse_vehicle(
        f"{read_vehicle('quarter_car').text}\n[implementation]\nnoise = {{ sprung_velocity = 0.01 }}\n"
        '[controllers.q]\nmeasured = ["sprung_velocity"]\ndesign = "lqg"\n'
    )
    with pytest.raises(DesignError, match=r"'q': LQG uses white noise .* has noise without sample_period; give both, or neither"):
        Designer(car).design("q")


def regular_problem(seed: int) -> tuple[GeneralizedPlant, np.ndarray, np.ndarray]:
    """A random plant whose z weighs every force, and all of whose measurements are noisy."""
    rng = np.random.default_rng(seed)
    n, m, q = (int(rng.integers(low, high)) for low, high in ((1, 6), (1, 4), (1, 4)))
    d, r = m + int(rng.integers(0, 3)), q + int(rng.integers(0, 3))
    A, B, Bw, C, D = (rng.standard_normal(shape) for shape in ((n, n), (n, m), (n, r), (d, n), (d, m)))
    return GeneralizedPlant(A, B, Bw, C, D, np.zeros((d, r))), rng.standard_normal((q, n)), rng.standard_normal((q, r))


# Of 49, 176, 273, 283 and 295 a force costs, or a measurement has, little against the plant's own size, and something.
@pytest.mark.parametrize("seed", [0, 1, 49, 176, 273, 283, 295, *attacks(range(2, 49))])
def test_the_optimum_of_a_regular_problem(seed):
    """The H2 norm of a regular problem is that of two Riccati equations (Zhou, Doyle, Glover 1996, 14.5); nothing is assumed."""
    plant, Cy, Dyw = regular_problem(seed)
    A, B, Bw, C, D = plant.A, plant.B, plant.Bw, plant.C, plant.D
    X = linalg.solve_continuous_are(A, B, C.T @ C, D.T @ D, s=C.T @ D)
    Y = linalg.solve_continuous_are(A.T, Cy.T, Bw @ Bw.T, Dyw @ Dyw.T, s=Bw @ Dyw.T)
    F = -np.linalg.solve(D.T @ D, B.T @ X + D.T @ C)
    squared = np.trace(Bw.T @ X @ Bw) + np.trace(D @ F @ Y @ F.T @ D.T)
    found = h2_design(plant, Cy, Dyw)
    assert found.h2_norm**2 == pytest.approx(squared, rel=1e-6, abs=1e-9 * np.trace(C @ C.T) * np.trace(Bw @ Bw.T))  # rounding
    assert found.remark == ""
