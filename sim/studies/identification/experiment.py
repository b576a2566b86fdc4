"""Experiments. Each is a stretch of a measured log at equidistant times, with the inputs of the vehicle and the sensor signals.

On a dyno, a single part of the vehicle (such as a damper) is moved. The extension of the part is given, and the force is
measured.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.kinds.kind import VehicleKind
from models.roads.iso8608 import Iso8608

# Signals of a part on a dyno: its extension from equilibrium, and its force, which is positive if it pulls the ends together
EXTENSION, FORCE = "part_extension", "part_force"
OF_PARTS: Mapping[str, str] = {EXTENSION: "m", FORCE: "N"}  # units of these signals


def signal_units(kind: VehicleKind) -> dict[str, str]:
    """Returns the units of all signals that a log may contain, by name."""
    return {**{name: one.unit for name, one in kind.possible.items()}, **OF_PARTS}


@dataclass(frozen=True, eq=False)
class Channel:
    """Measured signal of an experiment.

    Attributes:
        signal: name of the vehicle's signal that is measured.
        values: measured values in SI units, shape (T,); NaN for a missing or unusable value.
        noise: rms of the sensor's noise, in the unit of the signal; None if the rms is estimated.
        delay: delay of the sensor [s], or the initial value of a delay that is estimated.
        delay_estimated: True if the delay is estimated.
        offset_estimated: True if a constant offset is estimated.
    """

    signal: str
    values: Array
    noise: float | None = None
    delay: float = 0.0
    delay_estimated: bool = False
    offset_estimated: bool = False

    @property
    def counted(self) -> Array:
        """True for the samples that have a value, shape (T,)."""
        return np.isfinite(self.values)


@dataclass(frozen=True, eq=False)
class Experiment:
    """One stretch of a log.

    Attributes:
        name: name of the log, followed by the name of the stretch if the log has several.
        step: time between two samples [s].
        road: road heights under the r wheels [m], shape (T, r); if `hubs` is True, vertical accelerations of the r hubs [m/s2].
            Values are interpolated linearly between samples.
        forces: control forces [N], shape (T, m).
        channels: measured signals, one for each sensor.
        added: additions to parameters of the vehicle file, such as a payload, by name [SI].
        from_rest: True if the vehicle starts in equilibrium on the first road height; False if the starting state is estimated.
        hubs: True if the road is unknown, and the measured accelerations of the hubs are the inputs instead.
        forces_held: True if each force is held until the next sample, as by a computer; False if forces are interpolated
            linearly.
        road_held: True if the height halfway between two samples is held over the step, as in MuJoCo.
        part: name of the force element that a dyno moves; empty if the whole vehicle is measured.
            If a part is named, `road` is its extension.
        start: time of the first sample on the log's clock [s].
        random: random road with an unknown profile and a spectrum of known form; None for any other road.
    """

    name: str
    step: float
    road: Array
    forces: Array
    channels: tuple[Channel, ...]
    added: Mapping[str, float] = field(default_factory=dict[str, float])
    from_rest: bool = False
    hubs: bool = False
    forces_held: bool = False
    road_held: bool = False
    part: str = ""
    start: float = 0.0
    random: Iso8608 | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.road).all() and np.isfinite(self.forces).all()):
            raise InputError(f"{self.name}: a road height or a force is missing (NaN); split the log at this gap")
        for one in self.channels:
            if not one.counted.any():
                raise InputError(f"{self.name}: {one.signal} contains only NaN, no number; omit this channel")

    @property
    def time(self) -> Array:
        """Sample times on the log's clock [s], shape (T,)."""
        return self.start + self.step * np.arange(len(self.road))

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the measured signals."""
        return tuple(one.signal for one in self.channels)
