"""Identification from the spectra of logs of a random road."""
