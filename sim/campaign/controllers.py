"""The controllers of a campaign, which are designed when the campaign begins and stay the same until it ends.

The results folder contains the designed gains, but not the code of control laws written in Python. The files of control laws
written in Python must not change before the campaign ends.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from models.common.errors import InputError
from models.common.files import read_text
from models.laws.law import no_design
from models.laws.linear import law_of
from models.laws.preview import preview_of
from models.laws.python_law import sha256
from sim.campaign.file import Campaign
from sim.campaign.law_keys import drawn_entry
from sim.campaign.manifest import ELSEWHERE, Gains, gains_of
from sim.campaign.plan import Plan
from sim.campaign.samples import Values
from sim.command.comparison import controllers_of, warn_invalid_certificates
from synth.controller.controller import AnyController, Controller
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer


def design_controllers(campaign: Campaign, exported: Path | None = None) -> dict[str, dict[str, AnyController]]:
    """Returns the controllers of a new campaign, by vehicle and name.

    Args:
        campaign: campaign to which the runs belong.
        exported: folder with exported code that runs instead of one of the controllers; None without such code.

    Raises:
        DesignError: a controller cannot be designed.
        InputError: the file of a control law cannot be read, or the exported code belongs to a different controller or vehicle.
    """
    controllers_by_vehicle = {}
    for name, vehicle in campaign.vehicles.items():
        controllers = controllers_of(vehicle, campaign.controllers, Designer(vehicle, search=False).design, exported)
        if len(controllers) < len(campaign.controllers):
            raise DesignError(f"vehicle {name!r}: some controllers cannot be designed; remove those named above from the file")
        warn_invalid_certificates(controllers)
        controllers_by_vehicle[name] = dict(zip(campaign.controllers, controllers, strict=True))
    return controllers_by_vehicle


def plan_controllers(campaign: Campaign, gains: Gains) -> Plan:
    """Returns the plan of the runs, with the controllers that were designed when the campaign began, and with the variants of
    these controllers.

    This function does not run any control law written in Python.

    Args:
        campaign: campaign to which the runs belong.
        gains: designed gains that the results folder contains, by vehicle and controller.

    Raises:
        InputError: the file of a control law cannot be read, or has changed since the campaign began.
    """
    controllers: dict[str, dict[str, AnyController]] = {}
    drawn: dict[str, dict[str, list[AnyController]]] = {}
    for name, vehicle in campaign.vehicles.items():
        # All controllers of a vehicle share one designer, so that the solutions of the LMI problem (22) and the lower bounds
        # are computed only once
        designer = Designer(vehicle, search=False)
        controllers[name] = {one: _restore_controller(designer, one, gains[name][one]) for one in campaign.controllers}
        laws = campaign.variants[name].items()
        drawn[name] = {one: [_draw_controller(designer, one, values) for values in variants] for one, variants in laws}
    return Plan(campaign, controllers, drawn)


def _restore_controller(designer: Designer, name: str, entry: Mapping[str, Any]) -> AnyController:
    """Builds a controller from its entry in the gains that the results folder contains.

    If the campaign began with exported code for this controller, the code is compiled again.
    """
    vehicle, linear = designer.vehicle, name in designer.vehicle.linear_names

    def certified(name: str) -> Controller:
        law = designer.certify(name, entry["measured"], law_of(entry), vehicle.hardware(name))
        return replace(law, preview=preview_of(entry)) if "preview" in entry else law

    driver = vehicle.driver(name, certified)
    if "code" in entry:
        from synth.controller.export.compiled import code_again

        driver = replace(driver, code=code_again(vehicle, driver, entry["code"]))
    if not linear and gains_of({"": {name: driver}})[""][name] != entry:
        file = entry.get("law", entry.get("fmu"))
        raise InputError(f"controller {name!r}: {file} has changed since the campaign began; restore this file, or {ELSEWHERE}")
    return driver


def _draw_controller(designer: Designer, name: str, values: Values) -> AnyController:
    """Returns a controller in whose control law sampled values replace the original parameters."""
    entry = drawn_entry(designer.vehicle, name, values)
    law = entry.law
    return entry.driver(no_design if law is None else lambda name: designer.certify(name, entry.measured, law, entry.hardware))


def check_code(gains: Gains, exported: Path) -> None:
    """Checks that the exported code in a folder is the code with which the campaign began.

    Raises:
        InputError: the exported code has changed since the campaign began, or the campaign began without exported code.
    """
    from synth.controller.export.folder import MANIFEST

    codes = [entry["code"]["manifest_sha256"] for some in gains.values() for entry in some.values() if "code" in entry]
    if sha256(read_text(exported / MANIFEST, "manifest", "give a folder that roadproof synth --export wrote")) not in codes:
        raise InputError(
            f"--as {exported}: the campaign in this folder was started without this exported controller; give a new "
            "folder with --results"
        )
