"""The door for vehicles: a vehicle's signals as a plant, and a law as a controller, with what is proved of it and as built."""
