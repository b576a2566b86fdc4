"""The packages' public names: they are there, nothing heavy comes with the packages, and pages and examples use them alone."""

import ast
import copy
import dataclasses
import doctest
import importlib
import inspect
import json
import pickle
import re
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cloudpickle
import numpy as np
import pytest

import models
import sim
import synth
from models.vehicle.vehicle import shipped_vehicles
from tests.support.pages import PAGES  # contributors work behind the front door

ROOT = Path(__file__).parents[2]
PACKAGES = (models, synth, sim)
HEAVY = {"mujoco", "cvxpy", "pandas", "rerun", "control", "scipy", "numpy"}


@pytest.mark.parametrize("package", PACKAGES, ids=lambda one: one.__name__)
def test_names(package):
    """Type checkers see each name where it is, no name is a module's but those that are one, and the docstring lists them all."""
    source = ast.parse((ROOT / package.__name__ / "__init__.py").read_text(encoding="utf-8"))
    [checked] = [node for node in source.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    seen = {alias.name: node.module for node in checked.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert sorted(seen) == package.__all__ == dir(package)
    for name, module in seen.items():
        assert inspect.unwrap(getattr(package, name)) is inspect.unwrap(getattr(importlib.import_module(module or ""), name))
        is_file = (ROOT / package.__name__ / f"{name}.py").exists() or (ROOT / package.__name__ / name).is_dir()
        assert not is_file or inspect.ismodule(getattr(package, name))
        assert f"`{name}`" in package.__doc__
    with pytest.raises(AttributeError, match="has no attribute 'nonsense'"):
        _ = package.nonsense


def test_nothing_heavy_comes_with_a_package():
    """To import all three loads none of what takes long; nor does looking at what they have."""
    code = f"import models, synth, sim, sys; dir(sim); print({HEAVY!r} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True).stdout == "set()\n"


@pytest.mark.parametrize("name", PAGES)
def test_pages_use_public_names(name):
    """A snippet imports of ours what one of the three packages has in `__all__`."""
    for block in re.findall(r"^```python\n(.*?)^```", (ROOT / name).read_text(encoding="utf-8"), re.M | re.S):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.Import):
                assert not {alias.name.partition(".")[0] for alias in node.names} & {one.__name__ for one in PACKAGES}
            elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in ("models", "synth", "sim"):
                assert node.module in ("models", "synth", "sim")
                assert {alias.name for alias in node.names} <= set(sys.modules[node.module].__all__)


def test_functions_teach():
    """Every public function has a docstring with an example, and says what its arguments are."""
    for package in PACKAGES:
        for name in package.__all__:
            function = getattr(package, name)
            if inspect.isfunction(function):
                assert ">>>" in (function.__doc__ or ""), name
                assert "Args:" in (function.__doc__ or "") or len(inspect.signature(function).parameters) < 2, name


EXAMPLES = [
    (package, name)
    for package in PACKAGES
    for name in package.__all__
    if ">>>" in (getattr(getattr(package, name), "__doc__", None) or "")
]


@pytest.mark.parametrize(("package", "name"), EXAMPLES, ids=lambda one: one if isinstance(one, str) else one.__name__)
def test_examples(package, name):
    """An example in a docstring prints what it says."""
    finder = doctest.DocTestFinder(recurse=False)
    for example in finder.find(getattr(package, name), name, globs={}):
        told: list[str] = []
        assert doctest.DocTestRunner().run(example, out=told.append).failed == 0, "".join(told)


def test_what_is_shown(paper, designer):
    """A vehicle, a controller, its certificate and a run say in a few lines what they are; a notebook also draws."""
    controller = designer.design("I")
    [run] = sim.run(paper, [controller], models.Bump(height=0.05), duration=1.0)
    said = {
        paper: ("quarter_car", "sprung_mass", "controllers: passive"),
        controller: ("controller I: designed", "sprung_velocity", "norm: 7.843188", "bound: 7.87"),
        controller.certificate: ("certificate: holds", "norm: 7.843188"),
        run: ("run of I: MuJoCo agrees with the model; linear analysis applies over", "height 0.05", "1 s, step 1 ms"),
    }
    for one, parts in said.items():
        assert all(part in repr(one) for part in parts)
        assert len(repr(one).splitlines()) <= 7
        root = ElementTree.fromstring(f"<div>{one._repr_html_()}</div>")  # well formed
        shown = ["".join(each.itertext()) for each in root.iterfind("div/*") if each.tag in ("h3", "p")]
        assert " ".join(shown).split() == repr(one).split()
    plots = [re.findall(' id="plot-([^"-]*)-[^"]*-0"', str(one._repr_html_())) for one in said]
    assert [len(some) for some in plots] == [1] * 4
    assert len({*map(tuple, plots)}) == 4  # one notebook has many
    for row in ElementTree.fromstring(f"<div>{run._repr_html_()}</div>").findall(".//tbody/tr"):
        cells = ["".join(cell.itertext()) for cell in row]
        assert float(cells[1]) == pytest.approx(run.physics.peak(cells[0].split()[0]), rel=1e-4)
    assert "<script>" not in str(dataclasses.replace(controller, name="<script>")._repr_html_())
    wrong = dataclasses.replace(run.physics, values=np.full_like(run.physics.values, np.nan))
    assert "<svg" in str(dataclasses.replace(run, physics=wrong)._repr_html_())


def test_runs_by_name(tmp_path):
    """A run takes names, entries of the vehicle file and laws of every kind, as commands have them, and no other vehicle's."""
    (tmp_path / "mine.py").write_text("def step(sample, state):\n    return [0.0], state\n")
    text = (ROOT / "models/quarter_car.toml").read_text(encoding="utf-8")
    path = tmp_path / "car.toml"
    path.write_text(f'{text}\n[controllers.mine]\nmeasured = ["sprung_velocity"]\nlaw = "mine.py:step"\n', encoding="utf-8")
    vehicle, road = models.read_vehicle(path), models.Bump(height=0.05)
    passive, gain, mine = sim.run(vehicle, ["passive", vehicle.controllers["I"], "mine"], road, duration=0.5)
    [designed] = sim.run(vehicle, synth.design_controllers(vehicle, ["I"]), road, duration=0.5)
    assert np.array_equal(gain.physics.values, designed.physics.values)
    assert np.array_equal(mine.physics["tyre_deflection"], passive.physics["tyre_deflection"])
    [sky] = sim.run(models.read_vehicle("quarter_car_semi_active"), ["skyhook"], road, duration=0.5)
    assert sky.passed
    car = models.read_vehicle("full_car")
    for given, said in (
        (designed.controller, "'I' measures 'suspension_deflection', so this controller belongs to another vehicle"),
        (vehicle.controllers["mine"], "'mine' belongs to another vehicle"),
        ("mine", "unknown controller 'mine'"),
    ):
        with pytest.raises(models.InputError, match=said):
            sim.run(car, [given], road)


def test_what_cannot_be_confirmed_is_no_agreement(paper):
    """At a timestep that is too coarse a run passes, but does not agree: a warning says why; at a fine one, none does."""
    law: Any = lambda t, y: 0.0  # noqa: E731
    with pytest.warns(UserWarning, match=r"^controller 'passive': agrees is None, as the timestep is too coarse") as warned:
        [coarse, _] = sim.run(paper, ["passive", law], models.Bump(speed=25.0), duration=0.5, timestep=0.02)
    assert len(warned) == 2
    assert coarse.passed
    assert coarse.agrees is None
    with warnings.catch_warnings(action="error"):
        [fine, other] = sim.run(paper, ["passive", law], models.Bump(height=0.05), duration=0.5)
    assert fine.agrees is other.agrees is True


def test_peaks_of_a_run_are_floats(paper):
    """The peak and the rms of a single run are floats; those of several runs are arrays of the same numbers."""
    several = sim.run(paper, ["passive", "II_printed"], models.Bump(height=0.05), duration=0.2)
    both = dataclasses.replace(several[0].physics, values=np.stack([one.physics.values for one in several]))
    for name in ("peak", "rms"):
        alone = [getattr(one.physics, name)("tyre_deflection") for one in several]
        assert [type(one) for one in alone] == [float, float]
        np.testing.assert_array_equal(getattr(both, name)("tyre_deflection"), alone)


def test_with_parameters():
    """A vehicle with other parameters is the one that a file with them gives; wrong ones are refused as there."""
    vehicle = models.read_vehicle("quarter_car")
    text = vehicle.text.replace("sprung_mass = 504.5", "sprung_mass = 600.0", 1)
    assert vehicle.with_parameters(sprung_mass=600).parameters == models.parse_vehicle(text).parameters
    for wrong, said in (
        ({"sprung_mas": 600.0}, "unknown parameter 'sprung_mas'"),
        ({"sprung_mass": -1.0}, "sprung_mass = -1.0 is not allowed"),
        ({"tyre_stiffness": 1.0}, "tyre_deflection at rest is"),
    ):
        with pytest.raises(models.InputError, match=said):
            vehicle.with_parameters(**wrong)
    with pytest.raises(models.InputError, match="unknown parameter 'sprung_mas'"):
        dataclasses.replace(vehicle, parameters={**vehicle.parameters, "sprung_mas": 1.0})


def test_vehicles_and_controllers_go_to_other_processes():
    """Plain pickle writes every shipped vehicle, whole, and a controller; what comes back is the same, as is a deep copy."""
    for name in shipped_vehicles():
        vehicle = models.read_vehicle(name)
        for again in (pickle.loads(pickle.dumps(vehicle)), copy.deepcopy(vehicle)):
            assert (again.text, repr(again), again.kind.signals) == (vehicle.text, repr(vehicle), vehicle.kind.signals)
            for one, same in zip(vehicle.kind.wheels, again.kind.wheels, strict=True):
                assert one.behind is same.behind
                assert one.lateral(vehicle.parameters) == same.lateral(again.parameters)
            np.testing.assert_array_equal(again.linear_model.C, vehicle.linear_model.C)
    (controller,) = synth.design_controllers(models.read_vehicle("quarter_car"), ["I"])
    for again in (pickle.loads(pickle.dumps(controller)), copy.deepcopy(controller)):
        assert repr(again) == repr(controller)
        np.testing.assert_array_equal(again.gain, controller.gain)


def test_one_controller_is_a_list_of_one():
    """A single name, or controller, is run and designed as a list of it; no controller at all is refused by both."""
    vehicle, bump = models.read_vehicle("quarter_car"), models.Bump()
    (passive,) = synth.design_controllers(vehicle, "passive")
    for one in ("passive", passive):
        (alone,), (listed,) = (sim.run(vehicle, given, bump, duration=0.1) for given in (one, [one]))
        np.testing.assert_array_equal(alone.physics["tyre_deflection"], listed.physics["tyre_deflection"])
    for call in (lambda: sim.run(vehicle, [], bump), lambda: synth.design_controllers(vehicle, [])):
        with pytest.raises(models.InputError, match="at least one"):
            call()
    assert max(len(repr(one)) for one in (vehicle.kind, synth.Designer(vehicle))) < 130


def test_a_vehicle_is_read_only():
    """Its parameters, weights and controllers refuse changes, also copied or unpickled; the caller's own dicts do not."""
    vehicle = models.read_vehicle("quarter_car")
    own = dict(vehicle.parameters)
    again = dataclasses.replace(vehicle, parameters=own)
    own["sprung_mass"] = -1.0
    assert again.parameters == vehicle.parameters
    assert json.loads(json.dumps(vehicle.parameters)) == vehicle.parameters
    for one in (vehicle, again, copy.deepcopy(vehicle), cloudpickle.loads(cloudpickle.dumps(vehicle))):
        for name in ("parameters", "performance", "controllers"):
            mapping: Any = getattr(one, name)
            assert list(mapping) == list(getattr(vehicle, name))
            changes = (lambda known: known.__setitem__("a", -1.0), lambda known: known.update(a=1.0), lambda known: known.clear())
            for change in changes:
                with pytest.raises(models.InputError, match=r"with vehicle\.with_parameters"):
                    change(mapping)


def test_lists_do_for_matrices():
    """Every public function of plants takes nested lists where it takes arrays, and gives the same; a wrong shape is one line."""
    lists: tuple[Any, ...] = ([[0, 1], [-4, -0.1]], [[0], [1]], [[0], [1]], [[1, 0], [0, 0]], [[0], [0.1]], [[0], [0]])
    K: Any = [[-2.0]]
    Cy: Any = [[0, 1]]
    plant = synth.GeneralizedPlant(*lists)
    arrays = np.array(K), np.array(Cy, dtype=float)
    for gain, measured in ((K, Cy), arrays):
        assert synth.certify(plant, synth.Feedback(gain, measured)).norm.value == pytest.approx(0.290259, rel=1e-5)
        assert synth.refine(plant, measured, gain).after == pytest.approx(0.25, rel=1e-3)
    assert synth.static_output_feedback(plant, Cy).certificate.norm.value == pytest.approx(0.25, rel=1e-3)
    with pytest.raises(models.InputError, match=r"K has shape \(1, 2\); expected \(1, 1\)"):
        synth.refine(plant, Cy, np.array([[1.0, 2.0]]))


def test_former_names():
    """Arguments and attributes of public names that have been renamed are accepted by their former names, too."""
    one, zero = np.eye(1), np.zeros((1, 1))
    plant = synth.MeasuredPlant(synth.GeneralizedPlant(-one, one, one, one, zero, zero), one)
    former: Any = synth.HoldInterval, synth.FamilyMember, synth.certify  # type checkers know the present names alone
    assert former[0](duration=0.1, late=2).delay_samples == former[0](0.1, delay_samples=2).late == 2
    assert former[1](posed=(plant,)).plants == former[1]((plant,)).posed == (plant,)
    certificates = [former[2](plant, zero, **{name: plant}) for name in ("by_itself", "plant_without_law")]
    assert len({one.norm.value for one in certificates}) == 1
