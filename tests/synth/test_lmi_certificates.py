"""LMI certificates: two checkers agree about each kind of claim, damaged files, and every exact claim of our vehicles."""

import ast
import copy
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import linalg

from models.common.extensions import FEATURES
from models.laws.linear import LinearLaw, static_law
from models.laws.python_law import sha256
from models.vehicle.vehicle import read_vehicle
from synth.__main__ import main
from synth.analysis.bounding import certify_law
from synth.analysis.energy_to_peak import energy_peaks
from synth.analysis.lmi_certificate.check_certificate import SHAPES, check
from synth.analysis.lmi_certificate.claims import box_claims, decay_claim, peak_claim
from synth.analysis.lmi_certificate.document import Document, plain_names, plant_certificate, with_law
from synth.analysis.norm import hinf_norm
from synth.analysis.uncertainty_box import BoxProof
from synth.controller.controller import Controller
from synth.design.uncertainty.worst_case import worst_norm
from synth.plant.generalized import Feedback, Plant
from synth.vehicle.designer import Designer
from synth.vehicle.lmi_certificates import certificate, dumps
from tests.support.commands import attacks, in_the_suite
from tests.support.pages import ROOT

HERE = ROOT / "synth" / "analysis" / "lmi_certificate"
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
    answers: list[Answer] = [check(text) for text in texts]
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

    # X solves A X + X A' + B B' 1.02 / bound^2 + X C' C X = 0, by an invariant subspace of the Hamiltonian matrix.
    poles, vectors = np.linalg.eig(np.block([[loop.T, z.T @ z], [-1.02 / bound**2 * B @ B.T, -loop]]))
    stable = vectors[:, np.real(poles) < 0]
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
    assert [code for code, _ in both([json.dumps(document | {"claims": [], "plants": {}}), "[]", "{", ""])] == [2, 2, 2, 2]

    # The exit codes: a claim that does not hold, and one that is only computed.
    for change, code in (({}, 0), ({"bound": "0.29"}, 1), ({"proof": "computed twice"}, 2)):
        file = tmp_path / "by_hand.json"
        file.write_text(json.dumps({**document, "claims": [document["claims"][0] | change]}), encoding="utf-8")
        ran = subprocess.run([sys.executable, "-I", str(PYTHON), str(file)], capture_output=True, text=True, check=False)
        assert (ran.returncode, ran.stdout.count("\n"), ran.stderr) == (code, 1, "")


def drawn(seed: int, dt: float | None = None, states: int = 0) -> dict[str, Any]:
    """Returns a certificate of a plant with four states and noisy measurements, under a law with some states."""
    rng = np.random.default_rng(seed)
    n, d = 4, 3
    A = rng.standard_normal((n, n))
    A = A - (np.linalg.eigvals(A).real.max() + 0.5) * np.eye(n) if dt is None else 0.8 * A / np.abs(np.linalg.eigvals(A)).max()
    B, Bw, C, D, Cy = (rng.standard_normal(shape) for shape in ((n, 1), (n, 2), (d, n), (d, 1), (2, n)))
    plant = Plant(A, B, Bw, C, D, np.zeros((d, 2)), dt=dt, Cy=Cy, Dyu=0.1 * np.ones((2, 1)))
    plant = plant.with_disturbances(np.eye(2))
    law = static_law(0.02 * rng.standard_normal((1, 2)))
    if states:
        A, B, C = (0.2 * rng.standard_normal(shape) for shape in ((states, states), (states, 2), (1, states)))
        law = LinearLaw(A, B, C, law.D, sample_period=0.1)
    below = FEATURES.load("lower bounds").find_lower_bound(plant.without_feedthrough)
    document = plant_certificate("drawn", plant, law, certify_law(plant, law.continuous() if dt is None else law, below))
    if dt is None and not states:
        return document | {"claims": document["claims"] + more_claims(plant, law, document)}
    return document


