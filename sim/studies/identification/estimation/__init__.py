"""Maximum-likelihood estimates of the parameters of a vehicle: problem, residuals, search, structure and profiles."""
