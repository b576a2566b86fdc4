"""Multi-objective design: minimises one norm with bounds on other quantities, for one or more plants, with gain errors."""