def more_claims(plant: Plant, law: LinearLaw, into: dict[str, Any]) -> list[dict[str, Any]]:
    """Returns claims of energy and of errors, and adds the plants to a certificate."""
    larger, gain = with_law(plant, law)
    document = Document(gain)
    loop = document.loop("plant", larger, plain_names(larger))
    worst = worst_norm(plant, None, law.D, 0.2, 0.1)
    assert isinstance(worst.proof, BoxProof)
    document.add("plant", "errors", box_claims(loop, worst.proof))
    decay = decay_claim(loop)
    assert decay is not None
    document.add("plant", "stability", {"kind": "stability", "X": decay["X"]})
    alone = replace(plant, C=plant.C[:1], D=plant.D[:1], Dw=0 * plant.Dw[:1], Dyw=0 * plant.Dyw)
    peaks = energy_peaks(alone, Feedback(alone.acting(law.D), alone.Cy), alone.C, alone.D)
    signal = document.loop("signal", alone, plain_names(alone))
    document.add("signal", "energy", peak_claim(signal, float(peaks.bounds[0]), peaks.proof.X))
    into["plants"] |= document.plants
    assert not document.not_exact
    return document.claims


KINDS = {"stability", "decay", "norm", "energy_to_peak", "lower_bound", "invariant_point", "box"}


@cache
def each_kind() -> list[dict[str, Any]]:
    """Returns certificates with every kind of claim, of continuous and discrete plants and laws."""
    return [drawn(8), drawn(4, dt=0.1), drawn(4, states=2), drawn(2, dt=0.1)]


def test_each_kind():
    """Both checkers prove each kind of claim, continuous and discrete, and none whose bound is far beyond."""
    documents = each_kind()
    assert {claim["kind"] for document in documents for claim in document["claims"]} == KINDS
    assert [{"norm", "decay", "lower_bound"} <= {claim["kind"] for claim in one["claims"]} for one in documents[:3]] == 3 * [True]
    assert {code for code, _ in both([dumps(one) for one in documents])} == {0}
    false = []
    for document in documents:
        for i, claim in enumerate(document["claims"]):
            if bound := claim.get("bound", claim.get("rate")):
                sampled = document["plants"]["plant"]["sample_period"] is not None
                larger = claim["kind"] in ("lower_bound", "invariant_point") or (claim["kind"] == "decay" and not sampled)
                wrong, factor = copy.deepcopy(document), 2 if larger else Fraction(1, 2)
                wrong["claims"][i]["bound" if "bound" in claim else "rate"] = str(Fraction(bound) * factor)
                false.append(dumps(wrong))
    assert {code for code, _ in both(false)} == {1}


def floats(rows_of: Sequence[Sequence[str]]) -> np.ndarray:
    """Returns a matrix of a certificate in floats."""
    return np.array([[float(Fraction(x)) for x in row] for row in rows_of])


def plant_of(record: dict[str, Any]) -> Plant:
    """Returns a plant of a certificate."""
    A, B, Bw, C, D, Dw, Cy, Dyu, Dyw = (floats(record[name]) for name in SHAPES)
    return Plant(A, B, Bw, C, D, Dw, dt=1.0 if record["sample_period"] is not None else None, Cy=Cy, Dyu=Dyu, Dyw=Dyw)


def test_discrete_law_is_judged_by_its_counterpart():
    """The gain of the certificate has the numbers of a discrete law, and its loop is that of Tustin's counterpart."""
    document = each_kind()[2]
    p, K, own = plant_of(document["plants"]["plant"]), floats(document["gain"]), slice(4)
    law = LinearLaw(K[1:, 2:], K[1:, :2], K[:1, 2:], K[:1, :2], sample_period=0.1)
    measured = {"Cy": p.Cy[:2, own], "Dyu": p.Dyu[:2, :1], "Dyw": p.Dyw[:2]}
    plant = replace(p, A=p.A[own, own], B=p.B[own, :1], Bw=p.Bw[own], C=p.C[:, own], D=p.D[:, :1], **measured)
    norm = hinf_norm(plant.closed(law.continuous())).value
    bound = float(next(claim["bound"] for claim in document["claims"] if claim["kind"] == "norm"))
    assert norm < bound < norm * (1 + 1e-5)


