"""Cost of a low sample rate: the norm of a controller over the sample period, and its stability limit."""
