"""What a goal minimises or bounds: norms in a band and peaks over roads, by other routes, and proofs above them."""

import itertools
import warnings

import numpy as np
import pytest
from scipy import signal as signals
from scipy.integrate import solve_ivp

from models.roads.road import Bump
from synth.analysis.band_norm import norm_in_band
from synth.design.multi_objective.band_filter import band_filter
from synth.design.multi_objective.band_norm import BandLandscape
from synth.design.multi_objective.peak import Peak, peak_over_road
from synth.design.multi_objective.road_response import RoadExcitation, RoadLoop
from synth.plant.generalized import GeneralizedPlant
from synth.vehicle.designer import Designer
from synth.vehicle.multi_objective import goal_problem
from tests.support.analysed import continuous_response
from tests.support.commands import attacks
from tests.support.goals import HZ, TWO, vehicle_with


def random_loop(rng) -> tuple[GeneralizedPlant, np.ndarray]:
    """A stable plant of some states with lightly damped modes, and what is measured."""
    n = int(rng.integers(2, 7))
    A = rng.standard_normal((n, n)) * 10 ** rng.uniform(-1, 2)
    A -= (np.linalg.eigvals(A).real.max() + 10 ** rng.uniform(-2, 1)) * np.eye(n)
    draw = rng.standard_normal
    return GeneralizedPlant(A, draw((n, 2)), draw((n, 2)), draw((3, n)), draw((3, 2)), draw((3, 2))), draw((2, n))


def test_the_landscape_in_a_band_is_the_norm_there():
    """At random gains of random plants its height is `norm_in_band`, and its slope that of differences."""
    rng = np.random.default_rng(20261122)
    for _ in range(30):
        plant, Cy = random_loop(rng)
        rates = np.sort(np.abs(np.linalg.eigvals(plant.A)))
        low, high = rates[0] * rng.uniform(0, 1), rates[-1] * rng.uniform(1, 3)
        landscape = BandLandscape(plant.measured(Cy), (low, high))
        x = 0.02 * rng.standard_normal(landscape.scale.size)
        height, at = landscape.norm(x)
        if not np.isfinite(height):
            continue
        loop = plant.closed_loop(landscape.gain(x) @ Cy)
        assert height == pytest.approx(norm_in_band(loop, low, high).value, rel=1e-7)
        slope, step = landscape.slope(x, at), 1e-6 * np.eye(len(x))
        differences = [(landscape.norm(x + e)[0] - landscape.norm(x - e)[0]) / 2e-6 for e in step]
        assert slope == pytest.approx(differences, rel=1e-3, abs=1e-3 * np.abs(slope).max())  # peaks may be close to another


STIFF = np.array([[0.0, 1.0, 0.0], [-0.25, -0.2, 0.0], [0.0, 0.0, -100.0]])  # so steps are small, and the peak is late


SLOW = np.array([[0.0, 1.0, 0.0], [-4e-4, -4e-3, 0.0], [0.0, 0.0, -100.0]])


TWICE = np.array([[0.0, 1.0, 0.0], [-1.0, -2.0, 0.0], [0.0, 0.0, -3.0]])  # a double pole, with one eigenvector


def after_a_ramp(A: np.ndarray, c: list[float], until: float) -> tuple[Peak, float, float]:
    """The peak over a ramp of half a second; by matrix exponentials the largest height up to a time, and that at the peak's.

    Under the second wheel the ramp goes half as far down.
    """
    end, Bw, Br = 0.5, np.array([[0.2, 0.0], [-0.1, 0.2], [1.0, -0.4]]), np.array([[0.0, 0.1], [1.0, -0.2], [-0.5, 0.3]])
    f, wheels = np.array([-0.1, 0.2]), np.array([1.0, -0.5])
    drive = RoadExcitation(
        heights=lambda t: np.clip(t / end, 0, 1)[:, None] * wheels,
        rates=lambda t: np.where((t > 0) & (t < end), 1 / end, 0.0)[:, None] * wheels,
        kinks=np.array([0.0, end]),
        end=end,
    )
    none, of_u = np.zeros((3, 1)), np.zeros((1, 1))
    plant = GeneralizedPlant(A, none, Bw, np.array([c]), of_u, np.zeros((1, Bw.shape[1])), Cy=none.T, Dyu=of_u)
    driven = RoadLoop(plant, Br, f, drive)
    peak = peak_over_road(driven, of_u)
    # Of z' and z of the first wheel, which are linear on the ramp and after it.
    system = signals.StateSpace(A, np.column_stack([Bw @ wheels, Br @ wheels]), c, [[0.0, f @ wheels]])
    ramp, after = np.linspace(0, end, 2001), np.linspace(0, until, 12001)
    _, y, x = signals.lsim(system, np.column_stack([np.full(2001, 1 / end), ramp / end]), ramp)
    _, later, _ = signals.lsim(system, np.column_stack([np.zeros(12001), np.ones(12001)]), after, X0=x[-1])
    heights = np.abs([*y, *later[1:]])
    return peak, heights.max(), np.interp(peak.time, [*ramp, *(end + after[1:])], heights)


