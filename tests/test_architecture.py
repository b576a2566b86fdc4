"""The house: imports point one way, from room to room as the table says, and each heavy package is known to one file."""

import ast
import graphlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from sim.inspect.commanded import COMMANDS
from sim.recording.format import RESULTS

ROOT = Path(__file__).parent.parent
FILES = sorted(path for floor in ("models", "synth", "sim") for path in (ROOT / floor).rglob("*.py"))
NAMES = {path: ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for path in FILES}
MODULES = {name: path for path, name in NAMES.items()}

# A room is a folder, or a file that lies in none, and may import what stands behind it here: rooms of rows above its own, so that
# there can be no circle. What a row does not name it does not know.
ROOMS = {
    # models: what a vehicle is
    "models.common": "",
    "models.figures": "models.common",
    "models.filters": "models.common",
    "models.formats": "models.common",
    "models.own": "models.common",
    "models.goals": "models.common",
    "models.curves": "models.common",
    "models.damping": "models.common models.curves",
    "models.stops": "models.common",
    "models.parts": "models.common",
    "models": "models.common models.curves models.damping models.filters models.formats models.goals models.own "
    "models.parts models.stops",
    "models.loads": "models models.common",
    "models.roads": "models models.common models.formats models.loads",
    # synth: what a controller is; of vehicles it knows nothing below `controller`
    "synth": "",
    "synth.errors": "",
    "synth.extended": "",
    "synth.numerics": "synth.errors",
    "synth.plant": "synth.extended",
    "synth.scaling": "synth.plant",
    "synth.discrete": "synth.extended synth.plant",
    "synth.certificate": "synth.discrete synth.extended synth.numerics synth.plant synth.scaling",
    "synth.modes": "synth.certificate synth.plant synth.scaling",
    "synth.lmi": "synth.certificate synth.discrete synth.errors synth.numerics synth.plant synth.scaling",
    "synth.band": "synth.certificate synth.discrete synth.errors synth.lmi synth.numerics synth.plant synth.scaling",
    "synth.family": "synth.certificate synth.errors synth.lmi synth.numerics synth.plant synth.scaling",
    "synth.dynamic": "models synth.certificate synth.errors synth.modes synth.numerics synth.plant synth.scaling",
    "synth.posed": "synth.certificate synth.lmi synth.modes synth.plant synth.scaling",
    "synth.design": "synth.certificate synth.errors synth.lmi synth.modes synth.numerics synth.plant synth.posed synth.scaling",
    "synth.energy": "synth.certificate synth.design synth.errors synth.lmi synth.numerics synth.plant synth.scaling",
    "synth.search": "models synth.certificate synth.design synth.discrete synth.dynamic synth.errors synth.lmi synth.numerics "
    "synth.plant synth.scaling",
    "synth.full": "models synth.certificate synth.discrete synth.dynamic synth.errors synth.lmi synth.modes synth.numerics "
    "synth.plant synth.scaling synth.search",
    "synth.tolerance": "models synth.certificate synth.discrete synth.dynamic synth.errors synth.lmi synth.numerics synth.plant "
    "synth.search",
    "synth.fallback": "synth.certificate synth.design synth.errors synth.lmi synth.plant synth.search",
    "synth.redesign": "synth.design synth.errors synth.fallback synth.lmi synth.numerics synth.plant synth.scaling",
    "synth.problem": "models models.filters synth.dynamic synth.plant",
    "synth.controller": "models synth.certificate synth.plant synth.problem",
    "synth.sampled": "synth.certificate synth.plant",
    "synth.words": "models models.curves synth.controller",
    "synth.implemented": "models synth.certificate synth.controller synth.dynamic synth.plant synth.problem synth.sampled",
    "synth.held": "synth.design synth.errors synth.lmi synth.modes synth.numerics synth.plant synth.sampled synth.scaling "
    "synth.search",
    "synth.goals": "synth.certificate synth.discrete synth.dynamic synth.errors synth.numerics synth.plant synth.search "
    "synth.tolerance",
    "synth.designs": "models models.goals models.roads synth.band synth.certificate synth.controller synth.design synth.dynamic "
    "synth.energy synth.errors synth.family synth.goals synth.held synth.implemented synth.lmi synth.plant synth.problem "
    "synth.search synth.tolerance",
    "synth.designer": "models synth.certificate synth.controller synth.design synth.designs synth.dynamic synth.errors "
    "synth.fallback synth.full synth.goals synth.implemented synth.lmi synth.plant synth.problem synth.redesign synth.search",
    "synth.state_space": "models synth.controller synth.designer synth.plant synth.problem",
    "synth.paper": "models synth.certificate synth.design synth.designer synth.errors synth.lmi synth.numerics synth.plant",
    "synth.command": "models models.figures models.goals synth.certificate synth.controller synth.design synth.designer "
    "synth.designs synth.errors synth.implemented synth.lmi synth.plant synth.posed synth.sampled synth.scaling synth.tolerance "
    "synth.words",
    "synth.rates": "models models.figures synth.controller synth.designer synth.designs synth.errors synth.held "
    "synth.implemented synth.sampled",
    "synth.front": "models models.figures models.goals synth.band synth.certificate synth.command synth.controller synth.design "
    "synth.designer synth.designs synth.errors synth.goals synth.lmi synth.numerics synth.plant synth.problem synth.search "
    "synth.tolerance synth.words",
    "synth.asked": "synth.front",
    "synth.__main__": "models models.figures synth.asked synth.certificate synth.command synth.designer "
    "synth.designs synth.errors synth.front synth.implemented synth.problem synth.rates synth.search synth.words",
    # sim: what a run is
    "sim": "",
    "sim.response": "models.curves",
    "sim.semi_active": "",
    "sim.linear": "sim.response sim.semi_active models.curves models.roads",
    "sim.physics": "models.curves sim.response sim.semi_active models.roads",
    "sim.runs": "sim.linear sim.physics sim.response models.roads synth.words",
    "sim.acting": "models.curves models.figures models.loads sim.linear sim.response models.roads",
    "sim.ride": "models.curves models.filters sim.linear sim.response models.roads sim.runs",
    "sim.validity": "models.curves models.figures models.loads sim.linear sim.physics sim.response models.roads",
    "sim.stability": "models.figures sim.linear sim.physics models.roads sim.runs synth.problem synth.tolerance",
    "sim.frequency": "models.figures models.filters sim.linear sim.physics sim.response models.roads sim.runs synth.problem "
    "synth.words",
    "sim.recording": "models.figures sim.acting sim.linear sim.physics sim.response models.roads sim.runs",
    "sim.command": "models.roads sim.recording sim.runs",
    "sim.asked": "models.figures models.formats models.loads sim.command sim.frequency sim.response models.roads sim.runs "
    "sim.stability sim.validity",
    "sim.inspect": "models.figures sim.asked sim.linear sim.physics sim.recording sim.response sim.ride models.roads sim.runs "
    "synth.designs synth.dynamic synth.problem synth.words",
    "sim.campaign": "models.figures sim.command sim.linear sim.physics sim.response sim.ride models.roads sim.runs "
    "synth.designer",
    "sim.report": "sim.acting sim.asked sim.command models.figures models.loads sim.frequency sim.linear sim.physics "
    "sim.response sim.ride models.roads sim.runs sim.stability sim.validity synth.designer synth.designs synth.errors "
    "synth.front synth.paper synth.words",
    "sim.bump": "models.figures sim.asked sim.command models.roads sim.runs synth.designer",
    "sim.drive": "models.figures sim.asked sim.command sim.ride sim.runs synth.designer",
    "sim.sweep": "sim.asked sim.command models.figures sim.frequency sim.linear sim.runs synth.designer",
    "sim.margins": "models.curves sim.asked sim.command models.figures sim.linear sim.runs sim.stability synth.designer",
    "sim.__main__": "",
    "sim.envelope": "sim.asked sim.command models.figures models.loads sim.response models.roads sim.runs "
    "sim.validity synth.designer",
}
OF_ALL = "models.common"
OF_SIM = {
    "models",
    "models.own",
    "models.damping",
    "synth.certificate",
    "synth.controller",
    "synth.implemented",
    "synth.sampled",
}  # what all of sim may import
MOST_FLOORS = 8  # of rooms in sim, each standing on those below
MOST_FILES = 16  # in a room, beside its __init__
MOST_LINES = 300
LONG: dict[str, str] = {  # files with more lines, and why
    "synth.lmi.central": "one path, from its start to its rests, is one walk",
}

