"""All metrics. The name is the key of a metric in `--best` and in the table of controllers, whose columns have this order."""

import importlib
from functools import cache
from typing import Any

KINDS = "sim.studies.ride.kinds"
METRICS = {  # name -> module and class
    "dive": f"{KINDS}.angles:Dive",
    "squat": f"{KINDS}.angles:Squat",
    "roll": f"{KINDS}.angles:Roll",
    "final_angle": f"{KINDS}.angles:AtEnd",
    "rms_acceleration": f"{KINDS}.accelerations:Rms",
    "ride": f"{KINDS}.accelerations:Weighted",
    "vdv": f"{KINDS}.accelerations:VibrationDose",
    "mtvv": f"{KINDS}.accelerations:LargestRunning",
    "crest": f"{KINDS}.accelerations:Crest",
    "rms_travel": f"{KINDS}.travel:Rms",
    "peak_travel": f"{KINDS}.travel:Peak",
    "dynamic_load": f"{KINDS}.tyres:DynamicLoad",
    "off_ground": f"{KINDS}.tyres:OffGround",
    "force_rms": f"{KINDS}.actuators:Rms",
    "force_peak": f"{KINDS}.actuators:Peak",
    "power": f"{KINDS}.actuators:Power",
    "energy": f"{KINDS}.actuators:Energy",
    "at_stops": f"{KINDS}.travel:AtStops",
}


@cache
def metric_classes() -> dict[str, Any]:
    """Returns the class of every metric, by name.

    Raises:
        TypeError: a class lacks what every metric needs.
    """
    classes = {}
    for name, path in METRICS.items():
        module, _, named = path.partition(":")
        classes[name] = getattr(importlib.import_module(module), named)
        for one in ("what", "unit", "of", "over_runs"):
            if not hasattr(classes[name], one):
                raise TypeError(f"metric {name!r}: {path} has no {one}; see sim/studies/ride/metrics.py")
    return classes
