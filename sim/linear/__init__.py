"""Exact linear responses of the simulated loops in the time and frequency domain, without MuJoCo. Start with `prediction.py`."""
