"""Answers of controllers that are not linear to what a simulation asks of every controller."""


class NonlinearLaw:
    """Base of such controllers: they have no linear states, no road ahead and no delay of their own, unless they say so."""

    @property
    def states(self) -> int:
        """Number of states of a linear law: zero."""
        return 0

    @property
    def serial(self) -> bool:
        """True if only one thread at a time can execute the law."""
        return False

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
