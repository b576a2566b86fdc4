"""Drivers of control laws, one file for each, and their registry."""
