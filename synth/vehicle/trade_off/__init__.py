"""Trade-offs: designs along a front, what bounds them, and their picture."""
