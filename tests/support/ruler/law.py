"""A law in Python with a state and the road ahead."""


def step(sample, state):
    """Skyhook damping with a filtered velocity."""
    filtered = 0.9 * (state or 0.0) + 0.1 * sample["sprung_velocity"]
    return -900.0 * filtered - 500.0 * float(sample.preview[0][-1]) + 300.0 * sample.y[1], filtered
