"""The controllers of a campaign: designed when it begins, and from then on those that it began with.

Gains come from its folder. Laws in Python do not: their files are the user's, the same as then, and none that came with results.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from models.common.errors import InputError
from models.laws.linear import law_of
from models.laws.python_law import Programmed
from models.laws.semi_active import SemiActive
from models.vehicle.vehicle import Vehicle
from sim.campaign.file import Campaign
from sim.campaign.manifest import ELSEWHERE, FaultError, Gains, gains_of
from sim.command.comparison import controllers_of, lawful, programmed, say_false_claims
from synth.controller.controller import Controller, Driver
from synth.vehicle.designer import Designer

Controllers = Mapping[str, Mapping[str, Driver]]  # by vehicle and name


def designed(campaign: Campaign) -> Controllers:
    """Returns the controllers of a new campaign, by vehicle and name.

    Raises:
        InputError: one cannot be designed, or the file of a law cannot be read.
    """
    controllers_by_vehicle = {}
    for name, vehicle in campaign.vehicles.items():
        controllers = controllers_of(vehicle, campaign.controllers, Designer(vehicle, search=False).design)
        say_false_claims(controllers)
        controllers_by_vehicle[name] = dict(zip(campaign.controllers, controllers, strict=True))
    return controllers_by_vehicle


def as_begun(campaign: Campaign, gains: Gains, folder: Path) -> Controllers:
    """Returns the controllers that a campaign began with. Nothing is run.

    Args:
        gains: as its folder has them.

    Raises:
        FaultError: gains are missing, or are no gains.
        InputError: the file of a law cannot be read, is not as it was, or lies in that folder.
    """

    found: dict[str, dict[str, Driver]] = {}
    for name, vehicle in campaign.vehicles.items():
        found[name] = {}
        designer = Designer(vehicle, search=False)  # one for all: they share the path of (22) and the lower bounds
        for each in campaign.controllers:
            try:
                entry, linear = gains[name][each], each in vehicle.linear_names
            except KeyError as error:
                raise _strange(error) from error
            if linear:
                found[name][each] = _gain_of_then(designer, each, entry)
            elif isinstance(law := lawful(vehicle, each), SemiActive):  # ours, as the campaign's own vehicle file has it
                found[name][each] = law
                if gains_of({"": {each: law}})[""][each] != entry:
                    raise FaultError(f"the folder's gains are not those of the campaign (controller {each!r}); {ELSEWHERE}")
            else:
                found[name][each] = _law_of_then(vehicle, each, entry, folder)
    return found


def _gain_of_then(designer: Designer, name: str, entry: Mapping[str, Any]) -> Controller:
    """Certifies a controller again from an entry of `sim.campaign.manifest.gains_of`."""
    try:
        return designer.given(name, entry["measured"], law_of(entry), designer.vehicle.hardware(name))
    except (KeyError, ValueError) as error:
        raise _strange(error) from error


def _strange(error: Exception) -> FaultError:
    return FaultError(f"the folder's gains are not those of the campaign ({error}); {ELSEWHERE}")


def _law_of_then(vehicle: Vehicle, name: str, entry: Mapping[str, Any], folder: Path) -> Programmed:
    """The law of a controller, whose file the vehicle file names, as its campaign began with it. Nothing is run."""
    law = programmed(vehicle, name)
    path = law.law.path
    assert path is not None, "it was read"
    if path.resolve().is_relative_to(folder.resolve()):
        raise InputError(
            f"controller {name!r}: its law {path} lies in the folder of results, from which no code is run; put vehicle file and "
            "law elsewhere"
        )
    now = gains_of({"": {name: law}})[""][name]
    if now != entry:
        raise InputError(
            f"controller {name!r}: its law {law.law.law} has changed since the campaign began (SHA-256 of its file "
            f"{str(entry.get('sha256'))[:16]}... then, {law.sha256[:16]}... now); restore it, or {ELSEWHERE}"
        )
    return law
