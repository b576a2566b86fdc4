"""The H-infinity norm: two routes of our own, python-control's, and SLICOT's where it is installed."""

import control
import numpy as np
import pytest

from synth.norm import hinf_norm, level_set_norm, sweep_norm
from synth.plant import GeneralizedPlant


def system(A, B, C, D=None) -> GeneralizedPlant:
    """x' = A x + B w, z = C x + D w."""
    A, B, C = np.atleast_2d(A), np.atleast_2d(B), np.atleast_2d(C)
    D = np.zeros((len(C), B.shape[1])) if D is None else np.atleast_2d(D)
    return GeneralizedPlant(A=A, B=np.zeros((len(A), 1)), Bw=B, C=C, D=np.zeros((len(C), 1)), Dw=D)


def oscillator(omega: float, damping: float) -> GeneralizedPlant:
    """omega^2 / (s^2 + 2 damping omega s + omega^2)."""
    return system([[0, 1], [-(omega**2), -2 * damping * omega]], [[0], [1]], [[omega**2, 0]])


@pytest.mark.parametrize("route", [level_set_norm, sweep_norm])
@pytest.mark.parametrize("damping", [0.3, 1e-2, 1e-4, 1e-6])
def test_resonance(route, damping):
    """A resonance peaks at 1 / (2 zeta sqrt(1 - zeta^2)), at omega sqrt(1 - 2 zeta^2), however thin it is."""
    value, at = route(oscillator(7.0, damping))
    expected = 1 / (2 * damping * np.sqrt(1 - damping**2))
    assert value == pytest.approx(expected, rel=1e-8)  # conditioning of the pole: 1e-16 / damping
    assert at == pytest.approx(7.0 * np.sqrt(1 - 2 * damping**2), rel=1e-4)  # flat at the peak


@pytest.mark.parametrize("route", [level_set_norm, sweep_norm])
def test_low_pass_and_high_pass(route):
    """A peak at zero frequency, and one at infinity."""
    assert route(system(-2.0, 1.0, 3.0))[0] == pytest.approx(1.5, rel=1e-12)
    assert route(system(-2.0, 1.0, -2.0, 1.0)) == (pytest.approx(1.0, rel=1e-9), pytest.approx(np.inf))


@pytest.mark.parametrize("seed", range(10))
def test_routes_agree_on_random_systems(seed):
    """Both routes, python-control's own and, where installed, SLICOT's ab13dd give the same norm."""
    rng = np.random.default_rng(seed)
    n = 6
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + 10.0 ** rng.uniform(-3, 0)) * np.eye(n)
    plant = system(A, rng.standard_normal((n, 2)), rng.standard_normal((2, n)), 0.1 * rng.standard_normal((2, 2)))
    norm = hinf_norm(plant)
    assert norm.gap < 1e-8
    space = control.ss(plant.A, plant.Bw, plant.C, plant.Dw)
    assert norm.value == pytest.approx(control.system_norm(space, "inf", tol=1e-8), rel=1e-7)  # its tolerance  # pyright: ignore[reportArgumentType]
    if control.slycot_check():
        assert norm.value == pytest.approx(control.linfnorm(space, tol=1e-10)[0], rel=1e-8)


def test_unstable_system_has_no_finite_norm():
    """The norm of an unstable system is infinite."""
    assert hinf_norm(system(1.0, 1.0, 1.0)).value == np.inf


@pytest.mark.parametrize("name", ["passive", "state", "I", "II"])
def test_routes_agree_on_the_paper(designer, name):
    """On every configuration of the paper the two routes agree to rounding."""
    assert designer.design(name).certificate.norm.gap < 1e-10
