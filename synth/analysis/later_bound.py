"""A lower bound that is proved only when it is read, as most of those who design a controller never ask for it."""

from collections.abc import Callable
from functools import cached_property
from typing import Any


class LaterBound:
    """A `LowerBound` that is proved when one of its attributes is first read; for workers, it is proved before it is sent."""

    def __init__(self, prove: Callable[[], Any]) -> None:
        self._prove = prove

    @cached_property
    def _proved(self) -> Any:
        return self._prove()

    def __getattr__(self, name: str) -> Any:
        """Returns an attribute of the bound."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self._proved, name)

    def __reduce__(self) -> tuple[Callable[[Any], Any], tuple[Any]]:
        return proved, (self._proved,)


def proved(bound: Any) -> Any:
    """Returns a bound itself."""
    return bound
