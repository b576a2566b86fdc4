"""What a controller is: LMIs over any linear plant, and certificates. It knows no vehicle beyond the door `controller.py`."""

from models.common.interrupt import quiet_start

quiet_start()  # the first line of ours that `python -m` runs
