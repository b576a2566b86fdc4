"""The gallery: a comparison of published numbers with the numbers that Roadproof computes.

Start with `entries`, which reads the published numbers of a source. `numbers` computes the same quantities with Roadproof;
`report` prints published and computed numbers.
"""
