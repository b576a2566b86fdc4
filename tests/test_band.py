"""The norm within a band: by level sets on a stretch of the axis, against sweeps, python-control and closed forms."""

import dataclasses
import itertools

import control
import numpy as np
import pytest
from scipy import linalg

from models.common.errors import InputError
from synth.analysis.band_norm import norm_in_band, prove_in_band, stays_below
from synth.analysis.norm import hinf_norm
from synth.lmi.sdp import band_witness
from synth.plant.generalized import Feedback, GeneralizedPlant
from synth.plant.numerics import DesignError
from tests.test_norm import oscillator, system

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
    assert stays_below(plant, 1.0, 5.0, 0.99)
    assert not stays_below(plant, 1.0, np.inf, 0.99)


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


@pytest.mark.parametrize("seed", range(6))
def test_no_frequency_of_the_band_is_higher(seed):
    """On random loops and bands no gain of a dense grid exceeds the value, and one comes close; none exceeds the level."""
    plant, rng = random_system(seed), np.random.default_rng(seed + 100)
    for _ in range(6):
        low, high = np.sort(10 ** rng.uniform(-3, 3, 2))
        found, dense = norm_in_band(plant, low, high), dense_maximum(plant, low, high)
        assert dense <= found.value * (1 + 1e-12)  # rounding
        assert dense >= found.value * (1 - 1e-3)  # of the grid, a sixth of a hundredth of a damping
        assert low <= found.peak_frequency <= high
        assert stays_below(plant, low, high, found.level)
        assert not stays_below(plant, low, high, found.value * (1 - 1e-6))
        assert found.gap < 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_bands_together_are_the_axis(seed):
    """The norm is the largest of those of bands that make up the axis, and a band within another has no larger one."""
    plant = random_system(seed)
    edges = [0.0, 0.03, 0.5, 4.0, 60.0, np.inf]
    parts = [norm_in_band(plant, *band).value for band in itertools.pairwise(edges)]
    assert max(parts) == pytest.approx(hinf_norm(plant).value, rel=1e-9)  # two levels are 2e-10 apart
    assert norm_in_band(plant, 0.5, 60.0).value == pytest.approx(max(parts[2:4]), rel=1e-9)


def test_a_discrete_loop():
    """Of a discrete loop the band is one of its own frequencies, and ends at pi / dt; python-control's response agrees."""
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
    with pytest.raises(DesignError, match="the loop has a pole at z = -1"):
        norm_in_band(dataclasses.replace(system(-1.0, 1.0, 1.0), dt=dt), 1.0, 5.0)
    with pytest.raises(InputError, match=r"frequencies up to 31\.4159 rad/s; begin below that"):
        norm_in_band(plant, 32.0, 40.0)


def test_an_unstable_loop_is_said_to_be_one():
    """A band's number exists for an unstable loop, and its words say that no sinusoid settles."""
    found = norm_in_band(system(1.0, 1.0, -1.0), 1.0, 3.0)
    assert found.value == pytest.approx(0.5**0.5, rel=1e-12)
    assert not found.stability.stable
    assert "of a loop in which no sinusoid settles: unstable: a pole at 1 1/s" in found.words
    assert "settles" not in norm_in_band(system(-1.0, 1.0, -1.0), 1.0, 3.0).words


def test_a_pole_on_the_bands_stretch():
    """An undamped resonance makes the bands infinite that have it, and no other; nothing is proved to lie above them."""
    plant = system([[0, 1], [-1, 0]], [[1], [0]], [[0, 1]])
    found = norm_in_band(plant, 0.5, 2.0)
    assert (found.value, found.peak_frequency) == (np.inf, pytest.approx(1.0))
    assert "a pole at 1 rad/s, to rounding, does not decay" in found.words
    assert not stays_below(plant, 0.5, 2.0, 1e12)
    assert norm_in_band(plant, 2.0, 3.0).value == pytest.approx(1 / 3, rel=1e-12)  # -1 / (s^2 + 1) at 2j