# Who may import what is heavy, or replaceable.
OWNERS = {
    "cvxpy": {
        "synth/energy/lmi.py",
        "synth/lmi/clarabel.py",
        "synth/band/witness.py",
        "synth/family/lmi.py",
        "synth/tolerance/banded.py",
    },
    "tomllib": {"models/common/toml.py"},
    "mujoco": {
        "models/mjcf.py",
        "models/curves/actuators.py",
        "models/damping/mjcf.py",
        "sim/physics/readout.py",
        "sim/physics/blocks.py",
        "sim/physics/stepping.py",
        "sim/physics/energy.py",
        "sim/physics/geometry.py",
        "sim/recording/drawing.py",
    },
    "mcap": {
        "sim/recording/mcap_writer.py",
        "sim/inspect/mcap_channels.py",
        "sim/inspect/mcap_reader.py",
        "sim/inspect/mcap_stream.py",
    },
    "zstandard": {"sim/inspect/mcap_stream.py"},
    "lz4": {"sim/inspect/mcap_stream.py"},
    "mcap_protobuf": {"sim/recording/mcap_writer.py"},
    "google": {"sim/recording/mcap_writer.py", "sim/inspect/log.py", "sim/recording/foxglove_scene.py"},
    "foxglove_schemas_protobuf": {"sim/recording/foxglove_scene.py"},
    "rerun": {
        "sim/recording/rerun_axes.py",
        "sim/recording/rerun_writer.py",
        "sim/recording/rerun_signals.py",
        "sim/recording/rerun_scene.py",
        "sim/recording/rerun_layout.py",
    },
    "control": {"sim/response/export.py", "synth/state_space.py"},
    "pandas": {"sim/response/export.py"},
    "matplotlib": {"models/figures/picture.py"},
    "contourpy": {"models/figures/figure.py", "models/figures/page.py"},
    "jinja2": {"models/figures/page.py"},
    "pyopencrg": {"models/roads/opencrg.py"},
    "cloudpickle": {"sim/campaign/aside.py"},
    "filelock": {"sim/campaign/manifest.py"},
    "pyarrow": {"sim/campaign/store.py", "sim/campaign/verify.py"},
    "ray": {"sim/campaign/workers.py"},
}


