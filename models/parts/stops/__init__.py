"""Bump stops: their keys and tables in files, their force, and the parts that they become."""