@pytest.mark.parametrize(
    ("A", "c", "late"), [(STIFF, [1.0, 0.0, 0.1], True), (TWICE, [0.3, -1.0, 0.5], False), (SLOW, [1.0, 0.0, 0.0], None)]
)
def test_a_peak_beside_the_exact_response_to_a_ramp(A, c, late):
    """The peak over a ramp is that of matrix exponentials, of a double pole, and long after the road's end, and is proved.

    Where steps end long before a slow motion has its peak, what is proved is still above it, and not far.
    """
    peak, highest, then = after_a_ramp(A, c, 12.0 if late is not None else 200.0)
    if late is None:
        assert peak.time < 50.0
        assert peak.value < 0.5 * highest
        assert highest <= peak.proved <= 2 * highest
        return
    assert [peak.value, then] == pytest.approx([highest] * 2, rel=1e-5)  # a thousandth of a second
    assert (peak.time > 5.0) == late
    assert highest <= peak.proved <= highest * 1.01


def test_the_filter_of_a_band_is_at_least_one_there():
    """So a norm weighted by it bounds the norm in the band, and from above by little: 0.5 %."""
    for low, high in ((4 * HZ, 8 * HZ), (0.0, 8 * HZ), (4 * HZ, np.inf), (0.1, 300.0)):
        system = band_filter((low, high))
        omega = np.linspace(max(low, 1e-3), min(high, 1e3), 2000)
        gains = np.abs(system.response(1j * omega)[:, 0, 0])
        assert min(gains) >= 1 - 1e-9
        assert max(gains) <= 1.005


DRIVEN = [  # road, speed, signal
    ("watts_hump:height=0.1:length=0.2", 8.0, "control_force"),  # upright at both ends
    ("step:height=0.05:edge=0.001", 12.5, "tyre_deflection"),  # over within 80 us
    *attacks([("pothole:edge=0.05", 15.0, "suspension_deflection"), ("bump", 12.5, "control_force")]),
]


@pytest.mark.parametrize(("road", "speed", "signal"), DRIVEN)
def test_no_peak_lies_above_what_is_proved(road, speed, signal):
    """An adaptive integration of the loop, driven by the road's height, reaches the value, and nowhere exceeds what is proved."""
    bound = f"{{ peak = '{signal}', road = '{road}', speed = {speed}, at_most = 1e9 }}"
    vehicle = vehicle_with(f"measured = {TWO}\nbounds = [{bound}]")
    entry = vehicle.controllers["goal"]
    assert entry.goals is not None
    driven = goal_problem(vehicle, entry, entry.goals).members[0].driven_by[0]
    K = np.array([[10824.0, -2071.0]])
    peak, (A, c) = peak_over_road(driven, K), driven.loop(K)
    E, highest, x = A @ driven.plant.Bw + driven.Br, 0.0, np.zeros(4)
    edges = [0.0, *driven.drive.kinks, driven.drive.end + 2.0]
    for start, end in itertools.pairwise(np.unique(edges)):
        found = solve_ivp(
            lambda t, x: A @ x + E @ driven.drive.heights(np.array([t]))[0],
            (start, end),
            x,
            method="DOP853",
            rtol=1e-10,
            atol=1e-13,
            dense_output=True,
            max_step=(end - start) / 50,
        )
        t = np.linspace(start, end, 20001)
        y = found.sol(t).T @ c + driven.drive.heights(t) @ (c @ driven.plant.Bw + driven.f)
        highest, x = max(highest, np.abs(y).max()), found.y[:, -1]
    assert highest <= peak.proved
    assert peak.value == pytest.approx(highest, rel=2e-5)  # what a slope without end leaves of the integration's digits


@pytest.mark.parametrize("signal", ["suspension_deflection", "control_force"])
def test_a_peak_of_a_loop_whose_poles_are_all_real(signal):
    """If no pole swings a road's response is computed as where one does, without a warning, and is the other solver's."""
    gain = [[10121.047619047633, -108653.04761904797, -1630.6525396825323, 5240.445079365075]]
    measured = '["suspension_deflection", "tyre_deflection", "sprung_velocity", "unsprung_velocity"]'
    bound = f'{{ peak = "{signal}", road = "bump", at_most = 1e4 }}'
    vehicle = vehicle_with(f"measured = {measured}\ngain = {gain}\nbounds = [{bound}]")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        controller = Designer(vehicle).design("goal")
    assert all(pole.imag == 0 for pole in controller.certificate.poles)
    response = continuous_response(vehicle, controller, Bump(), np.linspace(0.0, 4.0, 8001))
    peak = next(each for each in controller.specifications if "over bump" in each.what)
    assert peak.value == pytest.approx(np.abs(response[signal]).max(), rel=1e-5)  # its times are 0.5 ms apart