def imported(path: Path) -> Iterator[str]:
    """Every module that a file imports, anywhere in it, with what it takes from it behind a dot."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def module_of(name: str) -> str | None:
    """The module of ours that a name is, or lies in."""
    while name and name not in MODULES:
        name = name.rpartition(".")[0]
    return name or None


def room_of(module: str) -> str:
    """The room of a module: its folder below the floor, or itself; in models all files but the common ones are one room."""
    floor, _, rest = module.partition(".")
    path = MODULES[module]
    if path.parent != ROOT / floor:
        return f"{floor}.{path.parent.relative_to(ROOT / floor).parts[0]}"
    return module if floor != "models" and rest else floor


def arrows() -> dict[str, set[str]]:
    """The rooms that each room imports."""
    found: dict[str, set[str]] = {room_of(module): set() for module in MODULES}
    for module, path in MODULES.items():
        for name in imported(path):
            other = module_of(name)
            if other and room_of(other) != room_of(module):
                found[room_of(module)].add(room_of(other))
    return found


def allowed(room: str) -> set[str]:
    """What a room may import."""
    own = {OF_ALL} - {room} | (OF_SIM if room.startswith("sim") else set())
    return own | set(ROOMS[room].split())


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_imports(path):
    """A file imports no room that its row does not name, and no package that belongs to another file."""
    own, room = path.relative_to(ROOT).as_posix(), room_of(NAMES[path])
    for name in imported(path):
        other = module_of(name)
        assert other is None or room_of(other) == room or room_of(other) in allowed(room), f"{own} imports {name}"
        assert own in OWNERS.get(name.split(".")[0], {own}), f"{name} is not for {own}"


def test_no_hidden_arrow():
    """No file imports by a name that it makes up as it runs, but the door to kinds of vehicle, within their own room."""
    hidden = set()
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            called = node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
            if called in ("import_module", "__import__", "spec_from_file_location", "run_module", "run_path"):
                hidden.add(NAMES[path])
    assert hidden == {"models.kinds"}


def test_doors_for_code():
    """Text becomes code only of kinds of vehicle and laws of the user's own; `interrupt` runs an empty one."""
    doors = set()
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("exec", "eval", "compile"):
                doors.add(NAMES[path])
    assert doors == {"models.own.code", "models.own_kind", "models.own.running", "models.common.interrupt"}


