"""What a vehicle file asks of a controller, as a plant with its measurements."""
