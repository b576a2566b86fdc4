"""Generalized plant (15): its matrices and units, filters on its signals, and the map from discrete to continuous time."""
