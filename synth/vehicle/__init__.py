"""Controllers of a vehicle file: design methods, trade-offs, sample rates, the paper's controllers, and conversion to and from
python-control.
"""
