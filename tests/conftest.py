"""Fixtures of several tests: the paper's vehicle, its designs, and vehicles drawn at random."""

import dataclasses
import gc
import signal
import zlib
from collections.abc import Iterator

import numpy as np
import pytest
from mcap.reader import make_reader

from models.common.errors import InputError
from models.roads.road import Bump
from models.vehicle.vehicle import Vehicle, read_vehicle
from sim.recording.run_log import RunLog
from sim.runs.run import run_controllers, sample_times
from synth.plant.generalized import GeneralizedPlant
from synth.vehicle.designer import Designer
from tests.support import shared
from tests.support.commands import without_attacks

shared.share_designs()
shared.share_vehicles()

# A shell without a terminal starts what is behind an `&` with Ctrl-C ignored, and every process of it inherits that: tests of
# interrupts would then wait for one that never comes.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# What a vehicle file may say beside its parameters.
BUILT = "\n[implementation]\nsample_period = 0.01\ndelay = {delay}\n"
LAGGED = "\n[limits]\nactuator_bandwidth = 60.0\n"

TEXTBOOK = {
    "sprung_mass": 300,
    "unsprung_mass": 60,
    "suspension_stiffness": 16000,
    "suspension_damping": 1000,
    "tyre_stiffness": 190000,
}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Adds the option with which CI runs a part of the attacks."""
    parser.addoption("--part", metavar="I/N", help="run part I of N of the selected tests, such as 2/5")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """With `--part`, a test belongs to the part that its name decides, so a part is the same on every machine."""
    if part := config.getoption("--part"):
        number, count = map(int, part.split("/"))
        every = [(item, zlib.crc32(item.nodeid.encode()) % count == number % count) for item in items]
        config.hook.pytest_deselected(items=[item for item, chosen in every if not chosen])
        items[:] = [item for item, chosen in every if chosen]


def pytest_configure(config: pytest.Config) -> None:
    """Cases of attacks are not made where the marks leave them out: they would be most of all cases."""
    if config.getoption("markexpr") == "not attack":
        without_attacks()


def pytest_collection_finish() -> None:
    """What has been imported stays: no later search for garbage looks through it."""
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _kept_while_the_session_lasts(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Workers share what `tests.support.shared` makes; sessions do not."""
    base = tmp_path_factory.getbasetemp()
    shared.keep_in((base.parent if hasattr(request.config, "workerinput") else base) / "shared")


@pytest.fixture
def monkeypatch(monkeypatch: pytest.MonkeyPatch) -> Iterator[pytest.MonkeyPatch]:
    """As pytest's own; designs are not shared while the product is patched."""
    with shared.making_designs_anew(monkeypatch) as patch:
        yield patch


@pytest.fixture(scope="session", autouse=True)
def _messages_are_whole() -> Iterator[None]:
    """Every complaint that any test meets is a sentence that ends: not in a comma, a colon, a space, nor of nothing."""
    plain, cut = InputError.__init__, []

    def checked(self: InputError, message: object = "") -> None:
        plain(self, message)
        if not str(self) or str(self)[-1] in ",: (":
            cut.append(str(self))

    InputError.__init__ = checked
    yield
    InputError.__init__ = plain
    assert not cut


@pytest.fixture(scope="session")
def paper() -> Vehicle:
    """The paper's quarter-car."""
    return read_vehicle("quarter_car")


@pytest.fixture(scope="session")
def textbook(paper) -> Vehicle:
    """A quarter-car with a damper as cars have it."""
    return dataclasses.replace(paper, parameters={name: float(value) for name, value in TEXTBOOK.items()})


@pytest.fixture(scope="session")
def designer(paper) -> Designer:
    """The designs of the paper's quarter-car."""
    return Designer(paper)


@pytest.fixture(scope="session")
def lifting(designer: Designer) -> RunLog:
    """A quarter-car with controller I over a bump that throws it off the road."""
    from sim.recording.run_records import run_log  # it imports Rerun, which most tests need not

    vehicle, road = designer.vehicle, Bump(height=0.2, speed=20.0)
    time = sample_times(vehicle, 0.5, 1e-3)
    return run_log(run_controllers(vehicle, [designer.design("I")], road, time)[0], "I")


def random_vehicles(vehicle: Vehicle, count: int, spread: float = 0.5) -> list[Vehicle]:
    """Vehicles of the same kind with every parameter that a file must give within +- `spread` of this one's."""
    rng, given = np.random.default_rng(20261120), {one.name for one in vehicle.kind.parameters if one.usual is None}
    return [
        dataclasses.replace(
            vehicle,
            parameters={
                name: value * rng.uniform(1 - spread, 1 + spread) if name in given else value
                for name, value in vehicle.parameters.items()
            },
        )
        for _ in range(count)
    ]


def recorded_runs(mcap: str) -> set[str]:
    """Names of the runs in a log."""
    with open(mcap, "rb") as stream:
        return {item.name.removeprefix("run/") for item in make_reader(stream).iter_metadata()} - {"roadproof"}


def plant_with_feedthrough(seed: int) -> GeneralizedPlant:
    """A random plant of five states, several inputs and disturbances, a D_w and, as a rule, an unstable A."""
    rng = np.random.default_rng(seed)
    n, m, r, d = 5, 2, 2, 4
    return GeneralizedPlant(
        A=rng.standard_normal((n, n)),
        B=rng.standard_normal((n, m)),
        Bw=rng.standard_normal((n, r)),
        C=np.vstack([rng.standard_normal((2, n)), np.zeros((2, n))]),
        D=np.vstack([np.zeros((2, m)), np.eye(m)]),
        Dw=0.3 * rng.standard_normal((d, r)),
    )
