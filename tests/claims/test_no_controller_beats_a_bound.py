"""No lower bound lies above what a controller reaches: the claim that all the others rest on, over plants made to break it."""

import contextlib
from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from scipy import linalg

from models.common.errors import InputError
from synth.analysis.lower_bounds.exact_algebra import Nullspace, identity
from synth.analysis.lower_bounds.invariant_point import invariant_limit, limit_at
from synth.analysis.lower_bounds.lower_bound import DualCertificate, prove_lower_bound
from synth.analysis.lower_bounds.synthesis_inequality import SynthesisInequality
from synth.analysis.norm import hinf_norm
from synth.analysis.rigorous import integers, product
from synth.design.static import static_output_feedback
from synth.design.two_step import state_feedback
from synth.lmi.full_order_bound import find_lower_bound
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError
from tests.support.commands import attacks

SLOWER = ("unstable", "free inputs", "nearly dependent inputs")
KINDS = (
    "few outputs",
    "undamped",
    "integrators",
    "unstable",
    "uncontrollable",
    "free inputs",
    "rank-deficient D",
    "nearly dependent inputs",
    "feedthrough",
    "nearly free inputs",
    "as many of each",
)
QUICK = [kind for kind in KINDS if kind not in SLOWER]
ROUTES = 1e-7  # relative: the norms of loops whose cost of control is 1e-6, by level sets, of plants in other units
NOTHING = 1e-9  # of the uncontrolled size of z: rounding of a norm where all of z is cancelled


def a_plant(kind: str, seed: int) -> tuple[GeneralizedPlant, np.ndarray]:
    """A random plant of a kind and what it measures; entries are halves and quarters as often as not, so that things cancel."""
    rng = np.random.default_rng([KINDS.index(kind), seed])
    n, m, r, q = int(rng.integers(2, 6)), int(rng.integers(1, 3)), int(rng.integers(1, 3)), int(rng.integers(1, 3))
    d = int(rng.integers(1, m + 1)) if kind == "few outputs" else int(rng.integers(1, 4)) + m

    if kind == "as many of each":  # so that there are zeros, from u to z and from w to y
        d, r, q = m, m, m

    def draw(*shape: int) -> np.ndarray:
        found = rng.standard_normal(shape)
        return np.round(2 * found) / 2 if seed % 2 else found

    A, B, Bw, C, Cy = draw(n, n), draw(n, m), draw(n, r), draw(d, n), draw(q, n)
    D, Dw = draw(d, m), np.zeros((d, r))
    A = A + np.eye(n) if kind in ("unstable", "as many of each") else A - (np.linalg.eigvals(A).real.max() + 0.25) * np.eye(n)
    if kind == "undamped":
        A[:2] = 0
        A[:2, :2] = [[0, 1], [-2, 0]]
    if kind == "integrators":
        A[:1] = 0
        Bw[0] = 0
    if kind == "uncontrollable":
        B[0], A[0, 1:] = 0, 0
        A[0, 0] = -0.5
    if kind == "free inputs" or (kind == "as many of each" and seed % 4 < 2):
        D = 0 * D
    if kind == "rank-deficient D":
        D[:, -1] = 0
    if kind in ("nearly dependent inputs", "nearly free inputs"):
        small = 10.0 ** -rng.integers(6, 16)
        if kind == "nearly free inputs":
            D = small * D
        elif m > 1:
            B[:, 1], D[:, 1] = B[:, 0] + small * B[:, 1], D[:, 0] + small * D[:, 1]
        else:
            B = small * B
    if kind == "feedthrough":
        Dw = draw(d, r) / 4
    Cy = Cy[np.any(Cy != 0, axis=1)]  # a signal that says nothing is refused at the door
    return GeneralizedPlant(A, B, Bw, C, D, Dw), Cy if len(Cy) else np.eye(n)[:1]


def of_lists(*matrices: Sequence[Sequence[float]]) -> GeneralizedPlant:
    """The plant of A, B, Bw, C, D, with Dw = 0."""
    A, B, Bw, C, D = map(np.array, matrices)
    return GeneralizedPlant(A, B, Bw, C, D, np.zeros((len(C), Bw.shape[1])))


def in_other_units(plant: GeneralizedPlant, Cy: np.ndarray, seed: int) -> tuple[GeneralizedPlant, np.ndarray]:
    """The same plant in units of states, inputs and measurements between 1e-8 and 1e8; powers of two, so that it is the same."""
    rng = np.random.default_rng(seed)
    T, V, Y = (np.diag(2.0 ** rng.integers(-26, 27, size)) for size in (len(plant.A), plant.B.shape[1], len(Cy)))
    return plant.in_coordinates(T).with_inputs(V), Y @ Cy @ T


