"""Filters of one signal, and those that a standard has."""
