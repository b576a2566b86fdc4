"""Signals over time: their differences, what ends the linear regime; a response knows its way to pandas and python-control."""
