"""The house: imports point one way, from room to room as the table says, and each heavy package is known to one file."""

import ast
import graphlib
import importlib
import inspect
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

import models
import sim
import synth
from models.common.extensions import FEATURES
from tests.house import ceilings
from tests.house.prose import Finding
from tests.support.commands import ROOT
from tests.support.sources import Source, sources

FILES = sorted(
    path for floor in ("models", "synth", "sim") for path in (ROOT / floor).rglob("*.py") if "gallery" not in path.parts[:-2]
)
NAMES = {path: ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for path in FILES}
MODULES = {name: path for path, name in NAMES.items()}

DRIVE = "sim.drive.__main__"  # the command of this name, above the loop in the same folder
# A room is a folder or a file right below its package, whose own `__init__` and `__main__` are its doors and no rooms. A row
# names every other room that its room imports, all of them in rows above its own, so that there can be no circle.
ROOMS = {
    # models: what a vehicle is
    "models.common": "",
    "models": "",
    "models.document": "",
    "models.laws": "",
    "models.characteristics": "",
    "models.kinds": "models.laws",
    "models.parts": "models.characteristics models.kinds",
    "models.full_car": "models.kinds",
    "models.half_car": "models.kinds",
    "models.half_car_roll": "models.kinds",
    "models.quarter_car": "models.kinds",
    "models.vehicle": "models.document models.laws models.characteristics models.kinds models.parts",
    "models.roads": "models.kinds models.vehicle",
    # synth: what a controller is; of vehicles it knows nothing below `controller`
    "synth": "",
    "synth.plant": "models.laws",
    "synth.analysis": "models.document models.laws synth.plant",
    "synth.controller": "models models.document models.laws models.characteristics models.kinds models.vehicle synth.plant "
    "synth.analysis",
    "synth.lmi": "synth.plant synth.analysis",
    "synth.design": "models.document models.laws synth.plant synth.analysis synth.lmi",
    "synth.vehicle": "models.document models.laws models.kinds models.vehicle models.roads synth.plant synth.analysis "
    "synth.controller synth.lmi synth.design",
    "synth.command": "models.document models.laws models.vehicle synth.plant synth.analysis synth.controller synth.lmi "
    "synth.design synth.vehicle",
    "synth.__main__": "models.laws models.vehicle synth.command",
    # sim: what a run is
    "sim": "",
    "sim.drive": "models.document models.laws models.characteristics models.kinds models.parts models.vehicle models.roads "
    "synth.controller",
    "sim.linear": "models.laws models.kinds models.parts models.vehicle models.roads synth.plant synth.controller sim.drive",
    "sim.observers": "models.document models.laws models.kinds models.parts models.vehicle models.roads synth.controller "
    "sim.drive sim.linear",
    "sim.runs": "models models.document models.laws models.characteristics models.kinds models.parts models.vehicle "
    "models.roads synth.controller synth.vehicle sim.drive sim.linear sim.observers",
    "sim.recording": "models.document models.kinds models.vehicle models.roads synth.controller sim.drive sim.observers sim.runs",
    "sim.studies": "models models.document models.laws models.characteristics models.kinds models.parts models.vehicle "
    "models.roads synth.plant synth.analysis synth.controller synth.design synth.vehicle synth.command sim.drive sim.linear "
    "sim.observers sim.runs",
    "sim.command": "models models.document models.vehicle models.roads synth.controller synth.vehicle sim.drive sim.runs "
    "sim.recording sim.studies",
    "sim.bump": "models.vehicle models.roads sim.command",
    "sim.campaign": "models.document models.laws models.kinds models.vehicle models.roads synth.plant "
    "synth.controller synth.vehicle sim.drive sim.observers sim.runs sim.studies sim.command",
    DRIVE: "models.vehicle sim.command",
    "sim.envelope": "sim.command",
    "sim.gallery": "sim.command",
    "sim.identify": "sim.command",
    "sim.inspect": "models.document models.laws models.kinds models.vehicle models.roads synth.analysis synth.controller "
    "sim.drive sim.linear sim.observers sim.runs sim.recording sim.studies",
    "sim.margins": "sim.command",
    "sim.new": "models.vehicle",
    "sim.report": "models.document models.laws models.vehicle models.roads synth.analysis "
    "synth.controller synth.vehicle synth.command sim.drive sim.linear sim.observers sim.runs sim.studies sim.command",
    "sim.sweep": "sim.command",
    "sim.__main__": "sim.studies sim.command",
}
OF_ALL = "models.common"
# Ceilings of each package: its folders, on how many floors these stand, each on those below, and the arrows from one to another.
# A command or a kind of vehicle that is one file is no folder, and adds to none of them.
MOST_ROOMS = {"models": 8, "synth": 7, "sim": 10}
MOST_FLOORS = {"models": 6, "synth": 6, "sim": 7}
MOST_ARROWS = {"models": 17, "synth": 19, "sim": 36}
MOST_FILES = 16  # in a folder, beside its __init__: as many as one overlooks

