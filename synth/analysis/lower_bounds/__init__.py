"""Lower bounds on the norm of every controller with given measurements, and their proofs."""
