"""LMI certificates of a vehicle's controllers: claims about each closed loop and its design goals, with signal names, units and
checksums.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from itertools import count
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.kinds.signals import load_signal
from models.laws.goals import REGRET, DecayBound, EnergyBound, NormBound, PeakBound
from models.laws.linear import LinearLaw
from models.laws.python_law import sha256
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from synth.analysis.energy_to_peak import energy_peaks
from synth.analysis.lmi_certificate.check_certificate import ExactLoop
from synth.analysis.lmi_certificate.claims import box_claims, decay_claim, norm_claim, peak_claim
from synth.analysis.lmi_certificate.document import MULTIPLIERS, Document, Names, Signal, with_law
from synth.analysis.uncertainty_box import BoxProof
from synth.controller.controller import Controller
from synth.controller.export.c_law import ExportedLaw, c_name, exported_law
from synth.controller.export.c_source import CSource
from synth.controller.problem import plant_states, road_twist_inputs
from synth.design.descent.landscape import EVERYWHERE
from synth.design.uncertainty.worst_case import stable_with_errors
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer
from synth.vehicle.multi_objective import goal_problem, with_outputs_of_norm
from synth.vehicle.verification import Verification, shifted_plant

PERFORMANCE = "performance"  # name of the plant with the output z that the section [performance] defines
CHECKERS = ("check_certificate.py", "check_certificate.html")  # programs that check a certificate independently
MOST_STATES = 40  # largest number of states of a loop for which a certificate is made; with more states, proofs take minutes
SAMPLED = "its matrix exponentials are irrational"
BAND = "a norm in a band is computed by level sets in floating point"
ROAD = "the response to a road is computed in floating point"


def certificate(designer: Designer, controller: Controller, law: ExportedLaw | None = None) -> dict[str, Any]:
    """Returns the LMI certificate of a controller as JSON.

    If no claim can be proved, the certificate contains the reason instead of claims.

    Args:
        designer: `Designer` of the vehicle to which the controller belongs.
        controller: linear controller of the vehicle.
        law: law in its exported form. If `law` is given, the certificate of a static law is for the rounded numbers in the
            exported code.
    """
    vehicle = designer.vehicle
    about = {"vehicle": vehicle.kind.name, "fingerprints": _fingerprints(vehicle, controller, law)}
    if controller.preview is not None:
        return _without_claims(controller, about, "its force from the road ahead is not feedback")
    problem = designer.problem(controller.measured, controller.hardware)
    own, said = _own_law(controller, law)
    if problem.integrals or problem.of_heights is not None:
        judged = problem.judged(own)
        if judged.with_road_heights is not None:
            return _without_claims(controller, about, "a constant road height affects z")
        plant, gain, k, base = replace(judged.plant, Cy=judged.G.Cy), judged.G.K, judged.law_states, None
        own_states = judged.states
    else:
        (plant, gain), k, base, own_states = with_law(problem.plant, own), own.states, problem.of_states, problem.states
    if len(plant.A) > MOST_STATES:
        return _without_claims(controller, about, f"the loop has {len(plant.A)} states, more than {MOST_STATES}")
    document, q = Document(gain, k), len(gain[0]) - k
    measured = [_signal(vehicle, name) for name in (*controller.measured, *(f"integral_{i + 1}" for i in range(q)))[:q]]
    names = _names(vehicle, controller, own_states, measured)
    loop = document.loop(PERFORMANCE, plant, names)
    entry, known = vehicle.controllers.get(controller.name), controller.certificate
    if known.bound is None and entry is not None and entry.certificate:
        saved, wrong = designer.checked(entry)
        known = known if wrong else saved
    known = known if own is controller.law else replace(known, proof=None)
    document.add_certificate(PERFORMANCE, plant, loop, known, base)
    for what in said:
        document.leave_out(*what)
    if vehicle.implementation.sample_period is not None:
        document.leave_out("norm of the sampled-data loop", SAMPLED)
    for promise in controller.robustness:
        document.leave_out(promise.what, MULTIPLIERS)
    if entry is not None and entry.goals is not None and base is not None and not own.states:
        _add_goals(document, vehicle, entry, own.D, names)
    elif controller.specifications:
        document.leave_out("goals of the section", "this format supports goals of static gains only", "none")
    return document.record(controller.name, about)


def _without_claims(controller: Controller, about: Mapping[str, Any], reason: str) -> dict[str, Any]:
    document = Document(controller.gain)
    document.leave_out("norm of the loop", reason, "none")
    return document.record(controller.name, about)


def _own_law(controller: Controller, law: ExportedLaw | None) -> tuple[LinearLaw, list[tuple[str, str]]]:
    """Returns the law that a certificate describes, and the claims that the certificate omits, each with the reason."""
    own = controller.law
    if law is None or not controller.acts:
        return own, []
    if own.states:
        same = law.numbers == "double" and own.sample_period == law.period
        return own, [] if same else [("loop of the exported code", "its numbers are a discretisation of this law, or rounded")]
    if law.numbers == "double":
        return own, []
    if law.fixed is None:
        return replace(own, D=own.D.astype(np.float32).astype(float)), []
    D = law.tables["D"] * np.outer(law.fixed.given * 2.0 ** -law.fixed.shifts[: len(own.D)], 1 / law.fixed.seen)
    return replace(own, D=D), []


def _fingerprints(vehicle: Vehicle, controller: Controller, law: ExportedLaw | None) -> dict[str, str]:
    """Returns the SHA-256 of the vehicle file and of the tables in the C code.

    The checksum of the tables is that of the lines that `grep -E '^(static| [{])' NAME_data.h` prints.
    """
    try:
        law = law or exported_law(vehicle, controller, "double", c_name(controller.name))
    except InputError:
        return {"vehicle file": sha256(vehicle.text)}
    lines = CSource(law, "").data().splitlines(keepends=True)
    tables = "".join(line for line in lines if line.startswith(("static", "    {")))
    return {"vehicle file": sha256(vehicle.text), f"tables of {law.name}_data.h": sha256(tables)}


def _signal(vehicle: Vehicle, name: str) -> Signal:
    return name, next((one.unit for one in vehicle.kind.signals if one.name == name), "1")


def _names(vehicle: Vehicle, controller: Controller, states: Sequence[str], measured: Sequence[Signal]) -> Names:
    """Returns the names and units of all signals of a controller's plant."""
    model, hardware = vehicle.linear_model, controller.hardware
    noise = zip(measured, hardware.noise, strict=False)
    return {
        "states": [_signal(vehicle, name) for name in states],
        "inputs": [_signal(vehicle, name) for name in model.inputs],
        "measurements": measured,
        "disturbances": [
            *((name, "m/s") for name in model.disturbances),
            *((f"road_twist_{i + 1}", f"m / {model.twist_rate:g} s") for i in range(len(road_twist_inputs(model)))),
            *((name, f"{size:g} {load_signal(name).unit}") for name, size in hardware.loads),
            *((f"noise_of_{name}", f"{rms:g} {unit}") for (name, unit), rms in noise if rms),
        ],
        "outputs": _outputs(vehicle),
    }


