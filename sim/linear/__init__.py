"""Exact linear responses of the simulated loops in the time domain and the frequency domain, computed without MuJoCo.

Start with `prediction.py`.
"""
