"""Certificates that are not true are not believed: forged by hand, by the hundred, and against rounding."""

import contextlib
import dataclasses
import json
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest

from models.common.errors import InputError
from models.vehicle.vehicle import ControllerEntry, read_vehicle
from synth.analysis.bounding import bounding_x
from synth.analysis.certificate import LmiProof, bounded_real_exactly, certify, eta_of, prove_bound
from synth.analysis.norm import hinf_norm
from synth.analysis.record import false_claims, to_record
from synth.analysis.rigorous import definiteness
from synth.command.check import check
from synth.plant.generalized import SHAPES, GeneralizedPlant
from synth.vehicle.designer import Designer
from tests import exactly
from tests.commands import main_of, refused


@pytest.fixture(scope="module")
def honest(designer):
    """Controller I with everything that can be claimed of it."""
    controller = designer.design("I")
    return controller, to_record(controller.certificate)


def failures(designer, controller, record) -> tuple[str, ...]:
    """Returns what `--check` says of a record; it reads TOML and JSON, so numbers go through text."""
    entry = ControllerEntry("forged", controller.measured, controller.law, json.loads(json.dumps(record)))
    vehicle = dataclasses.replace(designer.vehicle, controllers={"forged": entry})
    (row,) = check(Designer(vehicle), None)
    assert (row.notes == ("checked: every claim of its certificate holds",)) == (not row.failures)
    return row.failures


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"X": None, "bound": 0.1}, "the bound is claimed to be 0.1 without its proof"),
        ({"X": None}, "without its proof: there is no X"),
        ({"bound": None}, "there is an X and no bound"),
        ({"bound": 7.843188}, "LMI"),  # the norm itself, to 7 digits: nothing proves it with this X
        ({"peak_frequency": 1.0}, "reached at 1 rad/s, and is not"),
        ({"peak_frequency": 63.7}, "reached at 63.7 rad/s, and is not"),
        ({"peak_frequency": 0}, "reached at 0 rad/s, and is not"),
        ({"peak_frequency": 1e59}, "and is not"),
        ({"norm": 0.0}, "the norm is claimed to be 0, and is 7.843187604"),
        ({"norm": 7.8431881}, "the norm is claimed to be 7.8431881"),
        ({"lower_bound": 7.84, "limit_at": 60.0}, "the lower bound is claimed to be 7.84"),
        ({"limit_at": None}, "the lower bound is claimed"),
    ],
)
def test_false_claim(designer, honest, change, message):
    """A claim without its proof, or that is not true, is named."""
    controller, record = honest
    forged = {key: value for key, value in {**record, **change}.items() if value is not None}
    assert any(message in failure for failure in failures(designer, controller, forged)), failures(designer, controller, forged)


def test_claims_alone(designer, honest):
    """A certificate of nothing but a bound is refused, one of nothing but a true norm holds."""
    controller, record = honest
    assert any("without its proof" in failure for failure in failures(designer, controller, {"bound": 0.001}))
    assert failures(designer, controller, {"norm": record["norm"], "peak_frequency": record["peak_frequency"]}) == ()


@pytest.mark.parametrize("key", ["norm", "bound", "lower_bound", "peak_frequency", "limit_at"])
@pytest.mark.parametrize("value", [-1, -1e-3, 1e-200, 1e200, 1e-61, 10**400, True, "7"])
def test_numbers_out_of_range(designer, honest, key, value):
    """A number that no vehicle has is refused in one line, whatever stands beside it."""
    controller, record = honest
    for forged in ({**record, key: value}, {key: value}):
        with refused(match=f"controllers.forged.*{key} = .* is not a number from 1e-60 to 1e\\+60"):
            failures(designer, controller, forged)


@pytest.mark.parametrize("bound", [0, 0.0])
def test_bound_of_zero(designer, honest, bound):
    """No LMI proves a bound of zero."""
    controller, record = honest
    with pytest.raises(InputError, match=r"bound = 0(\.0)? in a certificate is not a number"):
        failures(designer, controller, {**record, "bound": bound})


