"""What is computed from runs and loops: ride, frequency responses, stability, and where linear analysis is valid."""
