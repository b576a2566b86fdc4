"""Cost of a low sample rate: norm of a loop as a function of the sample period, and the stability limit of the loop."""
