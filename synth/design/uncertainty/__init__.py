"""Gain errors of measurements and forces: worst case, bounds for all errors, and the largest errors that a law tolerates."""
