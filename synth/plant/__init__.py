"""Generalized plant (15): matrices and units, filters on the signals, and the map from discrete to continuous time."""
