"""Formats of numbers in sentences and messages: one for each kind of quantity, so that its digits are the same everywhere.

The columns of tables have fields instead (`models.document.field`).
"""

NORM_DIGITS = ".7g"  # of a norm, a bound on one, and a level
digits = f"{{:{NORM_DIGITS}}}".format
entry = "{:.6g}".format  # of a gain or a law
rough = "{:.4g}".format  # of a pole, a rate, a time, a slope
signed = "{:+.4g}".format  # of a change, or an imaginary part
brief = "{:.3g}".format  # of a size that only compares
about = "{:.2g}".format  # of an estimate
difference = "{:.1e}".format  # of a difference
magnitude = "{:.0e}".format  # of rounding errors
exactly = "{:.10g}".format  # of claims that do not hold, which may differ from the truth by little
margin = "{:#.2g}".format  # in warnings
place = "{:.12g}".format  # of a point in a table that is wrong
