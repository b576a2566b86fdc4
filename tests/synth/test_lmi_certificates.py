"""LMI certificates: two checkers agree about each kind of claim, about damaged files, and about every exact claim of our vehicles."""

import ast
import copy
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.laws.linear import LinearLaw, static_law
from models.laws.python_law import sha256
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from synth.__main__ import main
from synth.analysis.bounding import certify_law
from synth.analysis.energy_to_peak import energy_peaks
from synth.analysis.norm import hinf_norm
from synth.certificates.check_certificate import SHAPES, Loop, check
from synth.certificates.claims import box_claims, decay_claim, norm_claim, peak_claim
from synth.certificates.document import Document, plain_names, plant_certificate, with_law
from synth.certificates.rational import rows
from synth.certificates.vehicle import certificate, dumps
from synth.controller.controller import Controller
from synth.design.uncertainty.worst_case import worst_norm
from synth.plant.generalized import Feedback, Plant
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer
from tests.support.commands import attacks
from tests.support.pages import ROOT

HERE = ROOT / "synth" / "certificates"
PYTHON, PAGE = HERE / "check_certificate.py", HERE / "check_certificate.html"
NODE = shutil.which("node")
Answer = tuple[int, str]


def in_javascript(texts: Sequence[str]) -> list[Answer]:
    """Returns what the page answers to each certificate."""
    command = [str(NODE), str(ROOT / "tests" / "support" / "check_certificates.mjs"), str(PAGE)]
    ran = subprocess.run(command, input=json.dumps(texts), capture_output=True, text=True, check=True, encoding="utf-8")
    return [(code, line) for code, line in json.loads(ran.stdout)]


def both(texts: Sequence[str]) -> list[Answer]:
    """Returns the answers of Python, after a comparison with those of JavaScript: the same code, and the same claims."""
    answers = [check(text) for text in texts]
    if NODE:
        for text, one, other in zip(texts, answers, in_javascript(texts), strict=True):
            assert one[0] == other[0], (one, other, text[:2000])
            assert one[0] == 2 or one[1] == other[1]
    return answers


def test_by_hand(tmp_path):
    """A tutorial: an oscillator x'' = -4 x - 0.1 x' + u + w with u = -2 x' has a norm below 0.3 from w to z = (x, 0.1 u)."""
    A, B, K, bound = np.array([[0, 1], [-4, -0.1]]), np.array([[0], [1]]), np.array([[-2.0]]), 0.3
    C, D, Cy = np.array([[1, 0], [0, 0]]), np.array([[0], [0.1]]), np.array([[0, 1]])
    loop, z = A + B @ K @ Cy, C + D @ K @ Cy  # closed loop from w to z

    # X solves A X + X A' + B B' 1.02 / bound^2 + X C' C X = 0, a Riccati equation: an invariant subspace of its Hamiltonian matrix.
    poles, vectors = np.linalg.eig(np.block([[loop.T, z.T @ z], [-1.02 / bound**2 * B @ B.T, -loop]]))
    stable = vectors[:, poles.real < 0]
    X = np.round(np.real(stable[2:] @ np.linalg.inv(stable[:2])) * 1024) / 1024  # rounded: any X that proves the claim will do

    def exact(M: np.ndarray) -> list[list[str]]:
        return [[str(Fraction(str(float(x)))) for x in row] for row in M]

    def named(*names: str) -> list[dict[str, str]]:
        return [{"name": name, "unit": unit} for name, unit in (one.split() for one in names)]

    plant = {"A": A, "B": B, "Bw": B, "C": C, "D": D, "Dw": 0 * C[:, :1], "Cy": Cy, "Dyu": [[0]], "Dyw": [[0]]}
    document = {
        "format": "LMI certificate 1",
        "gain": exact(K),
        "plants": {
            "oscillator": {
                "sample_period": None,
                "states": named("position m", "velocity m/s"),
                "inputs": named("force N"),
                "disturbances": named("push N"),
                "outputs": named("weighted_position m", "weighted_force N"),
                "measurements": named("speed m/s"),
                **{name: exact(np.array(M)) for name, M in plant.items()},
            }
        },
        "claims": [{"kind": "norm", "plant": "oscillator", "proof": "exact", "bound": "0.3", "X": exact(X)}],
    }
    assert both([json.dumps(document)]) == [(0, "PROVED: norm 0.3")]

    # The exit codes: a claim that does not hold, and one that is only computed.
    for change, code in (({}, 0), ({"bound": "0.29"}, 1), ({"proof": "computed twice"}, 2)):
        file = tmp_path / "by_hand.json"
        file.write_text(json.dumps({**document, "claims": [document["claims"][0] | change]}), encoding="utf-8")
        ran = subprocess.run([sys.executable, "-I", str(PYTHON), str(file)], capture_output=True, text=True, check=False)
        assert (ran.returncode, ran.stdout.count("\n"), ran.stderr) == (code, 1, "")


