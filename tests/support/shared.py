"""Objects that take long to make and several tests need, made once in a session and shared by its workers: found on disk, by
content.

    def test_peak(paper):
        assert designed(paper, "I").certificate.bound < 7.9
        (run,) = ran(paper, "I", road=Bump(height=0.05), duration=1.0)
        assert run.passed

    def test_screen():
        done = printed("sim.bump", "--vehicle", "car.toml", "--logs", "logs", files={"car.toml": TEXT})
        assert (done.code, done.err) == (0, "")
        assert {path.suffix for path in (done.folder / "logs").iterdir()} == {".mcap", ".json", ".rrd"}

The designs themselves are `made`, whoever asks for them: see `share_designs`.

`made(function, *arguments)` is of any function. Everybody gets a copy of their own, so that no test changes another's; but the
`folder` of a command is one for all: copy what is to be changed. What is made must follow from the arguments alone: a test that
patches the product makes it itself. What raises is not kept.
"""

import functools
import hashlib
import importlib
import inspect
import io
import json
import marshal
import pickle
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, TypeVar

import cloudpickle
import numpy as np
import pytest
from filelock import FileLock

from models.common.errors import InputError
from models.kinds.kind import HERE, VehicleKind
from models.roads.road import Bump, Road
from models.vehicle import vehicle
from models.vehicle.vehicle import Vehicle
from sim.runs.run import Run, run_controllers, sample_times
from synth.analysis.certificate import LaterBound
from synth.controller.controller import Controller
from synth.vehicle.designer import Designer
from tests.support.commands import main_of

T = TypeVar("T")
_folders: list[Path] = []  # the session's, once it has begun
_patching: set[int] = set()  # patches of the product that are in force
_originals: dict[str, Callable] = {}  # of `DESIGNS`
_kinds: dict[int, tuple[VehicleKind, str]] = {}  # of this process: each kept alive, so that its number is of no other
_designers: dict[Path, Designer] = {}  # of this process: the designs of one vehicle share steps


def keep_in(folder: Path) -> None:
    """Says where this session keeps what it has made: a folder that its workers share, and no other session has."""
    _folders[:] = [folder]
    folder.mkdir(exist_ok=True)


def made(make: Callable[..., T], *arguments: Any) -> T:
    """Returns what a function makes of these arguments, made once in a session; outside a session, made at each call."""
    if not _folders:
        return make(*arguments)
    file = _place(make, *arguments).with_suffix(".pickle")
    if not file.exists():
        with FileLock(file.with_suffix(".lock")):
            if not file.exists():
                whole = file.with_suffix(".begun")
                whole.write_bytes(_written(make(*arguments), make, arguments))
                whole.rename(file)
    reader = pickle.Unpickler(io.BytesIO(file.read_bytes()))
    reader.persistent_load = lambda _: _bound_in(make, arguments)
    return reader.load()


class _SharedBound(LaterBound):
    """The lower bound of a controller's section, proved once in a session, and only if it is read."""

    def __init__(self, vehicle: Vehicle, search: bool, name: str) -> None:
        super().__init__(lambda: made(_bound_of, vehicle, search, name))
        self._of = vehicle, search, name


def _bound_in(make: Callable[..., Any], arguments: tuple[Any, ...]) -> LaterBound | None:
    """Returns the bound that is proved later, of what a function makes; None if it makes it of no such bound."""
    if make is _design_of:
        return _SharedBound(*arguments)
    return next((one for one in arguments if isinstance(one, LaterBound)), None)


class _Lazily(cloudpickle.Pickler):
    """Writes what is made, without the proof of a lower bound that nobody has read yet: it takes longer than most designs."""

    known = False  # True if who reads has the bound that is proved later

    def persistent_id(self, obj: Any) -> str | None:
        return "bound" if self.known and type(obj) is LaterBound and "_proved" not in vars(obj) else None

    def reducer_override(self, obj: Any) -> Any:
        if type(obj) is _SharedBound and "_proved" not in vars(obj):
            return _SharedBound, obj._of
        return super().reducer_override(obj)


def _written(thing: Any, make: Callable[..., Any], arguments: tuple[Any, ...]) -> bytes:
    """Returns what is made as bytes."""
    content = io.BytesIO()
    pickler = _Lazily(content, protocol=5)  # 5 keeps arrays read-only
    pickler.known = _bound_in(make, arguments) is not None
    pickler.dump(thing)
    return content.getvalue()


