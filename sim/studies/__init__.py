"""Studies of runs and loops: ride, frequency responses, stability, and the range of validity of linear analysis."""
