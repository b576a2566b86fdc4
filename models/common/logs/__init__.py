"""Measured logs of test rigs and vehicles."""
