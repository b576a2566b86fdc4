"""Loads on the body: their types, their texts and files, and roads with loads."""
