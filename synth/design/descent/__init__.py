"""Descent search over the entries of a gain, which lowers the norm of the closed loop; shared by several design methods."""
