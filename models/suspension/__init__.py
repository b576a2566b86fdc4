"""What is not linear in a suspension: curves of dampers and springs, adjustable dampers, bump stops."""

STOP_KEYS = ("suspension_stroke", "stop_stiffness")  # what is said of bump stops

LEAVES = 0.1  # of a curve's largest force either way: by that it has left its line
