"""Loads on the body: their kinds, their texts and files, and roads with loads."""
