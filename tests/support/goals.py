"""A built-in vehicle with one controller that is designed for goals: for tests of goals."""

import re

import numpy as np

from models.vehicle.vehicle import parse_vehicle, read_vehicle
from tests.support import shared

HZ = 2 * np.pi
THREE = '["suspension_deflection", "sprung_velocity", "unsprung_velocity"]'
TWO, ONE = '["suspension_deflection", "sprung_velocity"]', '["sprung_velocity"]'
BAND = "minimise = { band = [4.0, 8.0] }"
KEPT = "{ norm = 8.63 }, { decay = 1.19 }"


def vehicle_with(section: str, name: str = "quarter_car"):
    """A shipped vehicle whose only controller is `goal`."""
    text = re.sub(r"(?ms)^\[controllers\..*", "", read_vehicle(name).text)
    return parse_vehicle(f"{text}\n[controllers.goal]\n{section}\n")


def designed(section: str, name: str = "quarter_car"):
    """The controller, and what is known of its promises by their names: what is proved, or the value where that is exact."""
    controller = shared.designed(vehicle_with(section, name), "goal")
    assert controller.certificate.failures == ()
    assert controller.unmet_specifications == ()
    return controller, {each.what: each.value if each.proved is None else each.proved for each in controller.specifications}
