"""Trade-offs between two or three norms: designs along a Pareto front, lower bounds on the front, and figures."""
