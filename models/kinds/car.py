"""Vehicle types with a rigid body on several corners, derived from the body and the names of its corners."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from models.kinds import links, rigid_body, signals
from models.kinds.kind import SEAT_POINTS, BodyLoad, Parameter, Parameters, VehicleKind, Wheel, nowhere_else
from models.kinds.linear_model import LinearModel
from models.kinds.rigid_body import RigidBody
from models.kinds.signals import Signal

if TYPE_CHECKING:
    from models.kinds.motion import Motion


def lateral(corner: str, p: Parameters) -> float:
    """Returns the distance of a corner to the left of the vehicle's centre line [m]."""
    axle, _, side = corner.rpartition("_")
    return (links.track(axle, p) / 2 if side == "left" else -links.track(axle, p) / 2) - p.get("centre_offset", 0.0)


@dataclass(frozen=True)
class Car:
    """The functions of a vehicle type with a rigid body.

    Attributes:
        body: function of the parameters that returns the rigid body.
        corners: names of the corners: an axle, a side, or an axle and a side.
        tyres: signals of the tyre deflections that are states.
        rates: signals of the velocities of the body.
        accelerations: signals of the body's accelerations.
    """

    body: Callable[[Parameters], RigidBody]
    corners: tuple[str, ...]
    tyres: tuple[Signal, ...]
    rates: tuple[Signal, ...]
    accelerations: tuple[Signal, ...]

    def at_corners(self, *quantities: Signal) -> tuple[Signal, ...]:
        """Returns the signals of quantities at every corner."""
        return tuple(signal.at(corner) for signal in quantities for corner in self.corners)

    @property
    def states(self) -> tuple[Signal, ...]:
        """Signals of the states."""
        return (
            *self.at_corners(signals.SUSPENSION_DEFLECTION),
            *self.tyres,
            *self.rates,
            *self.at_corners(signals.UNSPRUNG_VELOCITY),
        )

    @property
    def derived(self) -> tuple[Signal, ...]:
        """Signals of the body's accelerations, and of its motion at the corners."""
        return (*self.accelerations, *self.at_corners(signals.SPRUNG_VELOCITY, signals.SPRUNG_ACCELERATION))

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
        """Returns the exact equations of motion. Their states include the deflection of every tyre."""
        from models.kinds.rigid_motion import rigid_motion

        lengths = self.at_corners(signals.SUSPENSION_DEFLECTION, signals.TYRE_DEFLECTION)
        states = (*lengths, *self.rates, *self.at_corners(signals.UNSPRUNG_VELOCITY))
        return rigid_motion(self.body(p), states, (*self.derived, *self.on_demand))

    def static_tyre_deflection(self, p: Parameters) -> dict[str, float]:
        """Returns the compression of each tyre in equilibrium [m], by tyre deflection signal."""
        return self.body(p).static_tyre_deflection()

    def static_loads(self, p: Parameters) -> dict[str, float]:
        """Returns the weight of the body on each suspension [N], by deflection signal."""
        names = (signal.name for signal in self.at_corners(signals.SUSPENSION_DEFLECTION))
        return dict(zip(names, self.body(p).static_loads().tolist(), strict=True))

    def write_mjcf(self, spec: Any, p: Parameters) -> None:
        """Writes the parameters into the MJCF."""
        rigid_body.write_mjcf(spec, self.body(p))

    def wheel_loads(self, p: Parameters) -> tuple[BodyLoad, ...]:
        """Returns the loads on the wheels."""
        return links.wheel_loads(p, self.corners)

    def carried(self, p: Parameters, way: str, force: float, acceleration: float) -> dict[str, float]:
        """Returns, by name, the loads [N, N m] of links and wheel inertia that add to the moment of a force on the body.

        For the arguments, see `links.carried_loads`.
        """
        return links.carried_loads(p, self.corners, way, force, acceleration)

    def angles(self, p: Parameters) -> dict[str, dict[str, float]]:
        """Returns the body's angles [rad] as sums of signals."""
        return rigid_body.angles(self.body(p))

    def kind(
        self,
        name: str,
        parameters: tuple[Parameter, ...],
        check: Callable[[Parameters], None],
        combined: Mapping[str, Mapping[str, float]] | None = None,
        lacking: Mapping[str, str] | None = None,
    ) -> VehicleKind:
        """Returns the vehicle type.

        The argument `check` is a function that refuses an impossible body; for the other arguments, see `VehicleKind`.
        """
        sides = {corner: next((side for side in links.SIDES if corner.endswith(side)), "") for corner in self.corners}
        rates = (signals.HEAVE_VELOCITY, signals.PITCH_RATE, signals.ROLL_RATE)
        return VehicleKind(
            name=name,
            parameters=parameters,
            signals=(*self.at_corners(signals.ROAD_DISPLACEMENT, signals.ROAD_VELOCITY), *self.outputs),
            wheels=tuple(
                Wheel(
                    road_body=f"road_{corner}",
                    road_displacement=f"road_displacement_{corner}",
                    road_velocity=f"road_velocity_{corner}",
                    tyre_deflection=f"tyre_deflection_{corner}",
                    behind=rigid_body.wheelbase if corner.startswith("rear") else nowhere_else,
                    side=side,
                    lateral=partial(lateral, corner) if side else nowhere_else,
                )
                for corner, side in sides.items()
            ),
            linear_model=self.linear_model,
            static_tyre_deflection=self.static_tyre_deflection,
            write_mjcf=self.write_mjcf,
            static_loads=self.static_loads,
            check_together=check,
            combined=combined or {},
            on_demand=self.on_demand,
            loads=tuple(load for load, rate in zip(rigid_body.LOADS, rates, strict=True) if rate in self.rates),
            wheel_loads=self.wheel_loads,
            carried=self.carried,
            angles=self.angles,
            motion=self.motion,
            lacking={**SEAT_POINTS, **(lacking or {})},
        )
