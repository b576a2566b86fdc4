"""Vehicle files: parameters, controllers, goals, weights, limits and implementation. Also builds the MuJoCo model."""
