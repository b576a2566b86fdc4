"""Multi-objective design: minimises one norm with bounds on others, for one or several plants, with gain errors."""
