"""All metrics. The name is the key of a metric in `--best` and in the table of controllers, whose columns have this order."""

from functools import cache
from typing import Any

from models.common.extensions import METRICS


@cache
def metric_classes() -> dict[str, Any]:
    """Returns the class of every metric, by name.

    Raises:
        TypeError: a class lacks what every metric needs.
    """
    classes = {}
    for name, path in METRICS.items():
        classes[name] = METRICS.load(name)
        for one in ("what", "unit", "of", "over_runs"):
            if not hasattr(classes[name], one):
                raise TypeError(f"metric {name!r}: {path} has no {one}; see sim/studies/ride/metrics.py")
    return classes
