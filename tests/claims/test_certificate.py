"""A certificate holds for what was designed, and fails for what is not true."""

import dataclasses

import numpy as np
import pytest

from models.laws.linear import static_law
from sim.runs.report import controller_notes
from synth.analysis.bounding import certify_tightly
from synth.analysis.certificate import FASTEST, certify
from synth.command.table import Row, details, record
from synth.design.two_step import last_certified_gain, state_path, two_step_design
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError
from synth.vehicle.designer import certify_given
from tests.support.commands import attacks

NAMES = ["state", "I", "II"]


@pytest.mark.parametrize("name", NAMES)
def test_designed_gain_is_proved(designer, name):
    """A designed gain has stable poles, X > 0, LMI (20) < 0 by a margin a thousand times rounding, and norm <= bound."""
    certificate = designer.design(name).certificate
    assert certificate.failures == ()
    assert certificate.stable
    assert certificate.proof.holds
    assert certificate.proof.positive.smallest > 0.04  # of X balanced to a unit diagonal; measured 0.046 for II
    assert certificate.proof.negative.smallest > 1000 * certificate.proof.negative.rounding
    assert certificate.norm.value <= certificate.bound


@pytest.mark.parametrize("name", NAMES)
def test_false_claim_is_seen(designer, paper, name):
    """A bound below the norm, an X that is not positive and a gain of the wrong sign are each refused, in words."""
    controller = designer.design(name)
    good, G = controller.certificate, controller.state_gain(paper)
    eta = good.bound**-2
    assert any(
        "exceeds the bound" in text for text in certify(designer.plant, G, good.proof.X, (0.999 * good.norm.value) ** -2).failures
    )
    assert any(
        "LMI (20) is not negative definite" in text for text in certify(designer.plant, G, good.proof.X, 1.01 * eta).failures
    )
    indefinite = good.proof.X - 1.01 * np.linalg.eigvalsh(good.proof.X)[0] * np.eye(4)
    assert any("not positive definite" in text for text in certify(designer.plant, G, indefinite, eta).failures)
    assert any("unstable" in text for text in certify(designer.plant, -G, good.proof.X, eta).failures)


def test_design_that_cannot_be_certified_is_an_error(designer):
    """A gain that nothing proves is an error; a bound that its X does not prove is never given, but one that another X does."""
    point = designer.state_feedback
    with pytest.raises(DesignError, match="its certificate fails: unstable"):
        last_certified_gain(designer.plant.measured(np.eye(4)), [dataclasses.replace(point, K=-10 * point.K)])
    found = last_certified_gain(designer.plant.measured(np.eye(4)), [dataclasses.replace(point, eta=2 * point.eta)]).certificate
    assert found.bound is not None
    assert found.norm.value < found.bound < 1.001 * found.norm.value


def test_given_gain_is_reported_as_it_is(designer):
    """A given gain is certified without a bound, and an unstable one is called so."""
    certificate = designer.design("I_printed").certificate
    assert certificate.bound is None
    assert certificate.failures == ()
    unstable = certify(designer.plant, np.array([[0.0, 0.0, 5000.0, 0.0]]))
    assert unstable.failures[0].startswith("unstable: a pole at")
    assert unstable.norm.value == np.inf


def slow_plant(rate: float) -> GeneralizedPlant:
    """A unit mass on a spring and a damper that hardly act, pushed by w."""
    return GeneralizedPlant(
        A=np.array([[0.0, 1.0], [-(rate**2), -rate]]),
        B=np.array([[0.0], [1.0]]),
        Bw=np.array([[0.0], [1.0]]),
        C=np.array([[1.0, 0.0], [0.0, 0.0]]),
        D=np.array([[0.0], [1.0]]),
        Dw=np.zeros((2, 1)),
    )


def test_no_actuator_withholds_a_proof():
    """A gain that makes the loop a thousand times as fast as the plant is proved like any other; its speed is remarked on."""
    plant = slow_plant(1e-3)
    certificate = certify_tightly(plant, np.array([[-3.0, -3.0]]))
    assert certificate.failures == ()
    assert certificate.bound is not None
    assert certificate.speed_up > FASTEST
    assert "too fast for actuators" in certificate.remarks[0]
    assert f"{certificate.speed_up:.2g} times" in certificate.remarks[0]
    assert certify_tightly(slow_plant(1.0), np.array([[-3.0, -3.0]])).remarks == ()


