"""Maximum-likelihood estimates of the parameters of a vehicle: problem, residuals, search, identifiability and likelihood
profiles.
"""