def loops(plant: GeneralizedPlant, Cy: np.ndarray) -> Iterator[tuple[bool, GeneralizedPlant]]:
    """Closed loops, and whether their controller knows the whole state: LQ and LQG from soft to hard, and gains that cancel z."""
    n, m = plant.B.shape
    none = np.zeros((len(plant.C), m))
    for small in (1.0, 1e-2, 1e-4, 1e-6):
        try:
            cost = plant.D.T @ plant.D + small * np.eye(m)
            P = linalg.solve_continuous_are(
                plant.A, plant.B, plant.C.T @ plant.C + small * np.eye(n), cost, s=plant.C.T @ plant.D
            )
            K = -np.linalg.solve(cost, plant.B.T @ P + plant.D.T @ plant.C)
            yield True, plant.closed_loop(K)
            noise = small * np.eye(len(Cy))
            S = linalg.solve_continuous_are(plant.A.T, Cy.T, plant.Bw @ plant.Bw.T + small * np.eye(n), noise)
            L = -S @ Cy.T / small
            A = np.block([[plant.A, plant.B @ K], [-L @ Cy, plant.A + plant.B @ K + L @ Cy]])
            Bw = np.vstack([plant.Bw, 0 * plant.Bw])
            yield False, GeneralizedPlant(A, np.zeros((2 * n, m)), Bw, np.hstack([plant.C, plant.D @ K]), none, plant.Dw)
        except (np.linalg.LinAlgError, ValueError):
            continue
    cancelling = -np.linalg.pinv(plant.D) @ plant.C
    for G in (cancelling, np.zeros((m, n))):
        yield True, plant.closed_loop(G)
    for k in (1.0, 1e3, 1e6):
        yield True, plant.closed_loop(cancelling - k * np.linalg.pinv(plant.B))
    for gain in np.random.default_rng(0).standard_normal((6, m, len(Cy))):
        yield False, plant.closed_loop(10 * gain @ Cy)


def refuse_false_bounds(kind: str, seed: int, search: bool = False) -> None:
    """Fails if a bound lies above a norm that is reached, in these or other units."""
    plant, Cy = a_plant(kind, seed)
    moved, Cy_moved = in_other_units(plant, Cy, seed)
    bounds = [(find_lower_bound(each).gamma, find_lower_bound(each, y).gamma) for each, y in ((plant, Cy), (moved, Cy_moved))]
    reached: list[tuple[bool, float]] = [(knows, hinf_norm(loop).value) for knows, loop in loops(plant, Cy)]
    if search and np.linalg.matrix_rank(Cy) == len(Cy):
        with contextlib.suppress(InputError):
            reached.append((False, static_output_feedback(plant, Cy).certificate.norm.value))
    if search:
        with contextlib.suppress(InputError):
            reached += [(True, hinf_norm(plant.closed_loop(point.K)).value) for point in state_feedback(plant, 1e-6)]
    size = np.linalg.norm(plant.C) * np.linalg.norm(plant.Bw)
    for knows_all, norm in reached:
        for state, output in bounds:
            assert state <= norm * (1 + ROUTES) + NOTHING * size, (kind, seed, norm)
            if not knows_all:
                assert output <= norm * (1 + ROUTES) + NOTHING * size, (kind, seed, norm)


@pytest.mark.parametrize(
    ("kind", "seed", "search"),
    [
        *((kind, KINDS.index(kind) % 2, False) for kind in QUICK[::2]),  # of random numbers, or of halves
        *attacks((kind, KINDS.index(kind) % 2, False) for kind in (*QUICK[1::2], *SLOWER)),
        *attacks((kind, seed, seed == 100) for kind in KINDS for seed in (100, 101, 102)),
    ],
)
def test_no_controller_beats_a_bound(kind, seed, search):
    """No bound lies above what LQ, LQG, cancelling, high, path's and searched gains reach, for all plants, in any units."""
    refuse_false_bounds(kind, seed, search)


@pytest.mark.attack
def test_where_control_can_change_all_nothing_is_bounded():
    """With as many inputs as outputs, or inputs that are weak or dependent to rounding, noise is no bound: 0, in any units."""
    reaching_zero = of_lists(
        [[0, 1, 0], [-3, 0, 0], [0, 0, -2]],
        [[-1, -2], [2, 2], [2, 1]],
        [[2, -1], [-1, 0], [-2, 0]],
        [[0, 2, 0], [0, 2, 1]],
        [[1, 0], [0, 1]],
    )
    loop = reaching_zero.closed_loop(-reaching_zero.C)
    assert not np.any(loop.C)  # z = 0, whatever w
    assert np.linalg.eigvals(loop.A).real.max() < -1
    decaying, one, none = [[-1, 0], [0, -2]], [[1, 0], [0, 1]], [[0, 0], [0, 0]]
    for plant in (
        reaching_zero,
        *(in_other_units(reaching_zero, np.eye(3), seed)[0] for seed in range(2)),
        *(of_lists(decaying, [[1, 0], [0, weak]], one, one, none) for weak in (1e-8, 1e-15, 1e-300)),
        of_lists(decaying, [[1, 1], [1, 1 + 2**-52]], one, one, none),
    ):
        assert invariant_limit(plant) is None
        assert find_lower_bound(plant).gamma == 0
        assert find_lower_bound(plant, np.eye(len(plant.A))).gamma == 0