def test_a_huge_gain_has_its_digits_in_a_band():
    """Of a gain of 1e12 both routes take twice the digits, and say how far rounding may have moved the value."""
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


@pytest.mark.parametrize(
    ("low", "high"), [(-1.0, 2.0), (2.0, 2.0), (3.0, 2.0), (np.nan, 2.0), (1.0, np.nan), (np.inf, np.inf), ("1", 2.0), (1j, 2)]
)
def test_what_is_no_band(low, high):
    """A band begins at 0 or above, and ends above that; else one line says so."""
    with pytest.raises(InputError, match="rad/s is no band; give where it begins, from 0, and where it ends, above that"):
        norm_in_band(oscillator(1.0, 0.1), low, high)


@pytest.mark.parametrize("level", [0.0, -1.0, np.nan, np.inf, "1"])
def test_what_is_no_level(level):
    """A level is a finite number above zero."""
    with pytest.raises(InputError, match="is no gain to stay below"):
        stays_below(oscillator(1.0, 0.1), 1.0, 2.0, level)


def lemma(loop: GeneralizedPlant, P: np.ndarray, Q: np.ndarray, bound: float, low: float, high: float) -> np.ndarray:
    """The matrix of the generalized KYP lemma in floats, as Iwasaki and Hara write it."""
    n, r = loop.Bw.shape
    if np.isfinite(high):
        mean = (low + high) / 2
        middle = np.block([[-Q, P + 1j * mean * Q], [P - 1j * mean * Q, -low * high * Q]])
    else:
        middle = np.block([[Q, P], [P, -(low**2) * Q]])
    F = np.block([[loop.A, loop.Bw], [np.eye(n), np.zeros((n, r))]])
    z = np.hstack([loop.C, loop.Dw])
    return F.T @ middle @ F + z.T @ z - bound**2 * np.diag([0.0] * n + [1.0] * r)


@pytest.mark.parametrize("name", ["passive", "I"])
@pytest.mark.parametrize("band", [(LOW, HIGH), (0.0, 20.0), (30.0, np.inf), (0.0, np.inf)])
def test_witnesses_of_the_papers_loops(paper, designer, name, band):
    """Every loop of the paper has a witness for a bound at most 0.1 % above its norm in a band, closed or open at either end."""
    G = designer.design(name).state_gain(paper)
    norm = norm_in_band(designer.plant.closed_loop(G), *band).value
    proof = band_witness(designer.plant, G, *band)
    assert norm < proof.bound <= norm * 1.0011
    assert proof.holds
    assert prove_in_band(designer.plant, G, proof.P, proof.Q, proof.bound, *band).holds
    matrix = lemma(designer.plant.closed_loop(G), proof.P, proof.Q, proof.bound, *band)
    np.testing.assert_allclose(matrix, matrix.conj().T, atol=1e-12 * np.abs(matrix).max())
    scale = np.abs(np.diag(matrix)) ** -0.5  # balanced, its eigenvalues are what was proved
    assert np.linalg.eigvalsh(matrix * scale * scale[:, None])[-1] < 0


def test_a_proof_is_of_its_own_bound_band_and_loop(paper, designer):
    """A witness proves nothing of a bound below the norm, of a wider band that has more, or of another loop; nor with a Q < 0."""
    plant, G = designer.plant, designer.design("I").state_gain(paper)
    proof, norm = band_witness(plant, G, LOW, HIGH), norm_in_band(plant.closed_loop(G), LOW, HIGH).value
    P, Q = proof.P, proof.Q
    assert prove_in_band(plant, G, P, Q, proof.bound * 1.01, LOW, HIGH).holds
    assert not prove_in_band(plant, G, P, Q, norm * (1 - 1e-9), LOW, HIGH).holds
    assert not prove_in_band(plant, G, P, Q, proof.bound, LOW, HIGH * 1.01).holds
    assert not prove_in_band(plant, G, P, Q, proof.bound, LOW, np.inf).holds
    assert not prove_in_band(plant, 1.01 * G, P, Q, proof.bound, LOW, HIGH).holds
    assert not prove_in_band(plant, G, P, -Q, proof.bound, LOW, HIGH).holds
    assert not prove_in_band(plant, G, P.conj(), Q.conj(), proof.bound, LOW, HIGH).holds  # that of the band's mirror image


