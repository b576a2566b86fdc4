"""Recommendation of a controller: candidates of several families are tuned by linear analysis and confirmed in MuJoCo."""

from collections.abc import Mapping

# goals of a recommendation, each with its column of the results
GOALS: Mapping[str, str] = {"ride": "ride", "holding": "dynamic_load", "travel": "peak_travel"}