# What certifies, checks and inspects reaches these rooms and files, by whatever way, and no other: none designs a controller.
REACHES = {
    "synth.analysis": "models.common models.document models.laws synth.plant",
    "synth.controller": "models.common models.characteristics models.document models.kinds models.laws models.parts "
    "models.vehicle synth.analysis synth.plant",
    "sim.inspect": "models.common models.characteristics models.document models.kinds models.laws models.roads models.parts "
    "models.vehicle synth.analysis synth.controller synth.plant sim.drive sim.linear sim.observers sim.recording sim.runs "
    "sim.studies",
}

# The core: the paper's two steps with their certificate, three cars, bump and random roads, one loop in MuJoCo, comparison and
# logs. It imports itself alone, and knows all else by its name in `models.common.extensions`.
CORE = {  # package -> its modules that are core
    "models.common": "arrays checks cli command errors extensions files lazy printed schema threads units",
    "models.document": "document field outputs text",
    "models": "full_car half_car quarter_car",
    "models.kinds": "at_wheels car kind linear_model links rigid_body rigid_motion signals strut_and_tyre",
    "models.laws": "design_methods design_request iso2631 law linear",
    "models.parts": "part",
    "models.parts.stops": "section",
    "models.roads": "iso8608 road spectrum",
    "models.vehicle": "controllers limits_and_implementation mjcf names performance suspension_forces vehicle",
    "sim": "bump",
    "sim.command": "comparison driven driven_lines driving road_options",
    "sim.drive": "actuators case computer drive driver jumps loop recursion regime response sensor_readout",
    "sim.drive.drivers": "linear registry",
    "sim.linear": "outputs prediction rounding sampled_response",
    "sim.observers": "recorder results",
    "sim.recording": "files mcap_writer run_log run_records scene",
    "sim.runs": "agreement record report result run",
    "sim.studies.ride.kinds": "standard",
    "sim.studies.ride": "metrics score_table scores weighting",
    "synth.analysis": "certificate norm rigorous specification stability",
    "synth.controller": "controller disk_margin law_margins loop_of problem report",
    "synth.design": "methods problem two_step",
    "synth.lmi": "barrier central_path output_nulling unknowns",
    "synth.plant": "double_double generalized loop numerics state_space units",
    "synth.vehicle": "design_problem designer",
}
MOST_CORE = 14_410  # lines of code of the core, without docstrings, comments and blank lines

