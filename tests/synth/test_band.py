"""The norm within a band: by level sets on a stretch of the axis, against sweeps, python-control and closed forms."""

import dataclasses
import itertools

import control
import numpy as np
import pytest
from scipy import linalg

from models.common.errors import InputError
from synth.analysis.band_norm import norm_in_band
from synth.analysis.norm import hinf_norm
from synth.plant.generalized import Feedback, GeneralizedPlant
from synth.plant.numerics import DesignError
from tests.support.commands import attacks
from tests.synth.test_norm import oscillator, system

LOW, HIGH = 2 * np.pi * 4.0, 2 * np.pi * 8.0


@pytest.mark.parametrize(
    ("name", "expected"), [("passive", 2.186), ("state_printed", 2.536), ("I", 2.052), ("II", 2.198), ("three", 0.780)]
)
def test_the_papers_loops_from_4_to_8_hz(paper, designer, name, expected):
    """The paper's loops have these norms from 4 to 8 Hz; with the wheel's velocity it is 0.780, of 7.887 in all."""
    if name == "three":
        rows, _ = paper.linear_model.rows(["suspension_deflection", "sprung_velocity", "unsprung_velocity"])
        loop = designer.plant.closed_loop(Feedback(np.array([[12194.0, -877.0, -252.0]]), rows))
        assert hinf_norm(loop).value == pytest.approx(7.887, abs=5e-4)  # given with 4 digits
    else:
        loop = designer.plant.closed_loop(designer.design(name).state_gain(paper))
    found = norm_in_band(loop, LOW, HIGH)
    assert found.value == pytest.approx(expected, abs=6e-4)  # from a grid, given with 3 decimals
    assert 0 < found.level / found.value - 1 < 1e-9
    there = loop.frequency_response(np.array([found.peak_frequency]))
    assert np.linalg.norm(there, 2, axis=(1, 2))[0] == pytest.approx(found.value, rel=1e-12)  # rounding


def test_a_peak_within_and_beside_a_band():
    """A thin resonance counts with its peak where the band has it, with the nearer edge's gain where it has not."""
    plant = oscillator(7.0, 1e-4)
    at = 7.0 * np.sqrt(1 - 2e-8)
    peak = 1 / (2e-4 * np.sqrt(1 - 1e-8))

    def gain(omega: float) -> float:
        return 49.0 / abs(49.0 - omega**2 + 2j * 1e-4 * 7.0 * omega)

    for low, high, expected, where in [
        (0.0, np.inf, peak, at),
        (1.0, 7.1, peak, at),
        (6.9999, np.inf, peak, at),
        (7.5, 9.0, gain(7.5), 7.5),
        (7.5, np.inf, gain(7.5), 7.5),
        (0.0, 6.5, gain(6.5), 6.5),
        (3.0, 6.5, gain(6.5), 6.5),
    ]:
        found = norm_in_band(plant, low, high)
        assert found.value == pytest.approx(expected, rel=1e-9)  # conditioning of the pole: 1e-16 over 1e-4
        assert found.peak_frequency == pytest.approx(where, rel=1e-5)  # a peak is flat: half the digits
        assert found.gap < 1e-9


def test_gain_at_infinity_counts_where_the_band_is_open():
    """A high pass reaches 1 at infinity: in an open band that is its norm, in a closed one the upper edge's gain."""
    plant = system(-2.0, 1.0, -2.0, 1.0)
    open_band, closed = norm_in_band(plant, 1.0, np.inf), norm_in_band(plant, 1.0, 5.0)
    assert (open_band.value, open_band.peak_frequency) == (pytest.approx(1.0, rel=1e-12), np.inf)
    assert (closed.value, closed.peak_frequency) == (pytest.approx(5 / np.hypot(5, 2), rel=1e-12), 5.0)


def random_system(seed: int, states: int = 8) -> GeneralizedPlant:
    """Poles from 1e-2 to 1e2 rad/s, dampings from 1 to 1e-3, two w and three z."""
    rng = np.random.default_rng(seed)
    omega, damping = 10 ** rng.uniform(-2, 2, states // 2), 10 ** rng.uniform(-3, 0, states // 2)
    A = np.zeros((states, states))
    for i, (w, z) in enumerate(zip(omega, damping, strict=True)):
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[0, w], [-w, -2 * z * w]]
    T = np.linalg.qr(rng.standard_normal((states, states)))[0]
    return system(
        T.T @ A @ T,
        rng.standard_normal((states, 2)),
        rng.standard_normal((3, states)),
        rng.uniform(0, 1) * rng.standard_normal((3, 2)),
    )


def dense_maximum(plant: GeneralizedPlant, low: float, high: float) -> float:
    """The highest gain on a grid that is dense about every pole of the band."""
    poles = np.linalg.eigvals(plant.A)
    near = np.abs(np.imag(poles))[:, None] + np.abs(np.real(poles))[:, None] * np.linspace(-3, 3, 601)
    grid = np.concatenate([np.linspace(low, high, 2001), np.geomspace(max(low, 1e-4), high, 2001), near.ravel()])
    grid = grid[(grid >= low) & (grid <= high)]
    return float(np.linalg.norm(plant.frequency_response(grid), 2, axis=(1, 2)).max())


