"""Controllers that a vehicle file has designed by name: full order, LQR, LQG, H2, with accelerometers too."""

import json
import re
from collections.abc import Collection
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from models.common.errors import InputError
from models.laws.combinations import KINDS, goes, refusal
from models.laws.design_methods import DESIGNS
from models.roads.road import Bump
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.runs.run import run_controllers, sample_times
from synth.__main__ import main
from synth.command.check import check
from synth.vehicle.designer import Designer
from synth.vehicle.trade_off.front import entry_of
from tests.support.commands import attacks, refused
from tests.support.pages import site
from tests.support.shared import designed

ROOT = Path(__file__).parents[2]
ACCELERATIONS = {"quarter_car": ("sprung",), "half_car": ("heave", "pitch"), "full_car": ("heave", "pitch", "roll")}
ONE_IN_A_THOUSAND = 1e-3  # of the lower bound: as near as a full-order controller is to come


def with_designs(name: str) -> Vehicle:
    """A vehicle that ships, with a controller of each kind beside its own."""
    vehicle = read_vehicle(name)
    model, velocities = vehicle.linear_model, list(vehicle.controllers["I"].measured)
    deflections = [signal for signal in velocities if signal.startswith("suspension")]
    readings = [*deflections, *(f"{one}_acceleration" for one in ACCELERATIONS[name]), *model.inputs]
    return parse_vehicle(
        f'{vehicle.text}\n[controllers.full]\nmeasured = {json.dumps(velocities)}\norder = "full"\n'
        f'[controllers.accelerometer]\nmeasured = {json.dumps(readings)}\norder = "full"\n'
        f'[controllers.lqg]\nmeasured = {json.dumps(velocities)}\ndesign = "lqg"\n[controllers.lqr]\ndesign = "lqr"\n'
        f'[controllers.h2]\nmeasured = {json.dumps(readings)}\ndesign = "h2"\n'
    )


@pytest.fixture(scope="module", params=["quarter_car", *attacks(["half_car", "full_car"])])
def designer(request) -> Designer:
    """Designs of each vehicle that ships, with controllers of each kind."""
    return Designer(with_designs(request.param))


NAMES = ("full", "accelerometer", "lqg", "lqr", "h2")


def test_full_order_comes_to_the_lower_bound(designer):
    """A full-order controller is within 0.1 % of what no controller beats, with accelerometers too, where a static one is not."""
    for name in ("full", "accelerometer"):
        certificate = designed(designer.vehicle, name).certificate
        assert certificate.proof is not None
        assert certificate.proof.holds
        assert certificate.gap is not None
        assert 0 <= certificate.gap < ONE_IN_A_THOUSAND
    static = designed(designer.vehicle, "I").certificate
    assert designed(designer.vehicle, "full").certificate.norm.value < static.norm.value


def test_best_in_the_mean_is_not_best_in_the_worst_case(designer):
    """LQR has the smallest H2 norm, LQG and H2 come near it from measurements, and none has the smallest H-infinity norm."""
    h2 = {}
    for name in ("lqr", "lqg", "h2"):
        controller = designed(designer.vehicle, name)
        h2[name] = float(next(one for one in controller.remarks if "H2 norm" in one).split("H2 norm is ")[1].split(",")[0])
        assert controller.certificate.norm.value > designed(designer.vehicle, "state").certificate.norm.value
    assert h2["lqr"] < min(h2["lqg"], h2["h2"]) < 1.2 * h2["lqr"]


def test_physics_follows_them_all(designer):
    """MuJoCo over the bump agrees with the exact sampled response of every one of them, and its energy balances."""
    vehicle = designer.vehicle
    runs = run_controllers(
        vehicle, [designed(designer.vehicle, name) for name in NAMES], Bump(height=0.05), sample_times(vehicle, 0.8, 1e-3)
    )
    for run in runs:
        assert run.passed, run.controller.name


