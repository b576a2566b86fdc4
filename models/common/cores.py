"""How many processors this process may use."""

import os


def cores() -> int:
    """At least 1. A container or a scheduler may allow fewer than the machine has, where the system can tell."""
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed is not None else os.cpu_count() or 1
