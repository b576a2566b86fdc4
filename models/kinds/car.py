"""Vehicle types with a rigid body on several corners (wheels with suspensions), derived from the body and its corner names."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.kinds import links, rigid_body, signals
from models.kinds.kind import SEAT_POINTS, BodyLoad, Parameter, Parameters, VehicleKind, Wheel, nowhere_else
from models.kinds.linear_model import LinearModel
from models.kinds.rigid_body import Bar, Corner, RigidBody, check_inertia, check_stands
from models.kinds.signals import Signal

if TYPE_CHECKING:
    from models.kinds.motion import Motion


MOTIONS = {  # parameter that a type has if its body can make this motion, and the signals of velocity, acceleration and load
    "sprung_mass": (signals.HEAVE_VELOCITY, signals.HEAVE_ACCELERATION, rigid_body.LOADS[0]),
    "pitch_inertia": (signals.PITCH_RATE, signals.PITCH_ACCELERATION, rigid_body.LOADS[1]),
    "roll_inertia": (signals.ROLL_RATE, signals.ROLL_ACCELERATION, rigid_body.LOADS[2]),
}
BAR = "anti_roll_stiffness"


def anti_roll_bar(axle: str = "") -> Parameter:
    """Returns the parameter of the anti-roll bar of an axle, or of the only axle."""
    meaning = "k_phi, stiffness of the anti-roll bar: moment per roll angle of the body"
    name, meaning = (f"{BAR}_{axle}", f"{meaning} at the {axle} axle") if axle else (BAR, meaning)
    return Parameter(name, "N m/rad", meaning, positive=False, usual=0.0)


def lateral(corner: str, p: Parameters) -> float:
    """Returns the distance of a corner to the left of the vehicle's centre line [m]; 0 on a vehicle with one track."""
    axle, _, side = corner.rpartition("_")
    if side not in links.SIDES:
        return 0.0
    return (links.track(axle, p) / 2 if side == "left" else -links.track(axle, p) / 2) - p.get("centre_offset", 0.0)


