"""Vehicles, roads, laws and the files that describe them."""
