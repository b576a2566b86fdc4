"""A certificate holds for what was designed, and fails for what is not true."""

import dataclasses

import numpy as np
import pytest

from synth.certificate import certify
from synth.design import furthest
from synth.errors import DesignError

NAMES = ["state", "I", "II"]


@pytest.mark.parametrize("name", NAMES)
def test_designed_gain_is_proved(designer, name):
    """A designed gain has stable poles, X > 0, LMI (20) < 0 by a margin a thousand times rounding, and norm <= bound."""
    certificate = designer.design(name).certificate
    assert certificate.failures == ()
    assert certificate.stable
    assert certificate.X_smallest > 0
    assert certificate.lmi_largest < -1000 * certificate.lmi_rounding
    assert certificate.norm.value <= certificate.bound


@pytest.mark.parametrize("name", NAMES)
def test_false_claim_is_seen(designer, paper, name):
    """A bound below the norm, an X that is not positive and a gain of the wrong sign are each refused, in words."""
    controller = designer.design(name)
    good, G = controller.certificate, controller.state_gain(paper)
    eta = good.bound**-2
    assert any(
        "exceeds the bound" in text for text in certify(designer.plant, G, good.X, (0.999 * good.norm.value) ** -2).failures
    )
    assert any("is violated" in text for text in certify(designer.plant, G, good.X, 1.01 * eta).failures)
    indefinite = good.X - 1.01 * np.linalg.eigvalsh(good.X)[0] * np.eye(4)
    assert any("not positive definite" in text for text in certify(designer.plant, G, indefinite, eta).failures)
    assert any("unstable" in text for text in certify(designer.plant, -G, good.X, eta).failures)


def test_design_that_cannot_be_certified_is_an_error(designer):
    """If the solution of the LMI does not prove the gain, `design` raises instead of returning it."""
    broken = dataclasses.replace(designer.state_feedback, eta=2 * designer.state_feedback.eta)
    with pytest.raises(DesignError, match="its certificate fails: LMI"):
        furthest(designer.plant, np.eye(4), [broken])


def test_given_gain_is_reported_as_it_is(designer):
    """A given gain is certified without a bound, and an unstable one is called so."""
    certificate = designer.design("I_printed").certificate
    assert certificate.bound is None
    assert certificate.failures == ()
    unstable = certify(designer.plant, np.array([[0.0, 0.0, 5000.0, 0.0]]))
    assert unstable.failures[0].startswith("unstable: a pole at")
    assert unstable.norm.value == np.inf
