"""Integrals as weights: designs that feed them back, norms of loops with and without, sums of signals, and what has no norm."""

import re

import numpy as np
import pytest
from scipy import linalg

from models.kinds.kind import HERE
from models.laws.filter import Filter
from models.roads.choice import choose_road
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.runs.run import run_controllers, sample_times
from synth.controller.problem import generalized_plant, plant_states
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer
from synth.vehicle.state_space import closed_loop
from tests.support.commands import attacks, refused
from tests.support.shared import designed, printed
from tests.support.weighted import weighted_loop

PI = "suspension_deflection = { weight = 2.0, numerator = [0.05, 0.15], denominator = [1.0, 0.0] }"
HEIGHT = "height = { weight = 0.5, sum = { suspension_deflection = 1.0, tyre_deflection = 1.0 } }"
LAWS = """
[controllers.h2]
design = "h2"
measured = ["suspension_deflection", "sprung_velocity"]
[controllers.full]
order = "full"
measured = ["suspension_deflection", "sprung_acceleration"]
[controllers.lqr]
design = "lqr"
[controllers.given]
measured = ["suspension_deflection", "sprung_velocity"]
A = [[-3.0, 0.0], [0.0, 0.0]]
B = [[0.0, 1.0], [2.0, 0.0]]
C = [[50.0, -100.0]]
D = [[1000.0, -2000.0]]
"""


def text_of(kind: str = "quarter_car", *lines: str, more: str = LAWS) -> str:
    """A shipped car whose z weighs the suspensions' integrals, or as the lines say."""
    text = read_vehicle(kind).text
    for line in lines or (PI, HEIGHT):
        name = line.split(" =")[0]
        text = re.sub(rf"(?m)^{name} *=.*\n", "", text).replace("[performance]", f"[performance]\n{line}", 1)
    return text + more


@pytest.fixture(scope="module")
def car() -> Vehicle:
    return parse_vehicle(text_of())


def weighted_peak(vehicle: Vehicle, loop, omega: np.ndarray) -> np.ndarray:
    """The gain of W T over frequency: the loop without weights, then each row of z by its polynomials."""
    T = np.array([loop(1j * w) for w in omega])
    rows = []
    for row in vehicle.weighted:
        (above, below), *_ = row.filter.sections if row.filter else [((1.0,), (1.0,))]
        signal = sum(factor * T[:, loop.output_labels.index(name)] for name, factor in row.terms.items())
        shape = np.polyval(above, 1j * omega) / np.polyval(below, 1j * omega)
        rows.append(row.weight * shape[:, None] * signal)
    return np.array([np.linalg.norm(one, 2) for one in np.stack(rows, axis=1)])


@pytest.mark.parametrize(("above", "below"), [((1.0,), (1.0, 0.0)), ((0.1, 0.3), (2.0, 0.0)), ((1.0, 2, 5), (1.0, 4, 7, 0))])
def test_a_filter_with_a_pole_at_0(above, below):
    """Such a filter is its polynomials, its residue over s and a stable rest; its gain is that of all three."""
    one, omega = Filter(((above, below),), integrates=True), np.geomspace(1e-3, 1e3, 30)
    s = 1j * omega
    expected = np.polyval(above, s) / np.polyval(below, s)
    parts = []
    for law in (one.realisation, one.remainder):
        A, B, C, D = law.A, law.B, law.C, law.D
        parts.append(D[0, 0] + (C @ np.linalg.solve(s[:, None, None] * np.eye(len(A)) - A, B[None].astype(complex)))[:, 0, 0])
    whole, rest = parts
    for found in (one.response(omega), whole, rest + one.residue / s):
        np.testing.assert_allclose(found, expected, rtol=1e-12)  # rounding of a handful of operations
    assert np.all(np.linalg.eigvals(one.remainder.A).real < 0)


@pytest.mark.parametrize("name", ["I", "full", "given", "passive", *attacks(["state", "h2", "lqr"])])
def test_norms_are_of_the_weighted_loop(car, name):
    """With an integral in z the norm is the peak of W T by frequency, of designs, of a given law that integrates in another
    scale, and of the passive car, whose springs return the deflection to zero on any slope."""
    controller = designed(car, name)
    certificate = controller.certificate
    assert not certificate.failures
    omega = np.append(np.geomspace(1e-3, 300, 200), certificate.norm.peak_frequency)
    gains = weighted_peak(car, closed_loop(car, controller), omega)
    assert gains[-1] == pytest.approx(certificate.norm.value, rel=1e-9)  # a peak is flat
    assert gains.max() <= certificate.norm.value * (1 + 1e-9)
    weighted = weighted_loop(car, controller)
    assert np.linalg.norm(weighted(1j * omega[3]), 2) == pytest.approx(gains[3], rel=1e-9)
    assert weighted.nstates == len(certificate.loop.A) == len(weighted.state_labels)
    assert ("integral_of_suspension_deflection" in weighted.state_labels) == (name != "passive")
    assert controller.law.states == {"I": 1, "state": 1, "h2": 5, "full": 6, "lqr": 1, "given": 2, "passive": 0}[name]


