"""Vehicles without some part of `[limits]` or `[implementation]`, to see what the part costs."""

from dataclasses import replace

from models.common.errors import InputError, listing
from models.vehicle.limits_and_implementation import Limits
from models.vehicle.names import PASSIVE, WITHOUT
from models.vehicle.vehicle import Vehicle


def without(vehicle: Vehicle, part: str) -> Vehicle:
    """Returns a vehicle without a part of its limits or implementation; equal to the vehicle if its file has no such part.

    Args:
        part: one of `WITHOUT`: `noise` is noise and quantisation, `delay` that of the forces, `limits` the largest force and the
            bump stops, and `lag` that of actuators or valves.
    """
    if part not in WITHOUT:
        raise InputError(f"without {part!r} is not known; known: {listing(WITHOUT)}")
    how, dampers = vehicle.implementation, vehicle.dampers
    limits, pushing = (one and _without(one, part) for one in (vehicle.limits, vehicle.force_limits))
    if part == "noise":
        how = how.without_noise
    elif part == "delay":
        how = replace(how, delay=0)
    elif part == "lag":
        dampers = {force: replace(damper, bandwidth=None) for force, damper in dampers.items()}
    whole = vehicle.limits, vehicle.force_limits, vehicle.implementation, vehicle.dampers
    if (limits, pushing, how, dampers) == whole:
        return vehicle
    return replace(vehicle, limits=limits, force_limits=pushing, implementation=how, dampers=dampers)


def _without(limits: Limits, part: str) -> Limits:
    return {
        "limits": Limits(actuator_bandwidth=limits.actuator_bandwidth),
        "lag": replace(limits, actuator_bandwidth=None),
    }.get(part, limits)


def has_part(vehicle: Vehicle, part: str) -> bool:
    """Returns True if a vehicle has a part that `without` takes out."""
    return without(vehicle, part) is not vehicle


def run_without(names: "list[str]", part: str) -> list[str]:
    """Returns the controllers, out of some, whose runs without a part differ: only limits matter to the passive vehicle."""
    return [name for name in names if name != PASSIVE or part == "limits"]


def variant_name(controller: str, part: str) -> str:
    """Returns the name of a controller's run without a part in tables; the controller's own if it is as built."""
    return f"{controller}, no {part}" if part else controller


def logged_name(controller: str, part: str) -> str:
    """Returns the name of such a run in a log."""
    return f"{controller}-no_{part}" if part else controller


def logged_part(name: str, controller: str) -> str:
    """Returns the part that a logged run leaves out, from its name; empty for a run as built."""
    part = name.removeprefix(f"{controller}-no_") if name != controller else ""
    return part if part in WITHOUT else ""
