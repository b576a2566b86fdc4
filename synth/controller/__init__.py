"""Controllers of vehicles: the vehicle model as a plant, control laws with certificates, and the sampled-data implementation of
a law.
"""
