"""Vehicle files: parameters, controllers, goals, weights, limits and implementation.

The package also builds the MuJoCo model of a vehicle.
"""
