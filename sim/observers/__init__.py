"""Observers of runs: recorder, ends, twin and growth; steps, commands and energy of a recording."""
