"""Runs of one vehicle, road and controller: simulation, predictions, their comparison, forces, and reports.

Start with `run.py`.
"""
