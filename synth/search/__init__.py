"""Descent on the norm itself, where the two steps end."""
