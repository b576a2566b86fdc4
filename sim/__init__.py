"""What a run is: roads, MuJoCo, the linear response, their comparison, logs, and the commands."""

from models.common.interrupt import quiet_start

quiet_start()  # the first line of ours that `python -m` runs
