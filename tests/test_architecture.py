"""The house: imports point one way, and each heavy package is known to one file."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FLOORS = ["models", "synth", "sim"]  # each may import those before it
FILES = [path for floor in FLOORS for path in sorted((ROOT / floor).glob("*.py"))]

# Who may import what is heavy, or replaceable.
OWNERS = {
    "cvxpy": {"synth/lmi.py"},
    "mujoco": {"models/mjcf.py", "sim/readout.py", "sim/physics.py", "sim/energy.py", "sim/drawing.py"},
    "mcap": {"sim/recording_mcap.py", "sim/mcap_file.py"},
    "zstandard": {"sim/mcap_file.py"},
    "lz4": {"sim/mcap_file.py"},
    "mcap_protobuf": {"sim/recording_mcap.py"},
    "google": {"sim/recording_mcap.py", "sim/recorded.py", "sim/foxglove_scene.py"},
    "foxglove_schemas_protobuf": {"sim/foxglove_scene.py"},
    "rerun": {"sim/recording_rerun.py", "sim/rerun_signals.py", "sim/rerun_scene.py", "sim/rerun_layout.py"},
    "control": {"sim/convert.py"},
    "pandas": {"sim/convert.py"},
    "matplotlib": {"sim/picture.py"},
    "contourpy": {"sim/figure.py"},
    "plotly": {"sim/page.py"},
    "jinja2": {"sim/page.py"},
    "pyopencrg": {"sim/opencrg.py"},
    "filelock": {"sim/campaign_manifest.py"},
    "pyarrow": {"sim/campaign_store.py", "sim/campaign_verify.py"},
    "ray": {"sim/campaign_workers.py"},
}


def imports(path: Path) -> set[str]:
    """Every package that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module.split(".")[0])
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports(path):
    """A file imports no floor above its own, and no package that belongs to another file."""
    own = path.relative_to(ROOT).as_posix()
    above = FLOORS[FLOORS.index(path.parent.name) + 1 :]
    for package in imports(path):
        assert package not in above
        assert own in OWNERS.get(package, {own})
