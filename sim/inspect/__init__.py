"""Check of a log: repeats the logged runs, and compares signals, results and certificates. No solver is needed."""
