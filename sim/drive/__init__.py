"""The MuJoCo response of N runs, and its energy balance."""

RUNS_AT_ONCE = 256  # more hardly save time
