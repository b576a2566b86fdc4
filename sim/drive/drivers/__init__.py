"""Drivers of control laws, one file each, and their registry."""
