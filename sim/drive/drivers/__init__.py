"""Drivers of control laws, with one file per driver, and the registry of drivers."""