def test_lqr_of_a_bus():
    """Weights of sums and of an integral give the gain of a Riccati equation written out, in its own five states.

    The states are body height, its rate, deflection, a sum of rate and heights that no step of the road moves, and the
    deflection's integral.
    """
    ms, mu, ks, cs, kt, ct = 2500.0, 320.0, 8e4, 350.0, 5e5, 15020.0
    a, c = cs / ms + cs / mu + ct / mu, ct / mu
    # s' = eta - a s + c z, eta' = -(ks / ms + ks / mu) s + (1 / ms + 1 / mu) u + kt / mu (z - s)
    A = np.zeros((5, 5))
    A[0, 1] = A[4, 2] = 1.0
    A[2] = [c, 0, -a, 1, 0]
    A[1] = -np.array([0, 0, ks, 0, 0]) / ms - cs / ms * A[2]
    A[3] = [kt / mu, 0, -ks / ms - ks / mu - kt / mu, 0, 0]
    B = np.array([[0], [1 / ms], [0], [1 / ms + 1 / mu], [0]])
    K = B.T @ linalg.solve_continuous_are(A, B, np.diag([30e6, 80e6, 80e6, 20e6, 20e9]), [[0.01]]) / 0.01
    law = designed(read_vehicle(HERE / "gallery" / "control_lab" / "lqr.toml"), "lqr").law
    z, rate, s, eta, integral = K[0]
    on_states = [z + s + eta * (a - c), z - eta * c, rate + eta, -eta]
    np.testing.assert_allclose(law.D[0], -np.array(on_states), rtol=1e-9)  # of two Riccati equations in other units
    np.testing.assert_allclose(law.C[0], [-integral], rtol=1e-9)
    # The gallery drives it on the body's height over a flat road, z_s = s + z_u - z_r there, as the integral of z_s'.
    driven = read_vehicle(HERE / "gallery" / "control_lab" / "car.toml").controllers["lqr"].law
    assert driven is not None
    (on_s, on_tyre, on_rate, on_stretch), (height, whole) = driven.D[0], driven.C[0]
    np.testing.assert_allclose([on_s + height, on_tyre + height, on_rate + on_stretch, -on_stretch], law.D[0], rtol=1e-9)
    np.testing.assert_allclose([whole], law.C[0], rtol=1e-9)


def test_h2_estimates_no_integral(car):
    """A law knows the integral of its own readings, so that the loop of H2 has the regulator's poles beside an estimator's."""
    regulator = designed(car, "lqr").certificate.poles
    poles = designed(car, "h2").certificate.poles
    for pole in regulator:
        assert np.abs(poles - pole).min() < 1e-6 * abs(pole)  # of two Riccati equations; the filter's half digits
    assert len(poles) == len(regulator) + 4


def test_half_car_with_two():
    """Both suspensions of a half-car have an integral of their own, and a design feeds both back."""
    weights = [
        f"suspension_deflection_{end} = {{ numerator = [0.1, 0.1], denominator = [1.0, 0.0] }}" for end in ("front", "rear")
    ]
    vehicle = parse_vehicle(text_of("half_car", *weights, more='[controllers.lqr]\ndesign = "lqr"\n'))
    assert {*plant_states(vehicle)[-2:]} == {f"integral_of_suspension_deflection_{end}" for end in ("front", "rear")}
    certificate = designed(vehicle, "lqr").certificate
    assert not certificate.failures
    gains = weighted_peak(vehicle, closed_loop(vehicle, designed(vehicle, "lqr")), np.array([certificate.norm.peak_frequency]))
    assert gains[0] == pytest.approx(certificate.norm.value, rel=1e-9)


@pytest.mark.attack
def test_a_payload_is_levelled_out(car):
    """In MuJoCo a design with the integral brings a loaded body back to its height, which its spring alone does not."""
    road = choose_road("flat + lift:force=-600:start=0:rise=0.5:hold=100").build(car, 20.0, 0, 500.0)
    runs = run_controllers(car, [designed(car, name) for name in ("passive", "I")], road, sample_times(car, 25.0, 2.5e-3))
    passive, levelled = (run.physics["suspension_deflection"] for run in runs)
    assert all(run.passed for run in runs)
    assert passive[-1] == pytest.approx(-600 / car.parameters["suspension_stiffness"], rel=1e-3)
    assert abs(levelled[-1]) < 0.01 * abs(passive[-1])  # of its slowest pole, -0.34 1/s, 25 s leave 2e-4
    assert levelled.min() < 0.1 * passive[-1]