@pytest.mark.parametrize(
    ("forge", "message"),
    [
        (lambda X: X * 1e-320, "no entry of its diagonal may be below"),
        (lambda X: X * 1e-100, "no entry of its diagonal may be below"),
        (lambda X: X * 1e100, "none beyond 1e\\+60"),
        (lambda X: -X, "no entry of its diagonal may be below"),
        (lambda X: 0 * X, "no entry of its diagonal may be below"),
        (lambda X: X + 1e-6 * np.triu(X, 1), "X in a certificate is not symmetric"),
        (lambda X: np.tril(X), "X in a certificate is not symmetric"),
        (lambda X: X[:3], "is not a matrix of finite numbers of shape"),
        (lambda X: X[0], "is not a matrix of finite numbers of shape"),
    ],
)
def test_matrix_that_is_none(designer, honest, forge, message):
    """So is an X that is not symmetric, or out of range."""
    controller, record = honest
    with refused(match=message):
        failures(designer, controller, {**record, "X": forge(np.array(record["X"])).tolist()})


def test_limit_at_a_pole_of_the_vehicle(designer, honest):
    """Next to a pole of the vehicle alone on the axis its frequency response proves no limit above the true one."""
    controller, _ = honest
    undamped = dataclasses.replace(designer.vehicle, parameters={**designer.vehicle.parameters, "suspension_damping": 0.0})
    at = float(np.imag(np.linalg.eigvals(undamped.linear_model.A)).max())
    assert failures(Designer(undamped), controller, {"lower_bound": 100.0, "limit_at": at})


