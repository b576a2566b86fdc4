"""The H-infinity norm: two routes of our own, python-control's, and SLICOT's where it is installed."""

from fractions import Fraction

import control
import numpy as np
import pytest
from scipy import linalg, signal

from synth.analysis.norm import hinf_norm, level_crossings, level_set_norm, sweep_norm
from synth.plant.generalized import GeneralizedPlant
from tests.support.commands import attacks


def system(A, B, C, D=None) -> GeneralizedPlant:
    """x' = A x + B w, z = C x + D w."""
    A, B, C = np.atleast_2d(A), np.atleast_2d(B), np.atleast_2d(C)
    if not A.size:
        A = np.zeros((0, 0))
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


def transfer_function(numerator, denominator) -> GeneralizedPlant:
    """A transfer function in companion form."""
    return system(*signal.tf2ss(numerator, denominator))


def matrix(text: str):
    """Rows separated by semicolons."""
    return np.array([[float(entry) for entry in row.split()] for row in text.split(";")])


def three_resonances() -> GeneralizedPlant:
    """SLICOT's example of AB13DD: resonances at sqrt(1/2), 1 and sqrt(2) rad/s, each with a tenth of the damping of the last."""
    A = linalg.block_diag([[0, 1], [-0.5, -2e-4]], [[0, 1], [-1, -2e-5]], [[0, 1], [-2, -2e-6]])
    return system(A, np.tile([[1.0], [0.0]], (3, 1)), np.tile([[1.0, 0.0]], 3))


def many_resonances(forces) -> GeneralizedPlant:
    """Ten resonances at 1 to 10 rad/s, all with the same damping in rad/s."""
    A = np.block([[-0.1 * np.eye(10), -np.diag(range(1, 11))], [np.diag(range(1, 11)), np.zeros((10, 10))]])
    return system(A, 0.1 * np.append(forces, np.zeros(10))[:, None], np.append(np.zeros(10), np.ones(10))[None])


def sensitivity() -> GeneralizedPlant:
    """1 / (1 + P C), 12 states: issue 1014 of ControlSystems.jl, where its norm did not converge."""
    pairs = {-7.282563985219324: 7.114985406231401, -1.5268748507837735: 1.2594070637611725}
    zeros = [-101.47795511977208, -48.91219110762173, -7.96322290641594, -0.7114937019357614]
    zeros += [complex(re, sign * im) for re, im in pairs.items() for sign in (1, -1)]
    pairs = {-5.297845964509693: 6.146324852257861, -1.4795349979133343: 1.2376578249023653}
    poles = [-101.32273797977184, -49.510558929948274, -20.0, -11.82446898287247, -10.604444850836952]
    poles += [-0.6235091399063754, -0.2743617810110765]
    poles += [complex(re, sign * im) for re, im in pairs.items() for sign in (1, -1)]
    numerator = 704.6392766532747 * 0.6 * np.real(np.poly([*zeros, -0.5]))
    denominator = np.real(np.poly([*poles, 0.0]))
    return transfer_function(denominator, np.polyadd(denominator, numerator))


