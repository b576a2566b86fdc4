"""Descent on a norm over gains, which several methods stand on."""
