"""Frequency responses and the norm, measured in MuJoCo."""
