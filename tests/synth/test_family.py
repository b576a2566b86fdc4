"""One gain for a family of plants: what it reaches for the worst of them, next to the two steps with a slack variable."""

import dataclasses
import itertools

import numpy as np
import pytest

from models.common.errors import InputError
from models.vehicle.vehicle import Vehicle, read_vehicle
from synth import design_feedback, slack_design, worst_norm
from synth.analysis.norm import hinf_norm
from synth.plant.generalized import Feedback, GeneralizedPlant
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer
from tests.support.commands import attacks

SHARED_SIGNALS = ["suspension_deflection_front", "suspension_deflection_rear", "heave_velocity", "pitch_rate"]
CORNER_SIGNALS = [f"{name}_{corner}" for corner in ("front", "rear") for name in ("suspension_deflection", "sprung_velocity")]


def measured(vehicle: Vehicle, signals) -> np.ndarray:
    return vehicle.linear_model.rows(signals)[0]


def worst_of(plants, Cys, structure=None) -> tuple[float, np.ndarray]:
    """Designs one gain, and returns its largest norm, which has a proof for every plant, and the gain."""
    first, *others = (plant.measured(Cy) for plant, Cy in zip(plants, Cys, strict=True))
    design = design_feedback(first, family=others, structure=structure)
    norms = [hinf_norm(plant.closed_loop(Feedback(design.gain, Cy))).value for plant, Cy in zip(plants, Cys, strict=True)]
    assert design.value == pytest.approx(max(norms), rel=1e-8)  # by the search's own route
    for plant, Cy, norm in zip(plants, Cys, norms, strict=True):
        assert norm <= worst_norm(plant, Cy, design.gain, 0.0).proved <= norm * (1 + 1.01e-4)
    return max(norms), design.gain


@pytest.mark.parametrize(("name", "slack"), [("I", 12.515132), *attacks([("II", 12.515080)])])
def test_family_of_four(paper, name, slack):
    """Body masses x {0.7, 1.4}, tyres x {0.75, 1.25}: the worst norm is near what the worst car alone admits, 12.51487."""
    plants = []
    for mass, tyre in itertools.product((0.7, 1.4), (0.75, 1.25)):
        parameters = dict(paper.parameters)
        parameters["sprung_mass"] *= mass
        parameters["tyre_stiffness"] *= tyre
        plants.append(Designer(dataclasses.replace(paper, parameters=parameters)).plant)
    worst, gain = worst_of(plants, [measured(paper, paper.controllers[name].measured)] * 4)
    assert 12.51486 < worst < slack * (1 + 2e-5)
    assert np.abs(gain).max() < 1.2e4


@pytest.mark.parametrize(
    ("signals", "pattern", "slack"),
    [
        (SHARED_SIGNALS, [[1, 0, 1, 1], [0, 1, 1, 1]], 6.676284),
        *attacks([(CORNER_SIGNALS, [[1, 1, 0, 0], [0, 0, 1, 1]], 6.045889)]),
    ],
)
def test_patterns_of_a_half_car(signals, pattern, slack):
    """Each actuator fed by its own corner, or with a measurement that both use: other gains are zero exactly."""
    vehicle = read_vehicle("half_car")
    worst, gain = worst_of([Designer(vehicle).plant], [measured(vehicle, signals)], np.array(pattern))
    assert worst <= slack
    assert np.all((gain == 0) == (np.array(pattern) == 0))


@pytest.mark.parametrize(("name", "slack"), [("I", 8.124782), *attacks([("II", 7.858929)])])
def test_plants_that_measure_differently(paper, designer, name, slack):
    """Sensors that are 20 % off are plants of their own: the gain is good for all vertices, where the printed I has 29.36."""
    Cy = measured(paper, paper.controllers[name].measured)
    Cys = [Cy, *(np.diag(scale) @ Cy for scale in itertools.product((0.8, 1.2), repeat=len(Cy)))]
    assert worst_of([designer.plant] * len(Cys), Cys)[0] < slack


@pytest.mark.parametrize(("seed", "slack"), [(1, 2.580328), *attacks([(0, 1.707921), (2, 2.844378)])])
def test_random_families(seed, slack):
    """Random families, with a Dw, lose nothing."""
    rng = np.random.default_rng(seed)
    base = [rng.standard_normal((4, 4)), rng.standard_normal((4, 2)), rng.standard_normal((4, 2)), rng.standard_normal((3, 4))]
    plants = []
    for _ in range(3):
        A, B, Bw, C = (part + 0.05 * rng.standard_normal(part.shape) for part in base)
        D, Dw = rng.standard_normal((3, 2)), 0.2 * rng.standard_normal((3, 2))
        plants.append(GeneralizedPlant(A - 3.0 * np.eye(4), B, Bw, C, D, Dw))
    assert worst_of(plants, [rng.standard_normal((2, 4))] * 3)[0] <= slack


def test_the_former_name():
    """`slack_design` names its successor, and returns the same gain; what no gain stabilises, or does not fit, is one line."""
    A, B = np.array([[0.0, 1.0], [-4.0, -0.4]]), np.array([[0.0], [1.0]])
    plant, Cy = GeneralizedPlant(A, B, B, np.diag([1.0, 0.0]), np.array([[0.0], [0.1]]), 0 * B), np.array([[0.0, 1.0]])
    with pytest.warns(DeprecationWarning, match="use `design_feedback` with `family`"):
        former = slack_design([plant, plant], [Cy, 1.1 * Cy])
    assert np.array_equal(former.gain, design_feedback(plant, Cy, family=[plant.measured(1.1 * Cy)]).gain)
    one = GeneralizedPlant(np.eye(1), np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1)), np.zeros((1, 1)))
    with pytest.raises(DesignError, match="stabilises every loop"):
        design_feedback(one, family=[dataclasses.replace(one, B=-one.B)])
    for others, said in (
        ([plant.measured(np.eye(2))], r"family\[0\] has the shapes .* Cy \(2, 2\)"),
        ([one], r"Cy has shape"),
    ):
        with pytest.raises(InputError, match=said):
            design_feedback(plant, Cy, family=others)
