"""Cost of a low sample rate: norm of a controller as a function of the sample period, and its stability limit."""
