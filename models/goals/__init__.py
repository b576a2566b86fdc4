"""What an engineer asks of a controller beyond the least norm, as its section of a vehicle file says."""
