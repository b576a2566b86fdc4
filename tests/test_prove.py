"""`python -m synth --prove`: laws that are given have a bound as designed ones have; and which laws do the same."""

import dataclasses
import json

import numpy as np
import pytest

from models.laws.linear import LinearLaw, static_law
from models.vehicle.vehicle import read_vehicle
from sim.campaign.verify import SAME_GAIN, _same_law
from synth.__main__ import main
from synth.command.check import UNPROVED, proved
from synth.vehicle.designer import Designer, certify_given
from tests.test_false_certificates import law_of


def rows(capsys, *options: str) -> dict[str, dict]:
    """Returns what the command says, by controller, as JSON."""
    capsys.readouterr()
    assert main([*options, "--json"]) == 0
    return {row["name"]: row for row in json.loads(capsys.readouterr().out)["controllers"]}


@pytest.mark.parametrize(("vehicle", "name"), [("quarter_car", "I_printed"), ("quarter_car_accelerometer", "accelerometer")])
def test_a_given_law_has_a_close_bound_when_asked(vehicle, name, capsys):
    """Static, or with states on an accelerometer: a bound a millionth above the norm, if asked; else none."""
    options = ("--vehicle", vehicle, "--controller", name)
    plain, asked = rows(capsys, *options)[name], rows(capsys, *options, "--prove")[name]
    assert plain["bound"] is None
    assert asked["lmi"]["proved"]
    assert asked["norm"] == plain["norm"]
    assert 0 < asked["bound"] / asked["norm"] - 1 < 1.1e-6  # the closest margin that is tried
    assert asked["notes"] == [*plain["notes"], "its law is given; its bound is proved here"]
    assert {key: value for key, value in asked.items() if key not in ("bound", "lmi", "notes", "certificate")} == {
        key: value for key, value in plain.items() if key not in ("bound", "lmi", "notes", "certificate")
    }


@pytest.mark.parametrize("period", [None, 0.004])
def test_the_proof_is_one(period):
    """For a random law, continuous or discrete, on an accelerometer, the X that is found satisfies (20) for its own loop."""
    paper = read_vehicle("quarter_car")
    one = certify_given(paper, "mine", ("suspension_deflection", "sprung_acceleration"), law_of(paper, 3, period))
    found, said = proved(Designer(paper), one)
    assert said
    assert found.certificate.proof is not None
    assert found.certificate.bound is not None
    assert found.certificate.bound > found.certificate.norm.value
    loop, X = one.loop(paper), found.certificate.proof.X
    assert np.linalg.eigvalsh(X).min() > 0
    eta = found.certificate.bound**-2
    off = X @ loop.C.T + eta * loop.Bw @ loop.Dw.T
    M = np.block(
        [[loop.A @ X + X @ loop.A.T + eta * loop.Bw @ loop.Bw.T, off], [off.T, eta * loop.Dw @ loop.Dw.T - np.eye(len(loop.C))]]
    )
    scale = 1 / np.sqrt(np.abs(np.diag(M)))
    assert np.linalg.eigvalsh(scale[:, None] * M * scale).max() < 1e-9  # to rounding; certified with twice the digits elsewhere


def test_what_is_designed_or_unstable_is_as_it_was():
    """A designed law keeps its own proof, and of an unstable loop nothing is proved."""
    paper = read_vehicle("quarter_car")
    designer = Designer(paper)
    designed = designer.design("I")
    assert proved(designer, designed) == (designed, ())
    assert proved(designer, designer.design("passive"))[1] == ()
    wild = certify_given(paper, "wild", ("sprung_velocity",), static_law(np.array([[9000.0]])))
    assert proved(designer, wild) == (wild, ())


def test_what_cannot_be_proved_is_said(monkeypatch):
    """If no X is found the law stays without a bound, and that is in its notes."""
    import synth.command.check as prove

    paper = read_vehicle("quarter_car")
    one = certify_given(paper, "mine", ("sprung_velocity",), static_law(np.array([[-9000.0]])))
    monkeypatch.setattr(prove, "certify_tightly", lambda *_: one.certificate)
    assert proved(Designer(paper), one) == (one, (UNPROVED,))


def record(law: LinearLaw) -> dict:
    """A law as the folder of a campaign has it."""
    return {"measured": ["suspension_deflection", "sprung_acceleration"], **json.loads(json.dumps(law.record))}


@pytest.mark.parametrize("period", [None, 0.004])
def test_a_law_in_other_coordinates_is_the_same_law(period):
    """The effect of a law is compared, not its matrices; another entry, force, period or order is another law."""
    law = law_of(read_vehicle("quarter_car"), 4, period)
    T = np.random.default_rng(3).standard_normal((4, 4)) + 3 * np.eye(4)
    turned = LinearLaw(np.linalg.solve(T, law.A) @ T, np.linalg.solve(T, law.B), law.C @ T, law.D, law.sample_period)
    assert not np.allclose(turned.A, law.A)
    assert _same_law(record(law), record(turned))
    for name in "ABCD":
        for at in np.ndindex(getattr(law, name).shape):
            if getattr(law, name)[at]:
                matrix = np.array(getattr(law, name))
                matrix[at] *= 1.001
                assert not _same_law(record(law), record(dataclasses.replace(law, **{name: matrix}))), (name, at)
    assert not _same_law(record(law), record(dataclasses.replace(law, sample_period=0.003)))
    assert not _same_law(record(law), record(law_of(read_vehicle("quarter_car"), 3, period)))
    assert not _same_law(record(law), record(static_law(law.D)))
    static = static_law(law.D)
    assert _same_law(record(static), record(static_law(law.D * (1 + 0.1 * SAME_GAIN))))
    assert not _same_law(record(static), record(static_law(law.D * (1 + 10 * SAME_GAIN))))
