"""Identification of a vehicle's parameters from measured logs, with confidence intervals and a list of what the logs do not
determine.
"""