@dataclass(frozen=True, eq=False)
class Car:
    """The functions that define a vehicle type with a rigid body.

    Attributes:
        parameters: parameters of the type; their names determine how the body moves, and which axles have anti-roll bars.
        corners: names of the c corners; a name consists of an axle, a side, or an axle and a side.
        modes: shares of the c corners in each mode of the tyre deflections, shape (c,), by name of the mode; the modes are
            states.
        warp: wheel motion that a rigid body cannot follow if all axles have the same track width, shape (c,); zero if the body
            can follow every motion.
    """

    parameters: tuple[Parameter, ...]
    corners: tuple[str, ...]
    modes: Mapping[str, Array]
    warp: Array

    @cached_property
    def _motions(self) -> list[tuple[Any, ...]]:
        """Signals of the body's velocities, of the body's accelerations, and of the loads on the body."""
        names = [one.name for one in self.parameters]
        return list(zip(*(MOTIONS[name] for name in MOTIONS if name in names), strict=True))

    @property
    def rates(self) -> tuple[Signal, ...]:
        """Signals of the velocities of the body."""
        return self._motions[0]

    @property
    def tyres(self) -> tuple[Signal, ...]:
        """Signals of the tyre deflections that are states."""
        return tuple(map(signals.TYRE_DEFLECTION.at, self.modes))

    def body(self, p: Parameters) -> RigidBody:
        """Returns the rigid body for parameters [SI]."""
        corners, widths, bars = list[Corner](), np.ones(len(self.corners)), list[Bar]()
        for i, corner in enumerate(self.corners):
            axle = corner.partition("_")[0]
            corners.append(Corner.of(p, corner, axle, lateral(corner, p)))
            if self.warp.any():
                widths[i] = links.track(axle, p)
        for one in self.parameters:
            if one.name.startswith(BAR):
                axle = one.name.removeprefix(BAR).removeprefix("_")
                left, right = (i for i, corner in enumerate(self.corners) if corner.startswith(axle))
                bars.append(Bar(axle or "axle", left, right, p[one.name]))
        pitch_arm, roll_arm = links.arms(p)
        return RigidBody(
            tuple(corners),
            p["sprung_mass"],
            p.get("pitch_inertia"),
            p.get("roll_inertia"),
            tyre_modes=np.stack([*self.modes.values()]),
            twist=self.warp * (widths.max() / widths),
            bars=tuple(bars),
            pitch_arm=pitch_arm,
            roll_arm=roll_arm,
            wheel_loads=self.wheel_loads(p),
            **{name: p.get(name, 0.0) for name in ("seat_mass", "seat_x", "seat_y")},
        )

    def check(self, p: Parameters) -> None:
        """Raises InputError if the parameters do not describe a possible body."""
        if "pitch_inertia" in p:
            check_inertia("pitch_inertia", p["pitch_inertia"], p["sprung_mass"], rigid_body.wheelbase(p), "wheelbase")
        if "roll_inertia" in p:
            widest = max(links.track(corner.rpartition("_")[0], p) for corner in self.corners)
            # Many published half-cars use `track` for the distance between the springs, which lie far inside the wheels
            size, of = (2 * widest, "doubled track") if self.corners == links.SIDES else (widest, "track")
            check_inertia("roll_inertia", p["roll_inertia"], p["sprung_mass"], size, of)
            if abs(offset := p.get("centre_offset", 0.0)) >= widest / 2:
                raise InputError(
                    f"centre_offset = {offset:g} m is beyond the wheels, which are {widest / 2:g} m from the middle "
                    "of the car; give a smaller centre_offset"
                )
        links.check_links(p)
        check_stands(self.body(p))

    def at_corners(self, *quantities: Signal) -> tuple[Signal, ...]:
        """Returns the signals of each supplied quantity at every corner."""
        return tuple(signal.at(corner) for signal in quantities for corner in self.corners)

    @property
    def states(self) -> tuple[Signal, ...]:
        """Signals of the linear model's states."""
        return (
            *self.at_corners(signals.SUSPENSION_DEFLECTION),
            *self.tyres,
            *self.rates,
            *self.at_corners(signals.UNSPRUNG_VELOCITY),
        )

    @property
    def derived(self) -> tuple[Signal, ...]:
        """Signals of the body's accelerations, and of its motion at the corners."""
        return (*self._motions[1], *self.at_corners(signals.SPRUNG_VELOCITY, signals.SPRUNG_ACCELERATION))

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """Output signals that every vehicle of the type has."""
        tyres = self.at_corners(signals.TYRE_DEFLECTION)
        more = () if tyres == self.tyres else tyres
        return (*self.states, *more, *self.derived, *self.at_corners(signals.CONTROL_FORCE))

    @property
    def on_demand(self) -> tuple[Signal, ...]:
        """Output signals that exist only if a controller or goal uses them: accelerations of the wheels, and heights."""
        heights = self.at_corners(signals.SPRUNG_DISPLACEMENT, signals.UNSPRUNG_DISPLACEMENT)
        return (*self.at_corners(signals.UNSPRUNG_ACCELERATION), signals.HEAVE_DISPLACEMENT, *heights)

    def linear_model(self, p: Parameters) -> LinearModel:
        """Returns the linear model for parameters [SI]."""
        forces, roads = self.at_corners(signals.CONTROL_FORCE), self.at_corners(signals.ROAD_VELOCITY)
        return rigid_body.linear_model(self.body(p), self.states, forces, roads, (*self.outputs, *self.on_demand))

    def motion(self, p: Parameters) -> "Motion":
        """Returns the exact equations of motion. The states in the equations of motion include the deflection of every tyre."""
        from models.kinds.rigid_motion import rigid_motion

        lengths = self.at_corners(signals.SUSPENSION_DEFLECTION, signals.TYRE_DEFLECTION)
        states = (*lengths, *self.rates, *self.at_corners(signals.UNSPRUNG_VELOCITY))
        return rigid_motion(self.body(p), states, (*self.derived, *self.on_demand))

    def static_tyre_deflection(self, p: Parameters) -> dict[str, float]:
        """Returns the compression of each tyre in equilibrium [m]; the keys are the tyre deflection signals."""
        return self.body(p).static_tyre_deflection()

    def static_loads(self, p: Parameters) -> dict[str, float]:
        """Returns the weight of the body on each suspension [N]; the keys are the suspension deflection signals."""
        names = (signal.name for signal in self.at_corners(signals.SUSPENSION_DEFLECTION))
        return dict(zip(names, self.body(p).static_loads().tolist(), strict=True))

    def write_mjcf(self, spec: Any, p: Parameters) -> None:
        """Writes the parameters into the MJCF."""
        rigid_body.write_mjcf(spec, self.body(p))

    def wheel_loads(self, p: Parameters) -> tuple[BodyLoad, ...]:
        """Returns the loads on the wheels due to suspension links and wheel inertia."""
        return links.wheel_loads(p, self.corners)

    def carried(self, p: Parameters, way: str, force: float, acceleration: float) -> dict[str, float]:
        """Returns the loads [N, N m], by name of the load, that links and wheel inertia cause in addition to the moment of a
        force on the body.

        For the arguments, see `links.carried_loads`.
        """
        return links.carried_loads(p, self.corners, way, force, acceleration)

    def angles(self, p: Parameters) -> dict[str, dict[str, float]]:
        """Returns the body's pitch and roll angles [rad], each as a weighted sum of signals."""
        return rigid_body.angles(self.body(p))

    def kind(self, name: str, lacking: Mapping[str, str] | None = None) -> VehicleKind:
        """Returns the vehicle type that the car's functions define. For the arguments, see `VehicleKind`."""
        sides = {corner: next((side for side in links.SIDES if corner.endswith(side)), "") for corner in self.corners}
        combined = {
            mode.name: {f"tyre_deflection_{corner}": float(share) for corner, share in zip(self.corners, pattern, strict=True)}
            for mode, pattern in zip(self.tyres, self.modes.values(), strict=True)
        }
        return VehicleKind(
            name=name,
            parameters=self.parameters,
            signals=(*self.at_corners(signals.ROAD_DISPLACEMENT, signals.ROAD_VELOCITY), *self.outputs),
            wheels=tuple(
                Wheel(
                    road_body=f"road_{corner}",
                    road_displacement=f"road_displacement_{corner}",
                    road_velocity=f"road_velocity_{corner}",
                    tyre_deflection=f"tyre_deflection_{corner}",
                    behind=rigid_body.wheelbase if corner.startswith("rear") else nowhere_else,
                    side=side,
                    lateral=partial(lateral, corner),
                )
                for corner, side in sides.items()
            ),
            linear_model=self.linear_model,
            static_tyre_deflection=self.static_tyre_deflection,
            write_mjcf=self.write_mjcf,
            static_loads=self.static_loads,
            check_together=self.check,
            combined=combined if {*self.modes} != {*self.corners} else {},
            on_demand=self.on_demand,
            loads=self._motions[2],
            wheel_loads=self.wheel_loads,
            carried=self.carried,
            angles=self.angles,
            motion=self.motion,
            lacking={**SEAT_POINTS, **(lacking or {})},
        )
