"""Identification of a vehicle from the spectra of logs that were recorded on a random road."""
