"""What lies under the wheels, and its exact derivative."""
