"""Ride against road holding, the picture that papers on suspensions draw: every controller of a campaign is a point.

With adjustable dampers a line shows what no damper that stays as it is can leave: all constant ones between their limits, as
they are expected to do over the same roads. What lies below it on the left is worth its control.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.figures.figure import DASHES, OTHERS, STYLES, Curve, Figure, Panel, styles
from models.roads.spectrum import Spectrum
from models.vehicle import Vehicle
from sim.campaign.plan import Plan
from sim.campaign.summary import headlines
from sim.ride.expected import expect
from synth.controller import Controller
from synth.designer import Designer

CONSTANT = 25  # dampers on the line
SOFTEST = 0.02  # of c_max, where c_min is less: next to no damper at all is none that anybody fits
ACROSS, UP = "load", "ride"
ACROSS_LABEL, UP_LABEL = "dynamic tyre load, rms [of the static load]", "weighted acceleration, rms [m/s²]"


def trade_off(plan: Plan, entries: Sequence[Mapping[str, Any]]) -> Figure:
    """A panel for every road and speed, a point for every vehicle and controller: their root mean squares in MuJoCo.

    Args:
        plan: of the campaign.
        entries: what it came to, see `summarise`.

    Raises:
        InputError: nothing of it has both metrics.
    """
    campaign, several = plan.campaign, len(plan.campaign.vehicles) > 1
    own = {vehicle: f", {vehicle}" if several else "" for vehicle in campaign.vehicles}
    looks = styles(tuple(f"{controller}{end}" for end in own.values() for controller in campaign.controllers))
    panels, crossed = [], False
    for road, speed in dict.fromkeys((entry["road"], entry["speed"]) for entry in entries):
        curves = []
        for i, (name, vehicle) in enumerate(campaign.vehicles.items()):
            place = Place(plan, name, vehicle, road, speed)
            line = place.constant_dampers()
            if len(line):
                color = OTHERS[-1 - i % len(OTHERS)]
                curves.append(Curve(line[:, 0], line[:, 1], f"constant dampers, expected{own[name]}", color, width=2.2))
            for controller, (x, y) in place.fully_active().items():
                label = f"{controller}, fully active, expected{own[name]}"
                color = looks[f"{controller}{own[name]}"][0]
                curves.append(Curve(np.array([x]), np.array([y]), label, color, "none", "x"))
        for entry in entries:
            x, y = entry[ACROSS]["rms"], entry[UP]["rms"]
            if (entry["road"], entry["speed"]) == (road, speed) and x is not None and y is not None:
                label = f"{entry['controller']}{own[entry['vehicle']]}"
                color, dash = looks[label]
                again = label not in STYLES and dash != DASHES[0]  # the colours are used up
                curves.append(Curve(np.array([x]), np.array([y]), label, color, "none", "+" if again else "o"))
        crossed = crossed or any(curve.marker == "x" for curve in curves)
        if any(curve.marker in ("o", "+") for curve in curves):
            title = f"{road} at {speed:g} m/s"
            panels.append(
                Panel(title, "dynamic tyre load, rms [of the static load]", "weighted acceleration, rms [m/s²]", tuple(curves))
            )
    if not panels:
        raise InputError("--picture: no run of the campaign has both ride and tyre load; there is nothing to draw")
    title = (
        "Ride against road holding: down is more comfortable, left holds the road better. Points: MuJoCo, root mean squares over "
        "runs, of the worst point of the vehicle."
        + (" Crosses: with actuators that push in place of adjustable dampers." if crossed else "")
    )
    return Figure("trade_off", title, tuple(panels), columns=min(2, len(panels)), size=(6.4, 4.8))


@dataclass(frozen=True, eq=False)
class Place:
    """A vehicle of a campaign on one of its roads at one of its speeds, and what is expected there.

    Nothing is expected over a road that is not random, of a vehicle whose parameters are sampled, and without adjustable dampers.

    Attributes:
        plan: of the campaign.
        name: of the vehicle, in it.
        vehicle: itself.
        road, speed: where.
    """

    plan: Plan
    name: str
    vehicle: Vehicle
    road: str
    speed: float

    @cached_property
    def spectrum(self) -> Spectrum | None:
        """Of the road; None where nothing is to be expected."""
        campaign = self.plan.campaign
        choice = next(one for one in campaign.roads if one.text == self.road)
        if not choice.random or not self.vehicle.adjustable or any(campaign.samples[self.name]):
            return None
        return choice.build(self.vehicle, self.speed, campaign.seeds[0], self.speed * campaign.duration).spectrum

    def expected(self, vehicle: Vehicle, controller: Controller) -> list[float] | None:
        """Dynamic load and ride; None of a loop that is not stable."""
        campaign, lines = self.plan.campaign, headlines(self.plan, self.name)
        if self.spectrum is None:
            return None
        found = expect(vehicle, controller, self.spectrum, campaign.timestep, campaign.duration - campaign.settle)
        return None if found is None else [max(found.mean[column] for column in lines[line]) for line in (ACROSS, UP)]

    def constant_dampers(self) -> Array:
        """Dynamic load and ride of adjustable dampers that stay as they are, softest first, shape (k, 2)."""
        if self.spectrum is None:
            return np.zeros((0, 2))
        vehicle, found = self.vehicle, []
        adjustable = {one.force: one.damper for one in vehicle.adjustable}
        dampers = {one.damping: adjustable[one.force] for one in vehicle.kind.suspensions if one.force in adjustable}
        passive = Designer(vehicle).design("passive")
        for share in np.linspace(0.0, 1.0, CONSTANT):
            fixed = {}
            for parameter, damper in dampers.items():
                softest = max(damper.c_min, SOFTEST * damper.c_max)
                fixed[parameter] = float(softest * (damper.c_max / softest) ** share)
            still = replace(vehicle, parameters={**vehicle.parameters, **fixed}).pushing
            found.append(self.expected(still, passive))
        return np.array([one for one in found if one is not None]).reshape(-1, 2)

    def fully_active(self) -> dict[str, list[float]]:
        """Dynamic load and ride of every linear law, by name, were every force given that it asks for."""
        found = {}
        for name, controller in self.plan.controllers[self.name].items():
            if isinstance(controller, Controller) and controller.law.acts:
                there = self.expected(self.vehicle.pushing, controller)
                found |= {name: there} if there is not None else {}
        return found
