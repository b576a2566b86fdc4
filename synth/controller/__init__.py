"""Controllers of vehicles: the vehicle as a plant, control laws with certificates, and the sampled-data implementation."""