@pytest.mark.parametrize(("decay", "said"), [(3e-10, True), (1e-5, False)])
@pytest.mark.parametrize(("unit", "dt"), [(1.0, None), (1e-6, None), (1.0, 0.25)])
def test_a_decay_that_is_none_is_remarked_on(decay, said, unit, dt):
    """A loop with a pole of -3e-10 beside one of -1 is stable, and proved, and a line says what that is worth, in any unit."""
    A = unit * np.diag([-decay, -1.0])
    A = A if dt is None else np.eye(2) + dt * A
    plant = GeneralizedPlant(A, np.ones((2, 1)), unit * np.eye(2), np.eye(2), np.zeros((2, 1)), np.zeros((2, 2)), dt=dt)
    certificate = certify(plant, np.zeros((1, 2)))
    assert certificate.stable
    assert certificate.hardly_decays == said
    remarks = [f"the loop is hardly stable: a pole decays at only {unit * decay:.2g} 1/s, 3e-10 times the "]
    assert [remark.partition("typical")[0] for remark in certificate.remarks] == remarks * said


@pytest.mark.parametrize("seed", [1, *attacks([0])])  # the optimum at a finite gain, and at an infinite one
def test_design_of_what_hardly_moves(seed):
    """If every proof along the path is beyond any actuator, the design is proved all the same."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((2, 2))
    plant = GeneralizedPlant(
        A=1e-4 * (A - (np.linalg.eigvals(A).real.max() + 0.2) * np.eye(2)),
        B=rng.standard_normal((2, 1)),
        Bw=rng.standard_normal((2, 1)),
        C=np.vstack([rng.standard_normal((1, 2)), np.zeros((1, 2))]),
        D=np.array([[0.0], [1.0]]),
        Dw=0.5 * rng.standard_normal((2, 1)),
    )
    path, both = state_path(plant), np.eye(2)
    design = last_certified_gain(plant.measured(both), path)
    proofs = [each for each in (certify(plant, point.K, point.X, point.eta) for point in path) if not each.failures]
    slowest = min(each.speed_up for each in proofs)
    assert slowest > FASTEST
    assert design.certificate.failures == ()
    assert design.certificate.bound == min(each.bound or np.inf for each in proofs if each.speed_up <= FASTEST * slowest)
    assert two_step_design(plant, both, path).certificate.bound == pytest.approx(
        design.certificate.bound, rel=1e-2
    )  # where each stops


def test_speed_is_printed(paper):
    """A gain beyond any actuator is said so on the terminal of both commands and in the JSON."""
    controller = certify_given(paper, "stiff", ["sprung_velocity"], static_law(np.array([[-1e7]])))
    (remark,) = controller.certificate.remarks
    assert remark in [one.text for one in details(paper, Row("stiff", controller, (), ())).statements]
    assert remark in controller_notes(paper, controller)
    assert record(Row("stiff", controller, ("a note",), ()))["notes"] == ["a note", remark]


@pytest.mark.parametrize(("slow", "fast"), [(5e-5, 1e3), (1e-6, 1e4)])
def test_a_norm_of_what_nearly_cancels_has_a_bound(slow, fast):
    """For what follows a slow reference z sees the small difference of two large states: a bound within a factor is proved."""
    loop = GeneralizedPlant(
        np.array([[-fast, fast, 0, 0], [0, -slow, 0, 0], [0, 0, -slow, 0], [0, 0, fast, -fast]]),
        np.zeros((4, 1)),
        np.array([[0.0], [0.011], [0.0011], [0.0]]),
        np.array([[1.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 1.0]]),
        np.zeros((2, 1)),
        np.zeros((2, 1)),
    )
    certificate = certify_tightly(loop, np.zeros((1, 4)))
    assert certificate.failures == ()
    # s / ((s + slow) (s + fast)) fast^-1 of the reference's rate: 0.011 / fast, at high frequencies of both.
    assert certificate.norm.value == pytest.approx(0.011 / fast * 1.01**0.5, rel=1e-3)
    assert certificate.bound is not None
    assert certificate.bound <= 2 * certificate.norm.value * (1 + 1e-9)  # the first of LOOSE