def test_saved_and_checked(tmp_path, capsys):
    """A design is saved with its proof, read again and checked without the solver; a changed matrix is found."""
    path, saved = tmp_path / "car.toml", tmp_path / "saved.toml"
    path.write_text(with_designs("quarter_car").text)
    chosen = [part for name in ("full", "h2") for part in ("--controller", name)]
    assert main(["--vehicle", str(path), *chosen, "--save", str(saved), "-v"]) == 0
    printed = capsys.readouterr().out
    assert "with 4 states" in printed
    vehicle = read_vehicle(saved)
    assert vehicle.controllers["full_designed"].law is not None
    assert [row.failures for row in check(Designer(vehicle), None) if row.name in ("full_designed", "h2_designed")] == [(), ()]
    text = saved.read_text()
    A = next(line for line in text.splitlines() if line.startswith("A = "))
    entry = float(A.split("[[")[1].split(",")[0])
    saved.write_text(text.replace(repr(entry), repr(entry * 1.01)))
    assert main(["--check", str(saved), "--controller", "full_designed"]) == 1
    assert "FAILS" in capsys.readouterr().out


def test_a_law_with_states_is_not_worth_refining(designer):
    """Only static gains are refined."""
    assert designer.worth_refining(designer.design("lqr")) == 0.0


def test_forces_are_taken_out_of_accelerations(designer):
    """A controller that is told the forces has the loop of one that measures accelerations without them, and a law no faster."""
    controller = designer.design("accelerometer")
    law = controller.law_on_states(designer.vehicle)
    np.testing.assert_allclose(law.A, controller.law.A, rtol=0, atol=1e-9 * np.abs(law.A).max())


def test_pages_example():
    """The controllers at the top of the page on dynamic controllers work in a built-in vehicle, and are stable."""
    block, *_ = site("Design dynamic controllers").blocks("toml")
    vehicle = parse_vehicle(f"{read_vehicle('quarter_car').text}\n{block}")
    for name in ("best", "lqg", "leaky"):
        assert Designer(vehicle).design(name).certificate.stable


@pytest.mark.parametrize("kind", ['design = "h2"\nnoise = true', *attacks(['design = "lqg"', 'design = "lqg"\nlag = true'])])
def test_what_is_saved_of_noise_is_checked(kind, tmp_path, capsys):
    """However loud the measurements, a design's claims are those of the matrices that are saved; its mean counts the noise."""
    said = "[implementation]\nsample_period = 0.005\nnoise = { sprung_velocity = 0.5, suspension_deflection = 0.5 }\n"
    said += "[limits]\nactuator_bandwidth = 60.0\n"
    said += f'[controllers.best]\nmeasured = ["suspension_deflection", "sprung_velocity"]\n{kind}\n'
    loud = tmp_path / "loud.toml"
    loud.write_text(f"{read_vehicle('quarter_car').text}\n{said}")
    saved = tmp_path / "saved.toml"
    assert main(["--vehicle", str(loud), "--controller", "best", "--save", str(saved), "-v"]) == 0
    words = " ".join(capsys.readouterr().out.split())
    assert ("of intensity 1, with noise of the sensors" in words) == ("lqg" in kind)
    assert ("of intensity 1, with noise of w on the sensors" in words) == ("h2" in kind)
    assert main(["--check", str(saved)]) == 0


