"""Trade-offs: designs along a Pareto front, lower bounds on the front, and figures."""
