"""Kinds of vehicles: equations, parameters and signals; the shipped ones, and the user's own."""
