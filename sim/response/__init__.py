"""Signals over time: their differences, what ends the linear regime, and their export."""