def test_the_lemma_by_integers():
    """On random numbers what is said of definiteness is what the eigenvalues of the matrix in floats say."""
    told, rng = 0, np.random.default_rng(0)
    for seed in range(200):
        plant = random_system(seed, 2)
        plant = dataclasses.replace(plant, B=rng.standard_normal((2, 1)), D=rng.standard_normal((3, 1)))
        P, Q = ((M + M.conj().T) / 2 for M in rng.standard_normal((2, 2, 2)) + 1j * rng.standard_normal((2, 2, 2)))
        low, high, bound = rng.uniform(0, 2), rng.uniform(3, 9) if seed % 3 else np.inf, rng.uniform(3, 30)
        K, Cy = rng.standard_normal((1, 2)), rng.standard_normal((2, 2))
        proof = prove_in_band(plant, Feedback(K, Cy), 100 * P, Q, bound, low, high)
        matrix = -lemma(plant.closed_loop(K @ Cy), 100 * P, Q, bound, low, high)
        diagonal = np.real(np.diag(matrix))
        if np.all(diagonal > 0):
            told += 1
            scale = np.exp2(-np.round(np.log2(diagonal) / 2))
            smallest = np.linalg.eigvalsh(matrix * scale * scale[:, None])[0]
            assert proof.negative.smallest == pytest.approx(smallest, rel=1e-9, abs=1e-11)  # rounding of entries of a thousand
        else:
            assert np.isnan(proof.negative.smallest)
        assert proof.positive.proved == bool(np.linalg.eigvalsh(Q)[0] > 0)
    assert told > 20


def test_a_witness_says_nothing_of_stability():
    """An unstable loop has a witness in a band as well, with a P that is not positive."""
    plant = system(1.0, 1.0, -1.0)
    proof = band_witness(plant, np.zeros((1, 1)), 1.0, 3.0)
    assert proof.holds
    assert proof.bound == pytest.approx(0.5**0.5, rel=1e-3)
    assert not norm_in_band(plant, 1.0, 3.0).stability.stable


def test_what_has_no_witness(designer):
    """Without a finite norm above zero there is nothing to prove, and a discrete plant or what is no band are refused."""
    with pytest.raises(DesignError, match="there is no bound to prove: the norm within the band is inf"):
        band_witness(system([[0, 1], [-1, 0]], [[1], [0]], [[0, 1]]), np.zeros((1, 2)), 0.5, 2.0)
    G = np.zeros((1, 4))
    with pytest.raises(InputError, match="is done for continuous ones alone"):
        band_witness(dataclasses.replace(designer.plant, dt=0.1), G, 0.5, 2.0)
    with pytest.raises(InputError, match="is no band"):
        band_witness(designer.plant, G, 2.0, 0.5)
    with pytest.raises(InputError, match="is no band"):
        prove_in_band(designer.plant, G, np.eye(4), np.eye(4), 1.0, 2.0, 0.5)
    with pytest.raises(InputError, match=r"the bound 1e\+250 with P and Q of sizes 1 and 1 is out of range"):
        prove_in_band(designer.plant, G, np.eye(4), np.eye(4), 1e250, 0.5, 2.0)
    with pytest.raises(InputError, match="out of range"):
        prove_in_band(designer.plant, G, np.nan * np.eye(4), np.eye(4), 1.0, 0.5, 2.0)
