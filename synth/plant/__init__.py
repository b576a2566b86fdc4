"""The generalized plant (15): its matrices, its units, filters at its ends, and the map from discrete time."""