# Who may import what is heavy, or replaceable.
OWNERS = {
    "cvxpy": {"synth/lmi/sdp.py"},
    "tomllib": {"models/common/files.py"},
    "tomlkit": {"models/common/toml_edit.py"},
    "mujoco": {
        "models/vehicle/mjcf.py",
        "models/parts/native.py",
        "sim/drive/sensor_readout.py",
        "sim/drive/loop.py",
        "sim/drive/part_steps.py",
        "sim/observers/energy.py",
        "sim/recording/scene.py",
    },
    "mcap": {
        "sim/recording/mcap_writer.py",
        "sim/recording/foxglove_scene.py",
        "sim/inspect/log.py",
        "models/common/logs/recordings.py",
    },
    "mcap_protobuf": {"sim/recording/foxglove_scene.py"},
    "google": {"sim/recording/mcap_writer.py", "sim/inspect/log.py", "sim/recording/foxglove_scene.py"},
    "foxglove_schemas_protobuf": {"sim/recording/foxglove_scene.py"},
    "rerun": {"sim/recording/rerun_writer.py", "sim/recording/rerun_contents.py"},
    "control": {"sim/drive/response.py", "synth/vehicle/state_space.py"},
    "pandas": {"sim/drive/response.py"},
    "matplotlib": {"models/document/picture.py"},
    "jinja2": {"models/document/page.py"},
    "python_calamine": {"models/common/table.py"},
    "asammdf": {"models/common/logs/recordings.py"},
    "pyopencrg": {"models/roads/opencrg.py"},
    "cloudpickle": {"models/kinds/kind.py", "models/laws/python_runtime.py"},
    "filelock": {"sim/campaign/manifest.py"},
    "pyarrow": {
        "models/common/table.py",
        "sim/campaign/columns.py",
        "sim/campaign/store.py",
        "sim/campaign/verify.py",
        "sim/recording/rerun_contents.py",
    },
    "ray": {"sim/campaign/workers.py"},
}


def imported(path: Path) -> tuple[str, ...]:
    """Every module that a file imports, see `tests.support.sources.Source`."""
    return sources()[path.relative_to(ROOT).as_posix()].imported


def module_of(name: str) -> str | None:
    """The module of ours that a name is, or lies in."""
    while name and name not in MODULES:
        name = name.rpartition(".")[0]
    return name or None


def room_of(module: str) -> str:
    """The room of a module: what it is, or lies in, right below its package; of a door the door itself."""
    return module if module == DRIVE else ".".join(module.split(".")[:2])


def is_door(room: str) -> bool:
    """Returns True if a room is none, but the `__init__` or `__main__` of a package."""
    return "." not in room or room.endswith(".__main__")


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
    """Returns what a room may import."""
    return {OF_ALL} - {room} | set(ROOMS.get(room, "").split())


def wrong_imports(code: Mapping[str, Source]) -> Iterator[Finding]:
    """Yields a finding for each import of a room that the row does not name, and of a package that belongs to another file."""
    for own, source in code.items():
        room = room_of(own.removesuffix(".py").removesuffix("/__init__").replace("/", "."))
        if own.startswith("models/gallery/"):  # types of vehicle as a user writes them
            continue
        if room not in ROOMS:
            yield Finding(own, f"{room} has no row", "add a row to ROOMS in test_architecture.py")
        for name in source.imported:
            other, owners = module_of(name), OWNERS.get(name.split(".")[0], {own})
            if other is not None and room_of(other) != room and room_of(other) not in allowed(room):
                yield Finding(own, f"{room} imports {name}", "move one of both, or extend ROOMS in test_architecture.py")
            if own not in owners:
                yield Finding(own, f"imports {name}", f"call {min(owners)}, or extend OWNERS in test_architecture.py")


def test_imports():
    """A file imports no room that its row does not name, and no package that belongs to another file."""
    wrong = [*wrong_imports(sources())]
    assert not wrong, "\n".join(map(str, wrong))


def test_no_hidden_arrow():
    """No file imports by a name that it makes up as it runs, but the doors to kinds, public names and commands of our own."""
    by_name = {"import_module", "__import__", "spec_from_file_location", "run_module", "run_path"}
    hidden = {NAMES[path] for path in FILES if by_name & sources()[path.relative_to(ROOT).as_posix()].names}
    doors = {"models.vehicle.vehicle", "models.common.lazy", "models.common.cli"}
    assert hidden == doors


def test_public_names_are_for_others():
    """Inside nobody imports what a package has for those outside, but from where it lies: else circles hide."""
    public = {f"{package.__name__}.{name}" for package in (models, synth, sim) for name in package.__all__} - set(MODULES)
    assert not {f"{NAMES[path]} imports {name}" for path in FILES for name in imported(path) if name in public}


