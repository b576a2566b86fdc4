"""Studies of MuJoCo runs and of control loops: ride, frequency responses, stability margins, validity of linear analysis, and
others.

Start with `study`, which defines the interface of all studies, and `subject`, which holds the vehicle and controllers of a
report. Each subpackage contains one group of studies.
"""
