"""Vehicle files: parameters, controllers, goals, weights, limits and implementation; and the MuJoCo model."""
