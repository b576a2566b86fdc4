"""Exact linear responses of the simulated loops in time and frequency domain, computed without MuJoCo.

Start with `prediction.py`.
"""
