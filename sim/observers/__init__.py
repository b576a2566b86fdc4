"""Observers of runs: `recorder`, `ends`, `twin` and `growth` work during a run; `steps`, `commands` and `energy` check its
recording.
"""
