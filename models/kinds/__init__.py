"""What a kind of vehicle is: its equations, parameters and signals; those that ship, and those of the user's own."""
