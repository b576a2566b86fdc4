"""Cost of a low sample rate: norm of a loop as a function of the sample period, and the shortest period at which the loop is
unstable.
"""
