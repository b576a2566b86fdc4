"""Runs of one vehicle with one controller over one road: simulation, predictions, comparison of both, forces, and reports.

Start with `run.py`.
"""