def test_a_plant_that_has_no_rate_of_its_own_has_a_bound():
    """With all poles at 0, simple, many or defective, seen by z or not, the bound is what it is by hand, in any units."""
    one, none = [[1.0, 0.0]], [[0.0]]
    chain = [[0, 1], [0, 0]]
    integers = [[0, 2, 2], [1, 1, 1], [-1, -1, -1]], [[0, -1], [0, -1], [0, 0]], [[-1], [1], [1]], [[-1, -1, -1]]
    for number, (plant, bound) in enumerate(
        (
            # With u = -k x, z = [x, u] = [1, -k] w / (s + k): at 0 rad/s of length (1 / k^2 + 1)^1/2, above 1 for every k.
            (of_lists(none, [[1]], [[1]], [[1], [0]], [[0], [1]]), 1),
            (of_lists(none, [[1e-3]], [[1e3]], [[1], [0]], [[0], [1]]), 1e6),  # at 0 rad/s u holds w still
            # z is the force: whatever holds the integrator still answers a lasting w with -w.
            (of_lists(none, [[1]], [[1]], [[0], [0]], [[0], [1]]), 1),
            # z is the output of a filter that u enters with -1 / 2 as much as w does: at 0 rad/s u = -w leaves half of w.
            (of_lists([[0, 0], [0, -1]], [[1], [-0.5]], [[1], [0]], [[0, 1], [0, 0]], [[0], [0]]), 0.5),
            (of_lists(chain, [[0], [1]], [[0], [1]], [*one, [0, 0]], [[0], [1]]), 1),
            (
                of_lists([[0, 0], [0, -1]], [[1], [1]], [[1], [1]], [[0, 1], [0, 0]], [[0], [1]]),
                1,
            ),  # likewise, and the force counts
            (of_lists(*integers, [[0, 0]]), 1),  # z + w is the rate of the last state, which comes to rest
            (of_lists([[0, 0]] * 2, [[1, 0], [0, 1]], [[1], [1]], [[1, 0], [0, 1]], [[0, 0]] * 2), 0),
        )
    ):
        Cy = np.eye(len(plant.A))[:1]
        # Every other one in other units.
        moved, Cy_moved = in_other_units(plant, Cy, number) if number % 2 else (plant, Cy)
        assert find_lower_bound(moved).gamma == pytest.approx(bound, rel=1e-9)  # rounded down
        assert find_lower_bound(moved, Cy_moved).gamma >= bound * (1 - 1e-9)


def test_a_limit_that_is_there_is_found_in_any_units():
    """The same limit, from the same plant in other units; and beside a resonance on the axis itself."""
    for seed in range(6):
        plant, Cy = a_plant("undamped", seed)
        moved, _ = in_other_units(plant, Cy, seed)
        limit, same = invariant_limit(plant), invariant_limit(moved)
        assert limit is not None
        assert same is not None
        assert same[0] == pytest.approx(limit[0], rel=1e-9)  # where the zoom ends: a maximum is flat
        for omega in (0.0, 2**0.5, 1.0, 1e-300, 1e300):
            assert limit_at(plant, omega) <= limit[0] * (1 + 1e-9)  # the zoom's end


def test_a_forged_frequency_proves_nothing_false(designer):
    """At a resonance, a zero of what u does, zero and infinity `limit_at` proves no more than the best controller reaches."""
    best = designer.state_feedback.gamma
    tyre = (designer.vehicle.parameters["tyre_stiffness"] / designer.vehicle.parameters["unsprung_mass"]) ** 0.5
    poles = np.linalg.eigvals(designer.plant.A)
    for omega in (0.0, tyre, *np.nextafter(tyre, [0, 100]), *np.abs(poles), 5e-324, 1e308, -tyre):
        assert limit_at(designer.plant, float(omega)) <= best * (1 + 1e-9)  # where the path ends
    resonant = of_lists([[0, 1], [-4, 0]], [[0], [1]], [[0], [1]], [[1, 0]], [[0]])
    # u and w act alike: u can cancel w, though near the resonance both have any size.
    assert [limit_at(resonant, omega) for omega in (2.0, np.nextafter(2.0, 3), 0.0)] == [0, 0, 0]