def _outputs(vehicle: Vehicle) -> list[Signal]:
    return [(row.name, f"{_signal(vehicle, row.name)[1]}, times {row.weight:g}") for row in vehicle.weighted]


def _add_goals(document: Document, vehicle: Vehicle, entry: ControllerEntry, K: Array, names: Names) -> None:
    """Adds the claims about the goals in a controller's section to a certificate, for each vehicle in the family that the goals
    define.
    """
    goals = entry.goals
    assert goals is not None, "they are given"
    asked = goal_problem(vehicle, entry, goals)
    verification, tolerance = Verification(vehicle, entry, goals, asked, K), asked.tolerance
    bounds = [bound for bound in goals.bounds if isinstance(bound, NormBound)]
    norms = [(goals.minimise, asked.minimise), *zip(bounds, asked.norms, strict=True)]
    if asked.bests is not None or goals.over == REGRET:
        document.leave_out("largest ratio to a vehicle's own best", "the optimum of each vehicle comes from a search", "none")
    for i, (member, which) in enumerate(zip(asked.members, verification.names, strict=True)):

        def loop(what: str, plant: Plant, of: Vehicle, outputs: list[Signal], which: str = which) -> tuple[str, ExactLoop]:
            states = [_signal(of, name) for name in plant_states(of, entry.hardware.bandwidth)[: len(plant.A)]]
            name = f"{which}: {what}" if which else what
            return name, document.loop(name, plant, {**names, "states": states, "outputs": outputs})

        for norm, spec in norms:
            if spec.band != EVERYWHERE:
                document.leave_out(f"{which} {norm.text}".strip(), BAND)
                continue
            of = with_outputs_of_norm(vehicle, norm)
            name, closed = loop(PERFORMANCE if of is vehicle else norm.text, member.plants[spec.which], of, _outputs(of))
            if which or norm.signals is not None:
                document.add(name, norm.text, norm_claim(closed))
            if asked.has_errors:
                proof = verification.worst(spec)[i].proof
                claims = box_claims(closed, proof) if isinstance(proof, BoxProof) else MULTIPLIERS
                document.add(name, f"{norm.text}, with errors", claims)
        for bound in (bound for bound in goals.bounds if isinstance(bound, DecayBound)):
            of = with_outputs_of_norm(vehicle, goals.minimise)
            name, closed = loop("plant without filters", member.plants[0].without_weighting, of, _outputs(of))
            document.add(name, "decay", decay_claim(closed, rate=bound.decay) or decay_claim(closed))
            if asked.has_errors:
                moved = shifted_plant(member.plants[0], bound.decay)
                proof = stable_with_errors(moved, K, tolerance.sensors, tolerance.forces)
                claims = box_claims(closed, proof, bound.decay) if isinstance(proof, BoxProof) else MULTIPLIERS
                document.add(name, "decay, with errors", claims)
        energies = [bound.energy_peak for bound in goals.bounds if isinstance(bound, EnergyBound)]
        for signal, peak in zip(member.signals, energies, strict=True):
            plant, of = member.plants[asked.minimise.which], with_outputs_of_norm(vehicle, goals.minimise)
            C, D = signal.c[None], signal.g[None]
            plant = replace(plant, C=C, D=D, Dw=np.zeros((1, plant.Bw.shape[1])))
            name, closed = loop(f"peak of {peak}", plant, of, [_signal(vehicle, peak)])
            try:
                peaks = energy_peaks(plant, plant.acting(K) @ plant.Cy, C, D)
            except DesignError as error:
                document.leave_out(signal.name, str(error), "none")
                continue
            document.add(name, signal.name, peak_claim(closed, float(peaks.bounds[0]), peaks.proof.X))
        for bound in (bound for bound in goals.bounds if isinstance(bound, PeakBound)):
            document.leave_out(f"{which} peak of {bound.peak} over {bound.road}".strip(), ROAD)


