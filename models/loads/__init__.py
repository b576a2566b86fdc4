"""What pushes the body from outside: brakes, curves, payloads, wind, as time histories by name or from a file."""
