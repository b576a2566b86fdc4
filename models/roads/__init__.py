"""Roads and loads: excitation of a vehicle, with exact derivatives."""
