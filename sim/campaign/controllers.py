"""The controllers of a campaign: designed when it begins, and from then on those that it began with.

Gains come from its folder. Laws in Python do not: their files are the user's, the same as then, and none that came with results.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from models.common.errors import InputError
from models.common.files import read_text
from models.laws.linear import law_of
from models.laws.python_law import Programmed, sha256
from models.laws.semi_active import SemiActive
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import Vehicle
from sim.campaign.file import Campaign
from sim.campaign.law_keys import drawn_entry
from sim.campaign.manifest import ELSEWHERE, FaultError, Gains, gains_of
from sim.command.comparison import controllers_of, warn
from synth.controller.controller import Controller, Driver
from synth.vehicle.designer import Designer

Controllers = Mapping[str, Mapping[str, Driver]]  # by vehicle and name


def designed(campaign: Campaign, exported: Path | None = None) -> Controllers:
    """Returns the controllers of a new campaign, by vehicle and name.

    Args:
        exported: folder whose code drives one of them, or None.

    Raises:
        InputError: one cannot be designed, the file of a law cannot be read, or the folder does not fit.
    """
    controllers_by_vehicle = {}
    for name, vehicle in campaign.vehicles.items():
        controllers = controllers_of(vehicle, campaign.controllers, Designer(vehicle, search=False).design, exported)
        warn(vehicle, controllers)
        controllers_by_vehicle[name] = dict(zip(campaign.controllers, controllers, strict=True))
    return controllers_by_vehicle


def designed_at_start(campaign: Campaign, gains: Gains, folder: Path) -> Controllers:
    """Returns the controllers that a campaign began with. Nothing is run.

    Args:
        gains: as its folder has them.

    Raises:
        FaultError: gains are missing, or are no gains.
        InputError: the file of a law cannot be read, is not as it was, or lies in that folder.
    """

    controllers: dict[str, dict[str, Driver]] = {}
    for name, vehicle in campaign.vehicles.items():
        controllers[name] = {}
        designer = Designer(vehicle, search=False)  # one for all: they share the path of (22) and the lower bounds
        for each in campaign.controllers:
            try:
                entry, linear = gains[name][each], each in vehicle.linear_names
            except KeyError as error:
                raise _strange(error) from error
            if linear:
                controllers[name][each] = _coded(vehicle, _gain_of_then(designer, each, entry), entry)
            elif isinstance(law := vehicle.controllers[each].driver(), SemiActive):  # as the campaign's vehicle file has it
                law = _coded(vehicle, law, entry)
                controllers[name][each] = law
                if gains_of({"": {each: law}})[""][each] != entry:
                    raise FaultError(f"the folder's gains are not those of the campaign (controller {each!r}); {ELSEWHERE}")
            else:
                controllers[name][each] = _as_then(law, entry, folder)
    return controllers


def drawn_laws(campaign: Campaign) -> dict[str, dict[str, list[Driver]]]:
    """Returns the drawn laws of every vehicle, by controller: each is its vehicle file's, with other numbers."""
    drawn: dict[str, dict[str, list[Driver]]] = {}
    for name, vehicle in campaign.vehicles.items():
        designer, drawn[name] = Designer(vehicle, search=False), {}
        for controller, variants in campaign.variants[name].items():
            entries = [drawn_entry(vehicle, controller, values) for values in variants]
            drawn[name][controller] = [_driver(designer, entry) for entry in entries]
    return drawn


def _driver(designer: Designer, entry: ControllerEntry) -> Driver:
    if entry.semi_active is not None:
        return entry.driver()
    assert entry.law is not None, "a law that is designed, or in Python, is not drawn"
    return designer.certify(entry.name, entry.measured, entry.law, entry.hardware)


def _gain_of_then(designer: Designer, name: str, entry: Mapping[str, Any]) -> Controller:
    """Certifies a controller again from an entry of `sim.campaign.manifest.gains_of`."""
    try:
        found = designer.certify(name, entry["measured"], law_of(entry), designer.vehicle.hardware(name))
        if not isinstance(entry.get("preview"), dict):
            return found
        from models.laws.preview import preview_of

        return replace(found, preview=preview_of(entry))
    except (KeyError, ValueError) as error:
        raise _strange(error) from error


def _coded(vehicle: Vehicle, driver: Driver, entry: Mapping[str, Any]) -> Driver:
    """Returns a controller, driven by its exported code if the campaign began so; the code is made again."""
    if "code" not in entry:
        return driver
    from synth.controller.export.compiled import code_again

    return replace(driver, code=code_again(vehicle, driver, entry["code"]))


def check_code(gains: Gains, exported: Path) -> None:
    """Refuses the code of a folder with which a campaign did not begin.

    Raises:
        InputError: it is other code, or the campaign began without any.
    """
    from synth.controller.export.folder import MANIFEST

    codes = [entry["code"]["manifest_sha256"] for some in gains.values() for entry in some.values() if "code" in entry]
    if sha256(read_text(exported / MANIFEST, "manifest", "name a folder of --export")) not in codes:
        raise InputError(f"--as {exported}: the campaign began without this code; name another folder with --results")


def _strange(error: Exception) -> FaultError:
    return FaultError(f"the folder's gains are not those of the campaign ({error}); {ELSEWHERE}")


def _as_then(law: Programmed, entry: Mapping[str, Any], folder: Path) -> Programmed:
    """Returns a law in Python if it is as its campaign began with it. Nothing is run."""
    path = law.law.path
    assert path is not None, "it was read"
    if path.resolve().is_relative_to(folder.resolve()):
        raise InputError(
            f"controller {law.name!r}: its law {path} lies in the folder of results, from which no code is run; put vehicle file "
            "and law elsewhere"
        )
    now = gains_of({"": {law.name: law}})[""][law.name]
    if now != entry:
        raise InputError(
            f"controller {law.name!r}: its law {law.law.law} has changed since the campaign began (SHA-256 of its file "
            f"{str(entry.get('sha256'))[:16]}... then, {law.sha256[:16]}... now); restore it, or {ELSEWHERE}"
        )
    return law
