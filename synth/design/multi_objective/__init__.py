"""Multi-objective design: one norm minimised within bounds on others, for one plant or several, with errors."""
