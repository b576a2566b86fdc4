"""The gallery: a comparison of published numbers with those that Roadproof computes.

Start with `entries`, which reads the published numbers of a source. `numbers` computes the same numbers; `report` prints both.
"""
