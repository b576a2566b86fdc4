"""What a run is: roads, MuJoCo, the linear response, their comparison, logs, and the commands."""
