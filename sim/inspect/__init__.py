"""Check of a log: repeats the logged runs, and compares their signals, results and certificates with the log. The check does
not need a solver.
"""