def designed(vehicle: Vehicle, name: str) -> Controller:
    """Returns a controller as `Designer.design` makes it."""
    return made(_designed, vehicle, name)


def ran(vehicle: Vehicle, *names: str, road: Road | None = None, duration: float = 3.0, timestep: float = 1e-3) -> list[Run]:
    """Returns the runs of some controllers over a road, by default the paper's bump, as `run_controllers` makes them."""
    return made(_ran, vehicle, names, road or Bump(), duration, timestep)


@dataclass(frozen=True)
class Printed:
    """The result of a command: its exit code, what it wrote to stdout and stderr, and the folder that it ran in, for reading."""

    code: int
    out: str
    err: str
    folder: Path

    @cached_property
    def json(self) -> Any:
        """Returns what it printed with `--json`."""
        return json.loads(self.out)


def printed(command: str, *arguments: str, files: Mapping[str, str] | None = None) -> Printed:
    """Returns what a command prints and writes, run by its `main` in a folder of its own that has these files, by name."""
    return made(_printed, command, arguments, dict(files or {}))


def _designed(vehicle: Vehicle, name: str) -> Controller:
    return Designer(vehicle).design(name)


def _ran(vehicle: Vehicle, names: tuple[str, ...], road: Road, duration: float, timestep: float) -> list[Run]:
    controllers = [designed(vehicle, name) for name in names]
    return run_controllers(vehicle, controllers, road, sample_times(vehicle, duration, timestep))


def _printed(command: str, arguments: tuple[str, ...], files: dict[str, str]) -> Printed:
    folder = _place(_printed, command, arguments, files)
    shutil.rmtree(folder, ignore_errors=True)  # of one that has raised
    folder.mkdir()
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8", newline="\n")
    with chdir(folder), redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
        code = main_of(command)(list(arguments))
    return Printed(code, out.getvalue(), err.getvalue(), folder)


DESIGNS = (  # functions of their arguments alone, which take long
    "synth.lmi.central_path.central_path",
    "synth.lmi.full_order_bound.bound_beyond_control",
    "synth.lmi.full_order_bound.find_lower_bound",
    "synth.lmi.sampled_bound.find_sampled_bound",
    "synth.design.two_step.two_step_design",
    "synth.design.static.static_output_feedback",
    "synth.design.full_order.full_order.full_order_design",
    "synth.design.uncertainty.fragility.fragility",
    "synth.design.descent.flatness.free_moves",
    "synth.analysis.certificate.certify",
    "synth.analysis.sampled_norm.sampled_norm",
)

# These import designs, and not the other way round.
BEYOND_DESIGNS = ("sim.", "synth.command.", "synth.vehicle.sample_rate.", "synth.vehicle.trade_off.")


def share(patch: pytest.MonkeyPatch, home: ModuleType, *names: str) -> None:
    """Has functions of a module, which must follow from their arguments alone, made once in a session while a patch lasts."""
    for name in names:
        patch.setattr(home, name, functools.partial(made, getattr(home, name)))


def share_designs() -> None:
    """Has every design made once in a session, before anything of the product takes the functions that make them.

    A test that patches the product makes its designs itself: see `making_designs_anew`.
    """
    for path in DESIGNS:
        module, _, name = path.rpartition(".")
        home = importlib.import_module(module)
        original = _originals[path] = getattr(home, name)
        shared = _sharing(path, original)
        for other in list(sys.modules.values()):
            if getattr(other, name, None) is original:
                setattr(other, name, shared)
    _originals["design"] = Designer.design
    Designer.design = functools.wraps(Designer.design)(_design)  # pyright: ignore[reportAttributeAccessIssue] - names of arguments


def share_vehicles() -> None:
    """Has every vehicle that ships read once in a process: it is frozen, and keeps its linear model."""
    original, ships = vehicle.read_vehicle, frozenset(vehicle.shipped_vehicles())
    once = functools.cache(original)

    @functools.wraps(original)
    def read(file: str | Path) -> Vehicle:
        known = isinstance(file, str) and file in ships and not _patching and not Path(file).is_file()
        return (once if known else original)(file)

    for other in list(sys.modules.values()):
        if getattr(other, "__dict__", {}).get("read_vehicle") is original:
            vars(other)["read_vehicle"] = read