MATLAB = system(
    matrix(
        "-1.017041847539126 -0.224182952826418 0.042538079149249; -0.310374015319095 -0.516461581407780 -0.119195790221750;"
        "-1.452723568727942 1.7995860837102088 -1.491935830615152"
    ),
    matrix("0.312858596637428 -0.164879019209038; -0.864879917324456 0.627707287528727; -0.030051296196269 1.093265669039484"),
    matrix("1.109273297614398 0.077359091130425 -1.113500741486764; -0.863652821988714 -1.214117043615409 -0.006849328103348"),
)
SEVENTH_ORDER = system(
    matrix(
        "-.81 .47 -.43 1.58 .25 -.40 .92; -.61 -1.89 .80 -1.59 2.01 .98 -.90; .50 -1.18 -2.12 -1.56 -1.14 .14 -.87;"
        "-1.28 2.12 .47 -1.16 3.65 -1.23 -1.26; -.24 -.08 1.58 -3.58 -1.26 1.72 -2.59; 1.28 -.96 -1.28 -.57 -2.43 -2.43 -.36;"
        "-.16 1.53 -.99 1.47 .61 -2.22 -3.27"
    ),
    matrix(".49 -.80 .10; -.18 .70 .72; 0 .83 2.58; 1.42 0 0; 0 .22 .19; 0 0 -.08; 0 -1.15 -1.93"),
    matrix("0 .84 .10 .30 .49 1.71 0; -1.79 -.89 -.54 -.60 .74 -.19 0"),
    matrix("1.36 .96 1.44; -1.07 0 -1.96"),
)
STATIC = system(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), matrix("-0.78593 -1.2707; 0.2638 -1.13143"))
TWO_CHANNELS = system(  # [0, 3s / (s^2 + s + 10); (s + 1) / (s + 5), 2 / (s + 6)]
    linalg.block_diag([[0, 1], [-10, -1]], -5, -6), matrix("0 0; 0 3; 1 0; 0 2"), matrix("0 1 0 0; 0 0 -4 1"), matrix("0 0; 1 0")
)

