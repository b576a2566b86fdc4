"""Loads on the body: types of loads, the texts and files that define loads, and roads with loads."""
