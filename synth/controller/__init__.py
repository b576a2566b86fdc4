"""Controllers of vehicles: a vehicle's signals as a plant, a law with its certificate, and the loop as implemented."""
