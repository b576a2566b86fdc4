"""Signals over time, their differences, and the ends of the linear regime; conversion to pandas and python-control."""