def certificate_texts(vehicle: Vehicle, controllers: Sequence[Controller], law: ExportedLaw | None = None) -> dict[str, str]:
    """Returns the files of a certificate folder: a certificate for each controller, and Python and JavaScript programs that
    check the certificates.

    Args:
        vehicle: vehicle to which the controllers belong.
        controllers: linear controllers. A controller without measurements has no certificate.
        law: control law in the form in which it is exported, if there is only one controller.

    Returns:
        Text of each file, by file name; empty if no controller has a certificate.
    """
    texts = dict[str, str]()
    for controller in [one for one in controllers if one.measured]:
        name, designer = c_name(controller.name), Designer(vehicle.with_actuators_of(controller.name), search=False)
        file = next(file for i in count(1) if (file := f"{name}{f'_{i}' * (i > 1)}.json") not in texts)
        texts[file] = dumps(certificate(designer, controller, law))
    here = files("synth.analysis.lmi_certificate")
    return texts | {name: here.joinpath(name).read_text("utf-8") for name in CHECKERS} if texts else {}


def dumps(certificate: Mapping[str, Any]) -> str:
    """Returns a certificate as JSON text with one line for each row of a matrix and for each signal."""
    text = json.dumps(certificate, indent=1, ensure_ascii=False)
    return re.sub(r"[\[{]\n[^\[\]{}]*[\]}]", lambda inner: re.sub(r"\n\s*", " ", inner[0]), text) + "\n"
