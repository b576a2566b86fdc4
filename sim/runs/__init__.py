"""Runs of one vehicle, road and controller: physics and predictions, their comparison, acting forces, and their text."""
