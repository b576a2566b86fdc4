"""Ride, travel and road holding: measured in a run, and expected over a class of roads."""
