"""The packages' public names: they are there, nothing heavy comes with the packages, and pages and examples use them alone."""

import ast
import dataclasses
import doctest
import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import models
import sim
import synth

ROOT = Path(__file__).parent.parent
PACKAGES = (models, synth, sim)
PAGES = ("README.md", "models/README.md", "synth/README.md", "sim/README.md", "logs/README.md", ".github/CONTRIBUTING.md")
HEAVY = {"mujoco", "cvxpy", "pandas", "rerun", "control", "scipy", "numpy"}


@pytest.mark.parametrize("package", PACKAGES, ids=lambda one: one.__name__)
def test_names(package):
    """Type checkers see each name where it is, no name is a module's but those that are one, and the docstring lists them all."""
    source = ast.parse((ROOT / package.__name__ / "__init__.py").read_text(encoding="utf-8"))
    [checked] = [node for node in source.body if isinstance(node, ast.If)]
    seen = {alias.name: node.module for node in checked.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert sorted(seen) == package.__all__ == dir(package)
    for name, module in seen.items():
        assert getattr(package, name) is getattr(importlib.import_module(module or ""), name)
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
    """What stands in a docstring is what comes out."""
    finder = doctest.DocTestFinder(recurse=False)
    for example in finder.find(getattr(package, name), name, globs={}):
        told: list[str] = []
        assert doctest.DocTestRunner().run(example, out=told.append).failed == 0, "".join(told)


def test_what_is_shown(paper, designer):
    """A vehicle, a controller, its certificate and a run say in a few lines what they are; a notebook's table holds the same."""
    controller = designer.design("I")
    [run] = sim.run(paper, [controller], models.Bump(height=0.05), duration=1.0)
    said = {
        paper: ("quarter_car", "sprung_mass", "controllers: passive"),
        controller: ("controller I: designed", "sprung_velocity", "norm: 7.843188", "bound: 7.87"),
        controller.certificate: ("certificate: holds", "norm: 7.843188"),
        run: ("run of I: agrees throughout; energy balances", "height 0.05", "1 s at 0.001 s"),
    }
    for one, parts in said.items():
        assert all(part in repr(one) for part in parts)
        assert len(repr(one).splitlines()) <= 7
        root = ElementTree.fromstring(f"<div>{one._repr_html_()}</div>")  # well formed
        table = ["".join(row.itertext()) for row in root.iter("tr")]
        assert table == [line.strip().replace(": ", "", 1) for line in repr(one).splitlines()[1:]]
    assert "<svg" in run._repr_html_()
    bad = dataclasses.replace(controller, name="<script>")
    assert "<script>" not in bad._repr_html_()
    wrong = dataclasses.replace(run.physics, values=np.full_like(run.physics.values, np.nan))
    assert "<svg" in dataclasses.replace(run, physics=wrong)._repr_html_()


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
        assert synth.static_output_feedback(plant, measured).certificate.norm.value == pytest.approx(0.25, rel=1e-3)
    refusing: tuple[Any, ...] = (
        synth.static_output_feedback,
        synth.two_step_design,
        synth.full_order_design,
        synth.find_lower_bound,
    )
    for wrong in ([[1, 2, 3]], [[np.nan, 1]], "yes"):
        for refuses in (*refusing, lambda plant, wrong: synth.refine(plant, wrong, K)):
            with pytest.raises(models.InputError) as caught:
                refuses(plant, wrong)
            assert "\n" not in str(caught.value)
    with pytest.raises(models.InputError, match=r"K has shape \(1, 2\); expected \(1, 1\)"):
        synth.refine(plant, Cy, np.array([[1.0, 2.0]]))