# (system, norm, relative tolerance: the published digits, peak [rad/s], its tolerance: half the digits, who says so)
PUBLISHED = {
    "ab13dd": (three_resonances(), 5.0e5, 1e-8, 1.41421, 1e-5, "SLICOT, AB13DD"),
    "sysnorm_lag": (system(-1.0, 1.0, 1.0), 1.0, 1e-12, 0.0, 1e-9, "python-control, sysnorm_test"),
    "sysnorm_mimo": (MATLAB, 4.276759162964244, 1e-12, None, 0, "python-control, sysnorm_test, from MATLAB"),
    "resonant": (system([[0, 1], [-1, -1]], [[0], [1]], [[1, 0]]), 2 / 3**0.5, 1e-12, 0.5**0.5, 1e-6, "ControlSystems.jl"),
    "seventh_order": (SEVENTH_ORDER, 4.899135403568278, 1e-11, 6.112977387441163, 1e-6, "ControlSystems.jl"),
    "two_channels": (TWO_CHANNELS, 3.014974550173459, 1e-11, 3.162123338668049, 1e-6, "ControlSystems.jl"),
    "biquad": (transfer_function([1 / 520, 0], [1 / 52**2, 1 / 520, 1]), 1.0, 1e-10, 52.0, 1e-5, "ControlSystems.jl"),
    "ten_resonances": (many_resonances(np.ones(10)), 1.05871265, 1e-8, 0.9874, 1e-4, "ControlSystems.jl"),
    "fourth_of_ten": (many_resonances(np.where(np.arange(10) == 4, 2, 1)), 2.00918, 1e-5, 4.9981, 1e-4, "ControlSystems.jl"),
    "static": (STATIC, 1.760164138376307, 1e-14, 0.0, 0, "ControlSystems.jl"),
    # Its two-step routine gives up there, the other stops 2e-4 below. The rational function itself on a fine grid has this peak.
    "sensitivity": (sensitivity(), 1.3056105481, 1e-9, 5.686244, 1e-5, "ControlSystems.jl, issue 1014"),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_norm(name):
    """The hard cases of others: their value, by both routes, to 1e-8 or to every digit they print."""
    plant, value, tolerance, peak, peak_tolerance, _ = PUBLISHED[name]
    norm = hinf_norm(plant)
    assert norm.value == pytest.approx(value, rel=tolerance)
    assert norm.gap < 1e-8
    if peak is not None:
        assert norm.peak_frequency == pytest.approx(peak, abs=peak_tolerance)


@pytest.mark.parametrize(
    ("plant", "pole"),
    [
        (system(0.0, 1.0, 1.0), 0.0),
        (system([[-2, 1], [0, 0]], [[0], [1]], [[1, 0]]), 0.0),
        (system([[0, 1], [-1, 0]], [[1], [0]], [[0, 1]]), 1.0),
    ],
)
def test_poles_on_the_axis(plant, pole):
    """An integrator and an undamped resonance have no finite norm, and the routes name the pole's frequency."""
    assert hinf_norm(plant).value == np.inf
    assert level_set_norm(plant) == sweep_norm(plant) == (np.inf, pole)


@pytest.mark.parametrize("route", [level_set_norm, sweep_norm])
def test_unstable_systems(route):
    """An unstable system has an infinite H-infinity norm; both routes find its peak on the axis (as sysnorm_test does)."""
    for plant in (system(1.0, 1.0, -1.0), system([[-1, 1], [0, 1]], [[0], [1]], [[1, 0]])):
        assert hinf_norm(plant).value == np.inf
        assert np.isnan(hinf_norm(plant).peak_frequency)
        assert route(plant) == (pytest.approx(1.0, rel=1e-12), 0.0)


@pytest.mark.parametrize("name", ["ab13dd", "seventh_order"])
@pytest.mark.parametrize(("time", "of_z"), [(1.0, 1.0), (1e-9, 1e6), (3e5, 1e-6)])
def test_units_do_not_matter(name, time, of_z):
    """States in units twelve orders of magnitude apart, any unit of time and any of z give the same norm."""
    plant, value, *_ = PUBLISHED[name]
    units = np.resize(10.0 ** np.array([6, -6, 0, 3, -3, 1]), len(plant.A))
    moved = plant.in_coordinates(np.diag(units))
    moved = system(moved.A / time, moved.Bw / time, of_z * moved.C, of_z * moved.Dw)
    assert hinf_norm(moved).value == pytest.approx(of_z * value, rel=1e-8)  # rounding 1e-16 over damping 1e-6


@pytest.mark.parametrize("name", ["passive", "state", "I", "II"])
def test_routes_agree_on_the_paper(designer, name):
    """On every configuration of the paper the two routes agree to rounding."""
    assert designer.design(name).certificate.norm.gap < 1e-10


def large_system(seed: int, states: int, feedthrough: float, least_damping: float) -> GeneralizedPlant:
    """Resonances from 1e-2 to 1e3 rad/s, each with a damping up to 1, seen from coordinates that mix them all."""
    rng = np.random.default_rng(seed)
    omega, damping = 10 ** rng.uniform(-2, 3, states // 2), least_damping ** rng.uniform(0, 1, states // 2)
    A = linalg.block_diag(*[[[0, w], [-w, -2 * z * w]] for w, z in zip(omega, damping, strict=True)])
    T = np.linalg.qr(rng.standard_normal((states, states)))[0]
    plant = system(A, rng.standard_normal((states, 2)), rng.standard_normal((2, states)), feedthrough * np.eye(2))
    return plant.in_coordinates(T)


@pytest.mark.parametrize(
    ("seed", "states", "feedthrough", "least_damping"),
    [
        (1, 60, 0.5, 0.1),
        *attacks([(0, 50, 0.0, 0.1), (2, 80, 0.0, 0.1), (3, 100, 0.5, 0.1), (1, 74, 0.0, 1e-4), (2, 98, 0.0, 1e-4)]),
    ],
)
def test_large_systems(seed, states, feedthrough, least_damping):
    """With 50 to 100 states the routes agree, and with python-control where no resonance is so thin that it stops short."""
    plant = large_system(seed, states, feedthrough, least_damping)
    norm = hinf_norm(plant)
    assert norm.gap < 1e-8  # rounding of poles six orders of magnitude apart
    if least_damping == 0.1:
        space = control.ss(plant.A, plant.Bw, plant.C, plant.Dw)
        theirs = control.system_norm(space, "inf", tol=1e-6)  # pyright: ignore[reportArgumentType]
        assert norm.value == pytest.approx(theirs, rel=1e-5)  # its tolerance


def test_modes_that_coincide():
    """Twenty equal lags in a row have one eigenvector: where the modes say nothing the norm is found without them."""
    n = 20
    plant = system(-np.eye(n) + np.eye(n, k=-1), np.eye(n)[:, [0]], np.vstack([np.eye(n)[-1], np.eye(n)[0]]))
    norm = hinf_norm(plant)
    assert norm.value == pytest.approx(2**0.5, rel=1e-12)  # both outputs pass what does not change
    assert norm.peak_frequency == pytest.approx(0.0, abs=1e-5)
    assert norm.gap < 1e-12


@pytest.mark.parametrize("seed", range(2))
def test_level_crossings_with_feedthrough(seed):
    """Far above the gain at infinity a Hamiltonian, near it a pencil: at every crossing they propose, the gain is the level."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((8, 8))
    plant = system(
        A - (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(8),
        rng.standard_normal((8, 2)),
        rng.standard_normal((3, 8)),
        rng.standard_normal((3, 2)),
    )
    at_infinity, top = float(np.linalg.norm(plant.Dw, 2)), hinf_norm(plant).value
    for level in (1.01 * at_infinity, 0.5 * (1.2 * at_infinity + top), 0.99 * top):
        crossings = level_crossings(plant, level)
        dense = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 4000)])
        values = np.linalg.svd(plant.frequency_response(dense), compute_uv=False) - level
        for i, k in np.argwhere(values[:-1] * values[1:] < 0):
            inside = crossings[(crossings >= dense[i]) & (crossings <= dense[i + 1])]
            assert len(inside), (level, dense[i], k)
            found = np.linalg.svd(plant.frequency_response(inside), compute_uv=False)
            assert np.abs(found / level - 1).min() < 1e-8  # rounding of a crossing that may be steep


@pytest.mark.parametrize(("time", "of_states", "of_z"), [(1e-12, 1.0, 1.0), (3e5, 1e-7, 1e7), (1e12, 1e5, 1e-6)])
def test_level_crossings_in_any_units(time, of_states, of_z):
    """Near the gain at infinity, too, crossings are the same in any units of time, of states and of z."""
    rng = np.random.default_rng(3)
    A = rng.standard_normal((6, 6))
    A -= (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(6)
    Bw, C, Dw = rng.standard_normal((6, 2)), rng.standard_normal((3, 6)), rng.standard_normal((3, 2))
    level = 1.01 * float(np.linalg.norm(Dw, 2))
    expected = level_crossings(system(A, Bw, C, Dw), level)
    there = system(A / time, Bw / time / of_states, C * of_states * of_z, Dw * of_z)
    found = time * level_crossings(there, level * of_z)
    for omega in expected:  # others may be proposed, at which nothing crosses
        if np.abs(np.linalg.svd(C @ np.linalg.inv(1j * omega * np.eye(6) - A) @ Bw + Dw)[1] / level - 1).min() < 1e-9:
            assert np.abs(found - omega).min() < 1e-9 * expected[-1]  # rounding, measured 1e-14


def test_what_floats_of_frequency_miss_is_rounding():
    """For a damping of 1e-12 the peak lies between two floats: the norm is below it by no more than its stated rounding.

    The peak of c / (s^2 + a s + b) is c / (a (b - a^2 / 4)^1/2) exactly.
    """
    missed = []
    for damping in (1e-9, 1e-10, 1e-11, 1e-12, 3e-13, 1e-13):
        for omega in (1.3, 311.7):
            plant = oscillator(omega, damping)
            a, b, c = (Fraction(float(entry)) for entry in (-plant.A[1, 1], -plant.A[1, 0], plant.C[0, 0]))
            norm = hinf_norm(plant)
            over = Fraction(norm.value) ** 2 * a**2 * (b - a**2 / 4) / c**2  # of squares
            missed.append(float(1 - over) / 2)
            assert abs(missed[-1]) <= norm.rounding + 4e-16  # of the norm as a float
            assert norm.rounding < 1e-6
    assert max(missed) > 1e-9  # so that it matters
