"""Faults put into the physics of a vehicle: every number of its compiled elements, off by a share."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

from models.vehicle import mjcf
from models.vehicle.vehicle import Vehicle
from sim.drive import sensor_readout
from sim.observers import energy

Fault = Callable[[Any], None]


@contextlib.contextmanager
def built_with(fault: Fault) -> Iterator[None]:
    """Every model that is built in here has the fault, that of the energy balance, too."""
    plain, caches = mjcf.build_spec, (mjcf.has_geometry, energy._energy_model, sensor_readout.prepared_readout)

    def build(vehicle: Vehicle, timestep: float) -> Any:
        spec = plain(vehicle, timestep)
        fault(spec)
        return spec

    for module in (mjcf, energy):
        module.build_spec = build
    for cached in caches:
        cached.cache_clear()
    try:
        yield
    finally:
        for module in (mjcf, energy):
            module.build_spec = plain
        for cached in caches:
            cached.cache_clear()


def places(spec: Any) -> list[tuple[str, str, str, int]]:
    """Every number of a model's elements that is not zero: what it is of, the element's name, the field, and the index."""
    found = []
    for what, elements, fields in (
        ("body", spec.bodies[1:], ("mass", "inertia", "pos")),
        ("joint", spec.joints, ("pos",)),
        ("site", spec.sites, ("pos",)),
        ("tendon", spec.tendons, ("stiffness", "damping", "springlength")),
        ("actuator", spec.actuators, ("gear", "gainprm", "biasprm", "forcerange", "dynprm")),
    ):
        for element in elements:
            for field in fields:
                value = getattr(element, field)
                numbers = [value] if isinstance(value, float) else list(value)
                if field in ("springlength",) and len(numbers) == 2 and numbers[0] == numbers[1]:
                    numbers = numbers[:1]  # a spring without a dead band
                found += [(what, element.name, field, i) for i, number in enumerate(numbers) if number]
    return found


def scaled(place: tuple[str, str, str, int], share: float) -> Fault:
    """The fault of one of these numbers."""
    what, name, field, index = place

    def fault(spec: Any) -> None:
        element = getattr(spec, what)(name)
        if element is None:  # in a model without limits
            return
        value = getattr(element, field)
        if isinstance(value, float):
            setattr(element, field, value * (1 + share))
            return
        both = field == "springlength" and value[0] == value[1]
        for i in (0, 1) if both else (index,):
            value[i] *= 1 + share

    return fault


def miswritten(vehicle: Vehicle, parameter: str, share: float) -> Vehicle:
    """The vehicle whose MJCF is written for another value of a parameter, preloads included."""
    kind = vehicle.kind

    def write(spec: Any, parameters: Any) -> None:
        kind.write_mjcf(spec, {**parameters, parameter: parameters[parameter] * (1 + share)})

    return dataclasses.replace(vehicle, kind=dataclasses.replace(kind, write_mjcf=write))
