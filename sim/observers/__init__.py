"""Observers of runs: recorder, ends, twin and growth during a run; checks of steps, commands and energy of a recording."""