def hostile(rng: np.random.Generator, good: DualCertificate) -> DualCertificate:
    """A witness that is spoilt: nearly singular, scaled, noisy, or with another eta."""
    n = len(good.X)
    X = good.X * 10.0 ** rng.uniform(-3, 3) if rng.random() < 0.3 else good.X
    vector = rng.standard_normal(n)
    if rng.random() < 0.5:
        values, vectors = np.linalg.eigh(X)
        values[: int(rng.integers(1, n + 1))] *= 10.0 ** -rng.uniform(0, 18)
        X = vectors * values @ vectors.T
    if rng.random() < 0.3:
        X = X + 10.0 ** rng.uniform(-3, 16) * np.outer(vector, vector)
    eta = good.eta * 10.0 ** (rng.uniform(-1, 1) if rng.random() < 0.5 else rng.uniform(-300, 300))
    return DualCertificate((X + X.T) / 2, eta if rng.random() < 0.5 else good.eta * (1 - 10.0 ** -rng.uniform(1, 16)))


@pytest.mark.attack
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numbers beyond floats are what is asked for
@pytest.mark.parametrize(
    "seeds", [range(2), pytest.param(range(100, 130), marks=pytest.mark.attack)], ids=["some", "by the hundred"]
)
def test_no_witness_proves_what_is_not_true(seeds):
    """Witnesses that are nearly singular, huge, or beyond the optimum prove no bound above what state feedback reaches."""
    for seed in seeds:
        plant, Cy = a_plant(("unstable", "feedthrough", "rank-deficient D", "free inputs")[seed % 4], seed)
        rng = np.random.default_rng(seed)
        try:
            path = state_feedback(plant, 1e-8)
            _, other = find_lower_bound(plant, Cy), SynthesisInequality.of(plant.measured(Cy).transposed)
        except DesignError:
            continue
        best = min(hinf_norm(plant.closed_loop(point.K)).value for point in path)
        good = DualCertificate(path[-1].X, path[-1].eta)
        proofs = [prove_lower_bound(plant, hostile(rng, good)).gamma for _ in range(10)]
        assert max(proofs) <= best * (1 + ROUTES), seed
        # An observer's witness of noise: the joint bound stays below what output feedback reaches.
        reached = min((hinf_norm(loop).value for knows, loop in loops(plant, Cy) if not knows), default=np.inf)
        for _ in range(5 if len(other.J) else 0):
            noise = DualCertificate(
                np.cov(rng.standard_normal((len(plant.A), 9))) * 10.0 ** rng.uniform(-6, 6), 10.0 ** rng.uniform(-9, 3)
            )
            proved = prove_lower_bound(plant.measured(Cy), good, hostile(rng, noise))
            assert proved.gamma <= reached * (1 + ROUTES), seed


def test_nullspaces_are_exact():
    """K' Phi = 0 to the last digit, and a column that differs from another by 1e-15 counts."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        K = rng.standard_normal((7, 3)) * 10.0 ** rng.integers(-8, 9, (7, 1))
        K = np.hstack([K, K[:, :1] * (1 + 1e-15), K[:, 1:2] * 2])
        whole, _ = integers(K)
        space = Nullspace(whole)
        assert len(space.pivots) == 4  # the last is twice another
        Phi = space.complete(identity(3))
        assert not np.any(product(whole.T, Phi))
        assert np.all(np.diagonal(Phi[space.free]) != 0)


def test_states_that_z_does_not_see_cost_no_bound():
    """A sensor's lag, a mode beside the plant: the bound of the plant without them, though they let X grow for ever."""
    plant, _ = a_plant("unstable", 5)
    n, m = plant.B.shape
    beside = np.array([[-3.0, 0.0, 0.0], [0.0, -0.1, 1.0], [0.0, -2.0, -0.1]])
    longer = GeneralizedPlant(
        A=np.block([[plant.A, np.zeros((n, 3))], [np.ones((3, n)), beside]]),
        B=np.vstack([plant.B, np.zeros((3, m))]),
        Bw=np.vstack([plant.Bw, np.zeros((3, plant.Bw.shape[1]))]),
        C=np.hstack([plant.C, np.zeros((len(plant.C), 3))]),
        D=plant.D,
        Dw=plant.Dw,
    )
    short = find_lower_bound(plant).gamma
    assert short > 3  # 1.2 is left where they are not seen to be hidden
    assert find_lower_bound(longer).gamma == pytest.approx(short, rel=1e-5)  # where the paths end: (2 n + d) 1e-6 / 2