def test_doors_for_code():
    """Text becomes code only of kinds of vehicle and laws of the user's own; that of `cli` is empty."""
    doors = {NAMES[path] for path in FILES if sources()[path.relative_to(ROOT).as_posix()].runs_text}
    assert doors - {"models.common.cli"} == {"models.laws.user_code", "models.kinds.user_kind", "models.laws.python_runtime"}


def test_the_table_is_the_house():
    """The table names the rooms that there are, each with what it imports and nothing in vain, and only rooms above its row."""
    found = arrows()
    assert set(found) == set(ROOMS)
    rows = list(ROOMS)
    for room, names in ROOMS.items():
        assert all(rows.index(name) < rows.index(room) for name in allowed(room)), room
        assert set(names.split()) <= found[room], f"{room} has in its row what it does not import"


def test_a_plant_carries_its_measurements():
    """Outside the public names no function takes a plant and its measurement matrices as separate arguments."""
    public = {inspect.unwrap(getattr(one, name)) for one in (models, synth, sim) for name in one.__all__}
    apart = set()
    for name in MODULES:
        module = importlib.import_module(name) if name.startswith(("synth.", "sim.")) and "__main__" not in name else models
        own = [one for one in vars(module).values() if getattr(one, "__module__", "") == name]
        classes = [one for one in own if inspect.isclass(one) and one not in public]
        functions = [*own, *(getattr(method, "__func__", method) for one in classes for method in vars(one).values())]
        for function in map(inspect.unwrap, functions):
            if inspect.isfunction(function) and function not in public:
                given = inspect.signature(function).parameters
                a_plant = "plant" in given or any("Plant" in str(one.annotation) for one in given.values())
                if a_plant and given.keys() & {"Cy", "Dyw", "Dyu", "through", "feedthrough"}:
                    apart.add(f"{name}.{function.__qualname__}")
    assert apart == set()


SYSTEMS = {"LinearModel", "LinearLaw", "Plant", "StateSpace"}  # `Loop` and `SampledLoop` hold a plant and a law
OTHERS = {
    "ControllerSection",  # keys of a file
    "RoadPreview",  # what a road ahead does
}


def test_linear_systems_are_of_four_classes():
    """Matrices A and B, or B_w, of a linear system are fields of four classes, and of no other but those that are named here."""
    fields = re.compile(r"^    (A|Bw?): ", re.M)
    texts = [text for path in FILES for text in re.split(r"^class ", path.read_text(encoding="utf-8"), flags=re.M)[1:]]
    found = {re.split(r"\W", text, maxsplit=1)[0] for text in texts if len({*fields.findall(text)}) > 1}
    assert found == SYSTEMS | OTHERS


def test_controllers_answer_for_themselves():
    """Only `sim.run`, which takes anything, asks if it was given a controller; nowhere else the class of one is asked."""
    asks = re.compile(r"isinstance\((?:[^()]|\([^()]*\))*\b(?:AnyController|Controller|ControlLaw|Programmed|SemiActive)\b")
    assert {NAMES[path] for path in FILES if asks.search(path.read_text(encoding="utf-8"))} == {"sim.runs.by_name"}


def test_no_circle():
    """No file imports itself by way of others, not even where it is used."""
    graph = {module: {module_of(name) for name in imported(path)} - {None, module} for module, path in MODULES.items()}
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError


@pytest.mark.parametrize("package", MOST_ROOMS)
def test_few_rooms(package):
    """A package has few rooms, on few floors, with few arrows between them."""
    inner = {
        room: {other for other in others if other.startswith(f"{package}.")}
        for room, others in arrows().items()
        if room.startswith(f"{package}.") and (ROOT / room.replace(".", "/")).is_dir()
    }
    inner = {room: others & set(inner) for room, others in inner.items()}
    floors: dict[str, int] = {}
    for room in graphlib.TopologicalSorter(inner).static_order():
        floors[room] = 1 + max((floors[other] for other in inner[room]), default=0)
    assert len(inner) <= MOST_ROOMS[package]
    assert max(floors.values()) <= MOST_FLOORS[package]
    assert sum(map(len, inner.values())) <= MOST_ARROWS[package]


