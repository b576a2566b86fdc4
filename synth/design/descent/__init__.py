"""Descent on a norm over gains, shared by several methods."""
