"""Check of a log: repeats the logged runs, and compares signals, results and certificates. The check does not need a solver."""
