"""Multi-objective design: minimises one norm with bounds on other quantities, for one or more plants, and for gain errors of
sensors and actuators.
"""