def core_modules() -> set[str]:
    """Returns the modules of the core."""
    return {f"{package}.{name}" for package, names in CORE.items() for name in names.split()}


def features_of(path: Path) -> list[str]:
    """Returns the names of the features that a file loads."""
    return re.findall(r'FEATURES\.load(?:_if_known)?\("([^"]+)"\)', path.read_text(encoding="utf-8"))


def imported_as_it_runs(path: Path) -> set[str]:
    """Returns the modules of ours that a file imports at its top or in a function, without what only type checkers see."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes, found = [tree], set[str]()
    while nodes:
        node = nodes.pop()
        within = [one for name in ("body", "orelse", "handlers", "finalbody", "cases") for one in getattr(node, name, ())]
        nodes += [one for one in within if not (isinstance(one, ast.If) and "TYPE_CHECKING" in ast.dump(one.test))]
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{one.name}" for one in node.names}
        elif isinstance(node, ast.Import):
            found |= {one.name for one in node.names}
    return {module for name in found if (module := module_of(name))}


def test_the_core_imports_itself_alone():
    """No module of the core imports an extension, at its top or where it is used, and the core has no more lines than allowed."""
    core = core_modules()
    knots = {
        (module, other)
        for module in core
        for other in imported_as_it_runs(MODULES[module]) - core
        if MODULES[other].name != "__init__.py"
    }
    assert not knots, "name these in EXTENSIONS, and load them by their names"
    assert sum(sources()[MODULES[module].relative_to(ROOT).as_posix()].code_lines for module in core) <= MOST_CORE


def test_features_have_rows():
    """Each feature that a module loads is in the table, and each one in the table is loaded by some module."""
    assert {name for path in FILES for name in features_of(path)} == {*FEATURES}


def test_few_files():
    """No folder holds more files than one overlooks."""
    for folder in {path.parent for path in FILES}:
        assert len([path for path in folder.glob("*.py") if path.name != "__init__.py"]) <= MOST_FILES


def test_every_file_is_of_one_capability():
    """Each file of code or text is in one row of the table of ceilings, and each glob of the table finds a file."""
    files, rows = ceilings.counted(), ceilings.rows()
    places = {name: [row.capability for row in rows if row.has(name)] for name in files}
    assert not [name for name, found in places.items() if not found], "add these to a row of tests/house/ceilings.py"
    assert not {name: found for name, found in places.items() if len(found) > 1}, "leave these in one row of ceilings.py"
    globs = {glob: re.compile(ceilings.expression(glob)) for row in rows for glob in row.globs}
    idle = [glob for glob, expression in globs.items() if not any(map(expression.fullmatch, files))]
    assert not idle, "these match no file; take them out of tests/house/ceilings.py"


def test_ceilings():
    """No capability has more lines than its row allows."""
    files = ceilings.counted()
    above = {row.capability: found for row in ceilings.rows() if (found := row.too_many(files))}
    assert not above, "new work fits into its capability's lines, or takes something away there; see tests/house/ceilings.py"


@pytest.mark.parametrize("start", REACHES)
def test_checked_without_the_solver(start):
    """Certifying, checking and inspecting reach only what its row allows, and no file that could call a solver."""
    ways, seen = [module for module in MODULES if f"{module}.".startswith(f"{start}.")], set()
    while ways:
        module = ways.pop()
        if module not in seen:
            seen.add(module)
            ways += [other for name in imported(MODULES[module]) if (other := module_of(name))]
            ways += [FEATURES[name] for name in features_of(MODULES[module])]
    rooms = {start, *REACHES[start].split()}
    assert not {module for module in seen if not ({module, room_of(module)} & rooms or is_door(room_of(module)))}
    assert not {module for module in seen if MODULES[module].relative_to(ROOT).as_posix() in OWNERS["cvxpy"]}
