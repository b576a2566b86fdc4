"""Identification: the parameters of a vehicle from measured logs, with intervals, and what the logs do not determine."""