def untrue(document: dict[str, Any]) -> list[str]:
    """Returns the kinds of claims that floating point refutes, by poles, norms and gramians instead of the proofs."""
    wrong, K = list[str](), floats(document["gain"])
    for claim in document["claims"]:
        plant, bound = plant_of(document["plants"][claim["plant"]]), float(Fraction(claim.get("bound", "0")))
        dt = plant.dt
        ends = [floats(claim[end])[0] for end in ("low", "high")] if claim["kind"] == "box" else [np.ones(sum(K.shape))] * 2
        for share in np.random.default_rng(0).random((8 if claim["kind"] == "box" else 1, sum(K.shape))):
            f = ends[0] + np.round(share) * (ends[1] - ends[0])
            loop = plant.closed(static_law(f[K.shape[1] :, None] * K * f[: K.shape[1]]))
            poles, norm = np.linalg.eigvals(loop.A), hinf_norm(loop).value
            kind, rate = claim.get("of", claim["kind"]), float(Fraction(claim.get("rate", "0" if dt is None else "1")))
            growth = poles.real.max() + rate if dt is None else np.abs(poles).max() - rate
            if kind in ("lower_bound", "invariant_point"):
                holds = growth >= 0 or norm >= bound * (1 - 1e-7)
            elif kind == "energy_to_peak":
                P = np.asarray(linalg.solve_continuous_lyapunov(loop.A, -loop.Bw @ loop.Bw.T))
                holds = growth < 0 and np.linalg.eigvalsh(loop.C @ P @ loop.C.T)[-1] <= bound**2 * (1 + 1e-9)
            else:
                holds = growth < 0 and (kind != "norm" or norm <= bound * (1 + 1e-9))
            wrong += [] if holds else [claim["kind"]]
    return wrong


def damaged(document: dict[str, Any], rng: np.random.Generator) -> str:
    """Returns the text of a certificate with one change: of a digit, the bound, the kind, a name, the order of states, a unit."""
    document = copy.deepcopy(document)
    claim = document["claims"][rng.integers(len(document["claims"]))]
    plant = document["plants"][claim["plant"]]
    numbers = [document["gain"], *(plant[name] for name in SHAPES), *(x for x in claim.values() if isinstance(x, list))]
    change = rng.integers(9)
    if change < 4:
        matrix = numbers[rng.integers(len(numbers))]
        row = matrix[rng.integers(len(matrix))]
        j = rng.integers(len(row))
        at = rng.choice([i for i, one in enumerate(row[j]) if one.isdigit()])
        row[j] = row[j][:at] + str(rng.integers(10)) + row[j][at + 1 :]
    elif change == 4:
        key = "bound" if "bound" in claim else "rate" if "rate" in claim else "X"
        claim[key] = str(Fraction(claim[key]) * Fraction(str(rng.uniform(0.9, 1.1)))) if key != "X" else claim[key][::-1]
    elif change == 5:
        claim["kind"] = str(rng.choice([*sorted(KINDS), "x"]))
    elif change == 6:
        signal = plant[rng.choice(["states", "inputs", "outputs", "measurements"])][0]
        signal[str(rng.choice(["name", "unit"]))] = str(rng.choice(["x2", "m/s", ""]))
    elif change == 7:
        order = rng.permutation(len(plant["states"]))
        for key in rng.choice(["A", "B", "C", "states", "Cy"], 2, replace=False):
            of_columns = key in ("C", "Cy")
            plant[key] = [[row[i] for i in order] for row in plant[key]] if of_columns else [plant[key][i] for i in order]
    else:
        del document[str(rng.choice(["format", "gain", "plants", "claims"]))]
    return dumps(document)


@pytest.mark.parametrize("seed", [0, *attacks(range(1, 21))])
def test_damaged_certificates_prove_nothing_false(seed):
    """Of 10 damaged files, in all 210, each is refused or proves what it then says; the checkers agree on each."""
    rng, documents = np.random.default_rng(seed), [certificate_of("quarter_car", "I"), *each_kind()]
    texts = [damaged(documents[rng.integers(len(documents))], rng) for _ in range(10)]
    answers = both(texts)
    for text, (code, _) in zip(texts, answers, strict=True):
        assert code or not untrue(json.loads(text))
    assert sum(code > 0 for code, _ in answers) > 1  # a change of a digit may leave the proof valid


def certificate_of(car: str, name: str) -> dict[str, Any]:
    """Returns the certificate of a controller of a built-in vehicle."""
    designer = Designer(read_vehicle(car), search=False)
    return certificate(designer, designer.design(name))


FILES = [
    path for path in sorted((ROOT / "models").glob("**/*.toml")) if path.name != "entry.toml" and "templates" not in path.parts
]
SECONDS = {4: 1, 8: 5}  # of a check, as the file estimates it, by states; 60 for more
UNPROVED = {"lqr.toml": "the plant of this bound has other states"}  # integrals in z


