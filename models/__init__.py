"""What a vehicle is: its equations, its MJCF and its parameters, side by side, and the names of its signals."""
