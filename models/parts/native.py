"""Representation of parts by MuJoCo's own elements: actuators and springs on a suspension's tendon, evaluated in every stage of
RK4.

Each actuator represents one straight segment of a characteristic. The control of a segment's actuator is always zero. The bias
of the actuator is affine in length or speed, and a `forcerange` clips the bias. The gain of the actuator stays 1. If the gain
were minus the slope of the bias against length, MuJoCo would interpret a positive slope against speed as a damping ratio. The
suspension's own spring and damper remain in the MuJoCo model, and give the linearised force. The actuators of the segments add
the deviation of the force from the linearised force.

A part that MuJoCo's own elements cannot represent gets a motor, which `sim.drive.part_steps` controls in every stage of RK4.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from models.characteristics.curve import Pieces
from models.common.errors import InputError

# pyright: reportAttributeAccessIssue=false
# MuJoCo's Python bindings do not have type stubs.


# This force [N] is larger than any suspension force, but smaller than the limit at which MuJoCo reports an error
LARGEST_FORCE = 1e9
MOTOR = "part_"  # this part of a motor's name is between the prefix and the name of the tendon


@dataclass(frozen=True)
class Tendon:
    """Tendon of a suspension in an `MjSpec`, to which a part adds its force.

    Attributes:
        spec: MuJoCo model of the vehicle, with all parameters.
        name: name of the tendon.
        rest: length of the tendon in equilibrium [m].
        prefix: beginning of the names of the actuators that a part adds.
    """

    spec: Any
    name: str
    rest: float
    prefix: str

    def add_pieces(self, name: str, pieces: Pieces, over_speed: bool = False) -> None:
        """Adds segments of a force that pulls the ends of the tendon together, as a function of the tendon's deflection or
        speed.
        """
        length = 0.0 if over_speed else self.rest
        for i in range(len(pieces.slope)):
            actuator = self._actuator(f"{self.prefix}{name}_{self.name}_{i + 1}")
            actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            slope, start = float(pieces.slope[i]), float(pieces.start[i])
            # A positive force of the characteristic pulls the ends of the tendon together, but a positive actuator force
            # stretches the tendon.
            along = [0.0, -slope] if over_speed else [-slope, 0.0]
            actuator.biasprm[:3] = [slope * (start + length), *along]
            actuator.forcelimited = True
            actuator.forcerange = np.clip([-pieces.high[i], -pieces.low[i]], -LARGEST_FORCE, LARGEST_FORCE)

    def add_spring(self, name: str, slack: tuple[float, float], stiffness: Sequence[float]) -> None:
        """Adds a spring in parallel with the tendon, whose force is f = -(a x + b x^2 + c x^3) at the extension x.

        The dead band is the range of lengths [m] in which the spring exerts no force.
        """
        spring = self.spec.add_tendon(name=f"{name}_{self.name}")
        spring.stiffness[:] = stiffness
        spring.springlength = slack
        for wrap in self.spec.tendon(self.name).path:
            if wrap.type == mujoco.mjtWrap.mjWRAP_JOINT:
                spring.wrap_joint(wrap.target.name, wrap.coef)
            else:
                spring.wrap_site(wrap.target.name)

    def add_motor(self) -> None:
        """Adds a motor on the tendon. The control of the motor is a force that pulls the ends of the tendon together [N]."""
        self._actuator(f"{self.prefix}{MOTOR}{self.name}").gainprm[0] = -1.0

    def adjust_input(
        self, force: str, line: float, ramps: Sequence[tuple[float, float, int]], low: float, ratio: float, lag: float | None
    ) -> None:
        """Replaces the motor of an input by a semi-active damper with the control c - c_s and the force -(c - c_s) h(v) at the
        velocity v.

        The function h is a straight line plus ramps that begin at knots. The line and each ramp have separate actuators, which
        receive the same control. A ramp with the slope a and the knot k gives the force (c - c_min) a (v - k). The force of a
        ramp has the same sign everywhere beyond the knot, and is clipped to zero before the knot.

        Args:
            force: name of the actuator of the input.
            line: slope of the function h at equilibrium.
            ramps: knot [m/s], slope and side (1 or -1) of each ramp.
            low: the smallest value of the control c - c_s [N s/m].
            ratio: motion ratio of the damper.
            lag: bandwidth of the valve [rad/s]; None for a valve without lag.

        Raises:
            InputError: the actuator is not a motor with gear 1 on the tendon.
        """
        actuator = next((one for one in self.spec.actuators if one.name == force), None)
        if actuator is None or (actuator.target, float(actuator.gear[0])) != (self.name, 1.0):
            raise InputError(
                f"for the damper of [actuators], the actuator {force!r} must be a motor with gear 1 on the tendon {self.name!r}; "
                "change this actuator, or omit [actuators]"
            )
        actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_AFFINE, mujoco.mjtBias.mjBIAS_NONE
        actuator.gainprm[:3] = [0.0, 0.0, -line]
        parts = [actuator]
        for number, (knot, slope, side) in enumerate(ramps, 1):
            ramp = self._actuator(f"{self.prefix}{force}_{number}")
            ramp.gear[0] = ratio
            ramp.gaintype, ramp.biastype = mujoco.mjtGain.mjGAIN_AFFINE, mujoco.mjtBias.mjBIAS_AFFINE
            ramp.gainprm[:3] = [slope * knot, 0.0, -slope]
            ramp.biasprm[:3] = [-low * slope * knot, 0.0, low * slope]
            ramp.forcelimited = True
            ramp.forcerange = [-LARGEST_FORCE, 0.0] if slope * side > 0 else [0.0, LARGEST_FORCE]
            parts.append(ramp)
        if lag is not None:
            for part in parts:
                # RK4 integrates the lag of the actuator together with the other states
                part.dyntype = mujoco.mjtDyn.mjDYN_FILTER
                part.dynprm[0] = 1 / lag

    def _actuator(self, name: str) -> Any:
        actuator = self.spec.add_actuator(name=name, target=self.name)
        actuator.trntype = mujoco.mjtTrn.mjTRN_TENDON
        return actuator


def sense_velocities(spec: Any, deflections: Sequence[tuple[str, str]]) -> None:
    """Adds sensors of velocities for tendons or joints whose length is already measured.

    Args:
        spec: MuJoCo model to which the sensors are added.
        deflections: pairs of signal names: the velocity to be measured, and the length that is already measured.

    Raises:
        InputError: a length is not measured by the sensor of a tendon or joint.
    """
    kind, sensors = mujoco.mjtSensor, {sensor.name: sensor for sensor in spec.sensors}
    speeds = {kind.mjSENS_TENDONPOS: kind.mjSENS_TENDONVEL, kind.mjSENS_JOINTPOS: kind.mjSENS_JOINTVEL}
    for velocity, deflection in deflections:
        length = sensors.get(deflection)
        if length is None or length.type not in speeds:
            raise InputError(
                f"{velocity!r} needs a sensor {deflection!r} that measures the length of a tendon or the position of "
                "a joint; add this sensor"
            )
        sensor = spec.add_sensor(name=velocity, type=speeds[length.type], objtype=length.objtype, objname=length.objname)
        sensor.userdata = list(length.userdata)