def exact_claims(controller: Controller) -> set[tuple[str, float]]:
    """Returns the exact claims of a certificate: upper and lower bounds."""
    of = controller.certificate
    return {("norm", of.bound or 0.0), ("lower", of.lower_bound or 0.0)} - {("norm", 0.0), ("lower", 0.0)}


@pytest.mark.parametrize("path", in_the_suite([ROOT / "models" / "quarter_car_accelerometer.toml"], FILES))
def test_every_exact_claim_has_a_proof(path):
    """Each bound and lower bound of the built-in vehicles and the gallery is in a file that both checkers prove."""
    vehicle = read_vehicle(path)
    for name in [name for name in vehicle.linear_names if name != "passive"]:
        designer = Designer(vehicle.with_actuators_of(name), search=False)
        controller = designer.design(name)
        found = certificate(designer, controller)
        ((code, line),) = both([dumps(found)])
        assert code == 0, line
        assert found["seconds_to_check"] <= SECONDS.get(len(found["plants"]["performance"]["A"]), 60)
        proved = {claim["kind"]: float(Fraction(claim["bound"])) for claim in found["claims"][::-1] if "bound" in claim}
        for kind, bound in exact_claims(controller):
            if kind == "lower" and UNPROVED.get(path.name) in {one["reason"] for one in found["not_exact"]}:
                continue
            level = proved["norm"] if kind == "norm" else proved.get("lower_bound", proved.get("invariant_point", 0.0))
            assert level == pytest.approx(bound, rel=1e-12 if kind == "norm" else 1e-7)


@pytest.mark.parametrize("numbers", ["double", "int16"])
def test_gain_of_the_code(tmp_path, numbers, capsys):
    """An exported folder has a certificate of the gain in its C code: equal in double, and proved again where it is rounded."""
    folder = tmp_path / "ecu"
    ranges = ["--range", "suspension_deflection=0.2", "--range", "sprung_velocity=2"] if numbers == "int16" else []
    assert main(["--controller", "I_printed", "--export", str(folder), "--numbers", numbers, *ranges]) == 0
    found = json.loads((folder / "certificates" / "I_printed.json").read_text(encoding="utf-8"))
    data, (gain,) = (folder / "I_printed_data.h").read_text(encoding="utf-8"), found["gain"]
    tables = "".join(line for line in data.splitlines(keepends=True) if line.startswith(("static", "    {")))
    assert found["fingerprints"]["vehicle file"] == sha256((folder / "vehicle.toml").read_text(encoding="utf-8"))
    assert found["fingerprints"]["tables of I_printed_data.h"] == sha256(tables)
    (table,) = re.findall(r"_D\[1\]\[2\] = \{ \{(.*?)\}\}", " ".join(data.split()))
    code = [float(number) for number in re.findall(r"-?\d[\d.e+]*", table)]
    if numbers == "double":
        assert [float(Fraction(x)) for x in gain] == code
    else:
        assert all(
            (Fraction(x) / Fraction(int(y))).denominator in {2**k for k in range(40)} for x, y in zip(gain, code, strict=True)
        )
        assert [float(Fraction(x)) for x in gain] == pytest.approx([10824.0, -2071.0], rel=1e-3)
    assert both([json.dumps(found)])[0][0] == 0
    names = {"check_certificate.py", "check_certificate.html", "I_printed.json"}
    assert {file.name for file in (folder / "certificates").iterdir()} == names
    capsys.readouterr()
    assert main(["--check", str(folder)]) == 0
    (folder / "certificates" / "I_printed.json").write_text("{}", encoding="utf-8")
    assert main(["--check", str(folder)]) == 1


def test_checkers_are_short_and_alone():
    """Each checker has at most 150 lines; that in Python needs the standard library alone, and the page loads nothing."""
    source, page = PYTHON.read_text(encoding="utf-8"), PAGE.read_text(encoding="utf-8")
    assert max(text.count("\n") for text in (source, page)) <= 150
    tree = ast.parse(source)
    modules = {
        one.module if isinstance(one, ast.ImportFrom) else one.names[0].name
        for one in ast.walk(tree)
        if isinstance(one, (ast.Import, ast.ImportFrom))
    }
    assert modules <= sys.stdlib_module_names
    longest = max(one.end_lineno - one.lineno for one in ast.walk(tree) if isinstance(one, ast.FunctionDef) and one.end_lineno)
    assert longest <= 28  # `check`; a kind has at most 20
    assert not re.search(r"https?:|src=|fetch|import ", page)