def drawn(seed: int, dt: float | None = None, states: int = 0) -> dict[str, Any]:
    """Returns a certificate of a plant with four states, with every claim that it has, under a law with some states."""
    rng = np.random.default_rng(seed)
    n, d = 4, 3
    A = rng.standard_normal((n, n))
    A = A - (np.linalg.eigvals(A).real.max() + 0.5) * np.eye(n) if dt is None else 0.8 * A / np.abs(np.linalg.eigvals(A)).max()
    parts = [rng.standard_normal(shape) for shape in ((n, 1), (n, 2), (d, n), (d, 1))]
    plant = Plant(A, *parts, np.zeros((d, 2)), dt=dt, Cy=rng.standard_normal((2, n)), Dyu=0.1 * np.ones((2, 1)))
    law = static_law(0.02 * rng.standard_normal((1, 2)))
    if states:
        shapes = ((states, states), (states, 2), (1, states))
        law = LinearLaw(*(0.2 * rng.standard_normal(shape) for shape in shapes), law.D, sample_period=0.1)
    below = FEATURES.load("lower bounds").find_lower_bound(plant.without_feedthrough)
    document = plant_certificate("drawn", plant, law, certify_law(plant, law, below))
    if dt is None and not states:
        return document | {"claims": document["claims"] + more_claims(plant, law, document)}
    return document


def more_claims(plant: Plant, law: LinearLaw, into: dict[str, Any]) -> list[dict[str, Any]]:
    """Returns claims of energy and of errors, and adds the plants to a certificate."""
    larger, gain = with_law(plant, law)
    document = Document(gain)
    loop = document.loop("plant", larger, plain_names(larger))
    worst = worst_norm(plant, None, law.D, 0.2, 0.1)
    document.add("plant", "errors", box_claims(loop, worst.proof))
    decay = decay_claim(loop)
    assert decay is not None
    document.add("plant", "stability", {"kind": "stability", "X": decay["X"]})
    alone = Plant(plant.A, plant.B, plant.Bw, plant.C[:1], plant.D[:1], 0 * plant.Dw[:1], Cy=plant.Cy, Dyu=plant.Dyu)
    peaks = energy_peaks(alone, Feedback(alone.acting(law.D), alone.Cy), alone.C, alone.D)
    signal = document.loop("signal", alone, plain_names(alone))
    document.add("signal", "energy", peak_claim(signal, float(peaks.bounds[0]), peaks.proof.X))
    into["plants"] |= document.plants
    assert not document.not_exact
    return document.claims


KINDS = {"stability", "decay", "norm", "energy_to_peak", "lower_bound", "box"}


def test_each_kind():
    """Both checkers prove each kind of claim, continuous and discrete, and none with a bound a little beyond the truth."""
    documents = [drawn(1), drawn(2, dt=0.1), drawn(3, states=2)]
    assert {claim["kind"] for claim in documents[0]["claims"]} == KINDS
    assert [code for code, _ in both([dumps(one) for one in documents])] == [0, 0, 0]
    false = []
    for document in documents:
        for i, claim in enumerate(document["claims"]):
            if bound := claim.get("bound", claim.get("rate")):
                better = claim["kind"] == "lower_bound" or (claim["kind"] == "decay" and document is not documents[1])
                wrong = copy.deepcopy(document)
                wrong["claims"][i]["bound" if "bound" in claim else "rate"] = str(Fraction(bound) * (2 if better else Fraction(1, 2)))
                false.append(dumps(wrong))
    assert {code for code, _ in both(false)} == {1}


def test_discrete_law_is_judged_by_its_counterpart():
    """The gain of the certificate has the numbers of a discrete law, and its loop is that of Tustin's counterpart."""
    document, rng = drawn(3, states=2), np.random.default_rng(0)
    assert rng is not None
    (p,) = document["plants"].values()
    read = {name: np.array([[float(Fraction(x)) for x in row] for row in p[name]]) for name in SHAPES}
    K = np.array([[float(Fraction(x)) for x in row] for row in document["gain"]])
    plant = Plant(*(read[name][:4, :4] if name == "A" else read[name] for name in ()), **{}) if False else None
    assert plant is None
    own = LinearLaw(K[1:, 2:], K[1:, :2], K[:1, 2:], K[:1, :2], sample_period=0.1)
    alone = Plant(
        read["A"][:4, :4], read["B"][:4, :1], read["Bw"][:4], read["C"][:, :4], read["D"][:, :1], read["Dw"],
        Cy=read["Cy"][:2, :4], Dyu=read["Dyu"][:2, :1],
    )
    norm = hinf_norm(alone.closed(own.continuous())).value
    bound = float(next(claim["bound"] for claim in document["claims"] if claim["kind"] == "norm"))
    assert norm < bound < norm * (1 + 1e-5)
