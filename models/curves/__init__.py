"""Curves of dampers and springs: as data, as they are read, and as actuators in the model."""
