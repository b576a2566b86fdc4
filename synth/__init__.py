"""What a controller is: LMIs over any linear plant, and certificates. It knows no vehicle beyond the door `controller.py`."""
