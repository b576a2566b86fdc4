"""Properties of a controller that a simulation needs; defaults are those of a law without states, preview and own delay."""


class ControlLaw:
    """Base of all controllers."""

    serial = False  # True if only one thread at a time can execute the law

    @property
    def states(self) -> int:
        """Number of states of a linear law."""
        return 0

    @property
    def own_delay(self) -> float:
        """Delay of the outputs that the law has itself [samples]."""
        return 0

    def preview_samples(self, period: float) -> int:
        """Returns the number of road heights that the law reads under each wheel, the present one included; 0 without preview.

        Args:
            period: sample period [s].
        """
        return 0

    def state_scale(self, period: float) -> float:
        """Returns the factor from the states that a linear law is run with to its own."""
        return 1.0