SECTIONS = {
    "gain": "gain = [[-1e3, -1e3]]",
    "states": "A = [[-1.0]]\nB = [[1.0, 1.0]]\nC = [[1.0]]\nD = [[1.0, 1.0]]",
    "steps": "",
    "full": 'order = "full"',
    "order": "order = 2",
    "pid": 'structure = "pid"\npid = { filter = 0.01 }',
    "lqr": 'design = "lqr"',
    "lqg": 'design = "lqg"',
    "h2": 'design = "h2"',
    "preview": 'design = "preview"\npreview = 0.5',
    "law": 'law = "mine.py:step"',
    "semi_active": 'semi_active = "skyhook"',
    "stable": "stable = true",
    "fastest_pole": "fastest_pole = 1e4",
    "anti_windup": "anti_windup = 20.0",
    "noise": "noise = true",
    "lag": "lag = true",
    "sampled": "sampled = true",
    "loads": "loads = { heave_load = 1e3 }",
    "goals": "minimise = { band = [4.0, 8.0] }",
    "tolerance": "tolerance = { sprung_velocity = 0.1 }",
    "family": "family = [{ sprung_mass = 0.9 }, {}]",
    "force": "",
}
BUILT = """
[implementation]
sample_period = 0.004
noise = { sprung_velocity = 1e-3 }
[limits]
actuator_bandwidth = 60.0
actuator_force = 1e4
"""


def with_parts(text: str, parts: Collection[str]) -> str:
    """Returns a vehicle file with a controller that has these parts."""
    signals = ["suspension_deflection", "sprung_velocity"][1 if "pid" in parts else 0 :] + ["control_force"] * ("force" in parts)
    measured = "" if {"lqr", "preview", "semi_active"} & {*parts} else f"measured = {json.dumps(signals)}\n"
    lines = "\n".join(SECTIONS[part] for part in parts)
    lines = lines.replace("1e3]]", "1e3, 0.0]]").replace("[[1.0, 1.0]]", "[[1.0, 1.0, 0.0]]") if "force" in parts else lines
    return f"{text}{BUILT}\n[controllers.mine]\n{measured}{lines}\n"


@pytest.mark.parametrize("one", [*SECTIONS][:-1])
def test_the_table_is_what_is_done(paper, one):
    """Two parts of a section are read where the table has them together, else refused in a line that names both and says why."""
    for other in [*SECTIONS][[*SECTIONS].index(one) + 1 :]:
        pair = {one, other}
        if {*DESIGNS} >= pair or {"full", "order"} == pair or ("steps" in pair and {*KINDS} >= pair):
            continue  # no section has both
        if "force" in pair and pair & {"lqr", "preview", "semi_active", "lag"}:
            continue  # these name no measurements, or have the force as a state
        designed = not pair & {*KINDS, "goals", "tolerance", "family"}
        parts = sorted(pair | {"steps"} if designed else pair, key=[*SECTIONS].index)
        why = [refusal(*two) for two in combinations(parts, 2) if refusal(*two)]
        if why:
            with refused(why[0], match=r"controllers[.]mine\] .* with .*: .*; choose .* or "):
                parse_vehicle(with_parts(paper.text, parts))
        else:
            entry = parse_vehicle(with_parts(paper.text, parts)).controllers["mine"]
            assert {*parts} - {"force", "steps"} <= entry.parts.keys()


@pytest.mark.parametrize(
    "part", [part for part in SECTIONS if part not in ("force", "law", "semi_active", "stable", "fastest_pole", "anti_windup")]
)
def test_the_table_says_what_commands_do(paper, part):
    """A command is refused in a line that names it and the part that it does not go with, or it goes on."""
    vehicle = parse_vehicle(with_parts(paper.text, [part]))
    designer, entry = Designer(vehicle), vehicle.controllers["mine"]
    asked = {"refine": designer.refine, "zero_l": lambda name: designer.design(name, zero_l=True)}
    for command, ask in {**asked, "front": lambda name: entry_of(vehicle, name)}.items():
        if goes(command, entry.parts) or (command == "zero_l" and part in ("gain", "states")):
            continue  # a law that is given is no design, which the command refuses
        why = next(refusal(command, each) for each in entry.parts if refusal(command, each))
        option = command.replace("_", "-")
        with pytest.raises(InputError, match=f"'mine': .* with --{option}: {re.escape(why)}; omit --{option}"):
            ask("mine")
    assert goes("front", entry.parts) == (part in ("gain", "steps", "noise", "lag", "loads", "goals"))