def _design(designer: Designer, name: str, *arguments: Any, **named: Any) -> Controller:
    """As `Designer.design`; of a kind that ships the controller is made once, whichever file has its vehicle."""
    vehicle = designer.vehicle
    if _folders and not _patching and not arguments and not named and vehicle.kind.mjcf.parent == HERE:
        with suppress(InputError):  # which names the file
            return made(_design_of, replace(vehicle, source="", text="", named_files=()), designer.search, name)
    return _originals["design"](designer, name, *arguments, **named)


def _design_of(vehicle: Vehicle, search: bool, name: str) -> Controller:
    designer = _designers.setdefault(_place(Designer, vehicle, search), Designer(vehicle, search))
    return _originals["design"](designer, name)


def _bound_of(vehicle: Vehicle, search: bool, name: str) -> Any:
    designer = _designers.setdefault(_place(Designer, vehicle, search), Designer(vehicle, search))
    entry = designer.entry(name)
    return designer.lower_bound(entry.measured, entry.hardware)


def _anew(path: str, *arguments: Any) -> Any:
    return _originals[path](*arguments)


def _sharing(path: str, original: Callable[..., T]) -> Callable[..., T]:
    signature = inspect.signature(original)

    @functools.wraps(original)
    def shared(*arguments: Any, **named: Any) -> T:
        if not _folders or _patching:
            return original(*arguments, **named)
        bound = signature.bind(*arguments, **named)
        bound.apply_defaults()
        return made(_anew, path, *bound.arguments.values())

    return shared


@contextmanager
def nothing_shared() -> Iterator[None]:
    """Within it every design is made anew."""
    _patching.add(0)
    yield
    _patching.discard(0)


@contextmanager
def making_designs_anew(patch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """From the first `setattr` of a patch on designs are not shared, but where it patches what no design imports."""
    plain = patch.setattr

    def setattr(target: Any, *arguments: Any, **named: Any) -> None:
        module = target if isinstance(target, str) else getattr(target, "__module__", None) or getattr(target, "__name__", "")
        if not module.startswith(BEYOND_DESIGNS):
            _patching.add(id(patch))
        plain(target, *arguments, **named)

    patch.setattr = setattr
    yield patch
    _patching.discard(id(patch))


class _Content(cloudpickle.Pickler):
    """Writes what things are, not how they came to be: dataclasses by fields, not by what they cache, and functions by code."""

    def reducer_override(self, obj: Any) -> Any:
        if type(obj) is np.ndarray and not obj.dtype.hasobject:  # most of what there is: cloudpickle takes five times as long
            return getattr, (obj.dtype.str, obj.shape, obj.flags.c_contiguous, obj.tobytes())
        if isinstance(obj, VehicleKind):
            return VehicleKind, (_of_kind(obj),)
        if isinstance(obj, LaterBound):  # the rest of its certificate says of what it is
            return LaterBound, ()
        if is_dataclass(obj) and not isinstance(obj, type):
            return type(obj), tuple(getattr(obj, one.name) for one in fields(obj))
        if isinstance(obj, FunctionType):
            closed = [cell.cell_contents for cell in obj.__closure__ or ()]
            return getattr, (obj.__module__, obj.__qualname__, marshal.dumps(obj.__code__, 2), obj.__defaults__, closed)
        return super().reducer_override(obj)


def _of_kind(kind: VehicleKind) -> str:
    """Returns a digest of the content of a kind of vehicle, which is most of a vehicle's; it is frozen, and written once."""
    if id(kind) not in _kinds:
        _kinds[id(kind)] = kind, _digest(tuple(getattr(kind, one.name) for one in fields(kind)))
    return _kinds[id(kind)][1]


def _digest(thing: Any) -> str:
    content = io.BytesIO()
    pickler = _Content(content, protocol=5)
    pickler.fast = True  # equal strings are written alike, one object or two
    pickler.dump(thing)
    return hashlib.sha256(content.getvalue()).hexdigest()


def _place(make: Callable, *arguments: Any) -> Path:
    """Returns where something is kept: the content of its function and arguments, under the session's folder."""
    return _folders[0] / _digest((make, arguments))
