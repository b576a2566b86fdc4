"""Studies of runs and loops: ride, frequency responses, stability margins, validity of linear analysis, and others.

Start with `study`, which defines the interface of all studies, and `subject`, the vehicle and controllers of a report. Each
package below this one contains one group of studies.
"""
