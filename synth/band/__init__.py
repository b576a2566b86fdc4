"""The gain within a band of frequencies: its norm, proved by level sets, and a witness in matrices."""
