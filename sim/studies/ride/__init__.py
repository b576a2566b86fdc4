"""Ride, travel and road holding: measured of a run, and expected of a class of roads."""
