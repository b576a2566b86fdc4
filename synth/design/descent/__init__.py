"""Descent on the norm of the closed loop over the entries of a gain, shared by several design methods."""