@pytest.mark.parametrize("seed", [0, 1, *attacks([2])])
def test_no_frequency_of_the_band_is_higher(seed):
    """On random loops and bands no gain of a dense grid exceeds the value, and one comes close; none exceeds the level.

    The norm is the largest of those of bands that make up the axis.
    """
    plant, rng = random_system(seed), np.random.default_rng(seed + 100)
    for _ in range(6):
        low, high = np.sort(10 ** rng.uniform(-3, 3, 2))
        found, dense = norm_in_band(plant, low, high), dense_maximum(plant, low, high)
        assert dense <= found.value * (1 + 1e-12)  # rounding
        assert dense >= found.value * (1 - 1e-3)  # of the grid, a sixth of a hundredth of a damping
        assert low <= found.peak_frequency <= high
        assert dense <= found.level
        assert found.gap < 1e-9
    parts = [norm_in_band(plant, *band).value for band in itertools.pairwise([0.0, 0.03, 0.5, 4.0, 60.0, np.inf])]
    assert max(parts) == pytest.approx(hinf_norm(plant).value, rel=1e-9)  # two levels are 2e-10 apart


@pytest.mark.attack
def test_a_discrete_loop():
    """For a discrete loop the band is one of its own frequencies, and ends at pi / dt; python-control's response agrees."""
    dt, slow = 0.1, oscillator(7.0, 0.05)
    held = linalg.expm(dt * np.block([[slow.A, slow.Bw], [np.zeros((1, 3))]]))
    A, B, C, D = held[:2, :2], held[:2, 2:], slow.C, slow.Dw
    plant, space = dataclasses.replace(system(A, B, C, D), dt=dt), control.ss(A, B, C, D, dt)
    for low, high in [(0.0, 5.0), (6.0, 8.0), (9.0, 25.0), (9.0, 1e4)]:
        found = norm_in_band(plant, low, high)
        grid = np.linspace(low, min(high, np.pi / dt), 10001)
        dense = np.abs(np.asarray(space(np.exp(1j * grid * dt)))).max()
        assert found.value == pytest.approx(dense, rel=1e-5)  # the grid's spacing over the damping, squared
        assert found.value >= dense * (1 - 1e-12)
    with pytest.raises(DesignError, match="for a pole at z = -1"):
        norm_in_band(dataclasses.replace(system(-1.0, 1.0, 1.0), dt=dt), 1.0, 5.0)
    with pytest.raises(InputError, match=r"Nyquist frequency, which is 31\.4159 rad/s for a .* s; give a smaller low"):
        norm_in_band(plant, 32.0, 40.0)


def test_an_unstable_loop_is_said_to_be_one():
    """A band's number exists for an unstable loop, and its words say that no sinusoid settles."""
    found = norm_in_band(system(1.0, 1.0, -1.0), 1.0, 3.0)
    assert found.value == pytest.approx(0.5**0.5, rel=1e-12)
    assert not found.stability.stable
    assert "but no sinusoid settles: the loop is unstable: a pole at 1 1/s" in found.words
    assert "settles" not in norm_in_band(system(-1.0, 1.0, -1.0), 1.0, 3.0).words


def test_a_pole_on_the_bands_stretch():
    """An undamped resonance makes the bands infinite that have it, and no other."""
    plant = system([[0, 1], [-1, 0]], [[1], [0]], [[0, 1]])
    found = norm_in_band(plant, 0.5, 2.0)
    assert (found.value, found.peak_frequency) == (np.inf, pytest.approx(1.0))
    assert "a pole at 1 rad/s does not decay" in found.words
    assert norm_in_band(plant, 2.0, 3.0).value == pytest.approx(1 / 3, rel=1e-12)  # -1 / (s^2 + 1) at 2j


def test_a_huge_gain_has_its_digits_in_a_band():
    """For a gain of 1e12 both routes take twice the digits, and say how far rounding may have moved the value."""
    plant = GeneralizedPlant(
        A=np.array([[0.0, 1.0], [-4.0, -0.1]]),
        B=np.array([[0.0], [1.0]]),
        Bw=np.array([[0.0], [1.0]]),
        C=np.array([[1.0, 0.0], [0.0, 0.0]]),
        D=np.array([[0.0], [0.1]]),
        Dw=np.zeros((2, 1)),
    )
    found = norm_in_band(plant.closed_loop(Feedback(np.array([[-1e12, -1e6]]), np.eye(2))), 0.5, 1.5)
    s = 1.5j
    exact = np.linalg.norm(np.array([1, 0.1 * (-1e12 - 1e6 * s)]) / (s**2 + 0.1 * s + 4 + 1e12 + 1e6 * s))
    assert found.value == pytest.approx(exact, rel=1e-11)  # of the reference's own sum
    assert found.rounding < 1e-11


@pytest.mark.parametrize(("low", "high"), [(-1.0, 2.0), (2.0, 2.0), (1.0, np.nan), (np.inf, np.inf)])
def test_what_is_no_band(low, high):
    """A band begins at 0 or above, and ends above that; else one line says so."""
    with pytest.raises(InputError, match="rad/s do not form a frequency band; give a low of at least 0, and a high above low"):
        norm_in_band(oscillator(1.0, 0.1), low, high)
