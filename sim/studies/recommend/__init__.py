"""Recommendation of a controller: candidates of several families are tuned in linear analysis and confirmed in MuJoCo."""

from collections.abc import Mapping

GOALS: Mapping[str, str] = {"ride": "ride", "holding": "dynamic_load", "travel": "peak_travel"}  # and their columns