def test_command_says_it_in_one_line(tmp_path, honest, capsys):
    """`python -m synth --check` of a bound without X exits with 1 and says why; of a number out of range with 2, no traceback."""
    controller, _ = honest
    text, measured = read_vehicle("quarter_car").text, json.dumps(list(controller.measured))
    file = tmp_path / "forged.toml"
    for bound in ("0.1", "1e200"):
        file.write_text(
            f"{text}\n[controllers.forged]\nmeasured = {measured}\ngain = {controller.gain.tolist()}\n"
            f"[controllers.forged.certificate]\nbound = {bound}\n"
        )
        arguments = ["--check", str(file), "--controller", "forged"]
        if bound == "0.1":
            assert main_of("synth")(arguments) == 1
            assert "FAILS: the bound is claimed" in capsys.readouterr().out
    done = subprocess.run([sys.executable, "-m", "synth", *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "bound = 1e+200" in done.stderr
    assert "Traceback" not in done.stderr


def first_order(c: float, d: float) -> GeneralizedPlant:
    """d + c / (s + 1)."""
    A, B, Bw, C, D, Dw = (np.full((1, 1), entry) for entry in (-1.0, 0.0, 1.0, c, 0.0, d))
    return GeneralizedPlant(A, B, Bw, C, D, Dw)


def test_flat_peak():
    """If the gain is the same at every frequency each of them is a peak; where it is not, only that of the norm."""
    flat = certify(first_order(-2.0, 1.0), np.zeros((1, 1)))
    assert all(flat.peaks_at(omega) for omega in (0.0, 1e-5, 1.0, 1e5))
    low = certify(first_order(1.0, 0.0), np.zeros((1, 1)))
    assert low.peaks_at(0.0)
    assert low.peaks_at(1e-6)  # 5e-13 below
    assert not low.peaks_at(1e-4)  # 5e-9 below
    high = certify(first_order(-1.0, 1.0), np.zeros((1, 1)))
    assert high.norm.peak_frequency == np.inf
    assert "peak_frequency" not in to_record(high)
    assert not high.peaks_at(1.0)


def test_peak_is_good_to_what_flatness_allows(designer, honest):
    """1e-6 beside the peak the gain is the norm to 1e-9, a thousandth beside it is not: the frequency is held to what it says."""
    controller, record = honest
    for factor, holds in ((1 + 1e-6, True), (1 - 1e-6, True), (1.001, False), (0.999, False)):
        found = failures(designer, controller, {**record, "peak_frequency": factor * record["peak_frequency"]})
        assert (found == ()) == holds


@pytest.mark.parametrize("apart", [1e-4, 1e-8, 1e-12, 0.0])
@pytest.mark.parametrize("claim", [0.0, 1.05, 100.0])
def test_norm_of_poles_that_nearly_meet(apart, claim):
    """However near two poles are, and their eigenvectors, the norm is known to rounding, and no other one is believed."""
    A = np.array([[-1.0, 1.0], [0.0, -1.0 - apart]])
    plant = GeneralizedPlant(A, np.eye(2)[:, 1:], np.eye(2)[:, 1:], np.eye(2)[:1], np.zeros((1, 1)), np.zeros((1, 1)))
    certificate = certify(plant, np.zeros((1, 2)))
    assert certificate.norm.value == pytest.approx(1 / (1 + apart), rel=1e-12)
    assert false_claims({**to_record(certificate), "norm": claim}, certificate)


def test_bound_is_rounded_upwards():
    """The bound that eta proves is never more than the bound that is claimed, to the last bit, both ways; nor is what it
    prints as one."""
    rng, any_ = np.random.default_rng(0), definiteness(np.eye(1))
    for bound in 10.0 ** rng.uniform(-60, 60, 300):
        eta = eta_of(bound)
        assert Fraction(bound) ** 2 * Fraction(eta) >= 1
        assert LmiProof(np.eye(1), eta, any_, any_).bound <= bound
        assert eta == pytest.approx(bound**-2, rel=1e-15)  # a few units in the last place


def test_matrix_of_the_proof():
    """The judged matrix is that of (20) in rational arithmetic, whatever the sizes of its numbers, rounded once."""
    rng = np.random.default_rng(1)
    for n, m, r, d in ((1, 1, 1, 1), (4, 2, 1, 3), (3, 0, 2, 1), (2, 1, 1, 2)):
        shapes = {"A": (n, n), "B": (n, m), "Bw": (n, r), "C": (d, n), "D": (d, m), "Dw": (d, r)}
        drawn = {
            name: rng.standard_normal(shape) * 10.0 ** rng.uniform(-30, 30, shape)
            for name, shape in {**shapes, "G": (m, n), "X": (n, n)}.items()
        }
        G, X, eta = drawn.pop("G"), drawn.pop("X"), 0.3
        A, B, Bw, C, D, Dw = (drawn[name] for name in SHAPES)
        plant, X = GeneralizedPlant(A, B, Bw, C, D, Dw), X + X.T
        still, turned = exactly.bounded_real(plant, G, X), exactly.disturbed(plant)
        for i, j in np.ndindex(n + d, n + d):
            assert bounded_real_exactly(plant, G, X, eta)[i, j] == float(still[i][j] + turned[i][j] * Fraction(eta))


def near_singular(rng, k: int, smallest: float) -> np.ndarray:
    """A symmetric matrix with rows of all sizes that is singular but for `smallest` and rounding."""
    V = np.linalg.qr(rng.standard_normal((k, k)))[0]
    values = 10.0 ** rng.uniform(-6, 0, k)
    values[0] = smallest
    M = (V * values) @ V.T
    scale = 10.0 ** rng.uniform(-20, 20, k)
    M = (M + M.T) / 2 * np.outer(scale, scale)
    return (M + M.T) / 2


def hold_to_the_truth(rng, count: int) -> int:
    """Holds `definiteness` against pivots in rational arithmetic, next to singularity. Returns how many were proved."""
    proved = 0
    for i in range(count):
        M = near_singular(rng, int(rng.integers(1, 9)), rng.choice([-1, 1]) * 10.0 ** rng.uniform(-18, -8))
        found = definiteness(M)
        true = exactly.positive_definite(exactly.exact(M))
        assert true or not found.proved, i
        assert found.proved or not true or found.smallest < 3 * found.rounding, i  # what lies well beyond rounding is proved
        proved += found.proved
    return proved


@pytest.mark.parametrize("count", [100, pytest.param(2000, marks=pytest.mark.attack)])
def test_definiteness(count):
    """A proof is true next to singularity, in rows of all sizes; and what is well beyond rounding is proved."""
    assert 0.2 < hold_to_the_truth(np.random.default_rng(2), count) / count < 0.8  # neither all nor none: the question was hard
    assert not definiteness(np.array([[1.0, np.nan], [np.nan, 1.0]])).proved
    assert not definiteness(np.array([[1.0, 0.0], [0.0, np.inf]])).proved
    assert not definiteness(np.array([[0.0]])).proved
    assert definiteness(np.array([[1e-150]])).proved
    assert definiteness(np.zeros((0, 0))).proved


def forged(rng) -> tuple[GeneralizedPlant, np.ndarray, np.ndarray, float]:
    """A plant, a gain, an X and a bound next to what is true of them, by one of many tricks."""
    n = int(rng.integers(2, 5))
    A = rng.standard_normal((n, n))
    shift = rng.choice([1.0, 0.3, 1e-2, 1e-3, 1e-8, 1e-12, 0.0, -1e-12, -1e-6])  # how far from the axis the last pole is
    A -= (np.linalg.eigvals(A).real.max() + shift) * np.eye(n)
    B, C, D = rng.standard_normal((n, 1)), rng.standard_normal((2, n)), rng.standard_normal((2, 1))
    G = rng.standard_normal((1, n)) * 10.0 ** rng.uniform(-3, 4)
    plant = GeneralizedPlant(A - B @ G, B, rng.standard_normal((n, 1)), C - D @ G, D, np.zeros((2, 1)))
    units = 10.0 ** rng.uniform(-8, 8, n) if rng.random() < 0.5 else np.ones(n)
    plant, G = plant.in_coordinates(np.diag(units)), G * units
    loop = plant.closed_loop(G)
    norm = hinf_norm(loop).value
    true = norm if np.isfinite(norm) else 10.0 ** rng.uniform(-3, 12)
    margin = 10.0 ** rng.uniform(-9, 0)
    above = true * (1 + margin)
    try:
        if not np.isfinite(norm):
            raise np.linalg.LinAlgError
        X = bounding_x(loop, above, 0.1 * margin, 1e-6)
    except (np.linalg.LinAlgError, ValueError):
        root = rng.standard_normal((n, n)) * units[:, None]
        X = root @ root.T * 10.0 ** rng.uniform(-6, 0)
    trick = rng.integers(6)
    if trick == 0:
        X = X - (1 - 10.0 ** rng.uniform(-16, -6)) * np.linalg.eigvalsh(X)[0] * np.eye(n)  # next to singular
    elif trick == 1:
        X = X * 10.0 ** rng.uniform(-12, 12)
    elif trick == 2:
        X = X + 1e-3 * rng.standard_normal((n, n)) * X  # not symmetric, either
    bound = rng.choice([true * (1 - 10.0 ** rng.uniform(-12, -3)), above, above, true, true * 10.0 ** rng.uniform(-20, 20)])
    return plant, G, X, float(bound)


def attack(rng, count: int) -> int:
    """Forges certificates and holds those that pass against rational arithmetic. Returns how many passed."""
    passed = 0
    for i in range(count):
        with np.errstate(all="ignore"):
            plant, G, X, bound = forged(rng)
        try:
            proof = prove_bound(plant, G, X, eta_of(bound))
        except InputError:
            continue
        if not proof.holds:
            continue
        passed += 1
        A, B, Bw, C, D, g = (exactly.exact(part) for part in (plant.A, plant.B, plant.Bw, plant.C, plant.D, G))
        loop, out = exactly.plus(A, exactly.times(B, g)), exactly.plus(C, exactly.times(D, g))
        assert exactly.stable(loop), i
        peak = hinf_norm(plant.closed_loop(G)).peak_frequency
        poles = np.abs(np.linalg.eigvals(plant.closed_loop(G).A))
        for omega in {0.0, float(peak if np.isfinite(peak) else 0.0), float(poles.max()), float(poles.min())}:
            assert exactly.gain_squared(loop, Bw, out, omega) < Fraction(bound) ** 2, i
    return passed


def honest_pair(rng) -> tuple[GeneralizedPlant, np.ndarray, np.ndarray]:
    """A stable loop in units of all sizes, its gain, and a symmetric X > 0 that proves some bound of it."""
    n = int(rng.integers(2, 7))
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + 10.0 ** rng.uniform(-3, 0)) * np.eye(n)
    B, C, D, G = (rng.standard_normal(shape) for shape in ((n, 1), (2, n), (2, 1), (1, n)))
    plant = GeneralizedPlant(A - B @ G, B, rng.standard_normal((n, 1)), C - D @ G, D, np.zeros((2, 1)))
    units = 10.0 ** rng.uniform(-8, 8, n)
    plant, G = plant.in_coordinates(np.diag(units)), G * units
    loop = plant.closed_loop(G)
    X = bounding_x(loop, 1.1 * hinf_norm(loop).value, 0.01, 1e-6)
    return plant, G, (X + X.T) / 2


def beside(rng, edge: Fraction) -> float:
    """A float on either side of a number, a few of its last digits away or a few thousand."""
    return float(edge) * (1 + rng.choice([-1, 1]) * 2.0 ** rng.choice([rng.uniform(-53, -49), rng.uniform(-49, -30)]))


def attack_at_the_edge(rng, count: int) -> tuple[int, int]:
    """Holds proofs to the truth where rounding decides: eta next to the one that makes (20) singular, X next to singular.

    Returns:
        How many were proved, and how many a plain Cholesky decomposition would have believed that are false.
    """
    proved = fooled = 0
    for i in range(count):
        plant, G, X = honest_pair(rng)
        last = len(X) - 1
        if i % 2 and exactly.positive_definite(exactly.exact(X)):
            # One entry of the diagonal decides whether X is singular.
            unit = exactly.exact(np.eye(len(X))[:, last:])
            X[last, last] = beside(rng, Fraction(float(X[last, last])) - 1 / exactly.solved(exactly.exact(X), unit)[last][0])
            matrix, found = X, definiteness(X)
            true = exactly.positive_definite(exactly.exact(X))
        else:
            edge = exactly.largest_eta(plant, G, X)
            if edge is None or not 1e-150 < edge < 1e150:
                continue
            eta = beside(rng, edge)
            matrix, found = -bounded_real_exactly(plant, G, X, eta), prove_bound(plant, G, X, eta).negative
            true = Fraction(eta) < edge
        assert true or not found.proved, i
        proved += found.proved
        if not true:
            with contextlib.suppress(np.linalg.LinAlgError):
                np.linalg.cholesky(matrix)
                fooled += 1
    return proved, fooled


@pytest.mark.parametrize(
    ("seed", "count", "more", "some"), [(6, 100, 10, 0), pytest.param(7, 600, 80, 6, marks=pytest.mark.attack)]
)
def test_no_proof_at_the_edge_is_rounding(seed, count, more, some):
    """If the last digits of eta or of X decide, what is proved is true; without the allowance some of it would not be."""
    proved, fooled = attack_at_the_edge(np.random.default_rng(seed), count)
    assert proved > more
    assert fooled > some


@pytest.mark.parametrize(("seed", "count"), [(4, 60), *(pytest.param(100 + k, 250, marks=pytest.mark.attack) for k in range(2))])
def test_no_forged_bound_passes(seed, count):
    """No certificate that passes claims a bound below the norm, or of an unstable loop; some that pass are true.

    They are hairs below the norm, X next to singular, rows of all sizes, loops next to instability, huge gains.
    """
    assert attack(np.random.default_rng(seed), count) >= 8  # else nothing was tried
