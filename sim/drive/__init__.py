"""Cases, drivers and the loop in MuJoCo; responses, and the ends of the linear regime."""

RUNS_AT_ONCE = 256  # more hardly save time
