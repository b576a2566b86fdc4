"""Experiments. Each experiment is a stretch of a measured log at equidistant times, with the inputs of the vehicle and the
sensor signals.

On a dynamometer (dyno), a single part of the vehicle, such as a damper, is moved. In an experiment on a dyno, the extension of
the part is the input, and the force of the part is measured.
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
    """Returns the units of all signals that a log may contain, by name of the signal."""
    return {**{name: one.unit for name, one in kind.possible.items()}, **OF_PARTS}


@dataclass(frozen=True, eq=False)
class Channel:
    """A measured signal of an experiment.

    Attributes:
        signal: name of the vehicle's signal that is measured.
        values: measured values of the signal in SI units, shape (T,); NaN for a missing or unusable value.
        noise: rms of the sensor's noise, in the unit of the signal; None if this rms is to be estimated.
        delay: delay of the sensor [s], or the initial value of a delay that is estimated.
        delay_estimated: True if the delay of the sensor is estimated.
        offset_estimated: True if a constant offset of the sensor is estimated.
    """

    signal: str
    values: Array
    noise: float | None = None
    delay: float = 0.0
    delay_estimated: bool = False
    offset_estimated: bool = False

    @property
    def counted(self) -> Array:
        """True for each sample that has a value, shape (T,)."""
        return np.isfinite(self.values)


@dataclass(frozen=True, eq=False)
class Experiment:
    """One stretch of a measured log.

    Attributes:
        name: name of the log, followed by the name of the stretch if the log has several stretches.
        step: time between two samples [s].
        road: road heights under the r wheels [m], shape (T, r); if `hubs` is True, vertical accelerations of the r hubs [m/s2].
            Between samples, the road heights or hub accelerations are interpolated linearly.
        forces: control forces [N], shape (T, m).
        channels: measured signals, each from one sensor.
        added: amounts added to parameters of the vehicle file, such as a payload, by name of the parameter [SI].
        from_rest: True if the vehicle starts in equilibrium at the first road height; False if the starting state is estimated.
        hubs: True if the road is unknown, and the measured hub accelerations are the inputs instead of road heights.
        forces_held: True if each force is constant until the next sample, as a computer holds it; False if forces are
            interpolated linearly.
        road_held: True if the road height during each step is constant, namely the height halfway between the two samples, as
            in MuJoCo.
        part: name of the force element that is moved on a dyno; empty if the whole vehicle is measured. If a part is named,
            `road` contains the extension of the part.
        start: time of the first sample on the log's clock [s].
        random: random road whose profile is unknown but whose spectrum has a known form; None for any other road.
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
