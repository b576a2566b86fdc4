"""A kind of vehicle may call its suspensions, tyres and forces as it likes: it says which they are, and no name is counted on."""

import json
import re
from pathlib import Path

import pytest

from models.kinds.kind import HERE, Suspension
from models.vehicle.vehicle import read_vehicle
from sim import bump, sweep
from sim.drive import __main__ as drive
from sim.studies.ride.metrics import metrics_of

OWN = {"suspension_deflection": "gap", "tyre_deflection": "squash", "control_force": "push", "road_displacement": "ground"}
LIMITS = "\n[limits]\nsuspension_stroke = 0.05\nstop_stiffness = 1e5\nactuator_force = 400.0\n"
RENAMED = f"""
import dataclasses
from types import SimpleNamespace
from models import signals as common
from models.kinds.kind import Suspension

own = {OWN}
signals = SimpleNamespace(**{{
    key: dataclasses.replace(one, name=own.get(one.name, one.name))
    for key, one in vars(common).items() if isinstance(one, common.Signal)
}})
"""


def other_words(text: str) -> str:
    """The text in the words of the renamed kind."""
    for old, new in OWN.items():
        text = re.sub(rf"\b{old}\b", new, text)
    return text


@pytest.fixture(scope="module")
def vehicles(tmp_path_factory) -> tuple[Path, Path]:
    """The quarter-car with limits, and the same in words of its own."""
    folder = tmp_path_factory.mktemp("kinds")
    ships, renamed = folder / "ships.toml", folder / "strut_car.toml"
    text = (HERE / "quarter_car.toml").read_text() + LIMITS
    ships.write_text(text)
    renamed.write_text(other_words(text).replace('"quarter_car"', '"strut_car"'))
    equations = (HERE / "quarter_car.py").read_text().replace("from models.kinds import signals\n", RENAMED)
    equations = equations.replace('name="quarter_car"', 'name="strut_car",\n    suspended=(Suspension("gap", "strut", "push"),)')
    (folder / "strut_car.py").write_text(equations.replace('spec.tendon("suspension")', 'spec.tendon("strut")'))
    drawn = re.sub(r'((tendon|fixed name|spatial name)=)"suspension"', r'\1"strut"', (HERE / "quarter_car.xml").read_text())
    (folder / "strut_car.xml").write_text(other_words(drawn))
    return ships, renamed


def test_it_says_so(vehicles):
    """The renamed kind has one suspension with a force, and every name of a metric is there once."""
    vehicle = read_vehicle(vehicles[1])
    assert vehicle.kind.suspensions == (Suspension("gap", "strut", "push"),)
    assert [*dict.fromkeys(one.source for one in metrics_of(vehicle))][-3:] == ["gap", "squash", "push"]
    names = [metric.name for metric in metrics_of(vehicle)]
    assert len(set(names)) == len(names) == len(metrics_of(read_vehicle(vehicles[0])))
    assert {"squash_dynamic_load", "squash_off_ground", "push_control_power", "push_control_energy"} <= set(names)


@pytest.mark.parametrize(
    ("main", "options"),
    [
        (bump.main, ["--controller", "I", "--height", "0.12", "--length", "1.5", "--duration", "1", "--no-logs"]),
        pytest.param(drive.main, ["--controller", "I", "--class", "F", "--duration", "1", "--no-logs"], marks=pytest.mark.attack),
        pytest.param(sweep.main, ["--controller", "I", "--timestep", "4e-3"], marks=pytest.mark.attack),
    ],
    ids=["bump", "drive", "sweep"],
)
def test_same_numbers(vehicles, capsys, main, options):
    """Bump stops, saturation, energy, metrics and invariants: every number is that of the quarter-car, in other words."""
    said = []
    for vehicle in vehicles:
        code = main(["--vehicle", str(vehicle), "--json", *options])
        result = json.loads(capsys.readouterr().out)
        said.append((code, result))
    (code, ours), (own_code, own) = said
    assert code == own_code
    assert flat(own) == flat(json.loads(other_words(json.dumps(ours))))
    if main is sweep.main:
        assert len(own["sweeps"][0]["invariants"]) == 2
    else:
        printed = []
        for vehicle in vehicles:
            main(["--vehicle", str(vehicle), *options, "-v"])
            printed.append(capsys.readouterr().out)
        ends = [line for line in printed[0].splitlines() if " stop:" in line or "saturation:" in line]
        assert len(ends) == 2
        assert set(ends) <= set(printed[1].splitlines())


def flat(value) -> list:
    """Every number and text of an object in the order of its keys, as names of metrics are made in other ways."""
    if isinstance(value, dict):
        return [one for key in value for one in flat(value[key])]
    if isinstance(value, list):
        return [one for part in value for one in flat(part)]
    return [value]
