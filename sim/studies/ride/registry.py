"""All metrics. The name is the key of a metric in `--best` and in the table of controllers, whose columns have this order."""

from functools import cache
from typing import Any

from models.common.lazy import named

STANDARD = "sim.studies.ride.kinds.standard"
METRICS = {  # name -> module and class
    "dive": f"{STANDARD}:Dive",
    "squat": f"{STANDARD}:Squat",
    "roll": f"{STANDARD}:Roll",
    "final_angle": f"{STANDARD}:FinalAngle",
    "rms_acceleration": f"{STANDARD}:RmsAcceleration",
    "ride": f"{STANDARD}:Weighted",
    "vdv": f"{STANDARD}:VibrationDose",
    "mtvv": f"{STANDARD}:TransientVibration",
    "crest": f"{STANDARD}:Crest",
    "rms_travel": f"{STANDARD}:RmsTravel",
    "peak_travel": f"{STANDARD}:PeakTravel",
    "dynamic_load": f"{STANDARD}:DynamicLoad",
    "off_ground": f"{STANDARD}:OffGround",
    "force_rms": f"{STANDARD}:RmsForce",
    "force_peak": f"{STANDARD}:PeakForce",
    "power": f"{STANDARD}:ControlPower",
    "energy": f"{STANDARD}:ControlEnergy",
    "at_stops": f"{STANDARD}:AtStops",
}


@cache
def metric_classes() -> dict[str, Any]:
    """Returns the class of every metric, by name.

    Raises:
        TypeError: a class lacks what every metric needs.
    """
    classes = {}
    for name, path in METRICS.items():
        classes[name] = named(path)
        for one in ("what", "unit", "of", "over_runs"):
            if not hasattr(classes[name], one):
                raise TypeError(f"metric {name!r}: {path} has no {one}; see sim/studies/ride/metrics.py")
    return classes