def test_every_command_that_records_is_known_to_inspect():
    """A log can be held against the line of every command that writes one."""
    assert set(COMMANDS) == set(RESULTS)


def test_the_table_is_the_house():
    """The table names the rooms that there are, each with what it imports and nothing in vain, and only rooms above its row."""
    found = arrows()
    assert set(found) == set(ROOMS)
    rows = list(ROOMS)
    for room, names in ROOMS.items():
        assert all(rows.index(name) < rows.index(room) for name in allowed(room)), room
        assert set(names.split()) <= found[room], f"{room} has in its row what it does not import"


def test_no_circle():
    """No file imports itself by way of others, not even where it is used."""
    graph = {module: {module_of(name) for name in imported(path)} - {None, module} for module, path in MODULES.items()}
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError


def test_floors():
    """The rooms of sim stand on few floors."""
    found, floors = arrows(), {}
    for room in graphlib.TopologicalSorter(found).static_order():
        floors[room] = 1 + max((floors[other] for other in found[room] if other.startswith("sim")), default=0)
    assert max(floors[room] for room in floors if room.startswith("sim")) <= MOST_FLOORS


def test_sizes():
    """No room holds more files than one overlooks, and no file more lines than one reads, without a reason."""
    for folder in {path.parent for path in FILES}:
        assert len([path for path in folder.glob("*.py") if path.name != "__init__.py"]) <= MOST_FILES
    long = {name for path, name in NAMES.items() if len(path.read_text(encoding="utf-8").splitlines()) > MOST_LINES}
    assert long == set(LONG)


def test_checked_without_the_solver():
    """What certifies, checks and inspects imports nothing, by whatever way, that could solve or search for a gain."""
    ways, seen = ["synth.controller", "sim.inspect.__main__", *(m for m in MODULES if m.startswith("synth.certificate."))], set()
    while ways:
        module = ways.pop()
        if module not in seen:
            seen.add(module)
            ways += [other for name in imported(MODULES[module]) if (other := module_of(name))]
    assert not {module for module in seen if room_of(module) in ("synth.lmi", "synth.search", "synth.design", "synth.designer")}


@pytest.mark.parametrize(
    "command", ["synth --json", "sim.bump --controller I --no-logs --json", "sim.sweep --help", "sim.report --help"]
)
def test_a_command_pays_for_what_it_does(command):
    """No command waits for a package that it has no use for; each of these takes a third of a second to two seconds to import."""
    code = (
        f"import atexit, runpy, sys; sys.argv = {command.split()}; atexit.register(lambda: print('\\nloaded', *sys.modules)); "
        "runpy.run_module(sys.argv[0], run_name='__main__', alter_sys=True)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(run.stdout.rsplit("\nloaded ", 1)[1].split())
    assert "argparse" in loaded
    assert not {"scipy.signal", "scipy.stats", "cvxpy", "control", "matplotlib", "rerun", "pandas", "pyarrow"} & loaded
