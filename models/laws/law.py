"""Properties of any controller that a simulation needs, and of the source of its law in a vehicle file."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from models.common.errors import InputError

T = TypeVar("T")
DriverKey = tuple[str, *tuple[object, ...]]
Design = Callable[[str], T]  # of a linear controller, by its name


class ControlLaw:
    """Base of all controllers. Defaults are those of a law without states, preview, own delay and certificate.

    A controller that drives a vehicle has `linear`, True if linear analysis applies, and `user_code`, True for a law in Python.
    """

    serial = False  # True if only one thread at a time can execute the law
    acts = True  # False if no measurement ever makes a force
    growth = 0.0  # of the fastest growing state of a linear law by itself [1/s]
    has_anti_windup = False
    preview = None  # force from the road ahead, a `RoadPreview`
    code: Any = None  # the `ExportedCode` that computes the outputs in runs
    implemented = True  # False if the sampling, delay and rate limit of the vehicle file do not apply
    false_claims: tuple[str, ...] = ()  # of its certificate, in words
    specifications = ()  # of its design or evaluation

    @property
    def law_key(self) -> DriverKey:
        """Name of the driver of the law in `sim.drive.drivers.registry`, then what is equal for laws that one driver takes."""
        return ("linear",)

    @property
    def driver_key(self) -> DriverKey:
        """The `law_key` of what computes the outputs in runs: the law, or its exported code."""
        return self.law_key if self.code is None else ("code", self.code.sha256)

    @property
    def states(self) -> int:
        """Number of states of a linear law."""
        return 0

    @property
    def own_delay(self) -> float:
        """Delay of the outputs that the law has itself [samples]."""
        return 0

    def preview_samples(self, period: float) -> int:
        """Returns the number of road heights that the law reads under each wheel, the present one included; 0 without preview.

        Args:
            period: sample period [s].
        """
        return 0

    def state_scale(self, period: float) -> float:
        """Returns the factor from the states that a linear law is run with to its own."""
        return 1.0


class LawSource:
    """Base of what a controller's law comes from: numbers, a design, a file of code, or the name of a semi-active law.

    A source also has `given`, its `LinearLaw`, and `request`, its `DesignRequest`, each None for all others.
    """

    linear = True  # False if linear analysis does not apply to the law
    sample_period: float | None = None  # of a given law in discrete time [s]
    title = "a linear law"  # kind of the law with its article, and its file

    @property
    def path(self) -> Path | None:
        """Path of the law's own file; None for a law without one."""
        return None

    @property
    def record(self) -> dict[str, Any]:
        """The source as in the section of a vehicle file."""
        return {}

    def record_from(self, folder: Path) -> dict[str, Any]:
        """Returns the key that names the law's file from another folder; empty without such a file.

        Raises:
            InputError: the file is not in that folder or below, where alone a vehicle file can name it.
        """
        return {}

    @property
    def values(self) -> dict[str, float | None]:
        """Numbers of the law by key, `gain[0][1]` for an entry of a matrix; None for a default. Empty for other laws."""
        return {}

    def with_values(self, measured: tuple[str, ...], values: Mapping[str, float]) -> dict[str, Any]:
        """Returns the section of the law with other `values`, as in a vehicle file."""
        return self.record

    def driver(self, name: str, measured: tuple[str, ...], design: Design[T], read: Callable[[], str] | None = None) -> T:
        """Returns the controller with this law.

        Args:
            name, measured: name of the controller, and its measured signals.
            design: function that designs or certifies a linear controller by its name.
            read: function that returns the text of a law in Python; by default it is read from the law's file, and not run.

        Raises:
            InputError: the file of the law cannot be read, or an error of `design`.
        """
        return design(name)


def no_design(name: str) -> NoReturn:
    """Refuses to design a linear controller."""
    raise InputError(f"controller {name!r} has a linear law; design this controller with synth.design_controllers")