DESIGNED = ("--controller", "I_designed", "--controller", "h2_designed")


def test_a_saved_law_is_proved(tmp_path, car):
    """What `--save` writes of laws with an integral is proved again by `--check`, and a note says that they keep it."""
    (tmp_path / "car.toml").write_text(car.text)
    asked = ("--vehicle", "car.toml", "--controller", "I", "--controller", "h2", "--save", "saved.toml")
    done = printed("synth", *asked, files={"car.toml": car.text})
    assert done.code == 0
    assert "use the integral of each such signal as a state" in " ".join(done.out.split())
    assert "x_c'" not in done.out  # of which controller it is, and its numbers, say the details
    saved = {"saved.toml": (done.folder / "saved.toml").read_text(encoding="utf-8")}
    again = printed("synth", "--check", "saved.toml", *DESIGNED, files=saved)
    assert again.code == 0
    assert "I_designed, h2_designed: checked: every claim of the saved certificate holds" in again.out
    forged = {"saved.toml": re.sub(r"(?m)^norm = .*$", "norm = 7.0", saved["saved.toml"])}
    assert printed("synth", "--check", "saved.toml", *DESIGNED, files=forged).code == 1


def test_a_norm_that_is_none(car):
    """A law on the body's velocity alone leaves a deflection on every slope: its loop has no norm, and no design measures so."""
    assert not np.isfinite(designed(car, "II_printed").certificate.norm.value)
    with pytest.raises(DesignError, match=r"none of them contains the mode at 0 rad/s.*integral_of_suspension_deflection"):
        Designer(car).design("II")


INTEGRAL = "{ numerator = [1.0], denominator = [1.0, 0.0] }"


@pytest.mark.parametrize(
    ("lines", "more", "said"),
    [
        ([f"tyre_deflection = {INTEGRAL}"], "", "integral of tyre_deflection, but no constant force changes"),
        ([f"sprung_displacement = {INTEGRAL}"], "", "sprung_displacement is a height above a fixed datum"),
        ([PI], '[controllers.p]\nmeasured = ["suspension_deflection"]\nstructure = "pi"\n', "has no state for it"),
        ([PI], '[controllers.e]\nmeasured = ["suspension_deflection"]\norder = "full"\nstable = true\n', "law alone is not"),
        (
            [PI],
            '[controllers.e]\nmeasured = ["suspension_deflection"]\norder = "full"\ntolerance = { force = { weight = 0.1 } }\n',
            "depends on frequency",
        ),
        ([PI], "[implementation]\nsample_period = 0.005\nsampled = true\n", "drives only the sum of its samples to zero"),
        (
            [PI],
            '[implementation]\nsample_period = 0.005\nnoise = { suspension_deflection = 1e-3 }\n[controllers.q]\ndesign = "lqg"\n'
            'measured = ["suspension_deflection"]\n',
            "integrate the noise on suspension_deflection",
        ),
        (["suspension_deflection = { numerator = [1.0, 0.0], denominator = [1.0, 0.0] }"], "", "that a zero at 0 cancels"),
        (["road = { numerator = [1.0], denominator = [1.0, 0.0] }"], "", "road: the filter is unstable: a root"),
        (["height = { sum = { sprung = 1.0 } }"], "", "sum has the unknown signal 'sprung'"),
        (["height = { sum = { tyre_deflection = 0.0 } }"], "", "is not allowed; give signals with factors"),
        (
            ["tyre_deflection = { sum = { tyre_deflection = 1.0 } }"],
            "",
            "is already the name of a signal; give the sum a different name",
        ),
    ],
)
def test_refused(lines, more, said):
    """What has no norm, or no room for the integral's state, is refused in one line that says why."""
    with refused(said):
        generalized_plant(parse_vehicle(text_of("quarter_car", *lines, more=more)))


def test_a_sum_of_one_signal_is_that_signal():
    """A weight on a sum of one signal makes the plant of a weight on the signal, and a sum weighs as its terms say."""
    plain, summed = (
        generalized_plant(parse_vehicle(text_of("quarter_car", *lines, more="")))
        for lines in (
            ["tyre_deflection = 0.2"],
            ["tyre_deflection = 0.0", "load = { weight = 0.1, sum = { tyre_deflection = 2.0 } }"],
        )
    )
    rows = np.argsort(np.abs(plain.C).sum(axis=1)), np.argsort(np.abs(summed.C).sum(axis=1))
    np.testing.assert_allclose(plain.C[rows[0]], summed.C[rows[1]], rtol=1e-15)
