"""LMI certificates of any plant: the plant, the gain and the claims, as JSON.

A control law with states, x_c' = A x_c + B y, u = C x_c + D y, is written as the static gain [D, C; B, A] of a larger plant.
The larger plant has the additional states x_c with x_c' = v, the additional inputs v, and the additional measurements x_c.

For a discrete law of a continuous plant, the claims concern the continuous counterpart of the law, which Tustin's method gives.
The counterpart and the discrete law have the same static gain, but the larger plants of the two laws differ. With a = 2 / T for
the sample period T, the larger plant of the counterpart has the states xi' = -a xi + v and measures x_c = 2 a xi - v. The
transfer function from v to x_c is then (a - s) / (a + s), by which Tustin's method replaces 1 / z. The file of either kind of
law thus contains the matrices of the law itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import mul
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.printed import digits
from models.laws.linear import LinearLaw
from synth.analysis.certificate import Certificate
from synth.analysis.lmi_certificate.check_certificate import SHAPES, SIGNALS, ExactLoop
from synth.analysis.lmi_certificate.claims import Claim, decay_claim, norm_claim
from synth.analysis.lmi_certificate.duals import lower_bound_claim
from synth.analysis.lmi_certificate.rational import decimal, exact_loop, rational, rows
from synth.plant.generalized import Plant, law_gain

FORMAT = "LMI certificate 1"
TWICE = "computed twice"
MULTIPLIERS = "its proof is not a common X but multipliers that depend on frequency, checked in floating point"
LAW_STATE = "controller_state_"
WEAKER = 1e-7  # a lower bound is listed as not exact if it is weaker than the claimed bound by more than this relative amount
# amount of work that a slow computer can check in 1 s. The work is the sum of the cubes of the numbers of states and outputs
WORK = 10_000

Signal = tuple[str, str]  # name and unit of a signal
Names = Mapping[str, Sequence[Signal]]  # signals of each group, by the name of the group as in `SIGNALS`


def with_law(plant: Plant, law: LinearLaw) -> tuple[Plant, Array]:
    """Returns the plant with the states of the law, and the law as a static gain on the measurements of this plant."""
    n, (q, m), k = len(plant.A), plant.Dyu.shape, law.states
    larger, gain = plant.with_states(k), law_gain(law)
    if not k or law.sample_period is None or plant.dt is not None:
        return larger, gain
    A, Cy, Dyu = larger.A.copy(), larger.Cy.copy(), larger.Dyu.copy()
    own, rate = np.arange(k), 2 / law.sample_period
    A[n + own, n + own], Cy[q + own, n + own], Dyu[q + own, m + own] = -rate, 2 * rate, -1.0
    return replace(larger, A=A, Cy=Cy, Dyu=Dyu), gain


def plain_names(plant: Plant) -> Names:
    """Returns the names x1, x2, ... for the states of a plant, and names such as u1, w1, z1 and y1 for its signals."""
    counts = dict(zip("xuwzy", (len(plant.A), plant.B.shape[1], plant.Bw.shape[1], len(plant.C), len(plant.Cy)), strict=True))
    return {key: [(f"{letter}{i + 1}", "1") for i in range(counts[letter])] for letter, key in SIGNALS.items()}


def _distinct(signals: Sequence[Signal]) -> list[dict[str, str]]:
    """Returns the signals of a plant as JSON. If several signals have the same name, a number is appended to the name of each
    later signal.
    """
    names = [name for name, _ in signals]
    before = [names[:i].count(name) for i, name in enumerate(names)]
    return [{"name": f"{name} ({k + 1})" if k else name, "unit": unit} for (name, unit), k in zip(signals, before, strict=True)]


@dataclass
class Document:
    """LMI certificate under construction, with claims about one or more plants that have the same gain.

    Attributes:
        gain: gain from the measurements to the forces, extended by the states of the law, shape (m + k, q + k).
        law_states: number k of the law's states.
        plants: plants by name, in the form for JSON.
        claims: proved claims.
        not_exact: claims that the file does not prove, each with the reason why the proof is missing.
    """

    gain: Array
    law_states: int = 0
    plants: dict[str, Any] = field(default_factory=dict)
    claims: list[Claim] = field(default_factory=list)
    not_exact: list[dict[str, str]] = field(default_factory=list)

    def loop(self, name: str, plant: Plant, names: Names) -> ExactLoop:
        """Adds a plant to the file, and returns the closed loop of the gain with this plant.

        Args:
            name: name of the plant in the file.
            plant: plant with the states of the law.
            names: names and units of the plant's signals, without the signals that the states of the law add.
        """
        law = [(f"{LAW_STATE}{i + 1}", "1") for i in range(self.law_states)]
        more = {"states": law, "measurements": law, "inputs": [(f"next_{one}", unit) for one, unit in law]}
        signals = {key: _distinct([*names[key], *more.get(key, [])]) for key in SIGNALS.values()}
        period = None if plant.dt is None else rational(decimal(plant.dt))
        self.plants[name] = {"sample_period": period, **signals} | {key: rows(getattr(plant, key)) for key in SHAPES}
        return exact_loop(plant, self.gain)

    def add(self, plant: str, what: str, claims: Claim | Sequence[Claim] | str | None) -> None:
        """Adds claims about a plant, or the reason why these claims are not proved.

        Args:
            plant: name of the plant.
            what: description of the claims, which is used in the list of claims without a proof.
            claims: one or several claims; if there is no proof, a text with the reason, or None.
        """
        if claims is None or isinstance(claims, str):
            self.leave_out(what, claims or "rounding leaves no proof", TWICE if claims == MULTIPLIERS else "none")
            return
        for claim in [claims] if isinstance(claims, dict) else claims:
            self.claims.append({"kind": claim["kind"], "plant": plant, "proof": "exact", **claim})

    def leave_out(self, what: str, reason: str, proof: str = TWICE) -> None:
        """Adds a claim to the list of claims that the file does not prove."""
        self.not_exact.append({"claim": what, "proof": proof, "reason": reason})

    def add_certificate(self, name: str, plant: Plant, loop: ExactLoop, certificate: Certificate, of: Plant | None) -> None:
        """Adds the claims of a certificate: the bound on the norm, the decay rate and the lower bound on the norm.

        Args:
            name: name of the plant.
            plant: plant with the states of the law.
            loop: closed loop of the gain with this plant.
            certificate: certificate of the closed loop.
            of: plant to which the lower bound applies; the states of this plant are the first states of `plant`. None if the
                file cannot contain a proof of the lower bound, because the lower bound was proved for a plant with different
                states.
        """
        proof, below = certificate.proof, certificate.below
        if certificate.stable:
            self.add(name, "bound of the norm", norm_claim(loop, plant.dt, certificate.bound, None if proof is None else proof.X))
            self.add(name, "decay", decay_claim(loop, plant.dt))
        else:
            self.leave_out("stability", f"the loop is {certificate.stability.words}", "none")
        if below is not None and below.gamma:
            claim = lower_bound_claim(of, loop, below) if of is not None else "the plant of this bound has other states"
            self.add(name, f"lower bound {digits(below.gamma)}", claim)
            if isinstance(claim, dict) and (proved := float(claim["bound"])) < below.gamma * (1 - WEAKER):
                self.leave_out(f"lower bound {digits(below.gamma)}", f"rational numbers prove {digits(proved)}", "none")

    def record(self, controller: str, about: Mapping[str, Any]) -> dict[str, Any]:
        """Returns the certificate as JSON.

        Args:
            controller: name of the controller.
            about: additional entries that are written to the file.
        """
        ends = [(claim.get("low", [[]]), claim.get("high", [[]])) for claim in self.claims]
        corners = [2 ** sum(a != b for a, b in zip(*low, *high, strict=True)) for low, high in ends]
        sizes = [sum(len(self.plants[claim["plant"]][key]) ** 3 for key in ("states", "outputs")) for claim in self.claims]
        return {
            "format": FORMAT,
            "controller": controller,
            **about,
            "check": "python check_certificate.py FILE.json, or open check_certificate.html in a browser and drop the file",
            "seconds_to_check": 1 + sum(map(mul, corners, sizes)) // WORK,
            "claims": self.claims,
            "not_exact": self.not_exact,
            "gain": rows(self.gain),
            "plants": self.plants,
        }


def plant_certificate(name: str, plant: Plant, law: LinearLaw, certificate: Certificate) -> dict[str, Any]:
    """Returns the LMI certificate of a control law on the measurements of any plant.

    Args:
        name: name of the controller.
        plant: continuous or discrete plant with measurements.
        law: control law.
        certificate: certificate of the closed loop, for example from `certify_law`.
    """
    larger, gain = with_law(plant, law)
    document = Document(gain, law.states)
    loop = document.loop("plant", larger, plain_names(plant))
    document.add_certificate("plant", larger, loop, certificate, plant.without_feedthrough)
    return document.record(name, {})
