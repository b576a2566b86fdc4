"""Base classes of the controllers that simulations use, and of the sources of control laws in vehicle files."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from models.common.errors import InputError

T = TypeVar("T")
DriverKey = tuple[str, *tuple[object, ...]]
Design = Callable[[str], T]  # type of a function that designs a linear controller with a given name


class ControlLaw:
    """Base class of all controllers. The default attributes describe a law without states, preview, additional delay or
    certificate.

    A controller also has the attributes `linear`, True if linear analysis applies, and `user_code`, True for a Python law.
    """

    serial = False  # True if the law can run in only one thread at a time
    acts = True  # False if the law returns a force of 0 for all measurements
    growth = 0.0  # growth rate of the fastest growing state of a linear law, without feedback [1/s]
    has_anti_windup = False
    preview = None  # `RoadPreview` of a law whose force also depends on the road ahead
    code: Any = None  # the `ExportedCode` that computes the law's outputs in runs
    implemented = True  # False if the law ignores the sampling, delay and rate limit of the vehicle file
    false_claims: tuple[str, ...] = ()  # descriptions of the statements in the certificate that are not true
    specifications = ()  # specifications for which the law is designed, or with which it is evaluated

    @property
    def law_key(self) -> DriverKey:
        """Name of the law's driver in `sim.drive.drivers.registry`, followed by values that are equal for laws that share a
        driver.
        """
        return ("linear",)

    @property
    def driver_key(self) -> DriverKey:
        """Key of the driver: `law_key` or, if exported code computes the outputs in runs, the checksum of the exported code."""
        return self.law_key if self.code is None else ("code", self.code.sha256)

    @property
    def states(self) -> int:
        """Number of states of a linear law."""
        return 0

    @property
    def own_delay(self) -> float:
        """Delay of the forces that the law itself causes [samples]; it is part of the delay in the vehicle file."""
        return 0

    def preview_samples(self, period: float) -> int:
        """Returns how many road heights the law uses for each wheel, including the present height; 0 without preview.

        Args:
            period: sample period [s].
        """
        return 0

    def state_scale(self, period: float) -> float:
        """Returns the factor that converts the states of a linear law, as sampled for a run, to the states of the law itself."""
        return 1.0


class LawSource:
    """Base class of the sources of control laws: numbers, a design, a file with code, or the name of a semi-active law.

    A source also has two attributes: `given` is its `LinearLaw`, and `request` is its `DesignRequest`. An attribute that does
    not apply to the type of source is None.
    """

    linear = True  # False if linear analysis does not apply to the law
    sample_period: float | None = None  # sample period [s] of a law that is given in discrete time, not designed
    title = "a linear law"  # type of the law with its article, and file that contains the law

    @property
    def path(self) -> Path | None:
        """Path of the law's file; None for a law without a file."""
        return None

    @property
    def record(self) -> dict[str, Any]:
        """The source of the law, as keys and values of a controller's section."""
        return {}

    def record_from(self, folder: Path) -> dict[str, Any]:
        """Returns the key that gives the path of the law's file relative to `folder`; empty for a law without a file.

        Raises:
            InputError: the file is neither in `folder` nor in a folder below it; vehicle files can refer only to such files.
        """
        return {}

    @property
    def values(self) -> dict[str, float | None]:
        """Numbers of the law by key, such as `gain[0][1]` for an entry of a matrix.

        A number with the value None has its default value. The mapping of numbers is empty for laws without numbers.
        """
        return {}

    def with_values(self, measured: tuple[str, ...], values: Mapping[str, float]) -> dict[str, Any]:
        """Returns the law's part of a controller's section, as in a vehicle file, after replacing numbers of the law by those
        in `values`.
        """
        return self.record

    def driver(self, name: str, measured: tuple[str, ...], design: Design[T], read: Callable[[], str] | None = None) -> T:
        """Returns the controller that applies the law.

        Args:
            name: name of the controller, as in the vehicle file.
            measured: names of the signals that the controller measures.
            design: function that designs or certifies a linear controller with a given name.
            read: function that returns the text of a Python law; by default, the text is read from the law's file. The function
                `read` does not execute the text.

        Raises:
            InputError: the file of the law cannot be read, or `design` raises an InputError.
        """
        return design(name)


def no_design(name: str) -> NoReturn:
    """Raises an InputError, because the controller has a linear law, which `synth.design_controllers` must design."""
    raise InputError(
        f"controller {name!r} has a linear law that is not designed yet; design the controller with synth.design_controllers"
    )
